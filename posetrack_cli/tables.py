"""Tables from strangers: their text, header, rows, stamps and numbers; and rows of ours as CSV.

A long file takes the memory of a row. Errors name file, line and column. Spreadsheets run cells that begin as
a formula does.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from textwrap import shorten
from typing import Any, NoReturn

from posetrack_cli import limits
from posetrack_cli.errors import PosetrackError
from posetrack_cli.files import open_input, read_text
from posetrack_cli.text import one_line
from posetrack_cli.units import NS_PER_S

COMMENT = "#"
SEPARATORS = {";": "semicolons", "\t": "tabs", " ": "spaces"}
"""What other programs write between columns."""
NS_PER_UNIT = {
    f"{name}_{unit}": ns
    for unit, ns in (("ns", 1), ("us", 1_000), ("ms", 1_000_000), ("s", NS_PER_S))
    for name in ("stamp", "timestamp", "time", "t")
}
"""Names of stamps, and what one of their units is in ns."""
FRAME_FIELDS = ("frame", "frame_index", "frame_id", "frame_number", "frame_idx", "image_index")
STATUS, LOST = "status", "lost"
SHOWN = 40
"""Characters of a value that an error shows."""
_FORMULA = tuple("=+-@\uff1d\uff0b\uff0d\uff20")
"""What begins a formula, also in its full width."""
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*(?:e[+-]?\d+)?|inf|nan)", re.ASCII | re.IGNORECASE)
_NOTHING = ("", "nan", "none", "null")
Kind = type[PosetrackError]
Row = tuple[int, list[str]]
"""A row of cells and its line."""


# Text: lines, rows, JSON


def text_lines(path: Path, kind: Kind, expected: str, most: int | None = None) -> Iterator[tuple[int, str]]:
    """Yield the lines of a UTF-8 text with their numbers from 1.

    Args:
        path: the file.
        kind: of error that is raised.
        expected: what kind of file it should be, for the error's hint.
        most: bytes of the file; None where its length is no matter.

    Raises:
        PosetrackError: of the kind given: the file cannot be read, it is too large, a line is longer than
            ``limits.LINE_BYTES``, or it is no UTF-8.
    """
    number = 0
    try:
        with open_input(path) as stream:
            size = os.fstat(stream.fileno()).st_size
            if most is not None and size > most:
                raise kind("is too large", where=path, found=f"{size} bytes", expected=f"{most} at most")
            while line := stream.readline(limits.LINE_BYTES + 1):
                number += 1
                if len(line) > limits.LINE_BYTES:
                    raise kind(
                        "line is too long",
                        where=f"{path} line {number}",
                        found="a line without end",
                        expected=f"at most {limits.LINE_BYTES} bytes",
                        hint=expected,
                    )
                yield number, line.decode("utf-8-sig" if number == 1 else "utf-8")
    except OSError as error:
        raise kind("cannot be read", where=path, found=error.strerror or error, hint=expected) from error
    except UnicodeDecodeError as error:
        found = f"byte 0x{error.object[error.start]:02x}"
        where = f"{path} line {number}"
        raise kind("is no UTF-8 text", where=where, found=found, hint=expected) from error


def csv_rows(path: Path, kind: Kind, expected: str, most: int | None = None) -> Iterator[Row]:
    """Yield the rows of a CSV file, the header row first, without comments (``#``) and empty lines.

    Args, Raises:
        as ``text_lines``; also for what is no CSV.
    """
    latest = 0

    def data_lines() -> Iterator[str]:
        nonlocal latest
        for number, line in text_lines(path, kind, expected, most):
            latest = number
            if not line.startswith(COMMENT):
                yield line

    try:
        for row in csv.reader(data_lines(), skipinitialspace=True):
            if any(cell.strip() for cell in row):
                yield latest, row
    except csv.Error as error:
        line_ends = "new-line" in str(error)  # of a Macintosh of old, which csv explains in its own terms
        found, hint = ("a carriage return alone", "end lines with a line feed") if line_ends else (error, "")
        raise kind("is no CSV", where=f"{path} line {latest}", found=found, hint=hint) from error


def json_file(path: Path, kind: Kind, expected: str, most: int, *, hint: str = "", nan: bool = False) -> Any:
    """Return the value of a JSON file.

    Args:
        path, kind, expected, most: as of ``text_lines``.
        hint: what to do about a file that cannot be read or is too large.
        nan: as of ``json_value``.

    Raises:
        PosetrackError: of the kind given: it cannot be read, is too large, or no JSON.
    """
    try:
        return json_value(read_text(path, most, "utf-8-sig"), path, kind, expected, nan=nan)
    except OSError as error:
        raise kind("cannot be read", where=path, found=error.strerror or error, hint=hint) from error
    except UnicodeDecodeError as error:
        raise kind("is no JSON", where=path, found=error, hint=expected) from error


def json_value(text: str, where: object, kind: Kind, expected: str, *, nan: bool = False) -> Any:
    """Return the value of a JSON text.

    Args:
        text: of a file or line.
        where: it is.
        kind, expected: as of ``text_lines``.
        nan: whether NaN and Infinity, which JSON does not have, are taken.

    Raises:
        PosetrackError: of the kind given: it is no JSON.
    """
    try:
        return json.loads(text, parse_constant=None if nan else _refuse)
    except (ValueError, RecursionError) as error:
        found = "values nested too deeply" if isinstance(error, RecursionError) else error
        raise kind("is no JSON", where=where, found=found, hint=expected) from error


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant}, which JSON does not have: null is for what is unknown")


def json_columns(columns: Mapping[str, Any], path: Path, kind: Kind) -> Iterator[Row]:
    """Yield the rows of lists by column, as ``posetrack export --format json`` writes them, the header first.

    Raises:
        PosetrackError: of the kind given: these are no lists of one length.
    """
    lists = list(columns.values())
    if not all(isinstance(values, list) and len(values) == len(lists[0]) for values in lists):
        raise kind("columns are not of one length", where=path, expected="lists of as many values each")
    yield 0, list(columns)
    for number, row in enumerate(zip(*lists, strict=True), 1):
        yield number, ["" if value is None else str(value) for value in row]


# A header row, and rows that fit it


@dataclass(frozen=True)
class Table:
    """A table whose header was read.

    Attributes:
        path: of the file.
        kind: of error that its faults raise.
        header: where its names are, for errors.
        names: of the columns.
        rows: after the header; they can be read once.
    """

    path: Path
    kind: Kind
    header: str
    names: tuple[str, ...]
    rows: Iterator[Row]

    @classmethod
    def of(cls, path: Path, rows: Iterator[Row], kind: Kind, expected: str) -> Table:
        """Take the header row.

        Args:
            path: of the file.
            rows: the header first.
            kind: of error.
            expected: what the header should have.

        Raises:
            PosetrackError: of the kind given: there is no row, columns are not separated by commas, numbers,
                too many, or of one name.
        """
        line, row = next(rows, (0, []))
        names = tuple(cell.strip() for cell in row)
        if not names:
            raise kind("is empty", where=path, expected=expected)
        if (other := _other_separator(names)) is not None:
            hint = "write it with commas, and with points as decimal signs"
            raise kind("columns are not separated by commas", where=path, found=other, hint=hint)
        table = cls(path, kind, f"{path} line {line}" if line else str(path), names, rows)
        if all(map(_NUMBER.fullmatch, names)):
            raise kind("header is not known", where=path, found=table.shown, expected=expected)
        if len(names) > limits.COLUMNS:
            raise kind("has too many columns", where=path, found=len(names), expected=limits.COLUMNS)
        twice = sorted(name for name, count in Counter(names).items() if name and count > 1)
        if twice:
            raise kind("column occurs twice", where=path, found=", ".join(twice))
        return table

    def __iter__(self) -> Iterator[Row]:
        """Yield the rows; one that is shorter or longer than the header raises."""
        for line, row in self.rows:
            if len(row) != len(self.names):
                found, expected = f"{len(row)} cells", len(self.names)
                what = "row does not fit the header"
                raise self.kind(what, where=self.where(line), found=found, expected=expected)
            yield line, row

    def where(self, line: int) -> str:
        """Say where a row is."""
        return f"{self.path} line {line}"

    @property
    def shown(self) -> str:
        """The first names, as errors show them."""
        return shorten(", ".join(self.names[:20]), 100, placeholder=" ...")


def small_table(path: Path, kind: Kind, expected: str, columns: Sequence[str], *others: str) -> Table:
    """Read the header of a CSV file of at most ``limits.TEXT_BYTES``.

    Args:
        path, kind, expected: as of ``text_lines``.
        columns: that it must have.
        others: what its header may have, for errors.

    Raises:
        PosetrackError: of the kind given: as of ``csv_rows`` and ``Table.of``, or a column is missing.
    """
    needed = ", ".join((*columns, *others))
    table = Table.of(path, csv_rows(path, kind, expected, limits.TEXT_BYTES), kind, needed)
    if not set(columns) <= set(table.names):
        raise kind("header is not known", where=path, found=table.shown, expected=needed)
    return table


def _other_separator(names: Sequence[str]) -> str | None:
    """What separates the columns of a header without commas; spaces do where they make names of stamps."""
    for sign, word in SEPARATORS.items():
        cells = {cell.strip(' "') for cell in names[0].split(sign)}
        if len(names) == 1 < len(cells) and (sign != " " or cells & NS_PER_UNIT.keys()):
            return word
    return None


def first_of(wanted: Iterable[str], names: Iterable[str]) -> str | None:
    """Return the first of some names that is there; None for none."""
    there = set(names)
    return next((name for name in wanted if name in there), None)


# Cells, or values of JSON


def whole_of(
    value: Any,
    where: object,
    kind: Kind,
    ns_per_unit: int | None = None,
    *,
    least: int = 0,
    fractions: bool = False,
) -> int:
    """Return a frame's number, or a stamp in ns: by decimals, as floats of today's seconds are not exact.

    Args:
        value: of a cell or of JSON.
        where: it is.
        kind: of error.
        ns_per_unit: of a stamp, ns in one of its units; None for a frame's number.
        least: what it is at least.
        fractions: whether a part of a ns is rounded.

    Raises:
        PosetrackError: of the kind given: it is no number, does not fit into 64 bits, or is not whole.
    """
    what, unit = ("frame number", "") if ns_per_unit is None else ("stamp", " ns")
    try:
        if isinstance(value, bool):
            raise ValueError
        number = Decimal(str(value).strip()) * (ns_per_unit or 1)
        is_inside = least <= number <= limits.INTEGER  # before it is rounded: 1e99999 has as many digits
    except (ValueError, ArithmeticError):
        raise kind(f"{what} is not a number", where=where, found=shown(value)) from None
    if not is_inside:
        expected = f"{least} to {limits.INTEGER}{unit}"
        raise kind(f"{what} is out of range", where=where, found=shown(value), expected=expected)
    if number != int(number) and (ns_per_unit is None or (ns_per_unit == 1 and not fractions)):
        raise kind(f"{what} is no whole number", where=where, found=shown(value))
    return round(number)


def number_of(
    value: Any, where: object, kind: Kind, *, optional: bool = False, most: float = limits.NUMBER
) -> float:
    """Return a number.

    Args:
        value: of a cell or of JSON.
        where: it is.
        kind: of error.
        optional: whether nothing (None, an empty cell or ``nan``) is NaN.
        most: its largest magnitude.

    Raises:
        PosetrackError: of the kind given: it is no number, not finite or too large.
    """
    if optional and (value is None or (isinstance(value, str) and value.strip().lower() in _NOTHING)):
        return math.nan
    try:
        if isinstance(value, (bool, list, dict)):
            raise ValueError
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise kind("is not a number", where=where, found=shown(value)) from None
    if optional and math.isnan(number):
        return number
    if not abs(number) <= most:
        what = "is too large" if math.isfinite(number) else "is not finite"
        raise kind(what, where=where, found=shown(value), expected=f"{most:g} at most")
    return number


def shown(value: Any) -> str:
    """Return a value as errors show it."""
    text = repr(value)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


# Rows of ours


def csv_of(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as CSV with line feeds.

    Text is printable; a cell that would be a formula begins with an apostrophe. Numbers stay as they are.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([_written(cell) for cell in row] for row in rows)
    return text.getvalue()


def _written(cell: object) -> object:
    if not isinstance(cell, str) or _NUMBER.fullmatch(cell):
        return cell
    text = one_line(cell).replace("\t", "\\t")
    return f"'{text}" if text.startswith(_FORMULA) else text
