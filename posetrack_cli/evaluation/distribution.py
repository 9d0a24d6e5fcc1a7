"""Values of many recordings together, without keeping them: what a pooled mean and percentile are made of.

Count, mean, standard deviation and largest value of sets of values follow exactly from those of each set. For
percentiles the values are counted in bins whose width is a share of the value, as in DDSketch (Masson et al.
2019); each bin keeps the sum of its values, too, so that a bin of equal values, or of one, stands for exactly
that. How much is kept depends on how far values spread, not on how many there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.evaluation.evaluation import Distribution, Statistics

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
