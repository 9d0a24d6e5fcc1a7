"""Layout of keypoint files: points, columns, units, and the sets read from a file."""

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


# Points of a subject, and their numbering in other programs
def _unchanged(name: str) -> str:
    return name


@dataclass(frozen=True)
class PointKind:
    """The points of a kind of subject.

    Attributes:
        subject: such as ``hand``.
        names: our names in our order; a set has this many points.
        counted: by a program's number of points, its indices mapped to ours; others are omitted.
        several: fields of JSON frames that list several subjects.
        command: command whose help gives details, for errors.
        plain: maps a lower-case name of another program to ours if known.
        flat: fields of OpenPose's people with x, y, score of each point, mapped to the side.
        parts: ranges of COCO-WholeBody's 133 points by side.
        ends: names of the first and last point, for errors.
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
        """Number of points in a set."""
        return len(self.names)

    @property
    def most(self) -> int:
        """Maximum number of points from a program."""
        return max(self.counted)

    @property
    def counts(self) -> str:
        """Supported numbers of points, as text: ``21``, or ``10, 68 or 478``."""
        *others, last = (str(count) for count in sorted(self.counted))
        return f"{', '.join(others)} or {last}" if others else last

    @property
    def expected(self) -> str:
        """Expected JSON content, for errors."""
        points = f"{self.counts} of [x, y], [x, y, z] or {{x, y, z}}"
        return f"a list of frames, each with landmarks: {points}"

    @property
    def range(self) -> str:
        """Numbers of our points, for errors."""
        first, last = (f" ({end})" if end else "" for end in self.ends)
        return f"0{first} to {self.size - 1}{last}"

    def number(self, name: str) -> int | None:
        """Return the number of a point by our or another program's name; None if unknown."""
        plain = self.plain(name.strip().lower().replace("-", "_").replace(" ", "_"))
        return self.names.index(plain) if plain in self.names else None

    def places(self, points: int) -> Mapping[int, int] | None:
        """Return the map from a program's indices to ours by its number of points; None if unknown."""
        return self.counted.get(points)


def same_order(count: int) -> Mapping[int, int]:
    """Return the index map of points in our order."""
    return {k: k for k in range(count)}


def by_index(indices: Sequence[int]) -> Mapping[int, int]:
    """Return the index map of points given by their indices in our order."""
    return {index: place for place, index in enumerate(indices)}


# Sets of points by frame or stamp

X, Y, Z, SCORE = range(4)  # columns of a set's values
# Stamps of a set and its frame may differ by this, and by less than half the frame interval.
NS_TOLERANCE = 10_000_000


