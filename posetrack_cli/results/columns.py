"""Estimates as columns, and layout checks for arrays read from files."""

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

# Columns, decoded in blocks and without an object per frame to keep memory flat on long results

Columns: TypeAlias = dict[str, np.ndarray[Any, Any]]

BLOCK_FRAMES = 1000
_GROWTH_FRAMES = 4096

_STATUSES = np.array([status.value for status in Status])
_STATUS_CODES = {status.value: code for code, status in enumerate(Status)}
_XYZ = itemgetter("x", "y", "z")
_APART = ("points", NUMBERS)
"""Arrays that messages store as objects."""


def column_blocks(
    messages: Iterable[bytes],
    fields: Collection[str] = FIELD_NAMES,
    frames: int = BLOCK_FRAMES,
    where: object = "",
    number_names: Sequence[str] = (),
) -> Iterator[Columns]:
    """Yield the columns of consecutive ``posetrack.Estimate`` messages, at most ``frames`` rows at a time.

    The arrays are those of ``empty_columns``; the first message determines K and P.

    Args:
        messages: JSON messages.
        fields: fields to decode.
        frames: rows per block; the last block may have fewer.
        where: file and topic, for errors.
        number_names: names of the M additional numbers to return; NaN where a message lacks one.

    Raises:
        ResultError: a message is not an estimate, or K or P differ between messages.
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
                f"message {number} is not a {ESTIMATE_SCHEMA_NAME}", where=where, found=error
            ) from error
        if rows.count == frames:
            yield rows.take()
    if rows is not None and rows.count:
        yield rows.take()


def empty_columns(fields: Collection[str], sizes: Sizes) -> Columns:
    """Return columns without rows: one array per field, for estimates of these sizes.

    Frame indices and stamps are integers, ``status`` is text, ``resampled`` boolean, everything else
    float64. Missing optional values (``UNKNOWN_ARRAYS``, ``UNKNOWN_NUMBERS``) are NaN.
    """
    shapes = array_shapes(sizes)
    return {name: np.empty((0, *shapes.get(name, ())), dtype=BY_NAME[name].column) for name in fields}


def joined(blocks: Iterable[Columns]) -> Columns:
    """Concatenate blocks, each freed after copying; {} without blocks.

    Arrays grow in place, so peak memory is little above the size of the columns.
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
    """Resize in place; safe without refcheck, as nothing else refers to the array yet."""
    # Growing in place avoids a second copy of the column, which np.concatenate would need.
    column.resize((rows, *column.shape[1:]), refcheck=False)


class _Rows:
    """Row collector with one buffer per field.

    Args:
        fields: fields to keep.
        sizes: array sizes of the estimates.
        number_names: names of the additional numbers.
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
        """Append a message's values; raise an error describing invalid ones."""
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
        """Return the collected columns and reset."""
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
    """Return the values after checking their count."""
    if len(values) != expected:
        raise ValueError(f"{name} has {len(values)} entries, expected {expected}")
    return values


# Layout checks.
#
# A checkpoint's digest protects against damage, not against forgery: anyone can compute it. Each tracker
# therefore declares the layout of its arrays, and they are checked before use.

Arrays: TypeAlias = Mapping[str, np.ndarray[Any, Any]]
Range: TypeAlias = tuple[int, int]

LARGEST = 1e9
"""Maximum of stored lengths (mm), angles, rates and pixels; squares and products stay finite."""
STAMPS_NS: Range = (-(1 << 62), 1 << 62)
"""Differences of two stamps still fit into 64 bits."""
FARTHEST = 1e140
"""Maximum of predicted pixel positions and motions: distortion can map points beyond ``LARGEST``."""
COUNTS: Range = (0, 1 << 53)
"""Range of frame numbers and other counts."""
FLAGS: Range = (0, 1)
_TOLERANCE = 1e-6


class LayoutError(ValueError):
    """Arrays or numbers that violate their layout; the message names the first of them."""


