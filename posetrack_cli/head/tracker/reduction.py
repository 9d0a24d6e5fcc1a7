"""Images reduced to the size that patches are made for **[ours]**.

Patches have 16 x 16 pixels, which the thesis chose for faces whose eyes are some 60 to 90 pixels apart. Of
a face that fills a large image they show a piece of a lid: a blink or a smile changes all of it. Such images
are reduced once the face was first found. Poses are in millimetres and do not change.
"""

from __future__ import annotations

from dataclasses import replace

import cv2

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import Frame

WHOLE = 1.0
"""The scale of images as recorded."""
LEAST_REDUCTION = 0.8
"""Images that would become hardly smaller stay as they are."""


def scale_for(eye_distance_px: float, wanted_px: float) -> float:
    """Return the scale that makes the eyes of a large face ``wanted_px`` apart; smaller faces stay."""
    scale = wanted_px / eye_distance_px
    return WHOLE if scale > LEAST_REDUCTION else scale


def reduced(frame: Frame, scale: float) -> Frame:
    """Return a frame with its image reduced; as it is for a scale of 1."""
    (image,) = frame.images
    if scale == WHOLE or image is None:
        return frame
    height, width = (_length(side, scale) for side in image.shape)
    return replace(frame, images=(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA),))


def reduced_camera(camera: Camera, scale: float) -> Camera:
    """Return the camera of reduced images: pixel u is at (u + 1/2) w'/w - 1/2."""
    if scale == WHOLE:
        return camera
    width, height = _length(camera.width, scale), _length(camera.height, scale)
    across, down = width / camera.width, height / camera.height
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * across,
        fy=camera.fy * down,
        cx=(camera.cx + 0.5) * across - 0.5,
        cy=(camera.cy + 0.5) * down - 0.5,
    )


def reduced_pixels(pixels: FloatArray, scale: float) -> FloatArray:
    """Return where pixels (..., 2) are after a reduction, to a thousandth of the image."""
    return pixels if scale == WHOLE else (pixels + 0.5) * scale - 0.5


def _length(side: int, scale: float) -> int:
    return max(round(side * scale), 1)
