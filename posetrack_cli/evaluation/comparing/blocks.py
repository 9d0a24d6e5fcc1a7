"""Blocks of one second: what stands for an independent sample where neighbouring frames err alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray

BLOCK_NS = 1_000_000_000
FEWEST_FOR_CORRELATION = 8


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
