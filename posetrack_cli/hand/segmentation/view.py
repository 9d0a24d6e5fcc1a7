"""The pixels of a window, as points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import Float32Array
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.segmentation.surfaces import pixel_mm, points_of
from posetrack_cli.rendering.window import Window


@dataclass(frozen=True, eq=False)
class View:
    """What a window shows.

    Attributes:
        window: which pixels.
        camera: whose.
        depth: (h, w) readings, mm, 0 = none.
        points: (h, w, 3) mm, camera axes.
        apart: (h, w) distance of neighbouring pixels that face the camera, mm.
    """

    window: Window
    camera: Camera
    depth: Float32Array
    points: Float32Array
    apart: Float32Array

    @classmethod
    def of(cls, depth: Float32Array, window: Window, camera: Camera) -> View:
        """A window of a camera with its readings (h, w), mm."""
        apart = pixel_mm(depth, window, camera).astype(np.float32)
        return cls(window, camera, depth, points_of(depth, window, camera), apart)
