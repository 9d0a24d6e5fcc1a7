"""Layouts of keypoint files: names, columns, the sets that come of them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from posetrack_cli import limits, tables
from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.errors import UsageError, nearest_name
from posetrack_cli.tables import FRAME_FIELDS, shown, whole_of

# What the points in a file are of: their names, and how many another program counts


def _unchanged(name: str) -> str:
    return name


@dataclass(frozen=True)
class PointKind:
    """A subject's points.

    Attributes:
        subject: such as ``hand``.
        names: ours, in our order; a set has so many points.
        counted: by how many points a program gives, which of ours each of them is; those that are none of
            ours are not listed.
        several: fields of JSON frames that list several subjects.
        plain: makes of a lower-case name of another program's ours, where it is one.
        flat: fields of OpenPose's people with x, y, score of each point, and the side that each is of.
        parts: points of COCO's 133 of a whole body, and the side that each part is of.
        ends: what the first and the last point are, for errors.
        command: whose help says more.
    """

    subject: str
    names: tuple[str, ...]
    counted: Mapping[int, Mapping[int, int]]
    several: tuple[str, ...]
    command: str
    plain: Callable[[str], str] = field(default=_unchanged)
    flat: Mapping[str, str] = field(default_factory=dict)
    parts: Mapping[str, slice] = field(default_factory=dict)
    ends: tuple[str, str] = ("", "")

    @property
    def size(self) -> int:
        """How many points a set has."""
        return len(self.names)

    @property
    def most(self) -> int:
        """How many points a program gives at most."""
        return max(self.counted)

    @property
    def counts(self) -> str:
        """How many points a program may give, for people: ``21``, or ``10, 68 or 478``."""
        *others, last = (str(count) for count in sorted(self.counted))
        return f"{', '.join(others)} or {last}" if others else last

    @property
    def expected(self) -> str:
        """What JSON is to hold, for errors."""
        points = f"{self.counts} of [x, y], [x, y, z] or {{x, y, z}}"
        return f"a list of frames, each with landmarks: {points}"

    @property
    def range(self) -> str:
        """The numbers of our own points, for errors."""
        first, last = (f" ({end})" if end else "" for end in self.ends)
        return f"0{first} to {self.size - 1}{last}"

    def number(self, name: str) -> int | None:
        """Return the number of a point by ours or another program's name of it; None for any other."""
        plain = self.plain(name.strip().lower().replace("-", "_").replace(" ", "_"))
        return self.names.index(plain) if plain in self.names else None

    def places(self, points: int) -> Mapping[int, int] | None:
        """Return which of ours each of so many points is; None if no program gives so many."""
        return self.counted.get(points)


def same_order(count: int) -> Mapping[int, int]:
    """Return the places of points that are ours, in our order."""
    return {k: k for k in range(count)}


def by_index(indices: Sequence[int]) -> Mapping[int, int]:
    """Return the places of points of which these, in our order, are ours."""
    return {index: place for place, index in enumerate(indices)}


# What a file of keypoints says, whatever its layout: sets of points, by frame or by time


X, Y, Z, SCORE = range(4)
"""Columns of a set's values."""
NS_TOLERANCE = 10_000_000
"""Stamps of a set and of its frame differ by this at most, ns, and by less than half the time to the next."""


@dataclass(frozen=True, eq=False)
class KeypointSets:
    """The sets of a file, sorted by their keys.

    Attributes:
        keys: (N,) frame numbers, or stamps, ns; a frame with several subjects has several sets.
        by_stamp: which of the two.
        points: (N, P, 3) x, y, z in the file's unit; NaN where unknown, z everywhere for points in images.
        scores: (N, P) 0 to 1; NaN where none is stated.
        right: (N,) the stated probability that the hand is a right one; NaN where none is stated.
        numbers: (N,) frame numbers next to stamps, -1 where none is stated.
        tolerance_ns: stamps of a set and of its frame differ by this at most.
    """

    keys: IntArray
    by_stamp: bool
    points: FloatArray
    scores: FloatArray
    right: FloatArray
    numbers: IntArray | None = None
    tolerance_ns: int = NS_TOLERANCE

    def __len__(self) -> int:
        return len(self.keys)

    def rows(self, kept: BoolArray, points: FloatArray) -> KeypointSets:
        """Return the sets of some rows, with other points (N, P, 3)."""
        numbers = None if self.numbers is None else self.numbers[kept]
        own = replace(self, keys=self.keys[kept], points=points[kept], scores=self.scores[kept])
        return replace(own, right=self.right[kept], numbers=numbers)

    def of(self, index: int, stamp_ns: int) -> slice:
        """Return which sets are of a frame: of its number or, told by stamps, of the stamp nearest to its."""
        key = stamp_ns if self.by_stamp else index
        if self.by_stamp and len(self.keys):
            after = int(np.searchsorted(self.keys, key))
            near = self.keys[max(after - 1, 0) : after + 1]
            nearest = int(near[int(np.argmin(np.abs(near - key)))])
            if abs(nearest - key) > self.tolerance_ns:
                return slice(0, 0)
            key = nearest
        return slice(int(np.searchsorted(self.keys, key)), int(np.searchsorted(self.keys, key, "right")))


