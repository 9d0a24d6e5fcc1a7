"""Columns of numbers from a file of rows, with errors that name the line and the column."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import islice
from operator import itemgetter
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.csv_rows import Row
from posetrack_cli.errors import TruthError
from posetrack_cli.evaluation.truth.formats import table_rows
from posetrack_cli.recording.matching import LATEST_NS
from posetrack_cli.results.estimate import Status
from posetrack_cli.units import NS_PER_S

SEPARATORS = {";": "semicolons", "\t": "tabs", " ": "spaces"}
"""What other programs write between columns."""
STATUS = "status"
BLOCK_ROWS = 4096  # as text a row takes ten times its numbers' memory
SHOWN = 40
"""Characters of a cell that an error shows."""
NS_PER_UNIT = {"stamp_ns": 1, "t_s": NS_PER_S, "time_s": NS_PER_S}
"""Columns of stamps, the first that a file has is taken, and what one of their units is in ns."""


@dataclass(frozen=True)
class CsvHeader:
    """What a file's header row says.

    Attributes:
        path: the file.
        columns: their names.
    """

    path: Path
    columns: tuple[str, ...]

    @property
    def stamp_column(self) -> str | None:
        """The column of the stamps, None if there is none."""
        return next((name for name in NS_PER_UNIT if name in self.columns), None)


def read_header(path: Path) -> CsvHeader:
    """Read the header row, the first that is no comment.

    Raises:
        TruthError: the file cannot be read, is empty, is not UTF-8, is not separated by commas, or has a
            column twice.
    """
    _, row = next(table_rows(path), (0, []))
    if not row:
        raise TruthError("is empty", where=path, expected="a CSV file with a header row")
    _check_separator(path, row)
    columns = tuple(cell.strip() for cell in row)
    if len(columns) > limits.COLUMNS:
        raise TruthError("has too many columns", where=path, found=len(columns), expected=limits.COLUMNS)
    twice = sorted(name for name, count in Counter(columns).items() if name and count > 1)
    if twice:
        raise TruthError("column occurs twice", where=path, found=", ".join(twice))
    return CsvHeader(path, columns)


def _check_separator(path: Path, row: list[str]) -> None:
    """Raise where a header row has a column of stamps once it is separated by something else than commas."""
    cells = {name: {cell.strip(' "') for cell in row[0].split(sign)} for sign, name in SEPARATORS.items()}
    other = next((name for name, own in cells.items() if len(own) > 1 and own & NS_PER_UNIT.keys()), None)
    if other is not None:
        raise TruthError(
            "columns are not separated by commas",
            where=path,
            found=other,
            hint="write it with commas, and with points as decimal signs",
        )


@dataclass(frozen=True, eq=False)
class CsvTable:
    """Some columns of a file.

    Attributes:
        path: the file.
        columns: names of the C columns.
        values: (N, C).
        stamp_ns: (N,) strictly increasing.
        lines: (N,) the line of each row in the file, counted from 1.
        lost: how many rows of frames that were lost are left out.
    """

    path: Path
    columns: tuple[str, ...]
    values: FloatArray
    stamp_ns: IntArray
    lines: IntArray
    lost: int

    def of(self, names: Sequence[str]) -> FloatArray:
        """Return the columns of these names, (N, len(names))."""
        return self.values[:, [self.columns.index(name) for name in names]]

    def where(self, row: int) -> str:
        """Say where a row is."""
        return f"{self.path} line {int(self.lines[row])}"


def read_table(header: CsvHeader, columns: Sequence[str], optional: Collection[str] = ()) -> CsvTable:
    """Read the stamps and some columns of a file, without the rows whose ``status`` is ``lost``.

    Args:
        header: of the file; has a column of stamps.
        columns: to read, C names.
        optional: those of them in which a cell may be empty or nan, which is NaN then.

    Raises:
        TruthError: names file, line and column of what is no number, of a row that is too short or too
            long, of a stamp that is not later than the one before. Also for a file without rows.
    """
    stamps: list[int] = []
    lines: list[int] = []
    blocks = []
    lost = 0
    for block in _blocks(header):
        kept = _not_lost(header, block)
        lost += len(block) - len(kept)
        stamps += _stamps(header, kept)
        lines += [line for line, _ in kept]
        blocks.append(_numbers(header, kept, columns, optional))
    if not lines:
        found = f"{lost} rows, all lost" if lost else "no row after the header"
        raise TruthError("has no truth", where=header.path, found=found, expected="a row per frame")
    values = np.vstack(blocks)
    table = CsvTable(header.path, tuple(columns), values, np.array(stamps), np.array(lines), lost)
    _check_order(table, str(header.stamp_column))
    return table


def _blocks(header: CsvHeader) -> Iterator[list[Row]]:
    """Yield the rows after the header, some at a time, each of the header's length."""
    rows = islice(table_rows(header.path), 1, None)
    while block := list(islice(rows, BLOCK_ROWS)):
        for line, row in block:
            if len(row) != len(header.columns):
                raise TruthError(
                    "row does not fit the header",
                    where=f"{header.path} line {line}",
                    found=f"{len(row)} cells",
                    expected=len(header.columns),
                )
        yield block


