"""Importance weights and resampling of N weighted particles into N equally weighted ones.

With 128 x 128 pixels a likelihood spans hundreds of orders of magnitude, so weights are stored as
logarithms and exponentiated only after subtracting the largest. NaN is an error and never a weight of zero,
as it means that the likelihood is broken.

All schemes are unbiased, E[number of children of i] = count w_i, and differ in variance (Douc, Cappe and
Moulines 2005; Chopin and Papaspiliopoulos 2020, chapter 9):

    multinomial   independent draws: variance count w_i (1 - w_i), the largest
    residual      floor(count w_i) deterministic copies, the rest multinomial
    stratified    one draw in each of count equal strata of [0, 1)
    systematic    the same draw in all strata: floor or ceil of count w_i children, one random number

A scheme is a function ``(weights (N,), rng, count) -> ancestors (count,)``, registered by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.filtering.errors import FilterError, Registry

TRUNCATION = 0.06
"""[ours] Limits the weights of the mean to 1 + 0.06 N^(2/3) times their average.

In about twenty dimensions a few of a hundred particles carry most of the weight, and their mean depends on
where they happen to be. Hands have the smallest errors with limits of 1.8 to 2.8 for 128 particles.
"""


def normalise(log_weights: FloatArray) -> tuple[FloatArray, float]:
    """Return the normalised weights, and the logarithm of their sum before normalisation.

    w_i = exp(l_i - m) / sum_j exp(l_j - m), log sum = m + log sum_j exp(l_j - m), with m = max_j l_j.

    Args:
        log_weights: (N,) logarithms of weights >= 0; -inf is a weight of zero.

    Returns:
        (N,) weights that sum to 1, and the log normaliser.

    Raises:
        FilterError: no weights, a NaN, an infinite weight, or all weights are zero.
    """
    if log_weights.ndim != 1 or not log_weights.size:
        raise FilterError("invalid weights", found=f"shape {log_weights.shape}", expected="(N,), N > 0")
    largest = float(log_weights.max())  # NaN if any weight is NaN
    if not math.isfinite(largest):
        raise _without_mass(log_weights)
    weights = np.exp(log_weights - largest)
    total = float(weights.sum())
    weights /= total
    return weights, largest + math.log(total)


def effective_count(weights: FloatArray) -> float:
    """Return the effective sample size 1 / sum_i w_i^2 of weights (N,) that sum to 1, between 1 and N.

    Kong, Liu and Wong 1994.
    """
    return 1.0 / float(weights @ weights)


def truncated(weights: FloatArray) -> FloatArray:
    """Return weights (N,) summing to 1, clipped to limit their influence, and renormalised.

    The limit is 1 + ``TRUNCATION`` N^(2/3) times their mean: truncated importance sampling (Ionides 2008).
    If few samples carry most of the weight, the variance of an estimate decreases much more than its bias
    grows, and the bias vanishes with N, as the limit is unbounded. Ionides' limit grows as N^(1/2), which
    is too high for few particles or too low for many.
    """
    count = weights.size
    limited = np.minimum(weights, 1.0 / count + TRUNCATION / math.cbrt(count))
    out: FloatArray = limited / limited.sum()
    return out


def _without_mass(log_weights: FloatArray) -> FilterError:
    """Return the error for a largest log-weight that is not finite."""
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


Scheme: TypeAlias = Callable[[FloatArray, np.random.Generator, int], IntArray]

_SCHEMES: Registry[Scheme] = Registry("resampling scheme")


@dataclass(frozen=True)
class Resampling:
    """Resampling scheme and frequency.

    Attributes:
        scheme: one of ``resampling_schemes``.
        threshold: resample if the effective sample size is below threshold * N. 1.0 or more: always, as in
            the paper; 0: never.

    Raises:
        FilterError: unknown scheme, or the threshold is negative or NaN.
    """

    scheme: str = "systematic"
    threshold: float = 0.5

    def __post_init__(self) -> None:
        _SCHEMES.find(self.scheme)
        if not self.threshold >= 0.0:
            raise FilterError("invalid threshold", found=self.threshold, expected="0 (never) to 1 (always)")

    def is_due(self, effective_sample_size: float, count: int) -> bool:
        """Return whether ``count`` particles with this effective sample size should be resampled."""
        # Equal weights have an effective size of N only up to rounding, so 'always' needs its own test.
        return self.threshold >= 1.0 or effective_sample_size < self.threshold * count


def resampling_schemes() -> tuple[str, ...]:
    """Return the names of the schemes."""
    return tuple(sorted(_SCHEMES))


def resample(
    scheme: str, weights: FloatArray, rng: np.random.Generator, count: int | None = None
) -> IntArray:
    """Draw ancestors so that particle i is chosen count * w_i times on average.

    Args:
        scheme: one of ``resampling_schemes``.
        weights: (N,) weights >= 0, not necessarily normalised.
        rng: source of randomness.
        count: number of ancestors; default: N.

    Returns:
        (count,) indices into weights, int64, in no particular order. Zero weights are never chosen.

    Raises:
        FilterError: unknown scheme, invalid weights, or count < 1.
    """
    draw = _SCHEMES.find(scheme)
    _check_weights(weights)
    count = weights.size if count is None else count
    if count < 1:
        raise FilterError("invalid number of ancestors", found=f"count {count}", expected="count >= 1")
    return draw(weights, rng, count)


@_SCHEMES.register("systematic")
def systematic(weights: FloatArray, rng: np.random.Generator, count: int) -> IntArray:
    """Invert the cumulative weights at (k + u) / count, k = 0..count-1, one u ~ U[0, 1) (Kitagawa 1996)."""
    return _inverse_cdf(weights, (np.arange(count) + rng.random()) / count)


@_SCHEMES.register("stratified")
def stratified(weights: FloatArray, rng: np.random.Generator, count: int) -> IntArray:
    """Invert the cumulative weights at (k + u_k) / count, k = 0..count-1, u_k ~ U[0, 1) independent."""
    return _inverse_cdf(weights, (np.arange(count) + rng.random(count)) / count)


@_SCHEMES.register("multinomial")
def multinomial(weights: FloatArray, rng: np.random.Generator, count: int) -> IntArray:
    """Invert the cumulative weights at independent u_k ~ U[0, 1) (Gordon, Salmond and Smith 1993)."""
    return _inverse_cdf(weights, rng.random(count))


@_SCHEMES.register("residual")
def residual(weights: FloatArray, rng: np.random.Generator, count: int) -> IntArray:
    """Copy floor(count w_i) times, then draw the rest from the remainders (Liu and Chen 1998)."""
    expected = count * (weights / weights.sum())
    certain = np.floor(expected).astype(np.int64)
    copies = np.repeat(np.arange(weights.size), certain)
    left = count - copies.size
    if left == 0:
        return copies
    return np.concatenate([copies, multinomial(expected - certain, rng, left)])


def _inverse_cdf(weights: FloatArray, queries: FloatArray) -> IntArray:
    """Return for each query in [0, 1] the first i whose cumulative weight exceeds it.

    Strictly, so that u = 0 skips leading zero weights. Cumulative weights that reach 1 are set to infinity:
    a query that rounds to 1, as (count - 1 + u) / count can, then finds the last particle with a weight
    instead of index N or a trailing zero weight.
    """
    cumulative = np.cumsum(weights, dtype=np.float64)
    cumulative /= cumulative[-1]
    cumulative[cumulative >= 1.0] = np.inf
    return np.searchsorted(cumulative, queries, side="right").astype(np.int64, copy=False)


def _check_weights(weights: FloatArray) -> None:
    """Raise unless weights (N,) are >= 0 with a finite sum > 0."""
    usable = weights.ndim == 1 and weights.size > 0 and bool(weights.min() >= 0.0)
    total = float(weights.sum()) if usable else math.nan
    if not (math.isfinite(total) and total > 0.0):
        raise FilterError(
            "invalid weights",
            found=f"shape {weights.shape}",
            expected="(N,), >= 0, with a finite sum > 0",
        )
