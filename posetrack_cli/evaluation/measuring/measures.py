"""What a metric is, and what its values per frame give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.evaluation.measuring.evaluation import Count, Distribution, Value, distribution, statistics
from posetrack_cli.evaluation.reading.tracks import Pairs, Track

# What a metric is


Better: TypeAlias = Literal["lower", "higher", "neither"]
PartKind: TypeAlias = Literal["joint", "finger", "angle", "point", "state"]
Group: TypeAlias = Literal["coverage", "accuracy", "velocity", "covariance", "honesty", "consistency", "run"]

GROUP_TITLES: dict[Group, str] = {
    "coverage": "Coverage",
    "accuracy": "Error against truth",
    "velocity": "Velocity error against truth",
    "covariance": "Stated covariance against truth",
    "honesty": "Honesty against truth",
    "consistency": "Self-consistency, without truth",
    "run": "Run",
}
"""The groups in the order of every table."""

_UNIT_ENDINGS = ("_deg_s", "_mm_s", "_mm", "_deg", "_px", "_s")


@dataclass(frozen=True)
class Metric:
    """What a figure means.

    Attributes:
        name: first word of its address; ends in its unit where it has one.
        unit: mm, deg, s, ...; empty for counts and shares.
        meaning: one sentence.
        part: kind of the parts that it is told for besides the whole; None for none.
        group: where tables show it.
        better: which way an improvement goes; ``neither`` where the figure has a target or none at all.
        scalar: one number; otherwise ``Statistics``.
        spoken: what a page calls it; by default the name without its unit.
        needs_depth: whether it is measured against depth images.
        pooled: of one number, whether it is told of several results together, too; ``Statistics`` always are.
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
        """What a page calls it."""
        endings = (self.name.removesuffix(end) for end in _UNIT_ENDINGS if self.name.endswith(end))
        return self.spoken or next(endings, self.name).replace("_", " ")


# What measuring works on and what it collects: matched rows, figures, series, and reasons for gaps


@dataclass(frozen=True, eq=False)
class Matched:
    """An estimate and a truth, and which of their rows belong together (M of them)."""

    estimate: Track
    truth: Track
    pairs: Pairs

    def __len__(self) -> int:
        return len(self.pairs.estimate)

    def of_estimate(self, name: str, *columns: int | slice) -> Any:
        """The matched rows of one of the estimate's arrays, or of some of its columns."""
        return rows_of(getattr(self.estimate, name)[:, *columns], self.pairs.estimate)

    def of_truth(self, name: str, *columns: int | slice) -> Any:
        """The same of the truth."""
        return rows_of(getattr(self.truth, name)[:, *columns], self.pairs.truth)

    def lacks(self, *names: str) -> str:
        """Why these arrays cannot be compared: which side has none; empty when both have all."""
        for side, track in (("truth", self.truth), ("result", self.estimate)):
            for name in names:
                if getattr(track, name) is None:
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


def rows_of(array: Any, rows: IntArray) -> Any:
    """Return rows of an array; of adjoining ones a view, since copies of long tracks cost most of the memory.

    Args:
        array: (N, ...).
        rows: (M,) increasing.
    """
    if len(rows) and rows[-1] - rows[0] + 1 == len(rows):
        return array[rows[0] : rows[-1] + 1]
    return array[rows]


@dataclass(frozen=True)
class Common:
    """Points or shape entries that an estimate and a truth both have.

    Attributes:
        names: in the estimate's order.
        estimate: their columns there.
        truth: their columns in the truth.
        lacking: the estimate's others.
    """

    names: tuple[str, ...]
    estimate: tuple[int, ...]
    truth: tuple[int, ...]
    lacking: tuple[str, ...]


def common_columns(estimate: Sequence[str], truth: Sequence[str]) -> Common:
    """Find what two lists of names share."""
    where = {name: column for column, name in enumerate(truth)}
    mine = [column for column, name in enumerate(estimate) if name in where]
    names = tuple(estimate[column] for column in mine)
    lacking = tuple(name for name in estimate if name not in where)
    return Common(names, tuple(mine), tuple(where[name] for name in names), lacking)


def shape_columns(
    matched: Matched, name: str, common: Common, first: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Return the shape entries (M, K) that both sides have; they begin at column ``first`` of the array."""
    mine = matched.of_estimate(name, slice(first, None))[:, common.estimate]
    theirs = matched.of_truth(name, slice(first, None))[:, common.truth]
    return mine, theirs


@dataclass
class Measures:
    """Collects what is measured.

    Attributes:
        nothing: why there is no figure where nothing is there to be summarised.
        metrics: values by address without statistic.
        series: per-frame values by address; of wholes only, parts would be many.
        track_series: the same of what needs no truth, over all frames of the track.
        absent: reasons by metric or address.
        counts: by address what ``share`` made shares from.
        distributions: by address of a whole what pooling needs of the values that were summarised.
        notes: what a reader must know about the figures.
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
        """Summarise the values of frames (M,), or of frames and parts (M, K), whose mean is the series.

        Args:
            address: of the whole.
            values: of every matched frame.
            known: (M,) the frames that have a value; the others are NaN in the series, and not summarised.
        """
        if self.summarise(address, values if known is None else values[known]):
            per_frame = values if values.ndim == 1 else values.mean(axis=1)
            self.series[address] = per_frame if known is None else np.where(known, per_frame, np.nan)

    def add_parts(self, address: str, values: FloatArray, names: Sequence[str]) -> None:
        """Summarise the values (M, K) together, and each part's (M,) by its name."""
        self.add(address, values)
        self.summarise_parts(address, values, names)

    def summarise_parts(self, address: str, values: FloatArray, names: Sequence[str]) -> None:
        """Summarise each part's values, a column of (M, K), by its name; without a series."""
        for column, name in enumerate(names):
            self.summarise(f"{address}.{name}", values[:, column])

    def summarise(self, address: str, values: FloatArray, nothing: str = "") -> bool:
        """Summarise values; of none the reason is kept. Returns whether there were any."""
        if values.size:
            summary = self.metrics[address] = statistics(values)
            if "." not in address:
                self.distributions[address] = distribution(values, summary)
        else:
            self.absent[address] = nothing or self.nothing
        return bool(values.size)

    def share(self, address: str, inside: np.ndarray[Any, Any]) -> None:
        """Keep which share of truth values is true; of none the reason is kept."""
        if inside.size:
            self.metrics[address] = float(inside.mean())
            self.counts[address] = Count(int(inside.sum()), inside.size)
        else:
            self.absent[address] = self.nothing

    def lack(self, reason: str, *addresses: str) -> None:
        """Keep why these have no value."""
        self.absent.update(dict.fromkeys(addresses, reason))
