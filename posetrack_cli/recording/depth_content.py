"""Whether stored images are depth, by their names, and of which unit, by what early images hold."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from math import sqrt
from typing import TypeVar

import cv2
import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.depth import MM_PER_M

Item = TypeVar("Item")

_NO_DEPTH = re.compile(
    r"(?<![a-z])(disparity|infrared|infra|n?ir|confidence|amplitude|intensity|brightness|reflectivity)(?![a-z])"
)
"""Words in names of 16-bit images and float images that are not depth."""
_PLAIN_PART = re.compile(r"(image|data|compressed)(_?(raw|rect|rect_raw|mono|16|depth))*")
"""Parts of a topic's name that say nothing of what its images are."""
EARLY_FRAMES = (0, 7, 15, 22, 30)
"""Numbers of the images that are looked at: of about the first second."""
MOST_PIXELS = 40_000
"""Of one image; of a larger one every second or third row and column is used."""
SEARCHED_MM = (120.0, 1500.0)
"""Depths at which hands are searched for, see ``hand.config``: a finer unit is considered only beyond."""
HAND_MM = (50.0, 350.0)
"""Square root of the area of a hand, with some of its forearm."""
_STEPS = {10: 0.1, 8: 0.125, 5: 0.2, 4: 0.25}
"""Unit by the common divisor of codes: whole millimetres of a sensor, stored in a finer unit."""
USUAL_UNITS_MM = (*_STEPS.values(), 1.0, 10.0, MM_PER_M)
"""In which depth is stored, millimetres."""
_DIVISIBLE = 0.999
"""Share of readings that a divisor must divide: some interpolate a few at edges."""
_LEAST_VALUES = 64
"""Different codes needed, or a flat scene would be a multiple of anything."""
_LABEL_BITS = 3
"""Of Kinect v1 images with the number of a player below the depth."""
_LABELS_ALIKE = 0.9
_LABELLED = 0.005
"""Neighbours whose labels are equal, and share of readings with a player, of such images."""
_FLOATS_IN_MM = (100.0, 200.0)
"""First percentile and median of floats in mm at least: no hand is recorded 100 m away."""
_TOO_FAR_MM = 10_000.0
"""Median depth that no camera for hands has."""
_TOUCHING_MM = 20.0
"""Everything within this is too near for any depth camera."""
_NEAREST_SHARES, _LEAST_SURFACE = (1.0, 2.0, 4.0, 8.0, 16.0), 0.008
"""Percentiles of readings at one of which the nearest surface begins, and its least share of the image:
nearer readings are specks."""
_SURFACE_REACH = 1.25
"""How far the nearest surface reaches in depth, a factor."""


@dataclass(frozen=True)
class DepthContent:
    """Statistics of stored depth values, in their own unit.

    Attributes:
        images: images looked at that have a reading.
        is_float: whether values are floats.
        share: of pixels that have a reading.
        near: where the nearest surface begins.
        middle, far: percentiles 50 and 99 of readings.
        surface: square root of the area of the nearest surface, in the unit of depth; 0 for none.
        values: different values, of integers.
        step: largest of 10, 8, 5 and 4 that divides the integers, else 1.
        labels_alike: share of neighbouring readings of different depth whose low three bits are equal.
        labelled: share of readings whose low three bits are not 0.
    """

    images: int = 0
    is_float: bool = False
    share: float = 0.0
    near: float = 0.0
    middle: float = 0.0
    far: float = 0.0
    surface: float = 0.0
    values: int = 0
    step: int = 1
    labels_alike: float = 0.0
    labelled: float = 0.0

    @property
    def convention_mm(self) -> float:
        """Millimetres per stored unit by convention: integers are mm, floats m."""
        return MM_PER_M if self.is_float else 1.0

    def range_words(self, unit_mm: float) -> str:
        """Say at which depths readings lie: ``4.8 to 6.6 m``."""
        return range_words(self.near * unit_mm, self.far * unit_mm)


@dataclass(frozen=True)
class Decision:
    """The unit of stored depth.

    Attributes:
        unit_mm: millimetres per stored unit.
        remark: why it is not the one by convention or the one given, one line; empty if it is.
    """

    unit_mm: float
    remark: str = ""

    @property
    def remarks(self) -> tuple[str, ...]:
        """The remark, if there is one."""
        return (self.remark,) if self.remark else ()


