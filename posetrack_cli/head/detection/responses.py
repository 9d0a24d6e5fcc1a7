"""Upright patches of a face at a standard size, and response maps of its points **[ours]**.

Corners are the structure tensor's smaller eigenvalue (thesis, 3.2). On a face that is not sufficient, since
the iris is the strongest corner, so it is combined with drawn templates: a dark wedge (corner of a lid or of
the lips), a dark bar that ends (inner end of a brow), a dark disc (nostril) and an arc (wings and base of the
nose).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray

PIXELS_PER_MM = 60.0 / 63.0
"""An average face's eye distance is 63 mm, and 60 pixels in a patch."""
WIDTH = HEIGHT = 220
MIDDLE = np.array([110.0, 75.0])
"""Nominal midpoint between the eyes in a patch."""


@dataclass(frozen=True, eq=False)
class FacePatch:
    """A part of an image at standard size.

    Attributes:
        grey: (HEIGHT, WIDTH) uint8.
        patch_T_image: (2, 3) similarity from pixels of the image to pixels of the patch.
    """

    grey: ImageArray
    patch_T_image: FloatArray

    @property
    def scale(self) -> float:
        """Patch pixels per image pixel."""
        return float(np.hypot(*self.patch_T_image[0, :2]))

    @property
    def roll(self) -> float:
        """Rotation, rad, that makes the image upright."""
        return float(np.arctan2(self.patch_T_image[0, 1], self.patch_T_image[0, 0]))

    def from_image(self, pixels: FloatArray) -> FloatArray:
        """Convert pixels (..., 2) of the image to pixels of the patch."""
        moved: FloatArray = pixels @ self.patch_T_image[:, :2].T + self.patch_T_image[:, 2]
        return moved

    def to_image(self, pixels: FloatArray) -> FloatArray:
        """Convert pixels (..., 2) of the patch to pixels of the image."""
        inverse = np.linalg.inv(self.patch_T_image[:, :2])
        moved: FloatArray = (pixels - self.patch_T_image[:, 2]) @ inverse.T
        return moved


