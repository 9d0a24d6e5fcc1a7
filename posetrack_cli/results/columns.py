"""Estimates as columns, and layout checks for arrays read from files."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, TypeAlias, cast

import numpy as np
from pydantic_core import from_json

from posetrack_cli import limits
from posetrack_cli.errors import ResultError
from posetrack_cli.results.estimate import Status
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME, LENGTH_TOLERANCE, parse_fields
from posetrack_cli.results.fields import (
    BY_NAME,
    FIELD_NAMES,
    NUMBERS,
    Field,
    Sizes,
    array_shapes,
)

# Columns, decoded in blocks and without an object per frame to keep memory flat on long results

Columns: TypeAlias = dict[str, np.ndarray[Any, Any]]

BLOCK_FRAMES = 1000
FEW_FRAMES = 250
"""Frames that are decoded in the processor's cache."""
_GROWTH_FRAMES = 4096

_STATUSES = np.array([status.value for status in Status])
_STATUS_CODES = {status.value.encode(): code for code, status in enumerate(Status)}


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
        fields: fields to decode; of the others, only the layout is checked.
        frames: rows per block; the last block may have fewer.
        where: file and topic, for errors.
        number_names: names of the M additional numbers to return; NaN where a message lacks one.

    Raises:
        ResultError: a message is not an estimate, or K or P differ between messages.
    """
    reader = BlockReader(fields, frames, where, number_names)
    for data in messages:
        if (block := reader.add(data)) is not None:
            yield block
            del block  # would stay alive while the next one grows
    if (block := reader.rest()) is not None:
        yield block


class BlockReader:
    """Collects messages until they are a block, and decodes it; for arguments see ``column_blocks``."""

    def __init__(
        self, fields: Collection[str], frames: int, where: object, number_names: Sequence[str]
    ) -> None:
        self._fields, self._frames, self._where, self._number_names = fields, frames, where, number_names
        self._messages: list[bytes] = []
        self._sizes: Sizes | None = None
        self._before = 0

    def add(self, data: bytes) -> Columns | None:
        """Add a message; return the columns of a full block."""
        self._messages.append(data)
        return self.rest() if len(self._messages) == self._frames else None

    def rest(self) -> Columns | None:
        """Return the columns of the messages since the last block; None without any."""
        messages, self._messages = self._messages, []
        if not messages:
            return None
        try:
            self._sizes = self._sizes or _sizes_of(messages[0], len(self._number_names))
            columns = _decoded(messages, self._fields, self._sizes, self._number_names)
        except _NO_ESTIMATE as error:
            raise _refusal(messages, self._sizes, self._before, self._where, error) from error
        self._before += len(messages)
        return columns


def empty_columns(fields: Collection[str], sizes: Sizes) -> Columns:
    """Return columns without rows: one array per field, for estimates of these sizes.

    Frame indices and stamps are integers, ``status`` is text, ``resampled`` boolean, everything else
    float64. Missing optional values (``UNKNOWN_ARRAYS``, ``UNKNOWN_NUMBERS``) are NaN.
    """
    shapes = array_shapes(sizes)
    return {name: np.empty((0, *shapes.get(name, ())), dtype=BY_NAME[name].column) for name in fields}


def joined(blocks: Iterable[Columns]) -> Columns:
    """Concatenate blocks, each freed after copying; {} without blocks."""
    grown = Joiner()
    for block in blocks:
        grown.add(block)
        del block
    return grown.columns()


class Joiner:
    """Concatenates blocks. Arrays grow in place, so peak memory is little above the size of the columns.

    Args:
        single: fields that are kept in single precision.
    """

    def __init__(self, single: Collection[str] = ()) -> None:
        self._grown: Columns = {}
        self._single, self._count = single, 0

    def add(self, block: Columns) -> None:
        """Copy a block."""
        rows, count = len(next(iter(block.values()), ())), self._count
        for name, part in block.items():
            kind = np.float32 if name in self._single else part.dtype
            column = self._grown.setdefault(name, np.empty((0, *part.shape[1:]), kind))
            if count + rows > len(column):
                _resize(column, count + max(rows, _GROWTH_FRAMES, count // 32))
            column[count : count + rows] = part
        self._count += rows

    def columns(self) -> Columns:
        """Return the columns of all blocks; {} without blocks."""
        for column in self._grown.values():
            _resize(column, self._count)
        return self._grown


def _resize(column: np.ndarray[Any, Any], rows: int) -> None:
    """Resize in place; safe without refcheck, as nothing else refers to the array yet."""
    # Growing in place avoids a second copy of the column, which np.concatenate would need.
    column.resize((rows, *column.shape[1:]), refcheck=False)


# The messages of ``estimate_to_json`` have a fixed layout: a pattern finds the text of every field, and one
# call parses a field's numbers in all messages of a block, in a third of the time of parsing each message.

_NO_ESTIMATE = (ValueError, KeyError, TypeError, OverflowError)
_N = rb"[-+.0-9eE]++"
_PATTERNS = {
    "integer": rb"([0-9]++)",
    "number": rb"(" + _N + rb")",
    "boolean": rb"(true|false)",
    "string": rb'"(\w++)"',
    "array": rb"\[([^]]*+)\]",
    "object": rb'(\{(?:"[^"\\]*+":' + _N + rb",?+)*+\})",
}
_OF_NUMBERS = b"-+.0123456789eE"
_POINT = b'{"x":,"y":,"z":}'
_COMMAS = bytes.maketrans(b";", b",")
Texts: TypeAlias = tuple[bytes | None, ...]
"""Texts of the fields in ``BY_NAME``, arrays without brackets; None for missing ones."""


class _OtherLayoutError(ValueError):
    """Arrays of a block are not written as by ``estimate_to_json``, or are not arrays of numbers."""


def _pattern(field: Field) -> bytes:
    value = _PATTERNS[field.json_type]
    return b'(?:,?"%b":%b)%b' % (field.name.encode(), value, b"" if field.required else b"?+")


_LAYOUT = re.compile(rb"\{" + b"".join(map(_pattern, BY_NAME.values())) + rb"\}")


def _texts(data: bytes) -> Texts:
    """Return the texts of a message; those of arrays are not checked yet.

    Raises:
        ValueError: the message is not an estimate.
    """
    found = _LAYOUT.fullmatch(data) if len(data) <= limits.MESSAGE_BYTES else None
    return found.groups() if found else _usual_texts(data)


def _usual_texts(data: bytes) -> Texts:
    """Return the texts of a message in the layout of ``estimate_to_json``; raise ValueError as ``_texts``."""
    values = parse_fields(data)
    values["points"] = [{axis: point[axis] for axis in "xyz"} for point in values["points"]]
    texts = (json.dumps(values.get(name), separators=(",", ":")).encode() for name in BY_NAME)
    return tuple(None if text == b"null" else text.strip(b'"[]') for text in texts)


def _sizes_of(data: bytes, numbers: int) -> Sizes:
    values = parse_fields(data)
    return Sizes(len(values["shape"]), len(values["points"]), numbers)


def _decoded(
    messages: Sequence[bytes], fields: Collection[str], sizes: Sizes, number_names: Sequence[str]
) -> Columns:
    try:
        return _columns([*map(_texts, messages)], empty_columns(fields, sizes), number_names)
    except _OtherLayoutError:
        return _columns([*map(_usual_texts, messages)], empty_columns(fields, sizes), number_names)


def _columns(rows: Sequence[Texts], columns: Columns, number_names: Sequence[str]) -> Columns:
    """Fill columns without rows."""
    texts = dict(zip(BY_NAME, zip(*rows, strict=True), strict=True))
    for name, field in BY_NAME.items():
        if name not in columns:
            if field.json_type == "array":
                _check_array(name, texts[name])
        elif name == "status":
            columns[name] = np.take(_STATUSES, [_STATUS_CODES[text] for text in texts[name]])
        elif name == "resampled":
            columns[name] = np.array([text == b"true" for text in texts[name]])
        elif name == NUMBERS:
            columns[name] = np.array(_named_numbers(texts[name], number_names)).reshape(len(rows), -1)
            _check_range(name, columns[name])
        else:
            shape = columns[name].shape[1:]
            values = _numbers(name, texts[name], math.prod(shape))
            column = np.fromiter(values, field.column, len(values)).reshape(len(rows), *shape)
            if not field.required and None in texts[name]:
                column[[text is None for text in texts[name]]] = np.nan
            _check_range(name, column)
            columns[name] = column
    return columns


def _check_array(name: str, texts: Sequence[bytes | None]) -> None:
    """Raise _OtherLayoutError unless the texts consist of points or of numbers."""
    joined = b",".join(text for text in texts if text).translate(None, _OF_NUMBERS)
    if (joined.replace(_POINT, b"") if name == "points" else joined).strip(b","):
        raise _OtherLayoutError(f"{name} is not an array of numbers")


def _named_numbers(texts: Sequence[bytes | None], names: Sequence[str]) -> list[float]:
    """Return the numbers with these names in the texts of objects; NaN for missing ones."""
    objects = from_json(b"[%b]" % b",".join(text or b"{}" for text in texts))
    return [found.get(name, math.nan) for found in objects for name in names]


def _numbers(name: str, texts: Sequence[bytes | None], size: int) -> list[Any]:
    """Return the numbers of all texts, ``size`` of each and 0 for None."""
    if not size:
        if any(texts):
            raise ValueError("different number of entries")
        return []
    usual = b",".join([_POINT] * (size // 3)) if name == "points" else b"," * (size - 1)
    missing = b"0" + b",0" * (size - 1)
    joined = b";".join([missing if text is None else text for text in texts])
    if joined.translate(None, _OF_NUMBERS) != b";".join([usual] * len(texts)):
        raise _OtherLayoutError("different number of entries")
    numbers = joined.translate(_COMMAS, b'{}":xyz' if name == "points" else b"")
    return cast("list[Any]", from_json(b"[%b]" % numbers))


def _check_range(name: str, column: np.ndarray[Any, Any]) -> None:
    least, most = _bounds(BY_NAME[name].strict)
    if ((column < least) | (column > most)).any():  # False for NaN, which is missing
        raise ValueError(f"{name} is out of range")
    if name == "quaternion" and (abs(np.linalg.norm(column, axis=1) - 1.0) > LENGTH_TOLERANCE).any():
        raise ValueError("not a unit quaternion")


def _bounds(schema: Any) -> tuple[float, float]:
    """Return the range of a schema's numbers."""
    if "fields" in schema:
        return _bounds(schema["fields"]["x"]["schema"])
    inner = schema.get("items_schema") or schema.get("values_schema")
    return _bounds(inner) if inner else (schema["ge"], schema["le"])


def _refusal(
    messages: Sequence[bytes], sizes: Sizes | None, first: int, where: object, error: Exception
) -> ResultError:
    """Return the error of the first message that is not an estimate; ``first`` is the number of the first."""
    for number, data in enumerate(messages, first):
        try:
            values = parse_fields(data)
            for name, shape in array_shapes(sizes or _sizes_of(data, 0)).items():
                if name != NUMBERS and values.get(name) is not None and len(values[name]) != shape[0]:
                    raise ValueError(f"{name} has {len(values[name])} entries, expected {shape[0]}")
        except _NO_ESTIMATE as problem:
            first, error = number, problem
            break
    return ResultError(f"message {first} is not a {ESTIMATE_SCHEMA_NAME}", where=where, found=error)


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