def _not_lost(header: CsvHeader, block: list[Row]) -> list[Row]:
    if STATUS not in header.columns:
        return block
    place = header.columns.index(STATUS)
    return [(line, row) for line, row in block if row[place].strip() != Status.LOST.value]


def _stamps(header: CsvHeader, block: list[Row]) -> list[int]:
    column = str(header.stamp_column)
    place, unit = header.columns.index(column), NS_PER_UNIT[column]
    return [
        _stamp(row[place].strip(), unit, f"{header.path} line {line}, column {column}") for line, row in block
    ]


def _stamp(cell: str, ns_per_unit: int, where: str) -> int:
    """Return a stamp, ns; by way of decimals, since floats of today's seconds are off by 0.2 microseconds."""
    try:
        stamp = Decimal(cell) * ns_per_unit
        if abs(stamp) > LATEST_NS:  # before it is rounded: 1e99999 has as many digits
            raise TruthError("stamp does not fit into 64 bits", where=where, found=cell)
        if ns_per_unit == 1 and stamp != int(stamp):
            raise TruthError("stamp is no whole number", where=where, found=cell)
        return round(stamp)
    except (ValueError, ArithmeticError) as error:
        raise TruthError("stamp is not a number", where=where, found=repr(cell)) from error


def _numbers(
    header: CsvHeader, block: list[Row], columns: Sequence[str], optional: Collection[str]
) -> FloatArray:
    """Return the cells of some columns of a block of rows as numbers."""
    if not (columns and block):
        return np.empty((len(block), len(columns)))
    places = [header.columns.index(name) for name in columns]
    pick = itemgetter(*places, places[0])  # one more, so that it is a tuple also of a single column
    try:
        values = np.array([list(map(float, pick(row))) for _, row in block])[:, :-1]
        required = [name not in optional for name in columns]
        if np.isfinite(values[:, required]).all() and not (np.abs(values) > limits.NUMBER).any():
            return values
    except ValueError:
        pass
    return np.array(
        [
            [
                cell_number(row[place], name in optional, f"{header.path} line {line}, column {name}")
                for place, name in zip(places, columns, strict=True)
            ]
            for line, row in block
        ]
    )


def cell_number(cell: str, optional: bool, where: str) -> float:
    """Return one cell; slow, for blocks with empty cells or with a fault that needs its place.

    Args:
        cell: its text.
        optional: whether an empty cell or ``nan`` is NaN.
        where: the cell is.

    Raises:
        TruthError: it is not a number, not finite or too large.
    """
    cell = cell.strip()
    if optional and cell.lower() in ("", "nan"):
        return math.nan
    try:
        value = float(cell)
    except ValueError as error:
        raise TruthError("is not a number", where=where, found=repr(cell[:SHOWN])) from error
    if not math.isfinite(value):
        raise TruthError("is not finite", where=where, found=cell[:SHOWN])
    if abs(value) > limits.NUMBER:
        raise TruthError(
            "is too large", where=where, found=cell[:SHOWN], expected=f"{limits.NUMBER:g} at most"
        )
    return value


def _check_order(table: CsvTable, column: str) -> None:
    back = np.flatnonzero(np.diff(table.stamp_ns) <= 0)
    if back.size:
        row = int(back[0]) + 1
        stamp, before = int(table.stamp_ns[row]), int(table.stamp_ns[row - 1])
        raise TruthError(
            "stamp occurs twice" if stamp == before else "stamps are not sorted",
            where=f"{table.where(row)}, column {column}",
            found=f"{stamp} ns after {before} ns",
            expected="each later than the one before",
        )
