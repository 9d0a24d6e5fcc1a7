"""Where a palm may be: the middles of the widest discs that fit into the surfaces of an image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, ImageArray, IntArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import DetectionSettings
from posetrack_cli.hand.segmentation.surfaces import (
    behind_others,
    jump_mm,
    pixel_mm,
    points_of,
    rims,
    surface_labels,
    without_pinholes,
)
from posetrack_cli.rendering.window import Window

_BEHIND_JUMPS = 3.0
_SPREAD_MM = 25.0
_APART_MM = 12.0
"""Discs closer together than this are one place."""
PALM_RADIUS_MM = (11.0, 85.0)
"""Of the largest disc on a palm; of a hand seen edge-on the smallest."""
_MOST_PLACES = 24
"""Looked at, the nearest first."""


@dataclass(frozen=True, eq=False)
class Surfaces:
    """A depth image taken apart.

    Attributes:
        window: its pixels.
        depth: (h, w) mm, 0 = no reading; single missing readings bridged.
        points: (h, w, 3) mm, camera axes.
        numbers: (h, w) of the surface, 0 = none.
        sizes: (S,) pixels of each surface, by number.
        behind: (h, w) which readings have a nearer surface beside them.
        radius: (h, w) of the largest disc around a pixel that stays on its surface, mm.
        pixel_mm: (h, w) distance of neighbouring pixels that face the camera.
    """

    window: Window
    depth: Float32Array
    points: Float32Array
    numbers: ImageArray
    sizes: IntArray
    behind: BoolArray
    radius: Float32Array
    pixel_mm: Float32Array


def surfaces_of(depth: Float32Array, window: Window, camera: Camera) -> Surfaces:
    """Take a depth image apart into surfaces.

    Args:
        depth: (h, w) the window's readings, mm, 0 = none.
        window: its pixels.
        camera: its camera.
    """
    unbridged = pixel_mm(depth, window, camera).astype(np.float32)
    whole = without_pinholes(depth, jump_mm(unbridged))
    apart = pixel_mm(whole, window, camera).astype(np.float32)
    jump = jump_mm(apart)
    count, numbers = surface_labels(whole, jump)
    sizes = np.bincount(numbers.ravel(), minlength=count)
    inside = ((whole > 0) & ~rims(whole, jump)).astype(np.uint8)
    # without any rim the distance to one is as large as floats can be
    to_rim = np.minimum(cv2.distanceTransform(inside, cv2.DIST_L2, 3), max(depth.shape))
    radius = (to_rim + 0.5) * apart  # a rim belongs half to its surface
    radius[whole <= 0] = 0.0
    behind = behind_others(whole, _BEHIND_JUMPS * jump)
    return Surfaces(window, whole, points_of(whole, window, camera), numbers, sizes, behind, radius, apart)


def palm_pixels(surfaces: Surfaces, settings: DetectionSettings) -> IntArray:
    """Rows and columns (K, 2) of places where a palm may be, the nearest first.

    They are local maxima of the disc's radius that a palm can have, at a depth where hands are searched for.
    """
    depth, radius = surfaces.depth, surfaces.radius
    low, high = PALM_RADIUS_MM
    in_range = (depth >= settings.nearest_mm) & (depth <= settings.farthest_mm)
    fits = in_range & (radius >= low) & (radius <= high)
    if not fits.any():
        return np.empty((0, 2), dtype=np.int64)
    size = 2 * max(1, round(_APART_MM / float(np.median(surfaces.pixel_mm[fits])))) + 1
    around = cv2.dilate(radius, np.ones((size, size), np.uint8))
    maxima = np.argwhere(fits & (radius >= around))
    places = _spread_out(maxima, surfaces)
    order = np.argsort(depth[places[:, 0], places[:, 1]], kind="stable")
    return np.asarray(places[order][:_MOST_PLACES], dtype=np.int64)


def _spread_out(maxima: IntArray, surfaces: Surfaces) -> IntArray:
    """Of places (K, 2) closer together than a palm's parts the one with the widest disc.

    The middle of an arm as wide everywhere is one maximum beside the other.
    """
    rows, columns = maxima.T
    points = surfaces.points[rows, columns]
    left = np.argsort(-surfaces.radius[rows, columns], kind="stable")
    chosen = []
    while left.size:
        chosen.append(left[0])
        offset = points[left] - points[left[0]]
        left = left[np.einsum("ij,ij->i", offset, offset) >= _SPREAD_MM**2]
    return maxima[chosen]
