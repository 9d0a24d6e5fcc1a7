"""The page's time, and which frames of a result it knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.evaluation.html.packing import Packed, packed
from posetrack_cli.evaluation.track import Track
from posetrack_cli.recording.timeline import GAP_FACTOR

TICK_NS = 100_000
"""0.1 ms: far below a frame, and 31 bits of it are 59 hours."""

MOST_TICKS = 2**31 - 1
MOST_SPANS = 1000
"""More spans than that cannot be told apart in a plot; those nearest each other are merged."""


@dataclass(frozen=True)
class Timebase:
    """What one result's times count from.

    Attributes:
        origin_ns: stamp of time 0.
        tick_ns: length of a tick.
    """

    origin_ns: int
    tick_ns: int

    def ticks(self, stamp_ns: IntArray) -> IntArray:
        """Return stamps as whole ticks since the origin."""
        return (stamp_ns - self.origin_ns) // self.tick_ns

    @property
    def tick_s(self) -> float:
        """Length of a tick, s."""
        return self.tick_ns * 1e-9

    def seconds(self, stamp_ns: IntArray) -> FloatArray:
        """Return stamps as seconds since the origin, to whole ticks: the very numbers of the scripts."""
        return self.ticks(stamp_ns).astype(np.float64) * self.tick_s


def timebases(tracks: Sequence[Track]) -> tuple[list[Timebase], bool]:
    """Return each track's time base, and whether all count from the same origin.

    Tracks whose spans all have some time in common are shown over one time that begins with the first of
    them; otherwise each counts from its own first frame.
    """
    filled = [track.stamp_ns for track in tracks if len(track)]
    if not filled:
        return [Timebase(0, TICK_NS) for _ in tracks], True
    first, last = [int(stamps[0]) for stamps in filled], [int(stamps[-1]) for stamps in filled]
    shared = max(first) <= min(last)
    longest = max(last) - min(first) if shared else max(b - a for a, b in zip(first, last, strict=True))
    tick_ns = max(TICK_NS, -(-longest // MOST_TICKS))
    starts = [int(track.stamp_ns[0]) if len(track) and not shared else min(first) for track in tracks]
    return [Timebase(start, tick_ns) for start in starts], shared


def gap_spans(stamp_ns: IntArray) -> IntArray:
    """Return (G, 2) stamps before and after each gap, the longest ``MOST_SPANS`` of them, in order.

    Gaps are what the metric ``gaps`` counts: intervals of more than ``GAP_FACTOR`` usual ones.
    """
    steps = np.diff(stamp_ns)
    if not len(steps):
        return np.empty((0, 2), dtype=np.int64)
    gaps = np.flatnonzero(steps > GAP_FACTOR * np.median(steps))
    if len(gaps) > MOST_SPANS:
        gaps = np.sort(gaps[np.argsort(-steps[gaps], kind="stable")[:MOST_SPANS]])
    return np.stack([stamp_ns[gaps], stamp_ns[gaps + 1]], axis=1)


def state_spans(stamp_ns: IntArray, holds: BoolArray) -> IntArray:
    """Return (S, 2) stamps of the first and last frame of each run of frames where ``holds`` is true.

    Of more than ``MOST_SPANS`` runs, those with the shortest pauses between them are merged.
    """
    edges = np.diff(np.concatenate([[False], holds, [False]]).astype(np.int8))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    if len(first) > MOST_SPANS:
        pauses = stamp_ns[first[1:]] - stamp_ns[last[:-1]]
        cuts = np.sort(np.argsort(-pauses, kind="stable")[: MOST_SPANS - 1])
        first, last = first[np.concatenate([[0], cuts + 1])], last[np.concatenate([cuts, [len(last) - 1]])]
    return np.stack([stamp_ns[first], stamp_ns[last]], axis=1)


TRACKING, LOST, REINITIALISED = 0, 1, 2


class RowTable:
    """Collects rows of a track; their times, frame numbers and states are embedded once.

    ``add`` returns a placeholder that ``finish`` fills with the rows' places in the table.
    """

    def __init__(self, track: Track, timebase: Timebase) -> None:
        self._track = track
        self._timebase = timebase
        self._waiting: list[tuple[IntArray, Packed]] = []

    def add(self, rows: IntArray) -> Packed:
        """Ask for rows of the track; the returned mapping holds their places after ``finish``."""
        places: Packed = {}
        self._waiting.append((rows, places))
        return places

    def finish(self) -> dict[str, Packed]:
        """Fill every placeholder and return the table: ticks, frame numbers and states."""
        asked = [rows for rows, _ in self._waiting]
        kept = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *asked]))
        for rows, places in self._waiting:
            places.update(packed(np.searchsorted(kept, rows), "u4"))
        return {
            "ticks": packed(self._timebase.ticks(self._track.stamp_ns[kept]), "i4"),
            "frames": packed(self._frame_numbers()[kept], "u4"),
            "states": packed(self._states()[kept], "u1"),
        }

    def _frame_numbers(self) -> IntArray:
        """Places in the recording; in the result where those are not known."""
        known = self._track.frame_index
        return np.arange(len(self._track), dtype=np.int64) if known is None else known

    def _states(self) -> IntArray:
        states = np.full(len(self._track), TRACKING, dtype=np.int64)
        for state, holds in ((LOST, self._track.lost), (REINITIALISED, self._track.reinitialised)):
            if holds is not None:
                states[holds] = state
        return states
