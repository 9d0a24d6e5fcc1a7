"""Palm positions and the region of a hand around them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import DetectionSettings
from posetrack_cli.hand.observe.surfaces import (
    behind_others,
    extent_mm,
    jump_mm,
    pixel_mm,
    points_of,
    rims,
    surface_labels,
    without_pinholes,
)
from posetrack_cli.rendering.port import Window

# Possible palms: centres of the widest discs in the surfaces of an image

_BEHIND_JUMPS = 3.0
_SPREAD_MM = 25.0
_APART_MM = 12.0
"""Discs closer together than this are one place."""
PALM_RADIUS_MM = (11.0, 85.0)
"""Range of the largest disc on a palm; smallest for a hand seen edge-on."""
_MAX_PLACES = 24
"""Largest number of places, the nearest first."""


@dataclass(frozen=True, eq=False)
class Surfaces:
    """A depth image split into surfaces.

    Attributes:
        window: its pixels.
        depth: (h, w) mm, 0 = no reading; single missing readings filled.
        points: (h, w, 3) mm, camera axes.
        numbers: (h, w) surface labels, 0 = none.
        sizes: (S,) pixels of each surface, by label.
        behind: (h, w) readings next to a nearer surface.
        radius: (h, w) of the largest disc around a pixel on its surface, mm.
        pixel_mm: (h, w) distance of neighbouring pixels on a surface facing the camera.
    """

    window: Window
    depth: Float32Array
    points: Float32Array
    numbers: ImageArray
    sizes: IntArray
    behind: BoolArray
    radius: Float32Array
    pixel_mm: Float32Array

    @cached_property
    def may_be_islands(self) -> BoolArray:
        """Return by label (S,) whether a surface is large enough and not behind others."""
        behind = np.bincount(self.numbers[self.behind], minlength=len(self.sizes))
        return (self.sizes >= _MIN_PIXELS) & (behind <= _MAX_BEHIND * self.sizes)


def surfaces_of(depth: Float32Array, window: Window, camera: Camera) -> Surfaces:
    """Split a depth image into surfaces.

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
    # without a rim OpenCV returns the largest float
    to_rim = np.minimum(cv2.distanceTransform(inside, cv2.DIST_L2, 3), max(depth.shape))
    radius = (to_rim + 0.5) * apart  # a rim belongs half to its surface
    radius[whole <= 0] = 0.0
    behind = behind_others(whole, _BEHIND_JUMPS * jump)
    return Surfaces(window, whole, points_of(whole, window, camera), numbers, sizes, behind, radius, apart)


def palm_pixels(surfaces: Surfaces, settings: DetectionSettings) -> IntArray:
    """Return rows and columns (K, 2) of possible palms, the nearest first.

    These are local maxima of the disc radius within a palm's range, at depths in the search range.
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
    return np.asarray(places[order][:_MAX_PLACES], dtype=np.int64)


def _spread_out(maxima: IntArray, surfaces: Surfaces) -> IntArray:
    """Keep the place with the widest disc among places (K, 2) of one palm.

    The centre line of an arm of constant width, for example, is a row of maxima.
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


# Region within reach of a palm, its exits, and its similarity to a hand

_RING_MM = 14.0
"""Thickness of the shell in which a region's exits are searched."""
_MIN_PIXELS = 3
_NEAR_PALM_MM = 80.0
"""Distance within which a palm, unlike a finger, is the widest part."""
_MAX_BEHIND = 0.25
_ARM_MM = 150.0
"""Largest width of an arm."""


@dataclass(frozen=True, eq=False)
class Exit:
    """A place where a surface leaves the reach of a palm, or the image.

    Attributes:
        middle: (3,) mm.
        width_mm: its largest extent.
    """

    middle: FloatArray
    width_mm: float


