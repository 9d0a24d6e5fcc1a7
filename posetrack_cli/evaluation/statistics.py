"""What is said about many errors at once."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from posetrack_cli.arrays import FloatArray


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
        count: how many values.
    """

    mean: float
    sd: float
    median: float
    p95: float
    max: float
    count: int


STATISTIC_NAMES = tuple(field.name for field in fields(Statistics))


def statistics(values: ArrayLike) -> Statistics:
    """Summarise values of any shape.

    A NaN among them makes every figure NaN, so that none hides. An infinite one makes the mean and the
    largest infinite and leaves no standard deviation (NaN).
    """
    flat = np.ravel(np.asarray(values, dtype=np.float64))
    if not flat.size:
        nan = float("nan")
        return Statistics(nan, nan, nan, nan, nan, 0)
    median, p95 = _percentiles(flat, [50.0, 95.0])
    with np.errstate(invalid="ignore"):  # infinity less infinity
        mean, sd = float(flat.mean()), _deviation(flat)
    return Statistics(mean, sd, float(median), float(p95), float(flat.max()), flat.size)


def _deviation(flat: FloatArray) -> float:
    """The standard deviation, scaled first: squares of a NEES with next to no variance would overflow."""
    largest = float(np.abs(flat).max())
    return largest * float((flat / largest).std()) if 0.0 < largest < np.inf else float(flat.std())


def _percentiles(flat: FloatArray, percent: list[float]) -> FloatArray:
    """Percentiles, linear between the two nearest values; numpy's own are NaN near an infinite value."""
    if not np.isinf(flat).any():
        return np.percentile(flat, percent)
    low, high = (np.percentile(flat, percent, method=method) for method in ("lower", "higher"))
    finite = np.isfinite(low) & np.isfinite(high)
    with np.errstate(invalid="ignore"):
        between = np.where(finite, np.percentile(flat, percent), high)
    return np.where(low == high, low, between)
