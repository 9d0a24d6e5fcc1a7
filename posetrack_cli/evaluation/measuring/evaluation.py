"""Evaluation of one result, statistics, and mergeable distributions of values."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.evaluation.measuring.honesty import JudgedFrames
from posetrack_cli.evaluation.reading.alignment import JointOffsets
from posetrack_cli.evaluation.reading.tracks import Coverage, Pairs, Track
from posetrack_cli.losses import Loss
from posetrack_cli.results.topics import FILTERED

# Statistics and Evaluation: the input of all outputs (tables, JSON, CSV, HTML, gates)


@dataclass(frozen=True)
class Statistics:
    """Summary of a set of values; all fields but ``count`` are NaN if the set is empty.

    Attributes:
        mean: arithmetic mean.
        sd: population standard deviation, sqrt(mean of squared deviations).
        median: 50th percentile.
        p95: 95th percentile, with linear interpolation.
        max: maximum.
        p5: 5th percentile, with linear interpolation; the bad end of metrics where higher is better.
        count: number of values.
    """

    mean: float
    sd: float
    median: float
    p95: float
    max: float
    p5: float
    count: int


STATISTIC_NAMES = tuple(one.name for one in fields(Statistics))


def statistics(values: ArrayLike) -> Statistics:
    """Summarise values of any shape.

    A NaN among the values makes all statistics NaN. An infinite value makes mean and maximum infinite and
    the standard deviation NaN.
    """
    return ranked_statistics(np.sort(np.asarray(values, dtype=np.float64), axis=None))


def ranked_statistics(ranked: FloatArray) -> Statistics:
    """Summarise values (N,) in increasing order, NaN last; see ``statistics``."""
    if not ranked.size:
        nan = float("nan")
        return Statistics(nan, nan, nan, nan, nan, nan, 0)
    with np.errstate(invalid="ignore"):  # inf - inf
        mean, sd = float(ranked.mean()), _deviation(ranked)
    largest = float(ranked[-1])
    p5, median, p95 = _percentiles_of_ranked(lambda at: float(ranked[at]), ranked.size, (5.0, 50.0, 95.0))
    if math.isnan(largest):
        p5 = median = p95 = largest
    return Statistics(mean, sd, median, p95, largest, p5, ranked.size)


def _deviation(ranked: FloatArray) -> float:
    # Scaled first, as the squares of a NEES with almost no variance would overflow.
    largest = float(np.maximum(ranked[-1], -ranked[0]))
    if not 0.0 < largest < np.inf:
        return float(ranked.std())
    middle = sum(float((piece / largest).sum()) for piece in _pieces(ranked)) / ranked.size
    squares = sum(float(np.square(piece / largest - middle).sum()) for piece in _pieces(ranked))
    return largest * math.sqrt(squares / ranked.size)


PIECE = 2**17
"""Number of values that are treated at a time; bounds the memory of long recordings."""


def _pieces(values: FloatArray) -> Iterator[FloatArray]:
    return (values[first : first + PIECE] for first in range(0, values.size, PIECE))


def _percentiles_of_ranked(
    ranked: Callable[[int], float], count: int, percent: Sequence[float]
) -> list[float]:
    """Return percentiles with linear interpolation.

    Args:
        ranked: returns the value of a rank, 0 to ``count`` - 1.
        count: number of values; at least one.
        percent: percentages, 0 to 100.
    """
    found = []
    for one in percent:
        place = one / 100.0 * (count - 1)
        low, high, share = ranked(math.floor(place)), ranked(math.ceil(place)), place - math.floor(place)
        if not (math.isfinite(low) and math.isfinite(high)):
            found.append(high)
        else:  # from the nearer of both, as numpy does
            found.append(low + share * (high - low) if share < 0.5 else high - (1.0 - share) * (high - low))
    return found


@dataclass(frozen=True, eq=False)
class Distribution:
    """Summary of values that can be merged with others without keeping the values.

    Attributes:
        count: number of values; at least one.
        mean: mean, NaN if a value is NaN.
        sd: standard deviation, see ``Statistics``.
        largest: maximum.
        bins: (B,) indices of the non-empty bins, increasing like the values.
        counts: (B,) number of values in each bin.
        means: (B,) mean of the values in each bin.
    """

    count: int
    mean: float
    sd: float
    largest: float
    bins: IntArray
    counts: IntArray
    means: FloatArray

    def statistics(self) -> Statistics:
        """Return statistics of the values; percentiles are accurate to the width of a bin."""
        if np.isnan(self.mean) and not np.isinf(self.means).any():
            nan = float("nan")
            return Statistics(nan, nan, nan, nan, nan, nan, self.count)
        last = np.cumsum(self.counts)

        def ranked(place: int) -> float:
            return float(self.means[np.searchsorted(last, place, side="right")])

        p5, median, p95 = _percentiles_of_ranked(ranked, self.count, (5.0, 50.0, 95.0))
        return Statistics(self.mean, self.sd, median, p95, self.largest, p5, self.count)


Value: TypeAlias = Statistics | float


@dataclass(frozen=True)
class Count:
    """A share as counts (true, of total), which can be pooled."""

    true: int
    of: int


@dataclass(frozen=True, eq=False)
class Curve:
    """Share of frames whose largest, or mean, joint error is below a threshold D.

    Attributes:
        thresholds_mm: (T,) thresholds D, mm, increasing.
        share: (T,) share, 0 to 1, of the expected frames whose largest joint error is below D; missed frames
            count as above.
        mean_share: (T,) likewise for the mean joint error.
    """

    thresholds_mm: FloatArray
    share: FloatArray
    mean_share: FloatArray


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Evaluation of one result.

    Attributes:
        name: display name; unique among the results of a report.
        path: path of the result.
        subject: ``hand`` or ``head``.
        run: the run record as stored (configuration as JSON text, seed, renderer, ...).
        coverage: frame counts.
        metrics: values by address without statistic: ``joint_error_mm``, ``joint_error_mm.index_tip``,
            ``frames_within_20mm``; in catalogue order.
        absent: all other addresses of the subject, including parts, with the reason for the missing value.
        series: per-frame values (M,) by metric, such as ``joint_error_mm`` (mean over the joints), over the
            matched frames, or over all frames without ground truth; used by comparisons and plots. NaN in
            frames without a value; a NEES can be infinite.
        series_stamp_ns: (M,) stamps of the series.
        curve: share of frames below an error threshold; None without true points.
        notes: remarks on how to read the metrics: alignment, unfinished run, ...
        losses: parts of the result that could not be read; if any, the exit code is 3.
        track, truth, pairs: compared tracks and their association; truth and pairs are None without ground
            truth.
        which: name of the track: ``filtered`` or ``smoothed``.
        joint_offsets: removed constant offsets of the joints; None if not requested.
        judged: the frames with ground truth, judged correct or wrong; None without ground truth.
        counts: counts of the shares among the metrics, for pooling.
        distributions: distributions of the metrics that are ``Statistics``, for pooling; wholes only.
        track_series: jitter, and residual and overlap if computed, over all N frames of the track; NaN in
            frames without a value.
    """

    name: str
    path: Path
    subject: str
    run: Mapping[str, str]
    coverage: Coverage
    metrics: Mapping[str, Value]
    absent: Mapping[str, str]
    series: Mapping[str, FloatArray]
    series_stamp_ns: IntArray
    curve: Curve | None
    notes: tuple[str, ...]
    losses: tuple[Loss, ...]
    track: Track
    truth: Track | None = None
    pairs: Pairs | None = None
    which: str = FILTERED
    joint_offsets: JointOffsets | None = None
    judged: JudgedFrames | None = None
    counts: Mapping[str, Count] = field(default_factory=dict)
    distributions: Mapping[str, Distribution] = field(default_factory=dict)
    track_series: Mapping[str, FloatArray] = field(default_factory=dict)
    label: str = ""

    @property
    def topic(self) -> str:
        """Part of the topics' names: ``hand``, ``hand/left``."""
        return f"{self.subject}/{self.label}" if self.label else self.subject

    def placed_series(self) -> dict[str, FloatArray]:
        """Return the series over all N frames of the track; NaN in frames without ground truth."""
        rows = np.searchsorted(self.track.stamp_ns, self.series_stamp_ns)
        placed: dict[str, FloatArray] = {}
        for name, values in self.series.items():
            placed[name] = np.full(len(self.track), np.nan)
            placed[name][rows] = values
        return placed


