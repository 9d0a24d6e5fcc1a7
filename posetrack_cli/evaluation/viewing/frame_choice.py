"""Selection of the frames to draw."""

from __future__ import annotations

import re
from bisect import bisect

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.reading.tracks import Track

EXPECTED = "all, frame numbers and ranges (0:300:5,420), spread:N or worst:N"
APART_NS = 1_000_000_000
"""Minimum distance of the worst frames, so that they do not show the same moment."""
_LARGEST = 2**62
_PART = re.compile(r"(?P<number>\d+)|(?P<start>\d*):(?P<stop>\d*)(?::(?P<step>\d*))?", re.ASCII)
_MANY = re.compile(r"(spread|worst):(\d+)", re.ASCII)


def chosen_rows(choice: str, track: Track, errors: FloatArray | None) -> IntArray:
    """Return the selected rows of a track, increasing.

    Args:
        choice: ``all``; comma-separated frame numbers of the recording and half-open ranges FIRST:STOP:STEP;
            ``spread:N``, N evenly spaced frames; or ``worst:N``, see ``worst_rows``.
        track: track of the result.
        errors: (N,) errors, mm, NaN in frames without ground truth; None without ground truth.

    Raises:
        UsageError: invalid syntax, or no such frame in the result.
    """
    rows = np.arange(len(track), dtype=np.int64)
    # Also for "all": an empty video or sheet cannot be written.
    if not rows.size:
        raise UsageError("no frame to draw", found="a result without estimates")
    if choice == "all":
        return rows
    many = _MANY.fullmatch(choice)
    if many is None:
        return _rows_of_numbers(choice, rows if track.frame_index is None else track.frame_index)
    count = int(many[2])
    if not count:
        raise _unknown(choice)
    if many[1] == "spread":
        return np.unique(np.linspace(0, len(track) - 1, count).round().astype(np.int64))
    return np.sort(worst_rows(track, errors, count))


def fewer_said(choice: str, found: int) -> str:
    """Return why fewer of the worst frames than requested were found; empty otherwise."""
    many = _MANY.fullmatch(choice)
    if many is None or many[1] != "worst" or found >= int(many[2]):
        return ""
    return f"{choice} selects only {found} frames, as they must be {APART_NS / 1e9:g} s apart"


def worst_rows(track: Track, errors: FloatArray | None, count: int) -> IntArray:
    """Return the rows of the worst frames, worst first, at least ``APART_NS`` apart.

    Frames are ranked by error; without ground truth, lost frames come first, then those with the lowest
    confidence, then those with the highest cost.

    Args:
        track: track of the result.
        errors: (N,) errors, mm, NaN in frames without ground truth, which are skipped; None without it.
        count: maximum number of frames.
    """
    chosen: list[int] = []
    stamps: list[int] = []  # stamps of the chosen rows, sorted
    for row in _worst_first(track, errors).tolist():
        if len(chosen) == count:
            break
        stamp = int(track.stamp_ns[row])
        place = bisect(stamps, stamp)
        if all(abs(stamp - near) >= APART_NS for near in stamps[max(0, place - 1) : place + 1]):
            stamps.insert(place, stamp)
            chosen.append(row)
    return np.array(chosen, dtype=np.int64)


def _worst_first(track: Track, errors: FloatArray | None) -> IntArray:
    if errors is not None and np.isfinite(errors).any():
        order = np.argsort(-errors, kind="stable")  # NaN last
        return order[np.isfinite(errors[order])]
    none = np.zeros(len(track))
    lost: BoolArray | FloatArray = none if track.lost is None else track.lost
    sure = none if track.confidence is None else np.nan_to_num(track.confidence, nan=np.inf)
    cost = none if track.cost is None else np.nan_to_num(track.cost, nan=-np.inf)
    return np.lexsort((-cost, sure, ~np.asarray(lost, dtype=np.bool_)))


def _rows_of_numbers(choice: str, frame_index: IntArray) -> IntArray:
    chosen = np.zeros(len(frame_index), dtype=np.bool_)
    for part in choice.split(","):
        chosen |= _named(part.strip(), frame_index)
    return np.flatnonzero(chosen)


def _named(part: str, frame_index: IntArray) -> BoolArray:
    """Return the mask of frames in a number or range."""
    found = _PART.fullmatch(part)
    if found is None or found["step"] == "0":
        raise _unknown(part)
    if found["number"] is not None:
        first = _bounded(found["number"], 0)
        last, step = first + 1, 1
    else:
        first, step = _bounded(found["start"], 0), _bounded(found["step"], 1)
        last = _bounded(found["stop"], _LARGEST)
    named = (frame_index >= first) & (frame_index < last) & ((frame_index - first) % step == 0)
    if not named.any():
        raise UsageError(
            "no such frame in the result",
            where=f"--select {part}",
            expected=f"frames from {frame_index.min()} to {frame_index.max()}",
        )
    return np.asarray(named, dtype=np.bool_)


def _bounded(digits: str | None, usual: int) -> int:
    """Return the number limited to the range of int64, or the default if it is missing."""
    return min(int(digits), _LARGEST) if digits else usual


def _unknown(choice: str) -> UsageError:
    return UsageError("invalid --select", found=f"'{choice}'", expected=EXPECTED)
