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


@dataclass(frozen=True)
class TextFile:
    """A file of text in UTF-8.

    All methods raise an error of its kind where it cannot be read or is not what it should be.

    Attributes:
        path: of the file.
        kind: of error.
        expected: what kind of file it should be, for hints.
        most: bytes of it; None where it is read line by line and its length is no matter.
    """

    path: Path
    kind: Kind
    expected: str
    most: int | None = limits.TEXT_BYTES

    def where(self, line: int) -> str:
        """Say where a line is."""
        return f"{self.path} line {line}"

    def lines(self) -> Iterator[tuple[int, str]]:
        """Yield the lines with their numbers from 1, each of at most ``limits.LINE_BYTES``."""
        number = 0
        try:
            with open_input(self.path) as stream:
                size = os.fstat(stream.fileno()).st_size
                if self.most is not None and size > self.most:
                    expected = f"{self.most} at most"
                    raise self.kind("is too large", where=self.path, found=f"{size} bytes", expected=expected)
                while line := stream.readline(limits.LINE_BYTES + 1):
                    number += 1
                    if len(line) > limits.LINE_BYTES:
                        raise self.kind(
                            "line is too long",
                            where=self.where(number),
                            found="a line without end",
                            expected=f"at most {limits.LINE_BYTES} bytes",
                            hint=self.expected,
                        )
                    yield number, line.decode("utf-8-sig" if number == 1 else "utf-8")
        except OSError as error:
            found = error.strerror or error
            raise self.kind("cannot be read", where=self.path, found=found, hint=self.expected) from error
        except UnicodeDecodeError as error:
            found, where = f"byte 0x{error.object[error.start]:02x}", self.where(number)
            raise self.kind("is no UTF-8 text", where=where, found=found, hint=self.expected) from error

    def rows(self) -> Iterator[Row]:
        """Yield the rows of CSV, the header row first, without comments (``#``) and empty lines."""
        latest = 0

        def data_lines() -> Iterator[str]:
            nonlocal latest
            for number, line in self.lines():
                latest = number
                if not line.startswith(COMMENT):
                    yield line

        try:
            for row in csv.reader(data_lines(), skipinitialspace=True):
                if any(cell.strip() for cell in row):
                    yield latest, row
        except csv.Error as error:
            ends = "new-line" in str(error)  # of a Macintosh of old, which csv explains in its own terms
            found, hint = ("a carriage return alone", "end lines with a line feed") if ends else (error, "")
            raise self.kind("is no CSV", where=self.where(latest), found=found, hint=hint) from error

    def table(self, columns: Sequence[str], *others: str) -> Table:
        """Return the table of CSV, which must have some columns; errors name others, too."""
        needed = ", ".join((*columns, *others))
        table = Table.of(self, self.rows(), needed)
        if not set(columns) <= set(table.names):
            raise self.kind("header is not known", where=self.path, found=table.shown, expected=needed)
        return table

    def json(self, hint: str = "", *, nan: bool = False) -> Any:
        """Return the one value of JSON, of a file that is not read line by line.

        Args:
            hint: what to do about one that cannot be read or is too large.
            nan: as of ``json_of``.
        """
        try:
            text = read_text(self.path, self.most or limits.TEXT_BYTES, "utf-8-sig")
        except OSError as error:
            found = error.strerror or error
            raise self.kind("cannot be read", where=self.path, found=found, hint=hint) from error
        except UnicodeDecodeError as error:
            raise self.kind("is no JSON", where=self.path, found=error, hint=self.expected) from error
        return self.json_of(text, self.path, nan=nan)

    def json_of(self, text: str, where: object, *, nan: bool = False) -> Any:
        """Return the value of its text, or of a line; ``nan`` takes NaN, which JSON does not have."""
        try:
            return json.loads(text, parse_constant=None if nan else _refuse)
        except (ValueError, RecursionError) as error:
            found = "values nested too deeply" if isinstance(error, RecursionError) else error
            raise self.kind("is no JSON", where=where, found=found, hint=self.expected) from error

    def json_rows(self, columns: Mapping[str, Any]) -> Iterator[Row]:
        """Yield the rows of lists by column, as ``export --format json`` writes them, the header first."""
        lists = list(columns.values())
        if not all(isinstance(values, list) and len(values) == len(lists[0]) for values in lists):
            expected = "lists of as many values each"
            raise self.kind("columns are not of one length", where=self.path, expected=expected)
        yield 0, list(columns)
        for number, row in enumerate(zip(*lists, strict=True), 1):
            yield number, ["" if value is None else str(value) for value in row]


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant}, which JSON does not have: null is for what is unknown")


# A header row, and rows that fit it


@dataclass(frozen=True)
class Table:
    """A table whose header was read.

    Attributes:
        file: that it is in.
        header: where its names are, for errors.
        names: of the columns.
        rows: after the header; they can be read once.
    """

    file: TextFile
    header: str
    names: tuple[str, ...]
    rows: Iterator[Row]

    @classmethod
    def of(cls, file: TextFile, rows: Iterator[Row], expected: str) -> Table:
        """Take the header row.

        Args:
            file: of the table.
            rows: the header first.
            expected: what the header should have.

        Raises:
            PosetrackError: of the file's kind: there is no row, columns are not separated by commas, numbers,
                too many, or of one name.
        """
        line, row = next(rows, (0, []))
        table = cls(file, file.where(line) if line else str(file.path), tuple(map(str.strip, row)), rows)
        names, where = table.names, file.path
        if not names:
            raise file.kind("is empty", where=where, expected=expected)
        if (other := _other_separator(names)) is not None:
            hint = "write it with commas, and with points as decimal signs"
            raise file.kind("columns are not separated by commas", where=where, found=other, hint=hint)
        if all(map(_NUMBER.fullmatch, names)):
            raise file.kind("header is not known", where=where, found=table.shown, expected=expected)
        if len(names) > limits.COLUMNS:
            raise file.kind("has too many columns", where=where, found=len(names), expected=limits.COLUMNS)
        twice = sorted(name for name, count in Counter(names).items() if name and count > 1)
        if twice:
            raise file.kind("column occurs twice", where=where, found=", ".join(twice))
        return table

    def __iter__(self) -> Iterator[Row]:
        """Yield the rows; one that is shorter or longer than the header raises."""
        for line, row in self.rows:
            if len(row) != len(self.names):
                found, where = f"{len(row)} cells", self.file.where(line)
                what = "row does not fit the header"
                raise self.file.kind(what, where=where, found=found, expected=len(self.names))
            yield line, row

    @property
    def shown(self) -> str:
        """The first names, as errors show them."""
        return shorten(", ".join(self.names[:20]), 100, placeholder=" ...")


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