# Mergeable distributions, for pooling many recordings without keeping their values.
#
# Count, mean, standard deviation and maximum merge exactly. Percentiles use logarithmic bins as in DDSketch
# (Masson et al. 2019). Each bin also stores the mean of its values, so that a bin with one value, or with
# equal values, is exact. Memory depends on the range of the values, not on their number.


STEP = 5e-4
"""Relative width of a bin, and so the relative error bound of a pooled percentile."""
SMALLEST = 1e-9
"""Smaller magnitudes, in the unit of the metric, count as 0."""
INFINITE = 2**40
"""Bin index of infinite values, above all others."""
FEWEST_TO_MERGE = 200_000
"""Number of pending bins that triggers a merge, as a merge costs the same for one set as for a hundred."""
Binned: TypeAlias = tuple[IntArray, IntArray, FloatArray]
"""Bin indices, increasing, and the counts and means of their values."""


def distribution(ranked: FloatArray, summary: Statistics) -> Distribution:
    """Return the distribution of values.

    Args:
        ranked: (N,) values in increasing order, NaN last; at least one.
        summary: statistics of the same values.
    """
    pieces = [_counted(piece) for piece in _pieces(ranked)]
    return Distribution(summary.count, summary.mean, summary.sd, summary.max, *_together(pieces))


