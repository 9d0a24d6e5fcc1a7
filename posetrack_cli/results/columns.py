"""Estimates as columns of numbers, and what the arrays of a file must be."""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from operator import itemgetter
from typing import Annotated, Any, TypeAlias

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

# Estimates as columns of numbers, decoded without an object per frame: for long results, block by block


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


# What the arrays and numbers of a file must be before anything is made of them.
#
# A digest says that a file is as it was written, not that it was written by this program: it can be computed
# by anyone. So each tracker states what its arrays are (``Layout``), and nothing is put together of others.


Arrays: TypeAlias = Mapping[str, np.ndarray[Any, Any]]
Range: TypeAlias = tuple[int, int]

LARGEST = 1e9
"""Of any length (mm), angle, rate or pixel that is kept; their squares and products are still numbers."""
STAMPS_NS: Range = (-(1 << 62), 1 << 62)
"""Differences of two stamps are whole numbers of 64 bits, too."""
FARTHEST = 1e140
"""Of pixels where points are thought to be, and of how they move: a lens sends points beyond it anywhere."""
COUNTS: Range = (0, 1 << 53)
"""Of frames and other things that are counted."""
FLAGS: Range = (0, 1)
_TOLERANCE = 1e-6


class LayoutError(ValueError):
    """Arrays or numbers that are not as stated; the text names the first of them."""


@dataclass(frozen=True)
class Layout:
    """What one array must be.

    Attributes:
        dtype: numpy's name of its type; ``str`` is text of any length.
        shape: lengths; a name stands for any length from 1 on that is the same wherever the name stands, and
            a name that ends in ``?`` for one that may be 0.
        least, most: of its values, or of those of each place of its last axis.
        missing: whether values may be NaN.
        unit: from where to where along its last axis there are vectors of length 1; None for nowhere.
        shares: whether its values add up to 1.
    """

    dtype: str
    shape: tuple[int | str, ...] = ()
    least: float | tuple[float, ...] = -LARGEST
    most: float = LARGEST
    missing: bool = False
    unit: tuple[int, int] | None = None
    shares: bool = False

    def sized(self, sizes: Mapping[str, int]) -> Layout:
        """Return the layout with the lengths of these names."""
        return replace(self, shape=tuple(sizes.get(str(length), length) for length in self.shape))

    def named(self, prefix: str) -> Layout:
        """Return the layout with lengths of its own, whose names begin with a prefix."""
        shape = tuple(f"{prefix}{length}" if isinstance(length, str) else length for length in self.shape)
        return replace(self, shape=shape)


def floats(
    *shape: int | str,
    least: float | tuple[float, ...] = -LARGEST,
    most: float = LARGEST,
    missing: bool = False,
) -> Layout:
    """Return the layout of numbers of double precision."""
    return Layout("float64", shape, least, most, missing)


def places(*shape: int | str) -> Layout:
    """Return the layout of what is or moves on images; NaN where nothing is seen."""
    return floats(*shape, least=-FARTHEST, most=FARTHEST, missing=True)


def units(*shape: int | str) -> Layout:
    """Return the layout of unit vectors or quaternions."""
    return Layout("float64", shape, unit=(0, int(shape[-1])))


def stamps(*shape: int | str) -> Layout:
    """Return the layout of times, ns."""
    return Layout("int64", shape, *STAMPS_NS)


def counts(*shape: int | str, most: int = COUNTS[1]) -> Layout:
    """Return the layout of whole numbers from 0 on."""
    return Layout("int64", shape, COUNTS[0], most)


Stamp: TypeAlias = Annotated[int, stamps()]
NotNegative: TypeAlias = Annotated[float, floats(least=0.0)]


def check_arrays(arrays: Arrays, layouts: Mapping[str, Layout]) -> None:
    """Refuse arrays that are not as stated; those of other names are not looked at.

    Raises:
        LayoutError: one is missing, of another type or shape, or has a value that it cannot have.
    """
    lengths: dict[str, int] = {}
    for name, layout in layouts.items():
        if name not in arrays:
            raise LayoutError(f"no array '{name}'")
        array = arrays[name]
        kind = "str" if array.dtype.kind == "U" else array.dtype.name
        if kind != layout.dtype or not _fits(array.shape, layout.shape, lengths):
            wanted = ", ".join(str(lengths.get(str(length), length)) for length in layout.shape)
            raise LayoutError(f"'{name}' as {array.dtype} {array.shape}, not {layout.dtype} ({wanted})")
        if array.dtype.kind in "fiu":
            _check_values(name, array, layout)


def check_numbers(numbers: Any, ranges: Mapping[str, Range]) -> None:
    """Refuse whole numbers that are not as stated, or not numbers by name.

    Raises:
        LayoutError: one is missing, no whole number, or out of its range.
    """
    if not isinstance(numbers, Mapping):
        raise LayoutError(f"numbers as {type(numbers).__name__}")
    for name, (least, most) in ranges.items():
        if name not in numbers:
            raise LayoutError(f"no number '{name}'")
        value = numbers[name]
        if type(value) is not int or not least <= value <= most:
            found = value if type(value) is int else type(value).__name__
            wanted = least if least == most else f"{least} to {most}"
            raise LayoutError(f"'{name}' as {found}, not {wanted}")


def _fits(shape: tuple[int, ...], stated: tuple[int | str, ...], lengths: dict[str, int]) -> bool:
    """Whether a shape is the one stated; lengths that are met first are noted by name."""
    if len(shape) != len(stated):
        return False
    for length, wanted in zip(shape, stated, strict=True):
        if isinstance(wanted, str):
            if length == 0 and not wanted.endswith("?"):
                return False
            wanted = lengths.setdefault(wanted, length)
        if length != wanted:
            return False
    return True


def _check_values(name: str, array: np.ndarray[Any, Any], layout: Layout) -> None:
    inside = (array >= layout.least) & (array <= layout.most)
    if layout.missing:
        inside |= np.isnan(array)
    if not np.all(inside):
        wrong = array[~inside].flat[0]
        what = f"the value {wrong}" if np.isfinite(wrong) else "values that are not finite"
        raise LayoutError(f"'{name}' with {what}")
    if layout.unit is not None:
        lengths = np.linalg.norm(array[..., slice(*layout.unit)], axis=-1)
        if not np.all(np.abs(lengths - 1.0) <= _TOLERANCE):
            raise LayoutError(f"'{name}' with vectors that are not of length 1")
    if layout.shares and not abs(array.sum() - 1.0) <= _TOLERANCE:
        raise LayoutError(f"'{name}' with shares that do not add up to 1")