def cut_patch(image: ImageArray, middle: FloatArray, pixels_per_mm: float, roll: float) -> FacePatch:
    """Cut the patch of a face with known eye midpoint (2,), scale and roll (rad, clockwise)."""
    scale = PIXELS_PER_MM / pixels_per_mm
    cos, sin = scale * np.cos(roll), scale * np.sin(roll)
    turn = np.array([[cos, sin], [-sin, cos]])
    transform = np.column_stack([turn, MIDDLE - turn @ middle])
    grey = _smoothed(image, scale)
    patch = cv2.warpAffine(
        grey, transform, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return FacePatch(patch, transform)


def _smoothed(image: ImageArray, scale: float) -> ImageArray:
    """Blur an image before reduction, to avoid aliasing."""
    if scale >= 0.7:
        return image
    return cv2.GaussianBlur(image, (0, 0), 0.5 * np.sqrt(1.0 / scale**2 - 1.0))


SMOOTHING = 0.7
# Suppression of a wedge's response by the opposite wedge's: inside a line both respond.
END_STOPPING = 0.6
# Quantile of corner strength and contrast that is mapped to 1.
FULL = 0.995


def response_maps(grey: ImageArray) -> Float32Array:
    """Return the responses (K + 1, height, width), 0..1, of each feature in an upright patch.

    The features are the ten points and the nose base, as in ``face.points.FITTED``.
    """
    smooth = _blurred(grey.astype(np.float32), SMOOTHING)
    opening_right, opening_left = _end_stopped(_matched(smooth, wedge(1)), _matched(smooth, wedge(-1)))
    corners = _corners(smooth)
    outer_right, outer_left = np.sqrt(opening_right * corners), np.sqrt(opening_left * corners)
    dark_corners = corners * _darkness(smooth)
    inner_right = np.sqrt(dark_corners * (0.3 + 0.7 * opening_left))
    inner_left = np.sqrt(dark_corners * (0.3 + 0.7 * opening_right))
    eyes = [outer_right, inner_right, inner_left, outer_left]
    maps = [*eyes, outer_right, outer_left, *_nose_and_brows(smooth)]
    return np.stack(maps).astype(np.float32)


@cache
def wedge(side: int) -> Float32Array:
    """Return a dark wedge on white, its tip at the centre, open to the right (1) or left (-1)."""
    return _drawn(7, 5, lambda x, y: (side * x > 0) & (abs(y) < 0.2 * side * x + 1.0))


@cache
def bar(side: int, half_thickness: float) -> Float32Array:
    """Return a dark bar on white that starts at the centre and extends to one side."""
    return _drawn(13, 10, lambda x, y: (side * x > 0) & (abs(y) < half_thickness))


@cache
def disc(radius: float = 3.5) -> Float32Array:
    """Return a dark disc on white, wider than high like a nostril."""
    return _drawn(8, 7, lambda x, y: (x / 1.4) ** 2 + y**2 < radius**2)


@cache
def arc(half_width: float = 19.0, half_thickness: float = 3.5) -> Float32Array:
    """Return a dark arc on white, open at the top, like the wings and base of a nose."""

    def on_arc(x: Any, y: Any) -> Any:
        radius = np.hypot(x / half_width, (y + 3.0) / (0.5 * half_width))
        return (abs(radius - 1.0) < half_thickness / half_width) & (y > -6.0)

    return _drawn(26, 11, on_arc)


def _drawn(half_width: int, half_height: int, dark: Callable[[Any, Any], Any]) -> Float32Array:
    """Draw the dark region at pixel offsets (x, y) from the centre, antialiased and slightly blurred."""
    samples = 8
    rows, columns = (2 * half_height + 1) * samples, (2 * half_width + 1) * samples
    y, x = np.mgrid[0:rows, 0:columns]
    x, y = (x + 0.5) / samples - half_width - 0.5, (y + 0.5) / samples - half_height - 0.5
    drawn = np.where(dark(x, y), 0.0, 1.0).astype(np.float32)
    size = (2 * half_width + 1, 2 * half_height + 1)
    small: ImageArray = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
    template = _blurred(small, 0.9)
    template.setflags(write=False)
    return template


def _nose_and_brows(smooth: Float32Array) -> list[Float32Array]:
    contrast = _contrast(smooth)
    round_ = np.sqrt(_matched(smooth, disc()) * contrast)
    nostrils = [0.5 * (np.sqrt(_matched(smooth, bar(side, 5.0)) * contrast) + round_) for side in (-1, 1)]
    brows = [np.sqrt(_matched(smooth, bar(side, 3.0)) * contrast) for side in (-1, 1)]
    return [*nostrils, *brows, _matched(smooth, arc()) * contrast]


def _matched(smooth: Float32Array, template: Float32Array) -> Float32Array:
    """Return the normalised correlation of a template at every place; 0 where negative."""
    half_height, half_width = template.shape[0] // 2, template.shape[1] // 2
    border = cv2.copyMakeBorder(
        smooth, half_height, half_height, half_width, half_width, cv2.BORDER_REPLICATE
    )
    return np.maximum(cv2.matchTemplate(border, template, cv2.TM_CCOEFF_NORMED), 0.0)


def _end_stopped(right: Float32Array, left: Float32Array) -> tuple[Float32Array, Float32Array]:
    return np.maximum(right - END_STOPPING * left, 0.0), np.maximum(left - END_STOPPING * right, 0.0)


def _corners(smooth: Float32Array) -> Float32Array:
    """Return the square root of the structure tensor's smaller eigenvalue, normalised to 1."""
    return _full_at_one(_root(cv2.cornerMinEigenVal(smooth, 5, ksize=3)))


def _darkness(smooth: Float32Array) -> Float32Array:
    """Return 0..1, a logistic function of the grey level difference to the surroundings."""
    difference = smooth - _blurred(smooth, 10.0)
    darkness: Float32Array = 1.0 / (1.0 + np.exp(difference / np.float32(6.0)))
    return darkness


def _contrast(smooth: Float32Array) -> Float32Array:
    """Return the local contrast, 0..1, to which correlation is invariant."""
    detail = np.abs(smooth - _blurred(smooth, 8.0))
    return _root(_full_at_one(_blurred(detail, 4.0)))


def _full_at_one(values: Float32Array) -> Float32Array:
    full = np.quantile(values, FULL)
    relative: Float32Array = np.clip(values / np.float32(max(float(full), 1e-6)), 0.0, 1.0)
    return relative


def _root(values: ImageArray) -> Float32Array:
    """Return the square root; negative rounding errors count as 0."""
    root: Float32Array = np.sqrt(np.maximum(values, 0.0))
    return root


def _blurred(values: Float32Array, sigma: float) -> Float32Array:
    blurred: ImageArray = cv2.GaussianBlur(values, (0, 0), sigma)
    return blurred