@dataclass(frozen=True, eq=False)
class Region:
    """The surface connected to a palm within its reach.

    Attributes:
        rows, columns: its part of the image.
        mask: (h, w) its pixels in that part.
        points: (h, w, 3) of that part, mm.
        palm: (3,) point on the surface from which reach is measured, mm.
        radius_mm: of the largest disc around the palm.
        widest_mm: of the largest disc near the palm.
        area_mm2: seen from the front.
        behind: share of its rim behind a nearer surface.
        exits: places where it continues; not determined for surfaces that are certainly not a hand.
    """

    rows: slice
    columns: slice
    mask: BoolArray
    points: Float32Array
    palm: FloatArray
    radius_mm: float
    widest_mm: float
    area_mm2: float
    behind: float
    exits: tuple[Exit, ...]

    @cached_property
    def likeness_of_surface(self) -> float:
        """Return the factors of ``likeness`` for disc, area and occlusion."""
        low, high = PALM_RADIUS_MM
        disc = _plateau(self.radius_mm, 0.8 * low, 1.3 * low, 0.8 * high, 1.1 * high)
        widest = _NARROW + (1.0 - _NARROW) * _ramp(self.radius_mm / self.widest_mm, *_OF_WIDEST)
        area = _plateau(self.area_mm2, *_AREAS_MM2)
        before = 1.0 - _ramp(self.behind, *_BEHIND)
        larger = 1.0 - _LARGER_FIRST * (1.0 - min(1.0, self.radius_mm / high))
        return disc * widest * area * before * larger


def region_around(surfaces: Surfaces, row: int, column: int, reach_mm: float) -> Region:
    """Return the region of the surface at a pixel.

    Args:
        surfaces: of the image.
        row, column: of the palm.
        reach_mm: Euclidean distance from the palm up to which pixels belong to the region.
    """
    rows, columns = _part(surfaces, row, column, reach_mm)
    points = surfaces.points[rows, columns]
    numbers = surfaces.numbers[rows, columns]
    palm = surfaces.points[row, column]
    squared = sum(
        np.square(points[..., axis] - palm[axis]) for axis in range(3)
    )  # einsum takes 5 times as long
    within = (numbers > 0) & (squared < reach_mm**2)
    at = (row - rows.start, column - columns.start)
    own = _connected(within & (numbers == numbers[at]), at)
    mask = own | _islands(within, numbers, surfaces)
    apart, radii = surfaces.pixel_mm[rows, columns], surfaces.radius[rows, columns]
    area, radius = float((apart * apart * mask).sum()), float(surfaces.radius[row, column])
    widest = max(radius, float((radii * (own & (squared < _NEAR_PALM_MM**2))).max()))
    rim = own & (radii <= apart)
    hidden = int(np.count_nonzero(rim & surfaces.behind[rows, columns]))
    behind = hidden / max(1, int(np.count_nonzero(rim)))
    region = Region(rows, columns, mask, points, palm.astype(np.float64), radius, widest, area, behind, ())
    if region.likeness_of_surface == 0.0:  # exits would not change that
        return region
    far = squared > (reach_mm - _RING_MM) ** 2
    return replace(region, exits=_exits(own, far, surfaces, rows, columns))


def _part(surfaces: Surfaces, row: int, column: int, reach_mm: float) -> tuple[slice, slice]:
    """Return the rows and columns that the reach may cover; nearer points appear larger."""
    z, apart = float(surfaces.depth[row, column]), float(surfaces.pixel_mm[row, column])
    half = int(np.ceil(reach_mm / apart * z / max(z - 0.5 * reach_mm, 0.5 * z)))
    height, width = surfaces.depth.shape
    return slice(max(0, row - half), min(height, row + half + 1)), slice(
        max(0, column - half), min(width, column + half + 1)
    )


def _connected(mask: BoolArray, at: tuple[int, int]) -> BoolArray:
    _, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    own: BoolArray = labels == labels[at]
    return own


def _islands(within: BoolArray, numbers: ImageArray, surfaces: Surfaces) -> BoolArray:
    """Return surfaces entirely within reach and not behind others, such as fingers in front of the palm."""
    inside = np.bincount(numbers[within])
    whole = (inside == surfaces.sizes[: len(inside)]) & surfaces.may_be_islands[: len(inside)]
    islands: BoolArray = within & whole[np.minimum(numbers, len(inside) - 1)]
    return islands