@dataclass
class SetCollector:
    """Puts sets together, point by point.

    Attributes:
        path: of the file.
        kind: whose points they are.
        by_stamp: whether keys are stamps.
    """

    path: Path
    kind: PointKind
    by_stamp: bool
    _values: dict[tuple[int, int], FloatArray] = field(default_factory=dict)
    _right: dict[tuple[int, int], float] = field(default_factory=dict)
    _numbers: dict[int, int] = field(default_factory=dict)
    _after: dict[tuple[int, int], int] = field(default_factory=dict)

    def set_of(self, key: int, hand: int, where: object) -> FloatArray:
        """Return the values (P, 4) of a set, to be written to; a new one is NaN.

        Args:
            key: frame number or stamp.
            hand: which of the frame's hands.
            where: it is said, for errors.

        Raises:
            UsageError: there are too many.
        """
        if (key, hand) not in self._values:
            if len(self._values) >= limits.KEYPOINT_SETS:
                expected = f"{limits.KEYPOINT_SETS} at most"
                raise UsageError("too many sets of keypoints", where=where, found="more", expected=expected)
            self._values[key, hand] = np.full((self.kind.size, 4), np.nan)
        return self._values[key, hand]

    def new_hand(self, key: int, hand: int = 0) -> int:
        """Return the first hand of a frame, from a given one on, of which nothing was said.

        What was passed is remembered: a frame of all the sets that a file may have takes no time without end.
        """
        passed = []
        while (key, hand) in self._values:
            passed.append((key, hand))
            hand = self._after.get((key, hand), hand + 1)
        self._after.update(dict.fromkeys(passed, hand))
        return hand

    def put(self, values: FloatArray, point: int, said: tuple[float, ...], where: object) -> None:
        """Write x, y, z and score of a point, NaN where unknown.

        Raises:
            UsageError: it was said before, or a score is none.
        """
        if not np.isnan(values[point, X]):
            raise UsageError("point occurs twice in a frame", where=where, found=f"point {point}")
        values[point] = said

    def tell_number(self, key: int, number: int) -> None:
        """Record the frame number next to a stamp."""
        self._numbers[key] = number

    def tell_side(self, key: int, hand: int, right: float) -> None:
        """Say with which probability a set is of a right hand."""
        self._right[key, hand] = right

    def sets(self) -> KeypointSets:
        """Return what was said.

        Raises:
            UsageError: no point was.
        """
        order = sorted(self._values)
        known = [key for key in order if np.isfinite(self._values[key][:, :Z]).all(axis=1).any()]
        if not known:
            raise UsageError(
                "holds no keypoint",
                where=self.path,
                expected=f"{self.kind.counts} points a frame; {self.kind.command}",
            )
        values = np.stack([self._values[key] for key in known])
        values[~np.isfinite(values[..., :Z]).all(axis=2)] = np.nan
        right = np.array([self._right.get(key, np.nan) for key in known])
        keys = np.array([key for key, _ in known], dtype=np.int64)
        numbers = [self._numbers.get(key, -1) for key, _ in known]
        stated = np.array(numbers, dtype=np.int64) if self._numbers else None
        return KeypointSets(keys, self.by_stamp, values[..., :SCORE], values[..., SCORE], right, stated)


# What names, numbers, sides and times mean in files of keypoints, however these are laid out


