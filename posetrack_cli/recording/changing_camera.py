"""Apply a calibration that changes during a recording, frame by frame.

A recording has one camera model per camera. Images taken under another calibration of the same camera are
resampled to the pixels of the first, which is exact up to a pixel: both see the same rays from one place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, ImageArray
from posetrack_cli.geometry.camera import IN_PLACE, Camera
from posetrack_cli.geometry.projection import pixel_map
from posetrack_cli.recording.base import NotCalibratedError
from posetrack_cli.recording.camera_of import is_same

Dated = tuple[int, Any]
"""Stamp, ns, and decoded message."""


class CurrentCamera:
    """The calibration that holds for an image.

    Args:
        first: camera of the recording's images as they are stored.
        camera_of: makes a camera of a decoded calibration.
    """

    def __init__(self, first: Camera, camera_of: Callable[[Any], Camera]) -> None:
        self._first = replace(first, camera_T_reference=IN_PLACE)
        self._camera_of = camera_of
        self._latest: Any = None
        self._known: Camera | None = None
        self._map: Resampling | None = None

    def resampling(self, calibration: Any) -> Resampling | None:
        """Return how images under a calibration become those of the first; None if they are.

        Raises:
            PosetrackError: the calibration is of another image size or cannot be used.
        """
        if calibration is None or calibration is self._latest:
            return self._map
        try:
            camera = self._camera_of(calibration)
        except NotCalibratedError:  # an empty calibration says nothing new
            return self._map
        self._latest = calibration
        if camera != self._known:
            self._known = camera
            self._map = None if is_same(self._first, camera) else Resampling(self._first, camera)
        return self._map


class Resampling:
    """Resamples images of one camera to the pixels of another in the same place."""

    def __init__(self, target: Camera, source: Camera) -> None:
        self._u, self._v = pixel_map(target, source)
        self._nearest: tuple[Float32Array, Float32Array] = (np.rint(self._u), np.rint(self._v))

    def apply(self, image: ImageArray) -> ImageArray:
        """Return the image at the target's pixels, 0 where the source has none.

        Depth is never interpolated: a value between hand and wall exists nowhere.
        """
        is_depth = image.dtype == np.float32
        u, v = self._nearest if is_depth else (self._u, self._v)
        how = cv2.INTER_NEAREST if is_depth else cv2.INTER_LINEAR
        return np.asarray(cv2.remap(image, u, v, how, borderMode=cv2.BORDER_CONSTANT, borderValue=0))


def with_calibration(items: Iterable[tuple[bool, int, Any]]) -> Iterator[tuple[Any, Any]]:
    """Yield each image with the calibration that holds for it, None before the first.

    That is the one of the same stamp, which drivers write before or after the image, else the latest before.

    Args:
        items: in order of the file, whether it is a calibration, its stamp in ns, and what it is.
    """
    current: Any = None
    waiting: Dated | None = None
    for is_calibration, stamp, item in items:
        if not is_calibration:
            if waiting is not None:
                yield waiting[1], current
            waiting = (stamp, item)
            continue
        if waiting is not None and stamp != waiting[0]:
            yield waiting[1], current
            waiting = None
        current = item
    if waiting is not None:
        yield waiting[1], current
