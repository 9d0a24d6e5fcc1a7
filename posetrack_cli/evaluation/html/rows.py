"""Which frames of a result the page knows: those that any of its lines or scenes needs."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import IntArray
from posetrack_cli.evaluation.html.packing import Packed, packed
from posetrack_cli.evaluation.html.timebase import Timebase
from posetrack_cli.evaluation.track import Track

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
