"""Slices across an arm: how wide it is, and how far two courses of widths are shifted."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray

BIN_MM = 4.0
"""Length of a slice."""


def slice_areas(along: FloatArray, areas: FloatArray, first_mm: float, count: int) -> FloatArray:
    """Area per length (count,), mm, that is the width seen, of slices across an arm.

    Args:
        along: (P,) where pixels lie along the arm, mm.
        areas: (P,) what each covers, mm^2.
        first_mm: where the first slice begins; each is ``BIN_MM`` long.
        count: how many slices.
    """
    number = np.floor((along - first_mm) / BIN_MM).astype(np.int64)
    valid = (number >= 0) & (number < count)
    return np.bincount(number[valid], weights=areas[valid], minlength=count) / BIN_MM


def best_shift(observed: FloatArray, expected: FloatArray, last: int, most: int, stiffness: float) -> float:
    """The shift t of an expected course of widths that an observed one shows, in slices.

        E(t) = sum over slices k < last + t of |observed_k - expected_(k - t)| + stiffness t^2 / 2

    ``expected`` counts up to ``last`` only; what is observed beyond ``last + t`` is not compared. Between
    whole slices the minimum is that of the parabola through the smallest E and its neighbours.

    Args:
        observed, expected: (K,) widths, mm.
        last: the slice before which the hand ends where it is expected.
        most: largest shift, in slices; at most K - ``last``.
        stiffness: of the prior about t = 0.
    """
    padded = np.pad(expected[:last], most)
    errors = np.empty(2 * most + 1)
    for k, shift in enumerate(range(-most, most + 1)):
        compared = last + shift
        moved = padded[most - shift : most - shift + compared]
        errors[k] = np.abs(observed[:compared] - moved).sum() + 0.5 * stiffness * shift**2
    return _vertex(errors) - most


def _vertex(errors: FloatArray) -> float:
    """Index of the smallest error, refined by the parabola through it and its neighbours."""
    k = int(np.argmin(errors))
    if k in (0, len(errors) - 1):
        return float(k)
    before, here, after = (float(e) for e in errors[k - 1 : k + 2])
    curvature = before - 2.0 * here + after
    return k + (0.5 * (before - after) / curvature if curvature > 0.0 else 0.0)
