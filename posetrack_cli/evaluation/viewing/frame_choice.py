"""Which frames of a result are drawn."""

from __future__ import annotations

import re
from bisect import bisect

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.reading.tracks import Track

EXPECTED = "all, numbers and ranges such as 0:300:5,420 or 7, spread:6, or worst:8"
APART_NS = 1_000_000_000
_LARGEST = 2**62
_PART = re.compile(r"(?P<number>\d+)|(?P<start>\d*):(?P<stop>\d*)(?::(?P<step>\d*))?", re.ASCII)
_MANY = re.compile(r"(spread|worst):(\d+)", re.ASCII)


def chosen_rows(choice: str, track: Track, errors: FloatArray | None) -> IntArray:
    """Rows of a track, increasing, that a choice names.

    Args:
        choice: ``all``; frame numbers of the recording and ranges FIRST:STOP:STEP of them (without STOP),
            separated by commas; ``spread:N``, N evenly spread; ``worst:N``, see ``worst_rows``.
        track: of the result.
        errors: (N,) mm, NaN without truth; None where there is none at all.

    Raises:
        UsageError: it cannot be read, or names no frame of the result or one that is not there.
    """
    rows = np.arange(len(track), dtype=np.int64)
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
    """Say why there are fewer of the worst frames than were asked for; nothing where there are not."""
    many = _MANY.fullmatch(choice)
    if many is None or many[1] != "worst" or found >= int(many[2]):
        return ""
    return f"{choice} gives {found}: they are {APART_NS / 1e9:g} s or more apart"


def worst_rows(track: Track, errors: FloatArray | None, count: int) -> IntArray:
    """Rows of the worst frames, the worst first, at least a second apart: not all of the same moment.

    The largest error counts; where there is no truth, lost frames come first, then the least confidence, and
    of frames with as much the highest cost.

    Args:
        track: of the result.
        errors: (N,) mm, NaN for frames without truth, which then are not chosen; None without truth.
        count: how many at most; a short recording gives fewer.
    """
    chosen: list[int] = []
    stamps: list[int] = []  # of these, sorted
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
    """Which frames one number or range names."""
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
            "frame is not in the result",
            where=f"--select {part}",
            expected=f"some of {frame_index.min()} to {frame_index.max()}",
        )
    return np.asarray(named, dtype=np.bool_)


def _bounded(digits: str | None, usual: int) -> int:
    """A number that 64 bits hold; the usual one where none is given."""
    return min(int(digits), _LARGEST) if digits else usual


def _unknown(choice: str) -> UsageError:
    return UsageError("--select cannot be read", found=f"'{choice}'", expected=EXPECTED)