def other_content(name: str) -> str:
    """Return the word in the name of a topic or folder that says that its images are not depth; else ""."""
    parts = [part for part in name.lower().split("/") if part and not _PLAIN_PART.fullmatch(part)]
    found = _NO_DEPTH.search(parts[-1]) if parts and "depth" not in parts[-1] else None
    return "" if found is None else found.group(1)


def early(items: Iterable[Item]) -> Iterator[Item]:
    """Yield the items whose images are looked at."""
    wanted = frozenset(EARLY_FRAMES)
    return (item for number, item in enumerate(islice(items, max(wanted) + 1)) if number in wanted)


def content_of(images: Iterable[ImageArray], camera: Camera, missing: int = 0) -> DepthContent:
    """Return the statistics of depth images as they are stored.

    Args:
        images: (height, width) integers or floats.
        camera: of these images.
        missing: code of no reading.
    """
    shown = [image for image in map(_thinned, images) if _readings(image, missing).any()]
    shown = [image for image in shown if (image.shape, image.dtype) == (shown[0].shape, shown[0].dtype)]
    if not shown:
        return DepthContent()
    masks = [_readings(image, missing) for image in shown]
    values = np.concatenate([image[mask] for image, mask in zip(shown, masks, strict=True)])
    middle, far = (float(value) for value in np.percentile(values, (50.0, 99.0)))
    focal = sqrt(camera.fx * camera.fy) * shown[0].shape[0] / camera.height
    nearest = [_nearest(image, mask, focal) for image, mask in zip(shown, masks, strict=True)]
    near, surface = (float(value) for value in np.median(nearest, axis=0))
    share = len(values) / sum(image.size for image in shown)
    found = DepthContent(len(shown), True, share, near, middle, far, surface)
    if values.dtype.kind == "f":
        return found
    pairs = [_labels(image, mask) for image, mask in zip(shown, masks, strict=True)]
    alike, compared = (sum(counts) for counts in zip(*pairs, strict=True))
    return DepthContent(
        found.images,
        False,
        share,
        near,
        middle,
        far,
        surface,
        values=len(np.unique(values)),
        step=next((k for k in _STEPS if np.mean(values % k == 0) >= _DIVISIBLE), 1),
        labels_alike=alike / compared if compared else 0.0,
        labelled=float(np.mean(values & 7 != 0)),
    )


def decide_unit(content: DepthContent, given_mm: float | None = None) -> Decision:
    """Decide the unit of stored depth.

    Args:
        content: of early images.
        given_mm: mm per stored unit, where somebody has stated it.
    """
    usual = content.convention_mm
    if not content.images:
        return Decision(usual if given_mm is None else given_mm)
    if given_mm is not None:
        return _given(content, given_mm)
    if content.is_float:
        low, middle = _FLOATS_IN_MM
        if content.near >= low and content.middle >= middle and content.far < _TOO_FAR_MM * 2:
            return _found(content, 1.0, "floats are millimetres, not metres")
        return Decision(usual)
    if _has_players(content):
        return _found(content, 0.125, "Kinect v1 player numbers below the depth")
    unit = _STEPS.get(content.step, usual)
    if unit != usual and content.values >= _LEAST_VALUES and _is_finer(content, unit):
        return _found(content, unit, f"all values are multiples of {content.step}")
    return Decision(usual)


def likely_units(content: DepthContent, unit_mm: float = 1.0) -> tuple[float, ...]:
    """Return the usual units in which the nearest surface is as far away as a hand, and as large as one.

    Args:
        content: of images, whose values are multiples of ``unit_mm``.
        unit_mm: the unit that they were read in, mm; 1 of stored values.
    """
    low, high = SEARCHED_MM
    return tuple(
        unit
        for unit in USUAL_UNITS_MM
        if low <= content.near * unit / unit_mm <= high
        and HAND_MM[0] <= content.surface * unit / unit_mm <= HAND_MM[1]
    )


