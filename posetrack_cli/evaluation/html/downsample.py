"""Fewer points that look the same: what a plot of limited width cannot show is left out, but never a peak."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray


def envelope_rows(lines: FloatArray, limit: int) -> IntArray:
    """Choose the rows that a plot of several lines over the same rows needs.

    The rows are cut into equal intervals; of each interval the rows are kept where a line is smallest and
    largest, and the first at which it has no value, so that lines break where they must. The first and the
    last row are kept too.

    Args:
        lines: (L, N), NaN or infinite where a line has no value.
        limit: about how many rows to keep; all N are kept if they are no more than that.

    Returns:
        (R,) row numbers, increasing; R <= max(limit, 3 L + 2).
    """
    count = lines.shape[1]
    if count <= limit:
        return np.arange(count, dtype=np.int64)
    per_interval = 2 * len(lines) + int((~np.isfinite(lines)).any(axis=1).sum())
    intervals = max(1, (limit - 2) // per_interval)
    size = -(-count // intervals)
    chosen = [np.array([0, count - 1], dtype=np.int64)]
    for line in lines:
        chosen += _extremes(line, size)
    return np.unique(np.concatenate(chosen))


def _extremes(line: FloatArray, size: int) -> list[IntArray]:
    """Rows of the smallest and largest value and of the first missing one in every ``size`` rows."""
    padding = -len(line) % size
    values = np.pad(line, (0, padding), constant_values=np.nan).reshape(-1, size)
    valid = np.isfinite(values)
    has_value = valid.any(axis=1)
    missing = ~valid
    if padding:
        missing[-1, -padding:] = False
    start = np.arange(len(values), dtype=np.int64) * size
    smallest = start + np.where(valid, values, np.inf).argmin(axis=1)
    largest = start + np.where(valid, values, -np.inf).argmax(axis=1)
    first_missing = start + missing.argmax(axis=1)
    return [smallest[has_value], largest[has_value], first_missing[missing.any(axis=1)]]


def step_for(count: int, limit: int) -> int:
    """Return the k for which every k-th of ``count`` rows are no more than ``limit``."""
    return max(1, -(-count // limit))
