"""Slices across an arm: how wide it is, and how far two courses of widths are shifted."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray

BIN_MM = 4.0
"""Length of a slice."""
_MOST_FORESHORTENED = 0.33
"""An arm that points more at the camera is sliced as if it pointed no more."""


def slice_areas(
    along: FloatArray, areas: FloatArray, extent_mm: FloatArray, first_mm: float, count: int
) -> FloatArray:
    """Area per length (count,), mm, that is the width seen, of slices across an arm.

    A pixel's area is spread over what the pixel covers: slices about as long as pixels are apart would else
    hold now one row of them, now two, and courses of widths would fit where the rows do, not the hands.

    Args:
        along: (P,) where pixels lie along the arm, mm.
        areas: (P,) what each covers, mm^2.
        extent_mm: (P,) over what length of the arm each does (``extents``), > 0.
        first_mm: where the first slice begins; each is ``BIN_MM`` long.
        count: how many slices.
    """
    half = 0.5 * extent_mm
    begin, end = (along - half - first_mm) / BIN_MM, (along + half - first_mm) / BIN_MM
    first = np.floor(begin)
    density = areas / (end - begin)
    total = np.zeros(count)
    for k in range(int(np.ceil((end - begin).max(initial=0.0))) + 1):
        number = first + k
        covered = np.minimum(end, number + 1.0) - np.maximum(begin, number)
        valid = (covered > 0.0) & (number >= 0) & (number < count)
        weights = (density * covered)[valid]
        total += np.bincount(number[valid].astype(np.int64), weights=weights, minlength=count)
    return total / BIN_MM


def extents(apart: FloatArray, axis: FloatArray) -> FloatArray:
    """Over what length of an arm each of its pixels reaches, mm (P,).

    Rows or columns of the image, ``apart`` where the arm lies across the view, are farther apart on one that
    does not, and closer together on one that lies between them.

    Args:
        apart: (P,) distance of neighbouring pixels that face the camera, mm.
        axis: (3,) unit vector along the arm, camera axes.
    """
    x, y = np.abs(axis[:2])
    length = max(float(np.hypot(x, y)), _MOST_FORESHORTENED)
    across = max(x, y, np.sqrt(0.5) * _MOST_FORESHORTENED)
    return np.asarray(apart * (across / length**2), dtype=np.float64)


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