def _exits(
    own: BoolArray, far: BoolArray, surfaces: Surfaces, rows: slice, columns: slice
) -> tuple[Exit, ...]:
    """Return the places where a region touches the limit of its reach or the image border."""
    height, width = surfaces.depth.shape
    leaving = own & far
    for at_border, edge in (
        (rows.start == 0, np.s_[0, :]),
        (rows.stop == height, np.s_[-1, :]),
        (columns.start == 0, np.s_[:, 0]),
        (columns.stop == width, np.s_[:, -1]),
    ):
        if at_border:
            leaving[edge] |= own[edge]
    left, top, across, down = cv2.boundingRect(leaving.astype(np.uint8))
    if not across:
        return ()
    box = np.s_[top : top + down, left : left + across]
    _, labels, stats, _ = cv2.connectedComponentsWithStats(leaving[box].astype(np.uint8), connectivity=8)
    points, apart = surfaces.points[rows, columns][box], surfaces.pixel_mm[rows, columns][box]
    exits = []
    for number, (left, top, across, down, area) in enumerate(stats.tolist()):
        if number > 0 and area >= _MIN_PIXELS:
            box = np.s_[top : top + down, left : left + across]
            part = labels[box] == number
            inside = points[box][part].astype(np.float64)
            width = extent_mm(inside, float(apart[box][part].mean()))
            exits.append(Exit(inside.mean(axis=0), width))
    return tuple(exits)


_THICK_MM = 16.0
"""Disc radius that fits into arms but not into fingers."""


def thin_mask(mask: BoolArray, pixel_mm: float) -> BoolArray:
    """Return the part of a mask (h, w) that no inner disc of ``_THICK_MM`` covers: fingers, and the rim."""
    radius = _THICK_MM / pixel_mm
    reach = int(np.ceil(radius))
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = (rows**2 + columns**2 <= radius**2 + 0.5).astype(np.uint8)
    whole = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    thick = cv2.morphologyEx(whole, cv2.MORPH_OPEN, disc)
    thin: BoolArray = whole > thick
    return thin


_FINGER_MM, _OF_DISC = 36.0, 0.8
"""An exit narrower than two fingers is not an arm, unless it is about as wide as the disc: a thin arm
continues at constant width, a finger is narrower than its palm."""
_AREAS_MM2 = (800.0, 2500.0, 42000.0, 65000.0)
"""Area of a hand with the part of its arm within reach: limits, with the usual range in between."""
_NO_ARM, _MORE_ARMS, _LONG_FINGER = 0.75, 0.2, 0.9
"""Factors for a hand without an arm, per further arm, and per finger that reaches too far."""
_OF_WIDEST, _NARROW = (0.1, 0.6), 0.2
"""A palm is the widest part of its surroundings: shares of the widest disc that count least and fully."""
_BEHIND = (0.3, 0.8)
"""Shares of the rim behind nearer surfaces: usual, and impossible for a hand."""
_LARGER_FIRST = 0.1


def arm_exit(region: Region) -> Exit | None:
    """Return the exit of the arm: the widest one that is not a finger; None without one."""
    return max(_arms(region), key=lambda one: one.width_mm, default=None)


def likeness(region: Region) -> float:
    """Return the similarity to a hand, 0 to 1: the product of factors for disc, area, exits and occlusion.

    A hand's exit is not as wide as a body; a fingertip is not the widest part of its surroundings; a surface
    visible between nearer ones is background.
    """
    return region.likeness_of_surface * _of_exits(region)


def _of_exits(region: Region) -> float:
    arms = [one.width_mm for one in _arms(region)]
    fingers = _LONG_FINGER ** (len(region.exits) - len(arms))
    if not arms:
        return fingers * _NO_ARM
    narrow = 1.0 - _ramp(max(arms), _ARM_MM, 1.5 * _ARM_MM)
    return fingers * narrow * _MORE_ARMS ** (len(arms) - 1)


def _arms(region: Region) -> list[Exit]:
    narrowest = min(_FINGER_MM, _OF_DISC * 2.0 * region.radius_mm)
    return [one for one in region.exits if one.width_mm >= narrowest]


def _ramp(value: float, low: float, high: float) -> float:
    """Return 0 up to ``low``, 1 from ``high`` on, and linear between."""
    return min(max((value - low) / (high - low), 0.0), 1.0)


def _plateau(value: float, low: float, first: float, last: float, high: float) -> float:
    """Return 1 from ``first`` to ``last``, falling linearly to 0 at ``low`` and ``high``."""
    return _ramp(value, low, first) - _ramp(value, last, high)
