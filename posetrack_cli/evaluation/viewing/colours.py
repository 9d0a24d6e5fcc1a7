"""Colours of pictures, blue green red as OpenCV has them: depth in false colour, shaded surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray

Colour = tuple[int, int, int]

SKIN: Colour = (150, 200, 235)
SECOND: Colour = (235, 190, 120)
TRUTH: Colour = (120, 255, 120)
LOST: Colour = (60, 60, 255)
FOUND_ANEW: Colour = (60, 190, 255)
TEXT: Colour = (235, 235, 235)
TONES = (SKIN, SECOND)

# A hand and what is near behind it get most colours; a body further back is dark blue.
_IN_FRONT_MM, _BEHIND_MM = 90.0, 330.0
_USUAL_MM = (450.0, 1100.0)
_BLUEST = 14.0  # of 255: the colour map's lowest end is nearly black, which means no reading
_STEEPEST = 2.0  # mm per pixel at scale 1: steeper surfaces are as dark
_AMBIENT, _SLOPE_LIGHT = 0.75, 0.25


@dataclass(frozen=True)
class DepthRange:
    """The depths that get colours, mm: ``near`` is red, ``far`` blue."""

    near: float
    far: float

    @classmethod
    def of_points(cls, z: FloatArray) -> DepthRange:
        """Around the depths of tracked points (any shape), mm; outliers do not count."""
        good = z[np.isfinite(z) & (z > 0)]
        if not good.size:
            return cls(*_USUAL_MM)
        low, high = np.percentile(good, [1.0, 99.0])
        return cls(max(0.0, float(low) - _IN_FRONT_MM), float(high) + _BEHIND_MM)


def false_colour(depth: Float32Array, depths: DepthRange) -> ImageArray:
    """Depth (h, w), mm, as a picture (h, w, 3): near is red, far is blue, no reading is black."""
    gain = (255.0 - _BLUEST) / (depths.far - depths.near)
    value = np.clip(_BLUEST + (depths.far - depth) * gain, _BLUEST, 255.0).astype(np.uint8)
    picture: ImageArray = cv2.applyColorMap(value, cv2.COLORMAP_TURBO)
    picture[depth <= 0] = 0
    return picture


def lit(depth: Float32Array, mm_per_pixel: float) -> FloatArray:
    """How bright a surface (h, w), mm, 0 where there is none, is under light from the upper left: 0 to 1.

    Args:
        depth: of the surface.
        mm_per_pixel: how far apart neighbouring pixels of a plain surface lie at its depth.
    """
    down, right = np.gradient(np.where(depth > 0, depth, np.nan))
    slope = np.clip((down + right) / max(mm_per_pixel, 1e-3), -_STEEPEST, _STEEPEST)
    light = _AMBIENT - _SLOPE_LIGHT * slope
    return np.asarray(np.clip(np.nan_to_num(light, nan=0.5), 0.15, 1.0), dtype=np.float64)


def shaded(colours: ImageArray, light: FloatArray) -> ImageArray:
    """Colours (h, w, 3) or (3,) under a light (h, w)."""
    return np.asarray(light[..., None] * colours, dtype=np.uint8)