@dataclass(frozen=True)
class Layout:
    """Layout of one array.

    Attributes:
        dtype: numpy type name; ``str`` is text of any length.
        shape: lengths; a name stands for any length >= 1 that is equal wherever the name occurs, a name
            ending in ``?`` also allows 0.
        least, most: range of the values, or of each entry along the last axis.
        missing: whether NaN is allowed.
        unit: (first, end) of the unit vectors along the last axis; None for none.
        shares: whether the values must sum to 1.
    """

    dtype: str
    shape: tuple[int | str, ...] = ()
    least: float | tuple[float, ...] = -LARGEST
    most: float = LARGEST
    missing: bool = False
    unit: tuple[int, int] | None = None
    shares: bool = False

    def sized(self, sizes: Mapping[str, int]) -> Layout:
        """Return the layout with the named lengths replaced."""
        return replace(self, shape=tuple(sizes.get(str(length), length) for length in self.shape))

    def named(self, prefix: str) -> Layout:
        """Return the layout with a prefix on its length names, so that they are independent of others."""
        shape = tuple(f"{prefix}{length}" if isinstance(length, str) else length for length in self.shape)
        return replace(self, shape=shape)


def floats(
    *shape: int | str,
    least: float | tuple[float, ...] = -LARGEST,
    most: float = LARGEST,
    missing: bool = False,
) -> Layout:
    """Return a layout of float64 values."""
    return Layout("float64", shape, least, most, missing)


def places(*shape: int | str) -> Layout:
    """Return a layout of image positions or motions; NaN where unobserved."""
    return floats(*shape, least=-FARTHEST, most=FARTHEST, missing=True)


def units(*shape: int | str) -> Layout:
    """Return a layout of unit vectors or quaternions."""
    return Layout("float64", shape, unit=(0, int(shape[-1])))


def stamps(*shape: int | str) -> Layout:
    """Return a layout of times, ns."""
    return Layout("int64", shape, *STAMPS_NS)


def counts(*shape: int | str, most: int = COUNTS[1]) -> Layout:
    """Return a layout of non-negative integers."""
    return Layout("int64", shape, COUNTS[0], most)


Stamp: TypeAlias = Annotated[int, stamps()]
NotNegative: TypeAlias = Annotated[float, floats(least=0.0)]


def check_arrays(arrays: Arrays, layouts: Mapping[str, Layout]) -> None:
    """Check arrays against their layouts; arrays without a layout are ignored.

    Raises:
        LayoutError: one is missing, or has another type, shape or range.
    """
    lengths: dict[str, int] = {}
    for name, layout in layouts.items():
        if name not in arrays:
            raise LayoutError(f"array '{name}' is missing")
        array = arrays[name]
        # numpy encodes text lengths in the dtype name, e.g. str96.
        kind = "str" if array.dtype.kind == "U" else array.dtype.name
        if kind != layout.dtype or not _fits(array.shape, layout.shape, lengths):
            wanted = ", ".join(str(lengths.get(str(length), length)) for length in layout.shape)
            raise LayoutError(f"'{name}' is {array.dtype} {array.shape}, expected {layout.dtype} ({wanted})")
        if array.dtype.kind in "fiu":
            _check_values(name, array, layout)


def check_numbers(numbers: Any, ranges: Mapping[str, Range]) -> None:
    """Check that integers are present and within their ranges.

    Raises:
        LayoutError: not a mapping, or a number is missing, not an integer, or out of range.
    """
    if not isinstance(numbers, Mapping):
        raise LayoutError(f"expected numbers by name, found {type(numbers).__name__}")
    for name, (least, most) in ranges.items():
        if name not in numbers:
            raise LayoutError(f"number '{name}' is missing")
        value = numbers[name]
        if type(value) is not int or not least <= value <= most:
            found = value if type(value) is int else type(value).__name__
            wanted = least if least == most else f"{least} to {most}"
            raise LayoutError(f"'{name}' is {found}, expected {wanted}")


def _fits(shape: tuple[int, ...], stated: tuple[int | str, ...], lengths: dict[str, int]) -> bool:
    """Return whether a shape matches; record lengths of names seen for the first time."""
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
        # Comparisons with NaN are False, so NaN needs its own test.
        inside |= np.isnan(array)
    if not np.all(inside):
        wrong = array[~inside].flat[0]
        what = f"an out-of-range value {wrong}" if np.isfinite(wrong) else "values that are not finite"
        raise LayoutError(f"'{name}' has {what}")
    if layout.unit is not None:
        lengths = np.linalg.norm(array[..., slice(*layout.unit)], axis=-1)
        if not np.all(np.abs(lengths - 1.0) <= _TOLERANCE):
            raise LayoutError(f"'{name}' has vectors that are not of unit length")
    if layout.shares and not abs(array.sum() - 1.0) <= _TOLERANCE:
        raise LayoutError(f"'{name}' does not sum to 1")