def _counted(ranked: FloatArray) -> Binned:
    """Count the values in bins; NaN is left out, as it already shows in the mean."""
    values = ranked[~np.isnan(ranked)]
    bins = _bins(values)
    first = np.flatnonzero(np.diff(bins, prepend=bins[:1] - 1))
    counts = np.diff(first, append=len(bins))
    if not first.size:
        return bins, counts, values
    return bins[first], counts, np.add.reduceat(np.where(np.isfinite(values), values, 0.0), first) / counts


def _together(pieces: Sequence[Binned]) -> Binned:

    numbers, counts, means = (np.concatenate([piece[k] for piece in pieces]) for k in range(3))
    bins, places = np.unique(numbers, return_inverse=True)
    total = np.bincount(places, counts, len(bins)).astype(np.int64)
    sums = np.bincount(places, np.where(np.isfinite(means), means, 0.0) * counts, len(bins))
    return bins, total, np.where(np.abs(bins) == INFINITE, np.copysign(np.inf, bins), sums / total)


def _bins(values: FloatArray) -> IntArray:
    """Return the bin index of each value: 0 around 0, increasing with the value."""
    size = np.abs(values)
    with np.errstate(divide="ignore"):
        place = np.floor(np.log(size / SMALLEST) / STEP) + 1.0
    place = np.where(size < SMALLEST, 0.0, np.where(np.isinf(size), INFINITE, place))
    bins: IntArray = (np.sign(values) * place).astype(np.int64)
    return bins


def merged(members: Sequence[Distribution]) -> Distribution:
    """Merge one or more distributions; all values have equal weight."""
    if len(members) == 1:
        return members[0]
    count = sum(one.count for one in members)
    weights = np.array([one.count for one in members]) / count
    means = np.array([one.mean for one in members])
    with np.errstate(invalid="ignore"):  # inf - inf
        mean = float(weights @ means)
        spread = np.concatenate([[one.sd for one in members], np.abs(means - mean)])
        largest = float(np.max(spread))  # NaN if one is
        scaled = spread / largest if 0.0 < largest < np.inf else spread
        share = float(np.tile(weights, 2) @ scaled**2)
    sd = float(np.sqrt(share)) * (largest if 0.0 < largest < np.inf else 1.0)
    binned = _together([(one.bins, one.counts, one.means) for one in members])
    return Distribution(count, mean, sd, float(np.max([one.largest for one in members])), *binned)


class Collected:
    """Merges distributions incrementally, so that memory does not grow with their number."""

    def __init__(self) -> None:
        self.members = 0
        self._waiting: list[Distribution] = []

    def add(self, one: Distribution) -> None:
        """Add a distribution."""
        self.members += 1
        self._waiting.append(one)
        first, *others = self._waiting
        if sum(len(other.bins) for other in others) > max(FEWEST_TO_MERGE, 2 * len(first.bins)):
            self._waiting = [merged(self._waiting)]

    def total(self) -> Distribution:
        """Return the merged distribution; requires at least one."""
        self._waiting = [merged(self._waiting)]
        return self._waiting[0]
