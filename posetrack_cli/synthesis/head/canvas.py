"""The texture that a head is painted on, and the strokes that everything on it is painted with."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.synthesis.head.form import BOTTOM, TOP, angle_of, half_width, height, smooth_head
from posetrack_cli.synthesis.head.skin_grid import POCKET_BAND, TEXTURE_SIZE, texel_angles, texel_levels
from posetrack_cli.synthesis.head.smooth import smooth_step

MARGIN_MM = 2.0
Box = tuple[float, float, float, float]
"""Smallest and largest x, smallest and largest y, mm, of the average head."""


class Canvas:
    """Reflectance and gloss of a head's skin.

    Attributes:
        reflectance, gloss: (rows, columns) float32, 0 to 1.
        texel_mm: about the size of a texel.
    """

    def __init__(self, reflectance: float, size: tuple[int, int] = TEXTURE_SIZE) -> None:
        self.reflectance: Float32Array = np.full(size, reflectance, dtype=np.float32)
        self.gloss: Float32Array = np.zeros(size, dtype=np.float32)
        self._levels, self._pocket = texel_levels(size[0])
        self._angles = texel_angles(size[1])
        self.texel_mm = (TOP - BOTTOM + POCKET_BAND) / size[0]

    @cached_property
    def places(self) -> FloatArray:
        """(rows, columns, 3) of every texel on the smooth average head, mm."""
        return smooth_head(self._angles[None, :], self._levels[:, None])

    @property
    def pocket(self) -> FloatArray:
        """(rows,) place in the pocket behind the lips, 0 above and 1 below it."""
        return self._pocket

    def paint(self, box: Box, tone: float, cover: Callable[[FloatArray, FloatArray], FloatArray]) -> None:
        """Blend a tone in: cover(x, y) is its opacity, 0 to 1."""
        self.change(box, lambda x, y, old: old + cover(x, y) * (tone - old))

    def shade(self, box: Box, factor: Callable[[FloatArray, FloatArray], FloatArray]) -> None:
        """Multiply the reflectance by factor(x, y)."""
        self.change(box, lambda x, y, old: old * factor(x, y))

    def polish(self, box: Box, gloss: float, cover: Callable[[FloatArray, FloatArray], FloatArray]) -> None:
        """Blend a gloss in: cover(x, y) is its opacity."""
        window = self.window(box)
        x, y = self._seen(window)
        part = self.gloss[window]
        part += cover(x, y) * (gloss - part)

    def change(
        self, box: Box, new: Callable[[FloatArray, FloatArray, Float32Array], FloatArray | Float32Array]
    ) -> None:
        """Replace the reflectance in a box by new(x, y, old)."""
        window = self.window(box)
        x, y = self._seen(window)
        self.reflectance[window] = new(x, y, self.reflectance[window])

    def texture(self) -> ImageArray:
        """The canvas (rows, columns, 2) as 8-bit texture."""
        both = np.stack([self.reflectance, self.gloss], axis=-1)
        codes: ImageArray = np.rint(np.clip(both, 0.0, 1.0) * 255.0).astype(np.uint8)
        return codes

    def window(self, box: Box) -> tuple[slice, slice]:
        """The texels that a box in front may cover."""
        low_x, high_x, low_y, high_y = box
        levels = np.linspace(low_y, high_y, 9)
        columns = self._columns(low_x, levels, min), self._columns(high_x, levels, max)
        heights = height(self._levels)
        rows = np.flatnonzero((heights <= high_y + MARGIN_MM) & (heights >= low_y - MARGIN_MM))
        return slice(rows[0], rows[-1] + 1), slice(max(columns[0] - 2, 0), columns[1] + 3)

    def _columns(self, x: float, levels: FloatArray, pick: Callable[..., float]) -> int:
        angle = float(pick(angle_of(np.full(len(levels), x), levels).tolist()))
        return int((angle / np.pi + 1.0) / 2.0 * len(self._angles))

    def _seen(self, window: tuple[slice, slice]) -> tuple[FloatArray, FloatArray]:
        """x and y, mm, (rows, columns) of a window's texels as seen from in front."""
        levels, angles = self._levels[window[0]], self._angles[window[1]]
        x = half_width(levels)[:, None] * np.sin(angles)[None, :]
        return x, np.broadcast_to(height(levels)[:, None], x.shape)


def blob(
    x: FloatArray, y: FloatArray, middle: tuple[float, float], spread: tuple[float, float]
) -> FloatArray:
    """Return a Gaussian spot (...) of height 1."""
    spot: FloatArray = np.exp(
        -0.5 * ((x - middle[0]) / spread[0]) ** 2 - 0.5 * ((y - middle[1]) / spread[1]) ** 2
    )
    return spot


def inside(distance: FloatArray, soft: float) -> FloatArray:
    """Return 1 where a signed distance (...), mm, is positive, 0 where negative; soft over ``soft`` mm."""
    return smooth_step(distance / soft + 0.5)
