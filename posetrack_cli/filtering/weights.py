"""Importance weights, kept as logarithms.

With 128 x 128 pixels a likelihood spans hundreds of orders of magnitude, so weights live as logarithms and
are exponentiated only after the largest has been subtracted. A NaN is an error here and never a weight of
zero: it means that the likelihood is broken, which no resampling mends.
"""

from __future__ import annotations

import math

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.errors import FilterError

TRUNCATION = 0.5
"""[ours]: half of Ionides' limit; measured on hands, it gives the smallest errors and honest variances."""


def normalise(log_weights: FloatArray) -> tuple[FloatArray, float]:
    """Return the normalised weights and the logarithm of their sum before.

    w_i = exp(l_i - m) / sum_j exp(l_j - m), log sum = m + log sum_j exp(l_j - m), with m = max_j l_j.

    Args:
        log_weights: (N,) logarithms of weights >= 0; -inf is a weight of zero.

    Returns:
        (N,) weights that sum to 1, and the log normaliser.

    Raises:
        FilterError: there is no weight, a NaN, an infinite weight, or all weights are zero.
    """
    if log_weights.ndim != 1 or not log_weights.size:
        raise FilterError(
            "weights cannot be used", found=f"shape {log_weights.shape}", expected="(N,), N > 0"
        )
    largest = float(log_weights.max())  # NaN if any is
    if not math.isfinite(largest):
        raise _without_mass(log_weights)
    weights = np.exp(log_weights - largest)
    total = float(weights.sum())
    weights /= total
    return weights, largest + math.log(total)


def effective_count(weights: FloatArray) -> float:
    """Return 1 / sum_i w_i^2 of weights (N,) that sum to 1: N when all are equal, 1 when one has everything.

    The effective sample size of Kong, Liu and Wong 1994.
    """
    return 1.0 / float(weights @ weights)


def truncated(weights: FloatArray) -> FloatArray:
    """Return weights (N,) of sum 1, those above ``TRUNCATION`` sqrt(N) times their mean cut to it.

    All are then normalised again. Truncated importance sampling (Ionides 2008): where few samples carry most
    of the weight, the variance of an estimate falls much more than its bias grows, and the bias vanishes with
    N.
    """
    limited = np.minimum(weights, TRUNCATION / math.sqrt(weights.size))
    out: FloatArray = limited / limited.sum()
    return out


def _without_mass(log_weights: FloatArray) -> FilterError:
    """Say why the largest log-weight is not finite."""
    count = log_weights.size
    broken = int(np.count_nonzero(np.isnan(log_weights)))
    if broken:
        return FilterError("log-weights are NaN", found=f"{broken} of {count}", expected="numbers or -inf")
    if np.any(log_weights > 0.0):
        infinite = int(np.count_nonzero(np.isposinf(log_weights)))
        return FilterError("log-weights are infinite", found=f"{infinite} of {count}", expected="< inf")
    return FilterError(
        "no particle explains the observation", found=f"all {count} weights zero", expected="one > 0"
    )
