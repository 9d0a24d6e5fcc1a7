"""Images scaled to the size that patches are made for **[ours]**.

Patches have 16 x 16 pixels, which the thesis chose for faces whose eyes are some 60 to 90 pixels apart. Of
a face that fills a large image they show a piece of a lid: a blink or a smile changes all of it. Of a small
one they show half of the face, so that points which lie at different depths are found to move alike, and a
turn is lost. Images are reduced, or the face's part of them is enlarged, once it was first found, and anew
where it comes much nearer or goes away. Poses are in millimetres and do not change.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import Frame

WHOLE = 1.0
"""The scale of images as recorded."""
LEAST_REDUCTION = 0.8
"""Images that would become hardly smaller, or hardly larger, stay as they are."""
STEP = 0.25
"""Images are enlarged by multiples: then every fourth pixel's edge falls on one of the enlarged image."""
LARGEST_SIDE_PX = 8192
"""No image is enlarged beyond."""
TOO_FAR = 1.6
"""A face is looked at at another scale where its eyes are so many times farther apart than wanted, or as much
less: from thence back it is a long way, so that no head at one place is looked at now so, now so."""
MARGIN_PX = 160
"""Enlarged is what lies no farther from a face's points: twice the eyes' distance, farther than patches and
windows reach in a frame."""
_EVERY = round(1.0 / STEP)


class Scaling(NamedTuple):
    """How a camera's images are scaled.

    Attributes:
        wanted_px: between the eyes of a face.
        largest: no image is enlarged by more; 1 leaves small faces as they are.
        camera: as recorded.
    """

    wanted_px: float
    largest: float
    camera: Camera

    def of_face(self, eye_distance_px: float) -> float:
        """Return the scale that brings a face's eyes, as recorded, to the distance wanted, or nearly so."""
        scale = self.wanted_px / eye_distance_px
        return WHOLE if LEAST_REDUCTION < scale <= 1.0 / LEAST_REDUCTION else self.usable(scale)

    def usable(self, scale: float) -> float:
        """Return the nearest scale that images are looked at at."""
        if scale <= WHOLE:
            return scale
        largest = min(self.largest, LARGEST_SIDE_PX / max(self.camera.width, self.camera.height))
        return max(min(round(scale / STEP), int(largest / STEP)) * STEP, WHOLE)

    def fitting(self, scale: float, eye_distance_px: float) -> float:
        """Return the scale to go on with: the same unless eyes so far apart, as recorded, ask for another."""
        fits = 1.0 / TOO_FAR <= scale * eye_distance_px / self.wanted_px <= TOO_FAR
        return scale if fits else self.of_face(eye_distance_px)


def reduced(frame: Frame, scale: float) -> Frame:
    """Return a frame with its image reduced; as it is for a scale of 1 or more."""
    (image,) = frame.images
    if scale >= WHOLE or image is None:
        return frame
    height, width = (_length(side, scale) for side in image.shape)
    return replace(frame, images=(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA),))


def enlarged(frame: Frame, scale: float, pixels: FloatArray) -> Frame:
    """Return a frame with its image enlarged about a face, and black elsewhere.

    Args:
        frame: as recorded.
        scale: above 1, a multiple of ``STEP``.
        pixels: (K, 2) of the face, about, in the enlarged image.
    """
    (image,) = frame.images
    if image is None:
        return frame
    height, width = (_length(side, scale) for side in image.shape)
    canvas: ImageArray = np.zeros((height, width), dtype=image.dtype)
    low, high = (np.nan_to_num(end) for end in (np.nanmin(pixels, axis=0), np.nanmax(pixels, axis=0)))
    sides = np.array(image.shape[::-1])
    first = np.clip((low - MARGIN_PX) / scale, 0, sides).astype(int) // _EVERY * _EVERY
    behind = np.clip(-(-(high + MARGIN_PX) // scale), 0, sides).astype(int)
    if np.all(behind > first):
        part = image[first[1] : behind[1], first[0] : behind[0]]
        large = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        left, top = np.rint(first * scale).astype(int)
        there = canvas[top : top + large.shape[0], left : left + large.shape[1]]
        there[:] = large[: there.shape[0], : there.shape[1]]
    return replace(frame, images=(canvas,))


def scaled_camera(camera: Camera, scale: float) -> Camera:
    """Return the camera of scaled images: pixel u is at (u + 1/2) w'/w - 1/2, of enlarged ones exactly."""
    if scale == WHOLE:
        return camera
    width, height = _length(camera.width, scale), _length(camera.height, scale)
    across, down = (scale, scale) if scale > WHOLE else (width / camera.width, height / camera.height)
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * across,
        fy=camera.fy * down,
        cx=(camera.cx + 0.5) * across - 0.5,
        cy=(camera.cy + 0.5) * down - 0.5,
    )


def scaled_pixels(pixels: FloatArray, scale: float) -> FloatArray:
    """Return where pixels (..., 2) are after scaling; after a reduction to a thousandth of the image."""
    return pixels if scale == WHOLE else (pixels + 0.5) * scale - 0.5


def _length(side: int, scale: float) -> int:
    return max(round(side * scale), 1)
