"""Where to search for faces: whole images, parts of them, reduced or rotated ones **[ours]**.

A cascade tolerates a roll of some 15 degrees and its cost grows with the area, so a thorough search takes a
second. It is made once, in the first frame. Later frames without a face are searched upright and reduced, and
in one more way that changes from frame to frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.head.detection.finders import FaceFinder, FaceGuess

ROTATIONS = tuple(np.radians(24.0 * k) for k in (1, -1, 2, -2, 3, -3, 4, -4, 5, -5, 6, -6, 7, -7))
"""Rad: rolls searched next to an upright face."""
ONE_FACE = 0.6
"""Faces closer than this, in eye distances, are the same."""
QUICK_AREA, QUICK_TURNED_AREA, THOROUGH_AREA = 280 * 210, 220 * 165, 640 * 480
"""Largest areas, pixels, of images in a quick search, which is slower for turned heads, and of rotated ones
in a thorough search. Eyes 20 pixels apart in 640 x 480 are found in all."""
TILE, OVERLAP = (640, 480), 128
"""Parts of larger images that are searched for small faces in turn, pixels, and their overlap."""


Part: TypeAlias = tuple[slice, slice]
"""Rows and columns of a part of an image."""


class Way(NamedTuple):
    """A way to search an image.

    Attributes:
        turned: whether heads turned to a side are searched, not those that look at the camera.
        roll: rad, clockwise, expected.
        area: largest area of the image, pixels; larger images are reduced.
        again: whether faces that were not found are searched by other features.
    """

    turned: bool = False
    roll: float = 0.0
    area: float = math.inf
    again: bool = False

    @property
    def is_usual(self) -> bool:
        """Whether upright faces that look at the camera are searched."""
        return not self.turned and not self.roll and not self.again


def thorough_ways(roll: float | None) -> Iterator[Way]:
    """Yield the ways of a thorough search, the most likely first; only those of a known roll."""
    yield from (Way(turned, roll or 0.0) for turned in (False, True))
    if roll is None:
        yield from (Way(False, roll, THOROUGH_AREA) for roll in ROTATIONS)
        yield from (Way(True, roll, 2 * QUICK_TURNED_AREA) for roll in ROTATIONS)
    rolls = (0.0, *ROTATIONS) if roll is None else (roll,)
    yield from (Way(False, roll, THOROUGH_AREA, again=True) for roll in rolls)


def quick_ways(index: int) -> tuple[Way, Way]:
    """Return the ways in which a frame is searched: upright, turned or rolled every other frame."""
    turned, roll = True, 0.0
    if index % 2:
        turn, turned = index // 2 % len(ROTATIONS), index // (2 * len(ROTATIONS)) % 2 == 1
        roll = ROTATIONS[turn]
    return Way(area=QUICK_AREA), Way(turned, roll, QUICK_TURNED_AREA if turned else QUICK_AREA)


def tile_of(shape: tuple[int, ...], index: int) -> Part | None:
    """Return the part of a large image to search for small faces in a frame; None for smaller images."""
    height, width = shape
    columns, rows = (
        max(math.ceil((side - OVERLAP) / (tile - OVERLAP)), 1)
        for side, tile in zip((width, height), TILE, strict=True)
    )
    if columns * rows == 1:
        return None
    row, column = divmod(index % (columns * rows), columns)
    top, left = row * (TILE[1] - OVERLAP), column * (TILE[0] - OVERLAP)
    return slice(top, top + TILE[1]), slice(left, left + TILE[0])


def distinct(found: Iterable[FaceGuess]) -> tuple[FaceGuess, ...]:
    """Return the best of overlapping detections, the largest first."""
    kept: list[FaceGuess] = []
    for guess in sorted(found, key=lambda one: -one.score):
        if all(is_elsewhere(guess, other) for other in kept):
            kept.append(guess)
    return tuple(sorted(kept, key=lambda one: -one.eye_distance))


def is_elsewhere(guess: FaceGuess, other: FaceGuess) -> bool:
    """Whether two detections are different faces."""
    return float(np.linalg.norm(guess.middle - other.middle)) > ONE_FACE * other.eye_distance


@dataclass(frozen=True, eq=False)
class SearchedImage:
    """An image to search, cut from a recorded one, then reduced.

    Attributes:
        grey: (height, width) uint8.
        corner: (2,) pixel of the recorded image at which it begins.
        scale: its pixels per recorded pixel.
        larger: size of the smallest faces to find relative to the usual minimum.
    """

    grey: ImageArray
    corner: FloatArray
    scale: float
    larger: float = 1.0

    @classmethod
    def part(cls, image: ImageArray, area: float = math.inf, part: Part | None = None) -> SearchedImage:
        """Cut a part (rows, columns) and reduce it to an area."""
        corner = np.zeros(2)
        if part is not None:
            image, corner = image[part], np.array([part[1].start, part[0].start], dtype=np.float64)
        scale = min(1.0, math.sqrt(area / image.size))
        if scale < 1.0:
            image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        return cls(np.ascontiguousarray(image), corner, scale)

    def faces(self, finder: FaceFinder, way: Way) -> Iterator[FaceGuess]:
        """Yield the faces found in one way, in the pixels of the recorded image."""
        turn, shift, image = np.eye(2), np.zeros(2), self.grey
        if way.roll:
            image, turn, shift = _rotated(self.grey, way.roll)
        find = finder.find_again if way.again else finder.find_turned if way.turned else finder.find

        def recorded(pixels: FloatArray) -> FloatArray:
            if not way.roll and self.scale == 1.0:  # without rounding errors
                return pixels + self.corner
            place: FloatArray = ((pixels - shift) @ turn + 0.5) / self.scale - 0.5 + self.corner
            return place

        for guess in find(image, self.scale * self.larger):
            right, left = (recorded(eyes) for eyes in guess.eyes)
            yield replace(
                guess,
                middle=recorded(guess.middle),
                eye_distance=guess.eye_distance / self.scale,
                roll=guess.roll + way.roll,
                eyes=(right, left),
            )


def _rotated(image: ImageArray, roll: float) -> tuple[ImageArray, FloatArray, FloatArray]:
    """Rotate an image so that faces of a roll, rad, become upright; return it with rotation and shift."""
    height, width = image.shape
    cos, sin = float(np.cos(roll)), float(np.sin(roll))
    size = (
        math.ceil(width * abs(cos) + height * abs(sin)),
        math.ceil(width * abs(sin) + height * abs(cos)),
    )
    turn = np.array([[cos, sin], [-sin, cos]])
    shift = np.array(size) / 2.0 - turn @ np.array([width, height]) / 2.0
    transform = np.column_stack([turn, shift])
    return cv2.warpAffine(image, transform, size, borderMode=cv2.BORDER_REPLICATE), turn, shift
