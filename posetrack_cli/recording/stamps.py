"""When images were taken: by timestamps.csv, at a fixed rate, or as a video tells it."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

from posetrack_cli import limits
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.files import read_text
from posetrack_cli.recording.matching import LATEST_NS
from posetrack_cli.units import NS_PER_S

STAMPS_FILE_NAME = "timestamps.csv"
STAMPS = f"0 to {LATEST_NS} ns, the years 1970 to 2262"
EXPECTED_HEADER = "stamp_ns or time_s, with or without a column filename before it"
SLOWEST_HZ, FASTEST_HZ = 1e-6, 1e6
MOST_BEHIND = 16
"""Frames in a row that may be earlier than the one before: as many as decoders hold back to put in order."""


def stamps_at_rate(count: int, fps: float) -> list[int]:
    """Return stamps of frames 0 to count - 1 at a fixed rate: frame i at round(i / fps), ns.

    Raises:
        UsageError: unless the rate is one that cameras have.
    """
    if not SLOWEST_HZ <= fps <= FASTEST_HZ:
        expected = f"a number above 0, from {SLOWEST_HZ:g} to {FASTEST_HZ:g}"
        raise UsageError("frame rate cannot be used", found=f"--fps {fps}", expected=expected)
    return [stamp_at_rate(index, fps) for index in range(count)]


def stamp_at_rate(index: int, fps: float) -> int:
    """Return the stamp of one frame at a fixed rate, ns."""
    return round(index * (NS_PER_S / Fraction(fps)))


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


class VideoStamps:
    """Turns the stamps that a video tells into stamps that increase, as far as the frames are in order.

    Behind damage a decoder may give out a frame that it had held back, long after its time. Such a frame
    keeps its stamp, which is then not later than the one before: it is out of place, and whoever takes the
    frames leaves it out. Where stamps begin anew, as in files that were put together, they go on.

    Args:
        period_ns: time between frames where no stamp tells it, above 0.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = max(period_ns, 1)
        self._latest: int | None = None
        self._offset, self._behind = 0, 0

    def stamp(self, told_ns: int) -> int:
        """Return the stamp, ns, of the frame that the video says was taken at ``told_ns``, 0 where untold."""
        if self._latest is None:
            self._offset = max(-told_ns, 0)
        elif told_ns + self._offset <= self._latest:
            if told_ns > 0 and self._behind < MOST_BEHIND:
                self._behind += 1
                return told_ns + self._offset
            self._offset = self._latest + self._period_ns - told_ns
        self._behind = 0
        self._latest = told_ns + self._offset
        return self._latest


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return the lines that are not blank, with their numbers from 1."""
    try:
        lines = io.StringIO(read_text(path, limits.TEXT_BYTES, "utf-8-sig"), newline="")
        return [(number, row) for number, row in enumerate(csv.reader(lines), 1) if any(row)]
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
        number_ns = Decimal(cell) * (1 if header[-1] == "stamp_ns" else NS_PER_S)
        if not 0 <= number_ns <= LATEST_NS:  # before it is rounded: 1e99999 has as many digits
            raise RecordingError("stamp is negative or too late", where=where, found=cell, expected=STAMPS)
        return row[0].strip(), int(cell) if header[-1] == "stamp_ns" else round(number_ns)
    except (ValueError, ArithmeticError) as error:
        raise RecordingError(
            "stamp is not a number", where=where, found=f"'{cell}'", expected=header[-1]
        ) from error


def _by_name(entries: list[tuple[str, int]], names: Sequence[str], path: Path) -> list[int]:
    stamps = dict(entries)
    for name in names:
        if name not in stamps:
            raise RecordingError("image has no stamp", where=path, found=f"no line for {name}")
    return [stamps[name] for name in names]
