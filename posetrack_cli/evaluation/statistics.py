"""What is said about many errors at once."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike


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
    """Summarise values of any shape; a NaN among them makes every figure NaN, so that none hides."""
    flat = np.ravel(np.asarray(values, dtype=np.float64))
    if not flat.size:
        nan = float("nan")
        return Statistics(nan, nan, nan, nan, nan, 0)
    median, p95 = np.percentile(flat, [50.0, 95.0])
    return Statistics(
        float(flat.mean()), float(flat.std()), float(median), float(p95), float(flat.max()), flat.size
    )
