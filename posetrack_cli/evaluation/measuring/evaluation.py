"""What an evaluation holds, and the distribution of values over frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
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
from posetrack_cli.results.channels import FILTERED

# What an evaluation says about one result; every output (table, JSON, CSV, HTML, gates) is made from it


@dataclass(frozen=True)
class Statistics:
    """Summary of a set of values; all but ``count`` are NaN when the set is empty.

    Attributes:
        mean: arithmetic mean.
        sd: standard deviation of these values, sqrt(mean of squared deviations): they are all there are,
            no sample of more.
        median: 50th percentile.
        p95: 95th percentile, linear between the two nearest values.
        max: largest.
        p5: 5th percentile, likewise: what stands for the bad end where small is bad.
        count: how many values.
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

    A NaN among them makes every figure NaN, so that none hides. An infinite one makes the mean and the
    largest infinite and leaves no standard deviation (NaN).
    """
    flat = np.ravel(np.asarray(values, dtype=np.float64))
    if not flat.size:
        nan = float("nan")
        return Statistics(nan, nan, nan, nan, nan, nan, 0)
    p5, median, p95 = _percentiles(flat, [5.0, 50.0, 95.0])
    with np.errstate(invalid="ignore"):  # infinity less infinity
        mean, sd = float(flat.mean()), _deviation(flat)
    return Statistics(mean, sd, float(median), float(p95), float(flat.max()), float(p5), flat.size)


def _deviation(flat: FloatArray) -> float:
    """The standard deviation, scaled first: squares of a NEES with next to no variance would overflow."""
    largest = float(np.abs(flat).max())
    return largest * float((flat / largest).std()) if 0.0 < largest < np.inf else float(flat.std())


def _percentiles_of_ranked(
    ranked: Callable[[int], float], count: int, percent: Sequence[float]
) -> list[float]:
    """Return percentiles, linear between the two nearest values, of values that are known by their rank.

    Args:
        ranked: returns the value that has so many smaller ones, 0 to ``count`` - 1.
        count: how many values; at least one.
        percent: 0 to 100 each.
    """
    found = []
    for one in percent:
        place = one / 100.0 * (count - 1)
        low, high = ranked(math.floor(place)), ranked(math.ceil(place))
        between = math.isfinite(low) and math.isfinite(high)
        found.append(low + (place - math.floor(place)) * (high - low) if between else high)
    return found


def _percentiles(flat: FloatArray, percent: list[float]) -> FloatArray:
    """Percentiles, linear between the two nearest values; numpy's own are NaN near an infinite value."""
    if not np.isinf(flat).any():
        return np.percentile(flat, percent)
    low, high = (np.percentile(flat, percent, method=method) for method in ("lower", "higher"))
    finite = np.isfinite(low) & np.isfinite(high)
    with np.errstate(invalid="ignore"):
        between = np.where(finite, np.percentile(flat, percent), high)
    return np.where(low == high, low, between)


@dataclass(frozen=True, eq=False)
class Distribution:
    """Values, summarised so that they can be pooled with others, see ``evaluation.measuring.evaluation``.

    Attributes:
        count: how many; at least one.
        mean: of them, NaN if one of them is NaN.
        sd: their standard deviation, see ``Statistics``.
        largest: of them.
        bins: (B,) numbers of the bins that have values, increasing as the values do.
        counts: (B,) how many values are in each.
        means: (B,) their mean.
    """

    count: int
    mean: float
    sd: float
    largest: float
    bins: IntArray
    counts: IntArray
    means: FloatArray

    def statistics(self) -> Statistics:
        """Return the summary of all values; percentiles are off by less than the width of a bin."""
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
    """Of how many of something a thing is true: a share that can be pooled with others."""

    true: int
    of: int


@dataclass(frozen=True, eq=False)
class Curve:
    """The field's curve: share of frames whose largest, or mean, joint error is below D.

    Attributes:
        thresholds_mm: (T,) D, increasing.
        share: (T,) 0 to 1, of all frames that should have been tracked, whose largest joint error is below:
            missed ones count as not below.
        mean_share: (T,) the same of the mean over the joints.
    """

    thresholds_mm: FloatArray
    share: FloatArray
    mean_share: FloatArray


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One result, measured.

    Attributes:
        name: the column's heading; unique among results that are shown beside each other.
        path: the result's file.
        subject: ``hand`` or ``head``.
        run: the result's run record, as written (configuration as JSON text, seed, renderer, ...).
        coverage: frames tracked, lost, unmatched.
        metrics: values by address without statistic: ``joint_error_mm``, ``joint_error_mm.index_tip``,
            ``frames_within_20mm``; in the order of ``evaluation.measuring.catalogue``.
        absent: every other address of this subject, parts included, and why it has no value ("no truth").
        series: per-frame values (M,) over the matched frames, without truth over all, by metric without part,
            such as ``joint_error_mm`` (mean over the joints) and ``largest_joint_error_mm``; what comparisons
            pair and plots show. NaN in a frame without a value (no true velocity, no cost); a NEES may be
            infinite.
        series_stamp_ns: (M,) their stamps.
        curve: None where there is no truth with points.
        notes: what a reader of the figures must know: an alignment that was removed, an unfinished run.
        losses: data of the result that could not be read; not empty means exit code 3.
        track, truth, pairs: what was compared; truth and pairs None without truth.
        which: of the result's tracks: ``filtered`` or ``smoothed``.
        joint_offsets: the constant offset that each joint was rid of; None where that was not asked for.
        judged: the frames with a truth, right or wrong, and what the track says of them; None without.
        counts: what the shares among the metrics are made from, where they are of single frames or entries.
        distributions: of the metrics as wholes that are ``Statistics``, what pooling needs of their values.
        track_series: jitter, and residual and overlap where measured, of all N frames of the track; NaN in a
            frame without a value.
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

    def placed_series(self) -> dict[str, FloatArray]:
        """Return the series at all N frames of the track; NaN in frames without truth."""
        rows = np.searchsorted(self.track.stamp_ns, self.series_stamp_ns)
        placed: dict[str, FloatArray] = {}
        for name, values in self.series.items():
            placed[name] = np.full(len(self.track), np.nan)
            placed[name][rows] = values
        return placed


