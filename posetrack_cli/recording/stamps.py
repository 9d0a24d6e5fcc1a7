"""Stamps of a folder of images: timestamps.csv, or a fixed rate."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from pathlib import Path

from posetrack_cli.errors import RecordingError, UsageError

STAMPS_FILE_NAME = "timestamps.csv"
EXPECTED_HEADER = "stamp_ns or time_s, with or without a column filename before it"
NS_PER_S = 1_000_000_000


def stamps_at_rate(count: int, fps: float) -> list[int]:
    """Return stamps of frames 0 to count - 1 at a fixed rate: frame i at round(i / fps), ns.

    Raises:
        UsageError: unless the rate is finite and above 0.
    """
    if not (math.isfinite(fps) and fps > 0):
        raise UsageError("frame rate cannot be used", found=f"--fps {fps}", expected="a number above 0")
    period = NS_PER_S / Fraction(fps)
    return [round(index * period) for index in range(count)]


def load_stamps(path: Path, names: Sequence[str]) -> list[int]:
    """Read the stamp of each image from a timestamps.csv.

    Args:
        path: the file; its header is ``stamp_ns`` (integers) or ``time_s`` (seconds), optionally with
            ``filename`` before it.
        names: the images' file names, sorted.

    Returns:
        One stamp per name, ns.

    Raises:
        RecordingError: if it cannot be read, or does not give exactly one stamp per image.
    """
    rows = _rows(path)
    if not rows:
        raise RecordingError("is empty", where=path, expected=f"a header line: {EXPECTED_HEADER}")
    header = tuple(cell.strip() for cell in rows[0][1])
    if header not in {("stamp_ns",), ("filename", "stamp_ns"), ("time_s",), ("filename", "time_s")}:
        raise RecordingError(
            "header is not known", where=path, found=f"'{','.join(header)}'", expected=EXPECTED_HEADER
        )
    entries = [_entry(row, number, header, path) for number, row in rows[1:]]
    if len(entries) != len(names):
        raise RecordingError(
            "stamps and images differ in number",
            where=path,
            found=f"{len(entries)} stamps",
            expected=f"{len(names)}, one per image",
        )
    return [stamp for _, stamp in entries] if len(header) == 1 else _by_name(entries, names, path)


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return the lines that are not blank, with their numbers from 1."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            return [(number, row) for number, row in enumerate(csv.reader(stream), 1) if any(row)]
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError("is not a CSV file", where=path, found=error) from error


def _entry(row: list[str], number: int, header: tuple[str, ...], path: Path) -> tuple[str, int]:
    where = f"{path} line {number}"
    if len(row) != len(header):
        raise RecordingError(
            "line does not fit the header", where=where, found=f"{len(row)} cells", expected=len(header)
        )
    cell = row[-1].strip()
    try:
        stamp = int(cell) if header[-1] == "stamp_ns" else round(Decimal(cell) * NS_PER_S)
    except (ValueError, InvalidOperation, OverflowError) as error:
        raise RecordingError(
            "stamp is not a number", where=where, found=f"'{cell}'", expected=header[-1]
        ) from error
    if stamp < 0:
        raise RecordingError("stamp is negative", where=where, found=cell)
    return row[0].strip(), stamp


def _by_name(entries: list[tuple[str, int]], names: Sequence[str], path: Path) -> list[int]:
    stamps = dict(entries)
    for name in names:
        if name not in stamps:
            raise RecordingError("image has no stamp", where=path, found=f"no line for {name}")
    return [stamps[name] for name in names]
