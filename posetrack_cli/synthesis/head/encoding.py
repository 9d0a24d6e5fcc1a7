"""How the images of a synthetic recording are stored."""

from __future__ import annotations

from typing import Any

import cv2

from posetrack_cli.arrays import ImageArray

FORMATS = ("jpeg", "png", "raw")
SUFFIXES = {"jpeg": ".jpg", "png": ".png"}
JPEG_QUALITY = 95
PNG_LEVEL = 1
"""Noise does not compress: level 9 takes ten times as long for some per cent."""


def encoded(image: ImageArray, image_format: str) -> bytes:
    """Return an image (height, width) uint8 as JPEG or PNG."""
    options = {
        "jpeg": [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY],
        "png": [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL],
    }
    _, data = cv2.imencode(SUFFIXES[image_format], image, options[image_format])
    return data.tobytes()


def message_class(image_format: str) -> Any:
    """Return foxglove's class of an image message."""
    if image_format == "raw":
        from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

        return RawImage
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    return CompressedImage


def image_message(image: ImageArray, image_format: str, frame_id: str, stamp_ns: int) -> bytes:
    """Return an image as a serialised foxglove message, mono8 or compressed."""
    if image_format == "raw":
        height, width = image.shape
        content = {"width": width, "height": height, "encoding": "mono8", "step": width}
        message = message_class(image_format)(frame_id=frame_id, data=image.tobytes(), **content)
    else:
        data = encoded(image, image_format)
        message = message_class(image_format)(frame_id=frame_id, format=image_format, data=data)
    message.timestamp.FromNanoseconds(stamp_ns)
    return bytes(message.SerializeToString(deterministic=True))