# Values of many recordings together, without keeping them: what a pooled mean and percentile are made of.
#
# Count, mean, standard deviation and largest value of sets of values follow exactly from those of each set.
# For percentiles the values are counted in bins whose width is a share of the value, as in DDSketch (Masson
# et al. 2019); each bin keeps the sum of its values, too, so that a bin of equal values, or of one, stands
# for exactly that. How much is kept depends on how far values spread, not on how many there are.


STEP = 5e-4
"""Width of a bin, a share of the values in it: a pooled percentile is off by less than this share."""
SMALLEST = 1e-9
"""In a figure's own unit: what is smaller counts as 0."""
INFINITE = 2**40
"""The bin of infinite values, behind all others."""
FEWEST_TO_MERGE = 200_000
"""How many bins wait before they are merged: merging takes as long for one set as for a hundred."""
PIECE = 2**17
"""Values that are put into bins at a time: bounds the memory of long recordings."""
Binned: TypeAlias = tuple[IntArray, IntArray, FloatArray]
"""Numbers of bins, increasing, counts and means of their values."""


def distribution(values: FloatArray, summary: Statistics) -> Distribution:
    """Return what is kept of values of any shape.

    Args:
        values: at least one.
        summary: of the same values.
    """
    flat = np.ravel(values)
    pieces = [_counted(flat[first : first + PIECE]) for first in range(0, flat.size, PIECE)]
    return Distribution(summary.count, summary.mean, summary.sd, summary.max, *_together(pieces))


def _counted(values: FloatArray) -> Binned:
    """The bins of values (N,) that are used, how many values are in each, and their mean; of NaN none."""
    values = values[~np.isnan(values)]  # the mean tells that there were any
    used, places, counts = np.unique(_bins(values), return_inverse=True, return_counts=True)
    return used, counts, np.bincount(places, np.where(np.isfinite(values), values, 0.0), len(used)) / counts


def _together(pieces: Sequence[Binned]) -> Binned:
    """Bins of several sets of values as those of one."""
    numbers, counts, means = (np.concatenate([piece[k] for piece in pieces]) for k in range(3))
    bins, places = np.unique(numbers, return_inverse=True)
    total = np.bincount(places, counts, len(bins)).astype(np.int64)
    sums = np.bincount(places, np.where(np.isfinite(means), means, 0.0) * counts, len(bins))
    return bins, total, np.where(np.abs(bins) == INFINITE, np.copysign(np.inf, bins), sums / total)


def _bins(values: FloatArray) -> IntArray:
    """The number of each value's bin: 0 around 0, increasing with the value."""
    size = np.abs(values)
    with np.errstate(divide="ignore"):
        place = np.floor(np.log(size / SMALLEST) / STEP) + 1.0
    place = np.where(size < SMALLEST, 0.0, np.where(np.isinf(size), INFINITE, place))
    bins: IntArray = (np.sign(values) * place).astype(np.int64)
    return bins


def merged(members: Sequence[Distribution]) -> Distribution:
    """Return the distribution of the values of one or more together, each value counting alike."""
    if len(members) == 1:
        return members[0]
    count = sum(one.count for one in members)
    weights = np.array([one.count for one in members]) / count
    means = np.array([one.mean for one in members])
    with np.errstate(invalid="ignore"):  # infinity less infinity
        mean = float(weights @ means)
        spread = np.concatenate([[one.sd for one in members], np.abs(means - mean)])
        largest = float(np.max(spread))  # NaN if one is
        scaled = spread / largest if 0.0 < largest < np.inf else spread
        share = float(np.tile(weights, 2) @ scaled**2)
    sd = float(np.sqrt(share)) * (largest if 0.0 < largest < np.inf else 1.0)
    binned = _together([(one.bins, one.counts, one.means) for one in members])
    return Distribution(count, mean, sd, float(np.max([one.largest for one in members])), *binned)


class Collected:
    """Distributions that come one after the other, merged in time: memory does not grow with their number."""

    def __init__(self) -> None:
        self.members = 0
        self._waiting: list[Distribution] = []

    def add(self, one: Distribution) -> None:
        """Take one more."""
        self.members += 1
        self._waiting.append(one)
        first, *others = self._waiting
        if sum(len(other.bins) for other in others) > max(FEWEST_TO_MERGE, 2 * len(first.bins)):
            self._waiting = [merged(self._waiting)]

    def total(self) -> Distribution:
        """Return all of them together; there must be one."""
        self._waiting = [merged(self._waiting)]
        return self._waiting[0]