PIXELS, NORMALISED, MILLIMETRES, METRES = "px", "normalised", "mm", "m"
UNITS = (PIXELS, NORMALISED, MILLIMETRES, METRES)
UNIT_NAMES = {name: name for name in UNITS} | {
    "pixel": PIXELS,
    "pixels": PIXELS,
    "norm": NORMALISED,
    "normalized": NORMALISED,
    "millimetres": MILLIMETRES,
    "metres": METRES,
}
"""What files call the units."""
SCORE_FIELDS = ("score", "confidence", "conf", "visibility", "presence", "likelihood")
POINT_FIELDS = ("landmark", "landmark_index", "landmark_id", "keypoint", "joint", "point", "name", "id")
OVER_ONE = 1.2
"""Scores up to this are 1: peaks of confidence maps, as SLEAP and OpenPose state them, may exceed it."""
SIDE, HANDEDNESS, MIRRORED = "side", "handedness", "multi_handedness"
"""Fields that tell right or left: the hand's own side; the label of MediaPipe's tasks, which is that since
version 0.10.15; and that of its solutions, which take every image for that of a mirror and so call a right
hand left where it is none. Files call either the second."""
SIDE_FIELDS = (SIDE, HANDEDNESS, MIRRORED)
KEYS = f"a number in {FRAME_FIELDS[0]} (from 0) or a stamp in stamp_ns, timestamp_ms or time_s"
key_of = partial(whole_of, kind=UsageError, fractions=True)
"""A frame's number, or a stamp in ns."""
number_of = partial(tables.number_of, kind=UsageError, optional=True, most=limits.LENGTH_MM)
"""A coordinate; NaN for nothing."""
_AXES = {"x": X, "y": Y, "z": Z} | dict.fromkeys((*SCORE_FIELDS, "c"), SCORE)
_NUMBERED = re.compile(r"(?:(?:landmark|keypoint|point|joint|kp|lm)_?)?(\d{1,3})_?([a-z]+)")
_AXIS_FIRST = re.compile(r"([a-z]+)_?(\d{1,3})")
_NAMED = re.compile(r"([a-z_]+[1-4]?)_([a-z]+)")


class Parsed(NamedTuple):
    """What a file says.

    Attributes:
        sets: its points.
        unit: that it names; None where it does not.
        side_field: which field tells sides, one of ``SIDE_FIELDS``; None where none does.
        first: what the first frame's number is.
    """

    sets: KeypointSets
    unit: str | None
    side_field: str | None
    first: int = 0


class PointColumn(NamedTuple):
    """A column of one point: which, which of its values, and the unit that its name ends in, if any."""

    point: int
    value: int
    unit: str | None


def point_of(kind: PointKind, value: Any, where: object) -> int:
    """Return the number of a point that is told by number or by name.

    Raises:
        UsageError: it is none.
    """
    text = str(value).strip()
    number = int(text) if text.isdecimal() and len(text) < 4 else kind.number(text)
    if number is None:
        raise UsageError("unknown point", where=where, found=repr(text), hint=nearest_name(text, kind.names))
    if not 0 <= number < kind.size:
        raise UsageError("no such point", where=where, found=number, expected=kind.range)
    return number


def point_column(kind: PointKind, name: str) -> PointColumn | None:
    """Return what a column of a wide table is of: ``x0``, ``landmark_0_x``, ``thumb_tip_x_mm`` ..."""
    plain, unit = name.strip().lower().replace(".", "_"), None
    for ending in UNIT_NAMES:
        if plain.endswith(f"_{ending}"):
            plain, unit = plain.removesuffix(f"_{ending}"), UNIT_NAMES[ending]
            break
    if found := _NUMBERED.fullmatch(plain):
        point, axis = int(found[1]), found[2]
    elif found := _AXIS_FIRST.fullmatch(plain):
        point, axis = int(found[2]), found[1]
    elif (found := _NAMED.fullmatch(plain)) and (named := kind.number(found[1])) is not None:
        point, axis = named, found[2]
    else:
        return None
    return PointColumn(point, _AXES[axis], unit) if axis in _AXES else None


def score_of(value: Any, where: object) -> float:
    """Return a score; NaN for none.

    Raises:
        UsageError: it is not between 0 and 1.
    """
    score = number_of(value, where)
    if 1.0 < score <= OVER_ONE:
        return 1.0
    if not math.isnan(score) and not 0.0 <= score <= 1.0:
        raise UsageError("score cannot be used", where=where, found=shown(value), expected="0 to 1")
    return score


def right_of(label: Any, score: float, where: object) -> float:
    """Return the probability that a hand labelled right or left is a right one; NaN for no label.

    Args:
        label: ``right``, ``left``, their first letters, or nothing.
        score: of the label, NaN for 1.
        where: it is said.

    Raises:
        UsageError: another label.
    """
    plain = str(label if label is not None else "").strip().lower()
    if plain in ("", "unknown", "none", "nan"):
        return math.nan
    if plain not in ("right", "left", "r", "l"):
        raise UsageError("unknown side", where=where, found=shown(label), expected="right or left")
    sure = 1.0 if math.isnan(score) else max(score, 0.5)  # a label less probable than the other is no label
    return sure if plain[0] == "r" else 1.0 - sure


def unit_of(name: Any, where: object) -> str:
    """Return a unit by its name in a file.

    Raises:
        UsageError: there is none of this name.
    """
    if (plain := str(name).strip().lower()) not in UNIT_NAMES:
        raise UsageError("unknown unit", where=where, found=shown(name), expected=", ".join(UNITS))
    return UNIT_NAMES[plain]
