"""What a file of keypoints says, whatever its layout: sets of points, by frame or by time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.errors import UsageError
from posetrack_cli.recording.keypoints.kind import PointKind

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
