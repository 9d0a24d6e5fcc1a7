"""Grey images in MCAP messages: which encodings can be made grey, and how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.mcap.decoding import COMPRESSED_IMAGE, RAW_IMAGE
from posetrack_cli.recording.grey import (
    StoredKind,
    check_size,
    decode_as_stored,
    decode_grey,
    grey_of,
    kind_of_image,
)
from posetrack_cli.recording.image_files import JPEG_BEGIN, PNG_SIGNATURE, WEBP_BEGIN
from posetrack_cli.recording.stored import UnreadableImageError


@dataclass(frozen=True)
class RawEncoding:
    """How a raw image stores its pixels.

    Attributes:
        dtype: of a value, without byte order.
        channels: values per pixel.
        conversion: OpenCV's code to grey; None where it is grey.
    """

    dtype: str
    channels: int
    conversion: int | None = None


RAW_GREY = {
    "mono8": RawEncoding("u1", 1),
    "8UC1": RawEncoding("u1", 1),
    "mono16": RawEncoding("u2", 1),
    "16UC1": RawEncoding("u2", 1),
    "rgb8": RawEncoding("u1", 3, cv2.COLOR_RGB2GRAY),
    "bgr8": RawEncoding("u1", 3, cv2.COLOR_BGR2GRAY),
    "8UC3": RawEncoding("u1", 3, cv2.COLOR_BGR2GRAY),
    "rgba8": RawEncoding("u1", 4, cv2.COLOR_RGBA2GRAY),
    "bgra8": RawEncoding("u1", 4, cv2.COLOR_BGRA2GRAY),
    "8UC4": RawEncoding("u1", 4, cv2.COLOR_BGRA2GRAY),
    "rgb16": RawEncoding("u2", 3, cv2.COLOR_RGB2GRAY),
    "bgr16": RawEncoding("u2", 3, cv2.COLOR_BGR2GRAY),
    "uyvy": RawEncoding("u1", 2, cv2.COLOR_YUV2GRAY_UYVY),
    "yuv422": RawEncoding("u1", 2, cv2.COLOR_YUV2GRAY_UYVY),
    "yuyv": RawEncoding("u1", 2, cv2.COLOR_YUV2GRAY_YUY2),
    "yuv422_yuy2": RawEncoding("u1", 2, cv2.COLOR_YUV2GRAY_YUY2),
    # OpenCV names a Bayer pattern by its second row's second and third pixel
    "bayer_rggb8": RawEncoding("u1", 1, cv2.COLOR_BayerBG2GRAY),
    "bayer_bggr8": RawEncoding("u1", 1, cv2.COLOR_BayerRG2GRAY),
    "bayer_gbrg8": RawEncoding("u1", 1, cv2.COLOR_BayerGR2GRAY),
    "bayer_grbg8": RawEncoding("u1", 1, cv2.COLOR_BayerGB2GRAY),
}


def holds_grey(decoded: Any, kind: str | None) -> bool:
    """Whether an image message can be made grey, as far as its head tells."""
    if kind == RAW_IMAGE:
        return str(decoded.encoding) in RAW_GREY
    return kind == COMPRESSED_IMAGE and bytes(decoded.data).startswith(
        (PNG_SIGNATURE, JPEG_BEGIN, WEBP_BEGIN)
    )


def kind_of_message(decoded: Any, kind: str, where: str, bits: int | None = None) -> StoredKind:
    """Tell what a camera's images are like from its first message.

    Raises:
        UnreadableImageError: the data are damaged.
        RecordingError: the pixels are of another kind.
    """
    if kind == RAW_IMAGE:
        return kind_of_image(_stored_pixels(decoded), where, bits)
    return kind_of_image(decode_as_stored(bytes(decoded.data)), where, bits)


def grey_of_message(decoded: Any, kind: str, stored: StoredKind, where: str) -> ImageArray:
    """Return the (height, width) uint8 grey image of a message.

    Raises:
        UnreadableImageError: the data are too short or damaged.
        RecordingError: the image is of another size than the first.
    """
    if kind == COMPRESSED_IMAGE:
        return decode_grey(bytes(decoded.data), stored, where)
    if str(decoded.encoding) not in RAW_GREY:
        raise UnreadableImageError(f"encoding {decoded.encoding} is not known")
    pixels = _stored_pixels(decoded)
    check_size(pixels, stored, where)
    conversion = RAW_GREY[str(decoded.encoding)].conversion
    try:
        return grey_of(pixels if conversion is None else cv2.cvtColor(pixels, conversion), stored.bits)
    except cv2.error as error:  # a width or height that the encoding cannot have
        raise UnreadableImageError(f"{decoded.encoding} cannot be {stored.width}x{stored.height}") from error


def _stored_pixels(decoded: Any) -> ImageArray:
    """Return (height, width) or (height, width, channels) values; rows may be padded to ``step`` bytes."""
    encoding = RAW_GREY[str(decoded.encoding)]
    dtype = np.dtype((">" if getattr(decoded, "is_bigendian", 0) else "<") + encoding.dtype)
    width, height, data = int(decoded.width), int(decoded.height), bytes(decoded.data)
    pixel = dtype.itemsize * encoding.channels
    step = int(decoded.step) or width * pixel
    needed = step * (height - 1) + width * pixel
    if min(width, height) < 1 or step < width * pixel or len(data) < needed:
        raise UnreadableImageError(f"{len(data)} bytes do not hold {width}x{height} {decoded.encoding}")
    shape = (height, width, encoding.channels)
    strided: ImageArray = np.ndarray(shape, dtype, data, strides=(step, pixel, dtype.itemsize))
    whole = strided.astype(dtype.newbyteorder("="))
    return whole[..., 0] if encoding.channels == 1 else whole
