"""Definition of a metric, and collection of metric values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.evaluation.measuring.evaluation import (
    Count,
    Distribution,
    Value,
    distribution,
    ranked_statistics,
)
from posetrack_cli.evaluation.reading.tracks import Pairs, Track

Better: TypeAlias = Literal["lower", "higher", "neither"]
PartKind: TypeAlias = Literal["joint", "finger", "angle", "point", "state"]
Group: TypeAlias = Literal["coverage", "accuracy", "velocity", "covariance", "honesty", "consistency", "run"]

GROUP_TITLES: dict[Group, str] = {
    "coverage": "Coverage",
    "accuracy": "Error against ground truth",
    "velocity": "Velocity error",
    "covariance": "Covariance consistency",
    "honesty": "Confidence and status",
    "consistency": "Self-consistency",
    "run": "Run",
}
"""Titles of the groups, in table order."""

_UNIT_ENDINGS = ("_deg_s", "_mm_s", "_mm", "_deg", "_px", "_s")


@dataclass(frozen=True)
class Metric:
    """Definition of a metric.

    Attributes:
        name: first component of its addresses; ends with the unit, if any.
        unit: mm, deg, s, ...; empty for counts and shares.
        meaning: description in one sentence.
        part: kind of the parts that it is also reported for; None for none.
        group: group in tables.
        better: direction of improvement; ``neither`` for metrics with a target value or no preference.
        scalar: True for a single number, False for ``Statistics``.
        spoken: display name; defaults to the name without its unit.
        needs_depth: whether it requires depth images.
        pooled: whether a scalar is pooled over results; ``Statistics`` always are.
    """

    name: str
    unit: str
    meaning: str
    part: PartKind | None = None
    group: Group = "accuracy"
    better: Better = "lower"
    scalar: bool = False
    spoken: str = ""
    needs_depth: bool = False
    pooled: bool = False

    @property
    def label(self) -> str:
        """Display name."""
        endings = (self.name.removesuffix(end) for end in _UNIT_ENDINGS if self.name.endswith(end))
        return self.spoken or next(endings, self.name).replace("_", " ")


@dataclass(frozen=True, eq=False)
class Matched:
    """Estimate and ground truth with their M associated rows."""

    estimate: Track
    truth: Track
    pairs: Pairs

    def __len__(self) -> int:
        return len(self.pairs.estimate)

    def of_estimate(self, name: str, *columns: int | slice) -> FloatArray:
        """Return the matched rows (M, ...) of an array of the estimate, or of some of its columns."""
        return _double(rows_of(getattr(self.estimate, name)[:, *columns], self.pairs.estimate))

    def of_truth(self, name: str, *columns: int | slice) -> FloatArray:
        """Return the matched rows (M, ...) of an array of the ground truth, or of some of its columns."""
        return _double(rows_of(getattr(self.truth, name)[:, *columns], self.pairs.truth))

    def blocks(self, frames: int) -> Iterator[Matched]:
        """Yield parts of at most ``frames`` rows: arrays of a long track need as much memory as itself."""
        for first in range(0, len(self), frames):
            yield self.part(slice(first, first + frames))

    def part(self, rows: slice) -> Matched:
        """Return some of the M rows."""
        return replace(self, pairs=Pairs(self.pairs.estimate[rows], self.pairs.truth[rows]))

    def lacks(self, *names: str) -> str:
        """Return why these arrays cannot be compared; empty if both sides have all of them."""
        for side, track in (("ground truth", self.truth), ("result", self.estimate)):
            for name in names:
                if getattr(track, name) is None:
                    # More helpful than naming the first of many missing arrays.
                    if track.pixels is not None:
                        return f"the {side} has only image points"
                    return f"the {side} has no {_WORDS.get(name, name)}"
        return ""


_WORDS = {
    "points": "points",
    "shape": "finger angles",
    "quaternion": "rotation",
    "twist": "velocity",
    "pose_variance": "covariance",
    "twist_variance": "velocity covariance",
}


def _double(array: np.ndarray[Any, Any]) -> FloatArray:
    return array.astype(np.float64, copy=False)


def rows_of(array: Any, rows: IntArray) -> Any:
    """Return rows of an array: a view if they are contiguous, as copies of long tracks dominate memory.

    Args:
        array: (N, ...).
        rows: (M,) increasing.
    """
    if len(rows) and rows[-1] - rows[0] + 1 == len(rows):
        return array[rows[0] : rows[-1] + 1]
    return array[rows]


@dataclass(frozen=True)
class Common:
    """Points or shape entries that estimate and ground truth have in common.

    Attributes:
        names: common names, in the order of the estimate.
        estimate: their columns in the estimate.
        truth: their columns in the ground truth.
        lacking: names that only the estimate has.
    """

    names: tuple[str, ...]
    estimate: tuple[int, ...]
    truth: tuple[int, ...]
    lacking: tuple[str, ...]


def common_columns(estimate: Sequence[str], truth: Sequence[str]) -> Common:
    """Return the common names of two lists."""
    where = {name: column for column, name in enumerate(truth)}
    mine = [column for column, name in enumerate(estimate) if name in where]
    names = tuple(estimate[column] for column in mine)
    lacking = tuple(name for name in estimate if name not in where)
    return Common(names, tuple(mine), tuple(where[name] for name in names), lacking)


def shape_difference(matched: Matched, name: str, common: Common, first: int = 0) -> FloatArray:
    """Return true minus estimated common shape entries (M, K), which start at column ``first``."""
    found: FloatArray = np.empty((len(matched), len(common.names)), order="F")
    for column, (mine, theirs) in enumerate(zip(common.estimate, common.truth, strict=True)):
        found[:, column] = matched.of_truth(name, first + theirs) - matched.of_estimate(name, first + mine)
    return found


def absolute_deg(angles: FloatArray) -> FloatArray:
    """Return |angles| in degrees; changes the array (rad) in place."""
    return np.degrees(np.abs(angles, out=angles), out=angles)


@dataclass
class Measures:
    """Collector of metric values.

    Attributes:
        nothing: reason for a missing value if there are no values to summarise.
        metrics: values by address without statistic.
        series: per-frame values by metric, without parts.
        track_series: per-frame values over all frames of the track, for metrics without ground truth.
        absent: reasons for missing values, by metric or address.
        counts: counts of the shares, by address.
        distributions: distributions of the summarised values by metric, for pooling.
        notes: remarks on how to read the metrics.
    """

    nothing: str
    metrics: dict[str, Value] = field(default_factory=dict)
    series: dict[str, FloatArray] = field(default_factory=dict)
    track_series: dict[str, FloatArray] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    counts: dict[str, Count] = field(default_factory=dict)
    distributions: dict[str, Distribution] = field(default_factory=dict)

    def add(self, address: str, values: FloatArray, known: BoolArray | None = None) -> None:
        """Summarise per-frame values (M,), or values of frames and parts (M, K), and add a series.

        Args:
            address: address of the metric.
            values: values of all matched frames; the series is their mean over parts.
            known: (M,) mask of the frames with a value; others are NaN in the series and not summarised.
        """
        if self.summarise(address, values, known=known):
            per_frame = values if values.ndim == 1 else values.mean(axis=1)
            self.series[address] = per_frame if known is None else np.where(known, per_frame, np.nan)

    def add_parts(self, address: str, values: FloatArray, names: Sequence[str]) -> None:
        """Summarise values (M, K) as a whole and by part."""
        self.add(address, values)
        self.summarise_parts(address, values, names)

    def summarise_parts(self, address: str, values: FloatArray, names: Sequence[str]) -> None:
        """Summarise each column of values (M, K) under the name of its part; adds no series."""
        for column, name in enumerate(names):
            self.summarise(f"{address}.{name}", values[:, column])

    def summarise(
        self, address: str, values: FloatArray, nothing: str = "", known: BoolArray | None = None
    ) -> bool:
        """Summarise values and return True; record the reason and return False if there are none.

        Args:
            address: address of the metric.
            values: values of any shape.
            nothing: reason; by default ``nothing`` of the collector.
            known: mask of the rows to summarise; None for all.
        """
        # The only copy of the values, as those of a long track are tens of MiB.
        ranked = values.flatten(order="K") if known is None else values[known].ravel(order="K")
        ranked.sort()
        if ranked.size:
            summary = self.metrics[address] = ranked_statistics(ranked)
            if "." not in address:  # parts are not pooled, and their distributions would dominate memory
                self.distributions[address] = distribution(ranked, summary)
        else:
            self.absent[address] = nothing or self.nothing
        return bool(ranked.size)

    def share(self, address: str, inside: np.ndarray[Any, Any]) -> None:
        """Add the share of True values; record the reason if there are none."""
        self.add_share(address, int(inside.sum()), inside.size)

    def add_share(self, address: str, true: int, of: int) -> None:
        """Add a share given as counts; record the reason if there are none."""
        if of:
            self.metrics[address] = true / of
            self.counts[address] = Count(true, of)
        else:
            self.absent[address] = self.nothing

    def lack(self, reason: str, *addresses: str) -> None:
        """Record why these addresses have no value."""
        self.absent.update(dict.fromkeys(addresses, reason))
