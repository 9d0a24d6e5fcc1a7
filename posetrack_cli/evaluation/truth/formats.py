"""Rows of a truth's table, in whichever of the text formats that ``export`` writes: CSV, JSON or TUM's."""

from __future__ import annotations

import json
from collections.abc import Iterator
from decimal import Decimal, InvalidOperation
from itertools import islice
from pathlib import Path
from typing import Any

from posetrack_cli import limits
from posetrack_cli.csv_rows import COMMENT, Row, csv_rows, text_lines
from posetrack_cli.errors import TruthError
from posetrack_cli.files import read_text
from posetrack_cli.results.export.table import POSITION, QUATERNION

EXPECTED = "a truth is an MCAP file, or an export as CSV, JSON or TUM in UTF-8"
TUM_COLUMNS = ("t_s", *POSITION, *QUATERNION)
"""Of a trajectory in TUM's format, whose positions are metres."""


def table_rows(path: Path) -> Iterator[Row]:
    """Yield the rows of a file, the header row first.

    Raises:
        TruthError: it cannot be read, or names file and line of what is not of its format.
    """
    if path.suffix.lower() == ".json":
        return _json_rows(path)
    return _tum_rows(path) if is_tum(path) else csv_rows(path, TruthError, EXPECTED)


def is_tum(path: Path) -> bool:
    """Return whether the first line that is not a comment has TUM's eight numbers, separated by spaces."""
    lines = (line for _, line in text_lines(path, TruthError, EXPECTED))
    first = next((line for line in lines if line.strip() and not line.startswith(COMMENT)), "")
    cells = first.split()
    return len(cells) == len(TUM_COLUMNS) and "," not in first and all(map(_is_number, cells))


def _tum_rows(path: Path) -> Iterator[Row]:
    """Yield TUM's rows with positions in mm; what is not a number is left to whoever reads the columns."""
    yield 0, list(TUM_COLUMNS)
    for number, line in text_lines(path, TruthError, EXPECTED):
        cells = line.split()
        if cells and not line.startswith(COMMENT):
            yield number, [_in_mm(cell) if 0 < k <= len(POSITION) else cell for k, cell in enumerate(cells)]


def _in_mm(metres: str) -> str:
    return str(Decimal(metres) * 1000) if _is_number(metres) else metres


def _is_number(cell: str) -> bool:
    try:
        return Decimal(cell).is_finite()
    except InvalidOperation:
        return False


def _json_rows(path: Path) -> Iterator[Row]:
    columns = _columns(path)
    yield 0, list(columns)
    for number, row in enumerate(zip(*columns.values(), strict=True), 1):
        yield number, ["" if value is None else str(value) for value in row]


def _columns(path: Path) -> dict[str, list[Any]]:
    """Return the columns of a JSON export: lists of one length by name."""
    try:
        said = json.loads(read_text(path, limits.REPORT_BYTES))
    except OSError as error:
        raise TruthError("cannot be read", where=path, found=error.strerror or error) from error
    except (ValueError, RecursionError) as error:
        found = "values nested too deeply" if isinstance(error, RecursionError) else error
        raise TruthError("is no JSON", where=path, found=found, hint=EXPECTED) from error
    columns = said.get("columns") if isinstance(said, dict) else None
    if not isinstance(columns, dict) or not all(isinstance(values, list) for values in columns.values()):
        expected = "an object with columns, as posetrack export --format json writes it"
        found = ", ".join(map(str, islice(said, 5)))[:80] if isinstance(said, dict) else type(said).__name__
        raise TruthError("holds no table", where=path, found=found, expected=expected)
    if len({len(values) for values in columns.values()}) > 1:
        raise TruthError("columns are not of one length", where=path)
    return columns
