"""Tables from untrusted text: header, rows, stamps and numbers; and CSV output.

Files are read row by row in constant memory. Errors name file, line and column. Output cells are escaped, as
spreadsheets run cells that look like formulas.
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
"""Column separators of other programs."""
NS_PER_UNIT = {
    f"{name}_{unit}": ns
    for unit, ns in (("ns", 1), ("us", 1_000), ("ms", 1_000_000), ("s", NS_PER_S))
    for name in ("stamp", "timestamp", "time", "t")
}
"""Column names of stamps, with their unit in ns."""
FRAME_FIELDS = ("frame", "frame_index", "frame_id", "frame_number", "frame_idx", "image_index")
STATUS, LOST = "status", "lost"
SHOWN = 40
"""Characters of a value shown in errors."""
_FORMULA = tuple("=+-@\uff1d\uff0b\uff0d\uff20")
"""Characters that start a formula, including their full-width forms."""
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*(?:e[+-]?\d+)?|inf|nan)", re.ASCII | re.IGNORECASE)
_NOTHING = ("", "nan", "none", "null")
Kind = type[PosetrackError]
Row = tuple[int, list[str]]
"""Line number and cells of a row."""

# Text files: lines, CSV rows, JSON


@dataclass(frozen=True)
class TextFile:
    """UTF-8 text file.

    All methods raise an error of type ``kind`` if the file is unreadable or has the wrong format.

    Attributes:
        path: path of the file.
        kind: error type.
        expected: expected kind of file, for hints.
        most: maximum size in bytes; None if the file is read line by line.
    """

    path: Path
    kind: Kind
    expected: str
    most: int | None = limits.TEXT_BYTES

    def where(self, line: int) -> str:
        """Return the location of a line, for errors."""
        return f"{self.path} line {line}"

    def lines(self) -> Iterator[tuple[int, str]]:
        """Yield lines with their numbers from 1; each has at most ``limits.LINE_BYTES``."""
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
                            found="no line break",
                            expected=f"at most {limits.LINE_BYTES} bytes",
                            hint=self.expected,
                        )
                    yield number, line.decode("utf-8-sig" if number == 1 else "utf-8")
        except OSError as error:
            found = error.strerror or error
            raise self.kind("cannot be read", where=self.path, found=found, hint=self.expected) from error
        except UnicodeDecodeError as error:
            found, where = f"byte 0x{error.object[error.start]:02x}", self.where(number)
            raise self.kind("is not UTF-8 text", where=where, found=found, hint=self.expected) from error

    def rows(self) -> Iterator[Row]:
        """Yield CSV rows, header first, without comments (``#``) and empty lines."""
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
            ends = "new-line" in str(error)  # classic Mac line ends; csv's own message is cryptic
            found, hint = ("a bare carriage return", "end lines with a line feed") if ends else (error, "")
            raise self.kind("is not valid CSV", where=self.where(latest), found=found, hint=hint) from error

    def table(self, columns: Sequence[str], *others: str) -> Table:
        """Return the CSV table; it must have ``columns``, and errors also list ``others``."""
        needed = ", ".join((*columns, *others))
        table = Table.of(self, self.rows(), needed)
        if not set(columns) <= set(table.names):
            raise self.kind("unknown header", where=self.path, found=table.shown, expected=needed)
        return table

    def json(self, hint: str = "", *, nan: bool = False) -> Any:
        """Return the JSON value of the whole file.

        Args:
            hint: hint for a file that is unreadable or too large.
            nan: see ``json_of``.
        """
        try:
            text = read_text(self.path, self.most or limits.TEXT_BYTES, "utf-8-sig")
        except OSError as error:
            found = error.strerror or error
            raise self.kind("cannot be read", where=self.path, found=found, hint=hint) from error
        except UnicodeDecodeError as error:
            raise self.kind("is not valid JSON", where=self.path, found=error, hint=self.expected) from error
        return self.json_of(text, self.path, nan=nan)

    def json_of(self, text: str, where: object, *, nan: bool = False) -> Any:
        """Parse JSON text, of a file or of one line; ``nan`` also accepts NaN, which JSON lacks."""
        try:
            return json.loads(text, parse_constant=None if nan else _refuse)
        except (ValueError, RecursionError) as error:
            found = "values nested too deeply" if isinstance(error, RecursionError) else error
            raise self.kind("is not valid JSON", where=where, found=found, hint=self.expected) from error

    def json_rows(self, columns: Mapping[str, Any]) -> Iterator[Row]:
        """Yield rows of column lists, as written by ``export --format json``, header first."""
        lists = list(columns.values())
        if not all(isinstance(values, list) and len(values) == len(lists[0]) for values in lists):
            expected = "lists of equal length"
            raise self.kind("columns differ in length", where=self.path, expected=expected)
        yield 0, list(columns)
        for number, row in enumerate(zip(*lists, strict=True), 1):
            yield number, ["" if value is None else str(value) for value in row]


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not valid JSON; use null for unknown values")


# Header and rows


@dataclass(frozen=True)
class Table:
    """Table whose header has been read.

    Attributes:
        file: file that contains it.
        header: location of the header, for errors.
        names: column names.
        rows: rows after the header; can be iterated once.
    """

    file: TextFile
    header: str
    names: tuple[str, ...]
    rows: Iterator[Row]

    @classmethod
    def of(cls, file: TextFile, rows: Iterator[Row], expected: str) -> Table:
        """Read and check the header row.

        Args:
            file: file that contains the table.
            rows: rows, header first.
            expected: expected columns, for errors.

        Raises:
            PosetrackError: of the file's kind: no rows, columns not separated by commas, numeric headers,
                too many columns, or duplicate names.
        """
        line, row = next(rows, (0, []))
        table = cls(file, file.where(line) if line else str(file.path), tuple(map(str.strip, row)), rows)
        names, where = table.names, file.path
        if not names:
            raise file.kind("is empty", where=where, expected=expected)
        if (other := _other_separator(names)) is not None:
            hint = "use commas between columns and decimal points in numbers"
            raise file.kind("columns are not separated by commas", where=where, found=other, hint=hint)
        if all(map(_NUMBER.fullmatch, names)):
            raise file.kind("unknown header", where=where, found=table.shown, expected=expected)
        if len(names) > limits.COLUMNS:
            raise file.kind("has too many columns", where=where, found=len(names), expected=limits.COLUMNS)
        twice = sorted(name for name, count in Counter(names).items() if name and count > 1)
        if twice:
            raise file.kind("column occurs twice", where=where, found=", ".join(twice))
        return table

    def __iter__(self) -> Iterator[Row]:
        """Yield rows; raise if a row's length differs from the header's."""
        for line, row in self.rows:
            if len(row) != len(self.names):
                found, where = f"{len(row)} cells", self.file.where(line)
                what = "row does not fit the header"
                raise self.file.kind(what, where=where, found=found, expected=len(self.names))
            yield line, row

    @property
    def shown(self) -> str:
        """First column names, for errors."""
        return shorten(", ".join(self.names[:20]), 100, placeholder=" ...")


def _other_separator(names: Sequence[str]) -> str | None:
    """Return the separator of a header without commas; a space counts only if it yields a stamp column."""
    for sign, word in SEPARATORS.items():
        cells = {cell.strip(' "') for cell in names[0].split(sign)}
        if len(names) == 1 < len(cells) and (sign != " " or cells & NS_PER_UNIT.keys()):
            return word
    return None


def first_of(wanted: Iterable[str], names: Iterable[str]) -> str | None:
    """Return the first wanted name that is among ``names``, or None."""
    there = set(names)
    return next((name for name in wanted if name in there), None)


# Values of cells or JSON


def whole_of(
    value: Any,
    where: object,
    kind: Kind,
    ns_per_unit: int | None = None,
    *,
    least: int = 0,
    fractions: bool = False,
) -> int:
    """Return a frame number, or a stamp in ns.

    Stamps are parsed as decimals, since today's epoch seconds do not fit into a float.

    Args:
        value: cell or JSON value.
        where: location, for errors.
        kind: error type.
        ns_per_unit: ns per unit of a stamp; None for a frame number.
        least: minimum.
        fractions: round fractions of a ns instead of refusing them.

    Raises:
        PosetrackError: of the given kind: not a number, not within 64 bits, or not whole.
    """
    what, unit = ("frame number", "") if ns_per_unit is None else ("stamp", " ns")
    try:
        if isinstance(value, bool):
            raise ValueError
        number = Decimal(str(value).strip()) * (ns_per_unit or 1)
        is_inside = least <= number <= limits.INTEGER  # checked before int(): 1e99999 has 100,000 digits
    except (ValueError, ArithmeticError):
        raise kind(f"{what} is not a number", where=where, found=shown(value)) from None
    if not is_inside:
        expected = f"{least} to {limits.INTEGER}{unit}"
        raise kind(f"{what} is out of range", where=where, found=shown(value), expected=expected)
    if number != int(number) and (ns_per_unit is None or (ns_per_unit == 1 and not fractions)):
        raise kind(f"{what} is not a whole number", where=where, found=shown(value))
    return round(number)


def number_of(
    value: Any, where: object, kind: Kind, *, optional: bool = False, most: float = limits.NUMBER
) -> float:
    """Return a number.

    Args:
        value: cell or JSON value.
        where: location, for errors.
        kind: error type.
        optional: return NaN for missing values (None, an empty cell or ``nan``).
        most: maximum magnitude.

    Raises:
        PosetrackError: of the given kind: not a number, not finite, or too large.
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
    """Return a value as shown in errors."""
    text = repr(value)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


# Output


def csv_of(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as CSV with line feeds.

    Text is made printable, and cells that look like formulas get a leading apostrophe. Numbers are
    unchanged.
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
