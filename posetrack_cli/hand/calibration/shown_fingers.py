"""Which frames a hand's shape is estimated from: those that show the most of fingers."""

from __future__ import annotations

from bisect import insort
from typing import NamedTuple

from posetrack_cli.recording.base import Frame

FIRST_FRAMES = 16
"""How many frames the first round uses, one of each part of the recording. The average hand is placed wrongly
in more of the others, and a shape adjusted to those starts the next round worse."""


class _Shown(NamedTuple):
    """A frame, and how much of fingers it shows, mm^2."""

    fingers_mm2: float
    frame: Frame

    def rank(self) -> tuple[float, int]:
        """What sorts those first that show the most, of equal ones the earliest."""
        return -self.fingers_mm2, self.frame.index


class ShownFingers:
    """Chooses frames by how much of fingers they show, those of the first round from all parts.

    Frames that show much of them follow each other, and are much alike. The first round, which knows the
    average hand alone, takes the best frame of each of ``FIRST_FRAMES`` parts of the recording; what it still
    lacks, and all others, are the best of the rest. No more frames are kept than are chosen.

    Args:
        most: how many are chosen.
        count: how many are expected; further ones belong to the last part.
    """

    def __init__(self, most: int, count: int) -> None:
        self._first, self._most, self._count = min(FIRST_FRAMES, most), most, max(count, 1)
        self._best: dict[int, _Shown] = {}
        self._rest: list[_Shown] = []
        self.seen = 0

    def add(self, frame: Frame, fingers_mm2: float) -> None:
        """Take the next frame into account."""
        part = min(self.seen * self._first // self._count, self._first - 1)
        self.seen += 1
        shown, best = _Shown(fingers_mm2, frame), self._best.get(part)
        passed: _Shown | None = shown
        if fingers_mm2 > 0.0 and (best is None or shown.rank() < best.rank()):
            self._best[part], passed = shown, best
        if passed is not None:
            insort(self._rest, passed, key=_Shown.rank)
        del self._rest[self._most - len(self._best) :]

    @property
    def frames(self) -> list[Frame]:
        """Those of the first round, in order, then the others."""
        ranked = [*self._best.values(), *self._rest]
        parts = (ranked[: self._first], ranked[self._first :])
        return [shown.frame for part in parts for shown in sorted(part, key=lambda one: one.frame.index)]
