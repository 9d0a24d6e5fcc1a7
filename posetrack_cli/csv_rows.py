"""CSV: rows of a stranger's file one by one with their lines, and rows of ours with a stranger's names.

A long file takes the memory of a row. Spreadsheets run cells that begin as a formula does.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from posetrack_cli import limits
from posetrack_cli.errors import PosetrackError
from posetrack_cli.files import open_input
from posetrack_cli.text import one_line

COMMENT = "#"
_FORMULA = tuple("=+-@\uff1d\uff0b\uff0d\uff20")
"""What begins a formula, also in its full width."""
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*(?:e[+-]?\d+)?|inf|nan)", re.ASCII | re.IGNORECASE)
Row = tuple[int, list[str]]
"""A row of cells and its line."""


def text_lines(path: Path, kind: type[PosetrackError], expected: str) -> Iterator[tuple[int, str]]:
    """Yield the lines of a UTF-8 text with their numbers from 1.

    Args:
        path: the file.
        kind: of error that is raised.
        expected: what kind of file it should be, for the error's hint.

    Raises:
        PosetrackError: of the kind given: the file cannot be read, a line is longer than
            ``limits.LINE_BYTES``, or it is no UTF-8.
    """
    number = 0
    try:
        with open_input(path) as stream:
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
        raise kind("cannot be read", where=path, found=error.strerror or error) from error
    except UnicodeDecodeError as error:
        found = f"byte 0x{error.object[error.start]:02x}"
        where = f"{path} line {number}"
        raise kind("is no UTF-8 text", where=where, found=found, hint=expected) from error


def csv_rows(path: Path, kind: type[PosetrackError], expected: str) -> Iterator[Row]:
    """Yield the rows of a CSV file, the header row first, without comments (``#``) and empty lines.

    Args, Raises:
        as ``text_lines``; also for what is no CSV.
    """
    latest = 0

    def data_lines() -> Iterator[str]:
        nonlocal latest
        for number, line in text_lines(path, kind, expected):
            latest = number
            if not line.startswith(COMMENT):
                yield line

    try:
        for row in csv.reader(data_lines()):
            if any(cell.strip() for cell in row):
                yield latest, row
    except csv.Error as error:
        line_ends = "new-line" in str(error)  # of a Macintosh of old, which csv explains in its own terms
        found, hint = ("a carriage return alone", "end lines with a line feed") if line_ends else (error, "")
        raise kind("is no CSV", where=f"{path} line {latest}", found=found, hint=hint) from error


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
    shown = one_line(cell).replace("\t", "\\t")
    return f"'{shown}" if shown.startswith(_FORMULA) else shown
