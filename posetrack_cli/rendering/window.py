"""The part of a camera's image that a tile shows, and how finely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.geometry.camera import Camera


@dataclass(frozen=True)
class Window:
    """A grid of image pixels, every ``step``-th in both directions, that one tile samples.

    Tile pixel (i, j) shows image pixel (left + i step, top + j step): both are rays through pixel
    centres, so nothing is blurred. The window may reach over the image's edge.
    """

    left: int
    top: int
    step: int
    width: int
    height: int

    @classmethod
    def whole(cls, camera: Camera) -> Window:
        """The whole image, every pixel."""
        return cls(0, 0, 1, camera.width, camera.height)

    @classmethod
    def around(cls, pixel: FloatArray, size: int, step: int) -> Window:
        """A square of size tile pixels centred on an image pixel (2,)."""
        half = 0.5 * (size - 1) * step
        left, top = (round(float(p) - half) for p in pixel)
        return cls(left, top, step, size, size)

    @property
    def centre(self) -> FloatArray:
        """The image pixel (2,) in the middle."""
        half = 0.5 * self.step * np.array([self.width - 1, self.height - 1])
        return np.array([self.left, self.top]) + half

    def columns(self) -> IntArray:
        """Image columns of the tile's columns, also those outside the image."""
        return self.left + self.step * np.arange(self.width)

    def rows(self) -> IntArray:
        """Image rows of the tile's rows, also those outside the image."""
        return self.top + self.step * np.arange(self.height)

    def tile_projection(self, camera: Camera) -> tuple[float, float, float, float]:
        """(a, b, c, d): a point falls on tile x = a X/Z + b, y = c Y/Z + d; pixel (0, 0) spans 0..1."""
        a, c = camera.fx / self.step, camera.fy / self.step
        b = (camera.cx - self.left) / self.step + 0.5
        d = (camera.cy - self.top) / self.step + 0.5
        return a, b, c, d