@dataclass(frozen=True, eq=False)
class KeypointSets:
    """The sets of a file, sorted by key.

    Attributes:
        keys: (N,) frame numbers, or stamps, ns; a frame with several subjects has several sets.
        by_stamp: True for stamps.
        points: (N, P, 3) x, y, z in the file's unit; NaN if unknown, z always for image points.
        scores: (N, P) 0 to 1; NaN if not stated.
        right: (N,) stated probability of a right hand; NaN if not stated.
        numbers: (N,) frame numbers in addition to stamps, -1 if not stated.
        tolerance_ns: maximum stamp difference between a set and its frame.
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
        """Return the selected sets with new points (N, P, 3)."""
        numbers = None if self.numbers is None else self.numbers[kept]
        own = replace(self, keys=self.keys[kept], points=points[kept], scores=self.scores[kept])
        return replace(own, right=self.right[kept], numbers=numbers)

    def of(self, index: int, stamp_ns: int) -> slice:
        """Return the slice of sets of a frame, by its number or the stamp nearest to its own."""
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
    """Collects sets point by point.

    Attributes:
        path: path of the file.
        kind: subject of the points.
        by_stamp: True if keys are stamps.
    """

    path: Path
    kind: PointKind
    by_stamp: bool
    _values: dict[tuple[int, int], FloatArray] = field(default_factory=dict)
    _right: dict[tuple[int, int], float] = field(default_factory=dict)
    _numbers: dict[int, int] = field(default_factory=dict)
    _after: dict[tuple[int, int], int] = field(default_factory=dict)

    def set_of(self, key: int, hand: int, where: object) -> FloatArray:
        """Return the writable values (P, 4) of a set, initially NaN.

        Args:
            key: frame number or stamp.
            hand: index of the hand in the frame.
            where: location, for errors.

        Raises:
            UsageError: there are too many sets.
        """
        if (key, hand) not in self._values:
            if len(self._values) >= limits.KEYPOINT_SETS:
                expected = f"at most {limits.KEYPOINT_SETS}"
                raise UsageError("too many keypoint sets", where=where, found="more", expected=expected)
            self._values[key, hand] = np.full((self.kind.size, 4), np.nan)
        return self._values[key, hand]

    def new_hand(self, key: int, hand: int = 0) -> int:
        """Return the first unused hand index of a frame, starting at ``hand``.

        Skipped indices are cached, or a frame with very many sets would take quadratic time.
        """
        passed = []
        while (key, hand) in self._values:
            passed.append((key, hand))
            hand = self._after.get((key, hand), hand + 1)
        self._after.update(dict.fromkeys(passed, hand))
        return hand

    def put(self, values: FloatArray, point: int, xyz_score: tuple[float, ...], where: object) -> None:
        """Write x, y, z and score of a point, NaN if unknown.

        Raises:
            UsageError: the point was already set.
        """
        if not np.isnan(values[point, X]):
            raise UsageError("point occurs twice in a frame", where=where, found=f"point {point}")
        values[point] = xyz_score

    def set_number(self, key: int, number: int) -> None:
        """Store the frame number that belongs to a stamp."""
        self._numbers[key] = number

    def set_side(self, key: int, hand: int, right: float) -> None:
        """Store the probability that a set is of a right hand."""
        self._right[key, hand] = right

    def sets(self) -> KeypointSets:
        """Return the collected sets.

        Raises:
            UsageError: there are no points.
        """
        order = sorted(self._values)
        known = [key for key in order if np.isfinite(self._values[key][:, :Z]).all(axis=1).any()]
        if not known:
            raise UsageError(
                "no keypoints",
                where=self.path,
                expected=f"{self.kind.counts} points per frame; {self.kind.command}",
            )
        values = np.stack([self._values[key] for key in known])
        values[~np.isfinite(values[..., :Z]).all(axis=2)] = np.nan
        right = np.array([self._right.get(key, np.nan) for key in known])
        keys = np.array([key for key, _ in known], dtype=np.int64)
        numbers = [self._numbers.get(key, -1) for key, _ in known]
        stated = np.array(numbers, dtype=np.int64) if self._numbers else None
        return KeypointSets(keys, self.by_stamp, values[..., :SCORE], values[..., SCORE], right, stated)


# Names of units, fields and columns
PIXELS, NORMALISED, MILLIMETRES, METRES = "px", "normalised", "mm", "m"
UNITS = (PIXELS, NORMALISED, MILLIMETRES, METRES)
# Names of units in files.
UNIT_NAMES = {name: name for name in UNITS} | {
    "pixel": PIXELS,
    "pixels": PIXELS,
    "norm": NORMALISED,
    "normalized": NORMALISED,
    "millimetres": MILLIMETRES,
    "metres": METRES,
}
SCORE_FIELDS = ("score", "confidence", "conf", "visibility", "presence", "likelihood")
POINT_FIELDS = ("landmark", "landmark_index", "landmark_id", "keypoint", "joint", "point", "name", "id")
# Scores up to this count as 1: confidence map peaks of SLEAP and OpenPose may exceed it.
OVER_ONE = 1.2
# Fields of right or left: the hand's own side; MediaPipe's tasks, which state the own side since 0.10.15;
# and MediaPipe's solutions, which assume mirrored images and so swap sides in others. Files use the
# latter's name for both.
SIDE, HANDEDNESS, MIRRORED = "side", "handedness", "multi_handedness"
SIDE_FIELDS = (SIDE, HANDEDNESS, MIRRORED)
KEYS = f"a number in {FRAME_FIELDS[0]} (from 0) or a stamp in stamp_ns, timestamp_ms or time_s"
# Parse a frame number, or a stamp to ns.
key_of = partial(whole_of, kind=UsageError, fractions=True)
# Parse a coordinate; NaN if empty.
number_of = partial(tables.number_of, kind=UsageError, optional=True, most=limits.LENGTH_MM)
_AXES = {"x": X, "y": Y, "z": Z} | dict.fromkeys((*SCORE_FIELDS, "c"), SCORE)
_NUMBERED = re.compile(r"(?:(?:landmark|keypoint|point|joint|kp|lm)_?)?(\d{1,3})_?([a-z]+)")
_AXIS_FIRST = re.compile(r"([a-z]+)_?(\d{1,3})")
_NAMED = re.compile(r"([a-z_]+[1-4]?)_([a-z]+)")


class Parsed(NamedTuple):
    """Content of a file.

    Attributes:
        sets: its points.
        unit: stated unit; None if there is none.
        side_field: field of sides, one of ``SIDE_FIELDS``; None if there is none.
        first: number of the first frame.
    """

    sets: KeypointSets
    unit: str | None
    side_field: str | None
    first: int = 0


class PointColumn(NamedTuple):
    """A column of one point: its number, the value, and the unit in its name, if any."""

    point: int
    value: int
    unit: str | None


def point_of(kind: PointKind, value: Any, where: object) -> int:
    """Return the number of a point given by number or name.

    Raises:
        UsageError: there is no such point.
    """
    text = str(value).strip()
    number = int(text) if text.isdecimal() and len(text) < 4 else kind.number(text)
    if number is None:
        raise UsageError("unknown point", where=where, found=repr(text), hint=nearest_name(text, kind.names))
    if not 0 <= number < kind.size:
        raise UsageError("no such point", where=where, found=number, expected=kind.range)
    return number


def point_column(kind: PointKind, name: str) -> PointColumn | None:
    """Return the content of a column of a wide table: ``x0``, ``landmark_0_x``, ``thumb_tip_x_mm``."""
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
    """Return a score; NaN if empty.

    Raises:
        UsageError: it is not between 0 and 1.
    """
    score = number_of(value, where)
    if 1.0 < score <= OVER_ONE:
        return 1.0
    if not math.isnan(score) and not 0.0 <= score <= 1.0:
        raise UsageError("score out of range", where=where, found=shown(value), expected="0 to 1")
    return score


def right_of(label: Any, score: float, where: object) -> float:
    """Return the probability of a right hand from a side label; NaN without label.

    Args:
        label: ``right``, ``left``, their first letters, or nothing.
        score: score of the label, NaN for 1.
        where: location, for errors.

    Raises:
        UsageError: the label is unknown.
    """
    plain = str(label if label is not None else "").strip().lower()
    if plain in ("", "unknown", "none", "nan"):
        return math.nan
    if plain not in ("right", "left", "r", "l"):
        raise UsageError("unknown side", where=where, found=shown(label), expected="right or left")
    sure = 1.0 if math.isnan(score) else max(score, 0.5)  # below 0.5 a label carries no information
    return sure if plain[0] == "r" else 1.0 - sure


def unit_of(name: Any, where: object) -> str:
    """Return a unit by its name in a file.

    Raises:
        UsageError: the name is unknown.
    """
    if (plain := str(name).strip().lower()) not in UNIT_NAMES:
        raise UsageError("unknown unit", where=where, found=shown(name), expected=", ".join(UNITS))
    return UNIT_NAMES[plain]
