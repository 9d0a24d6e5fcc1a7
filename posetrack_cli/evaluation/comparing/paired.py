"""Paired differences: blocks of one second as independent samples, Wilcoxon's test, a bootstrap interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from posetrack_cli.arrays import FloatArray, IntArray

BLOCK_NS = 1_000_000_000
FEWEST_FOR_CORRELATION = 8


CONFIDENCE = 0.95
SIGNIFICANCE = 0.05
RESAMPLES = 9999
BATCH_VALUES = 1_000_000
"""How many numbers the bootstrap draws at a time: bounds its memory."""


@dataclass(frozen=True, eq=False)
class PairedBlocks:
    """Two series over the frames they share, averaged second by second.

    Attributes:
        first, second: (B,) block means, in time's order.
        frames: frames they share, with a figure in both.
        left_out: frames of either that are not among them.
    """

    first: FloatArray
    second: FloatArray
    frames: int
    left_out: int


def paired_blocks(
    first_ns: IntArray, first: FloatArray, second_ns: IntArray, second: FloatArray
) -> PairedBlocks:
    """Average two series of the same recording over the same seconds of the frames that both have.

    The blocks begin at the first common frame; each counts once, also one with few frames.

    Args:
        first_ns, second_ns: (M1,), (M2,) stamps, strictly increasing.
        first, second: (M1,), (M2,) values; frames where one is not finite are left out.
    """
    stamps, mine, theirs = np.intersect1d(first_ns, second_ns, assume_unique=True, return_indices=True)
    a, b = first[mine], second[theirs]
    usable = np.isfinite(a) & np.isfinite(b)
    stamps, a, b = stamps[usable], a[usable], b[usable]
    left_out = len(first_ns) + len(second_ns) - len(mine) - len(stamps)
    return PairedBlocks(block_means(stamps, a), block_means(stamps, b), len(stamps), left_out)


def block_means(stamp_ns: IntArray, values: FloatArray) -> FloatArray:
    """Return the mean of the values in each second that has any, counted from the first stamp.

    Args:
        stamp_ns: (M,) strictly increasing.
        values: (M,).
    """
    if not len(stamp_ns):
        return np.empty(0)
    _, block = np.unique((stamp_ns - stamp_ns[0]) // BLOCK_NS, return_inverse=True)
    means: FloatArray = np.bincount(block, values) / np.bincount(block)
    return means


def neighbour_correlation(differences: FloatArray) -> float:
    """Return the correlation of a series with itself one step later, 0 where it says nothing.

    r = sum_i (d_i - m) (d_{i+1} - m) / sum_i (d_i - m)^2. Independent values have |r| below 2 / sqrt(n) in
    95 % of cases (Bartlett 1946); anything not above that, or of fewer than eight values, is returned as 0.
    """
    centred = differences - differences.mean() if len(differences) else differences
    power = float(centred @ centred)
    if len(differences) < FEWEST_FOR_CORRELATION or power == 0:
        return 0.0
    r = float(centred[:-1] @ centred[1:]) / power
    return r if r > 2 / np.sqrt(len(differences)) else 0.0


@dataclass(frozen=True)
class Paired:
    """What two paired samples say about their difference, second minus first.

    Attributes:
        count: pairs.
        mean_first, mean_second: means over the pairs; NaN without pairs.
        difference: mean of (second - first).
        low, high: 95 % bootstrap interval of the mean difference; NaN with fewer than two pairs.
        p_value: two-sided, of Wilcoxon's signed-rank test; 1 if no pair differs, NaN without pairs.
        note: what a reader must know about the test, or empty.
    """

    count: int
    mean_first: float
    mean_second: float
    difference: float
    low: float
    high: float
    p_value: float
    note: str = ""


def paired(first: ArrayLike, second: ArrayLike, rng_seed: int = 0) -> Paired:
    """Compare two samples whose entries belong together, such as two trackers' errors per recording.

    The test is Wilcoxon's signed-rank test (Wilcoxon 1945), two-sided, pairs without difference left out;
    exact for up to 50 pairs without ties, or up to 13 with ties, else by the normal approximation. The
    interval is Efron's bias-corrected and accelerated bootstrap interval (1987) of the mean difference.
    Both take the pairs as independent: frames of one recording are not, see ``evaluation.comparing.blocks``.

    Args:
        first, second: (n,) each, any unit, the same for both.
        rng_seed: of the bootstrap; the same seed gives the same interval.

    Raises:
        ValueError: the lengths differ, or a value is not finite.
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 1:
        raise ValueError(f"paired samples of shapes {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("paired samples must be finite")
    if not len(a):
        nan = float("nan")
        return Paired(0, nan, nan, nan, nan, nan, nan, "no pairs")
    differences = b - a
    p_value, note = _signed_rank(differences)
    low, high = _interval(differences, rng_seed)
    means = (float(a.mean()), float(b.mean()), float(differences.mean()))
    return Paired(len(a), *means, low, high, p_value, note)


def _signed_rank(differences: FloatArray) -> tuple[float, str]:
    """Return p and what limits it."""
    from scipy.stats import wilcoxon

    different = differences[differences != 0]
    if not len(different):
        return 1.0, "no pair differs"
    smallest = 2.0 ** (1 - len(different))  # all signs equal, either way, of 2^n equally likely ones
    pairs = "pair" if len(different) == 1 else "pairs"
    note = f"p cannot be below {smallest:g} with {len(different)} different {pairs}"
    return float(wilcoxon(different).pvalue), note if smallest > SIGNIFICANCE else ""


def _interval(differences: FloatArray, rng_seed: int) -> tuple[float, float]:
    from scipy.stats import bootstrap

    count = len(differences)
    if count < 2:
        return float("nan"), float("nan")
    if np.ptp(differences) == 0:  # every resample is the sample; the method has nothing to correct
        return float(differences[0]), float(differences[0])
    interval = bootstrap(
        (differences,),
        np.mean,
        n_resamples=RESAMPLES,
        batch=max(1, BATCH_VALUES // count),
        vectorized=True,
        confidence_level=CONFIDENCE,
        method="BCa",
        rng=np.random.default_rng(rng_seed),
    ).confidence_interval
    return float(interval.low), float(interval.high)