def range_words(low_mm: float, high_mm: float) -> str:
    """Return a range of lengths for people: ``4.8 to 6.6 m``."""
    low, high = length_words(low_mm), length_words(high_mm)
    unit = high.rpartition(" ")[2]
    return f"{low.removesuffix(f' {unit}')} to {high}"


def length_words(mm: float) -> str:
    """Return a length for people: ``0.6 mm``, ``35 mm``, ``4.8 m``, ``600 m``."""
    if mm < 99.5:
        return f"{mm:.2g} mm"
    metres = mm / MM_PER_M
    return f"{metres:.2f} m" if metres < 1.0 else f"{metres:.3g} m" if metres >= 100.0 else f"{metres:.1f} m"


def _found(content: DepthContent, unit_mm: float, why: str) -> Decision:
    taken = f"depth is taken as {unit_mm:g} mm per stored unit"
    where = f"readings then lie at {content.range_words(unit_mm)}"
    return Decision(unit_mm, f"{taken}: {why}; {where}; --depth-unit-mm overrides")


def _given(content: DepthContent, given_mm: float) -> Decision:
    """The unit given; one that only makes sense in metres per stored unit is taken as such."""
    metres = given_mm * MM_PER_M
    if content.far * given_mm >= _TOUCHING_MM or not (
        SEARCHED_MM[0] <= content.middle * metres <= 2 * _TOO_FAR_MM
    ):
        return Decision(given_mm)
    within = (
        f"a depth unit of {given_mm:g} mm places everything within {length_words(content.far * given_mm)}"
    )
    return Decision(metres, f"{within}: taken as {given_mm:g} m, which is {metres:g} mm per stored unit")


def _has_players(content: DepthContent) -> bool:
    """Whether codes are depth << 3 | player: low bits that stay where the depth changes are no depth."""
    return (
        content.values >= _LEAST_VALUES
        and content.labelled >= _LABELLED
        and content.labels_alike >= _LABELS_ALIKE
        and content.near >= SEARCHED_MM[1]
    )


def _is_finer(content: DepthContent, unit_mm: float) -> bool:
    """Whether values are of a finer unit than mm: too far for mm, or the nearest surface a hand's size."""
    low, high = SEARCHED_MM
    if content.near < high or not low <= content.near * unit_mm <= high:
        return False
    is_hand = HAND_MM[0] <= content.surface * unit_mm <= HAND_MM[1] < content.surface
    return is_hand or content.middle >= _TOO_FAR_MM


def _thinned(image: ImageArray) -> ImageArray:
    step = max(1, round(sqrt(image.size / MOST_PIXELS)))
    return image[::step, ::step]


def _readings(image: ImageArray, missing: int) -> ImageArray:
    if image.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            return np.asarray(np.isfinite(image) & (image > 0))
    return np.asarray((image > 0) & (image != missing) & (image != np.iinfo(image.dtype).max))


def _nearest(image: ImageArray, mask: ImageArray, focal: float) -> tuple[float, float]:
    """Where the nearest surface of some extent begins, and the square root of its area; both in its unit."""
    near, area = 0.0, 0
    for near in np.percentile(image[mask], _NEAREST_SHARES):
        surface = (mask & (image >= near) & (image <= _SURFACE_REACH * near)).astype(np.uint8)
        _, _, stats, _ = cv2.connectedComponentsWithStats(surface, connectivity=4)
        area = int(stats[1:, cv2.CC_STAT_AREA].max(initial=0))
        if area >= _LEAST_SURFACE * image.size:
            break
    return float(near), sqrt(area) * float(near) * 0.5 * (1.0 + _SURFACE_REACH) / focal


def _labels(image: ImageArray, mask: ImageArray) -> tuple[int, int]:
    """How many neighbours of different depth have equal low bits, and how many there are."""
    alike = compared = 0
    codes = image.astype(np.int64)
    for one, other, both in (
        (codes[:, :-1], codes[:, 1:], mask[:, :-1] & mask[:, 1:]),
        (codes[:-1], codes[1:], mask[:-1] & mask[1:]),
    ):
        differs = both & (one >> _LABEL_BITS != other >> _LABEL_BITS)
        alike += int(np.count_nonzero(differs & ((one ^ other) & 7 == 0)))
        compared += int(np.count_nonzero(differs))
    return alike, compared
