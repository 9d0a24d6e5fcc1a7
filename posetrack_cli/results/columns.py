"""Estimates as columns of numbers, decoded without an object per frame: for long results, block by block."""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from operator import itemgetter
from typing import Any, TypeAlias

import numpy as np

from posetrack_cli.errors import ResultError
from posetrack_cli.results.estimate import Status
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME, parse_fields
from posetrack_cli.results.fields import (
    BY_NAME,
    FIELD_NAMES,
    NUMBERS,
    UNKNOWN_ARRAYS,
    UNKNOWN_NUMBERS,
    Sizes,
    array_shapes,
)

Columns: TypeAlias = dict[str, np.ndarray[Any, Any]]

BLOCK_FRAMES = 1000
_GROWTH_FRAMES = 4096

_STATUSES = np.array([status.value for status in Status])
_STATUS_CODES = {status.value: code for code, status in enumerate(Status)}
_XYZ = itemgetter("x", "y", "z")
_APART = ("points", NUMBERS)
"""Arrays that messages hold as objects."""


def column_blocks(
    messages: Iterable[bytes],
    fields: Collection[str] = FIELD_NAMES,
    frames: int = BLOCK_FRAMES,
    where: object = "",
    number_names: Sequence[str] = (),
) -> Iterator[Columns]:
    """Yield the columns of consecutive messages ``posetrack.Estimate``, at most ``frames`` rows at a time.

    The arrays are those of ``empty_columns``, with as many shape entries K and points P as the first message.

    Args:
        messages: in JSON.
        fields: to decode.
        frames: per block; the last may have fewer.
        where: file and topic, for errors.
        number_names: of the further numbers (M) that are wanted; NaN where a message has not got one.

    Raises:
        ResultError: a message is no estimate, or has other numbers of shape entries or points.
    """
    rows: _Rows | None = None
    for number, data in enumerate(messages):
        try:
            values = parse_fields(data)
            sizes = Sizes(len(values["shape"]), len(values["points"]), len(number_names))
            rows = rows or _Rows(fields, sizes, number_names)
            rows.add(values)
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            raise ResultError(
                f"message {number} is no {ESTIMATE_SCHEMA_NAME}", where=where, found=error
            ) from error
        if rows.count == frames:
            yield rows.take()
    if rows is not None and rows.count:
        yield rows.take()


def empty_columns(fields: Collection[str], sizes: Sizes) -> Columns:
    """Return columns of no rows: each field's array, for estimates of these sizes.

    Frame indices and stamps are integers, ``status`` is text, ``resampled`` boolean, everything else float64.
    What a message need not have (``UNKNOWN_ARRAYS``, ``UNKNOWN_NUMBERS``) and has not is NaN.
    """
    shapes = array_shapes(sizes)
    return {name: np.empty((0, *shapes.get(name, ())), dtype=BY_NAME[name].column) for name in fields}


def joined(blocks: Iterable[Columns]) -> Columns:
    """Put blocks one below the other, each dropped when it is copied; {} if there are none.

    Arrays grow in place, so the peak is little above the size of the columns.
    """
    grown: Columns = {}
    count = 0
    for block in blocks:
        rows = len(next(iter(block.values()), ()))
        for name, part in block.items():
            column = grown.setdefault(name, np.empty_like(part[:0]))
            if count + rows > len(column):
                _resize(column, count + max(rows, _GROWTH_FRAMES, count // 8))
            column[count : count + rows] = part
        count += rows
    for column in grown.values():
        _resize(column, count)
    return grown


def _resize(column: np.ndarray[Any, Any], rows: int) -> None:
    """Change the length in place; nothing else refers to the array yet."""
    column.resize((rows, *column.shape[1:]), refcheck=False)


class _Rows:
    """Collects frames, field by field.

    Args:
        fields: the fields to keep.
        sizes: of the estimates.
        number_names: of the further numbers.
    """

    def __init__(self, fields: Collection[str], sizes: Sizes, number_names: Sequence[str]) -> None:
        self.count = 0
        self._empty = empty_columns(fields, sizes)
        self._number_names = number_names
        lengths = {name: math.prod(shape) for name, shape in array_shapes(sizes).items()}
        self._points = sizes.points
        self._sizes = {name: lengths[name] for name in self._empty if name in lengths and name not in _APART}
        self._optional = [name for name in self._empty if name in UNKNOWN_NUMBERS]
        others = {*lengths, *self._optional, "status"}
        self._numbers = [name for name in self._empty if name not in others]
        self._clear()

    def add(self, values: Mapping[str, Any]) -> None:
        """Append a message's values; what they raise says what is wrong with them."""
        buffers = self._buffers
        for name in self._numbers:
            buffers[name].append(values[name])
        for name in self._optional:
            value = values.get(name)
            buffers[name].append(math.nan if value is None else value)
        if "status" in buffers:
            buffers["status"].append(_STATUS_CODES[values["status"]])
        for name, size in self._sizes.items():
            unknown = name in UNKNOWN_ARRAYS and values.get(name) is None
            buffers[name].extend([math.nan] * size if unknown else _counted(name, values[name], size))
        if "points" in buffers:
            points = _counted("points", values["points"], self._points)
            buffers["points"].extend(chain.from_iterable(map(_XYZ, points)))
        if self._number_names and NUMBERS in buffers:
            further = values.get(NUMBERS, {})
            buffers[NUMBERS].extend(further.get(name, math.nan) for name in self._number_names)
        self.count += 1

    def take(self) -> Columns:
        """Return what was collected, and begin anew."""
        taken = {name: self._column(name, empty) for name, empty in self._empty.items()}
        self._clear()
        return taken

    def _clear(self) -> None:
        self.count = 0
        self._buffers: dict[str, array[Any]] = {name: array(BY_NAME[name].code) for name in self._empty}

    def _column(self, name: str, empty: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        flat = np.array(self._buffers[name])
        if name == "status":
            return np.take(_STATUSES, flat)
        column: np.ndarray[Any, Any] = flat.astype(empty.dtype, copy=False)
        return column.reshape(self.count, *empty.shape[1:])


def _counted(name: str, values: Any, expected: int) -> Any:
    """Return values if there are as many as expected."""
    if len(values) != expected:
        raise ValueError(f"{name} of {len(values)} entries among others of {expected}")
    return values
