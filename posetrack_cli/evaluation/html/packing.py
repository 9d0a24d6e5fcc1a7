"""Arrays and text as they are embedded in a page: fewer points that look the same, in few bytes."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from posetrack_cli.arrays import FloatArray, IntArray

ArrayType: TypeAlias = Literal["u1", "i2", "i4", "u4", "f4"]
Packed: TypeAlias = dict[str, Any]
MISSING = -32768
"""Stored in place of a coordinate that is not known."""
LARGEST = 32767
FINEST_STEP_MM = 0.01


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


def packed(values: NDArray[Any], kind: ArrayType) -> Packed:
    """Return an array as base64 of its little-endian bytes; numbers too large for float32 become infinite."""
    with np.errstate(over="ignore"):
        data = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<"))
    return {"type": kind, "data": base64.b64encode(data.tobytes()).decode("ascii")}


def quantisation(points: FloatArray) -> tuple[FloatArray, float]:
    """Return the origin (3,) and the step, mm, with which 16 bits hold points (..., 3), some perhaps NaN.

    The step is no finer than ``FINEST_STEP_MM``; a rounded coordinate is off by half a step at most.
    """
    finite = points[np.isfinite(points).all(axis=-1)]
    if not len(finite):
        return np.zeros(3), FINEST_STEP_MM
    low, high = finite.min(axis=0), finite.max(axis=0)
    return 0.5 * (low + high), max(FINEST_STEP_MM, float((high - low).max()) / (2 * LARGEST))


def quantised(points: FloatArray, origin: FloatArray, step: float) -> Packed:
    """Return points (..., 3) in whole steps from the origin, ``MISSING`` where one is not finite."""
    finite = np.isfinite(points).all(axis=-1, keepdims=True)
    steps = np.where(finite, np.rint((np.where(finite, points, 0.0) - origin) / step), MISSING)
    return packed(np.where(finite, np.clip(steps, -LARGEST, LARGEST), MISSING), "i2")


def json_text(data: Mapping[str, Any]) -> str:
    """Return JSON that can stand in a script element: no ``<``, ``>``, ``&``; NaN and infinity are null."""
    text = json.dumps(_finite(data), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float):  # numpy's float64 is one
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
