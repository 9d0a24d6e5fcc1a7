"""A head tracker that is timed step by step, and a clock for whole runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.smoothing import Learned, LearningTracker
from stepping import FRAME_NS

SETTLING = 10
"""Steps left out before times are taken: the search for the face, and caches."""


class HeadWalker:
    """A head tracker that is timed step by step.

    Args:
        tracker: of one camera or more.
    """

    def __init__(self, tracker: LearningTracker[Any]) -> None:
        self._tracker = tracker
        self._rng = np.random.default_rng(0)
        self._state: Any = None
        self.lost = 0
        self.last: Estimate | None = None

    def step(self, index: int, shown: Any) -> float:
        """Track one frame of images; return the seconds it took."""
        frame = Frame(index, (index + 1) * FRAME_NS, shown)
        if self._state is None:
            self._state = self._tracker.start(frame, self._rng)
        began = time.perf_counter()
        self._state, self.last = self._tracker.step(self._state, frame, self._rng)
        seconds = time.perf_counter() - began
        self.lost += self.last.status == Status.LOST
        return seconds

    def learned(self) -> Learned:
        """Return what another tracker can begin with."""
        return self._tracker.learned(self._state)


class FrameClock:
    """CPU time of a run's frames, of all threads, from one of its first estimates to its last.

    Args:
        settling: so many estimates are the start; no more than half of those that come.
    """

    def __init__(self, settling: int, now: Callable[[], float] = time.process_time) -> None:
        self._settling, self._now = settling, now
        self._times: list[float] = []

    def note(self, estimate: object) -> None:
        """See an estimate that was written."""
        self._times.append(self._now())

    @property
    def seconds_a_frame(self) -> float:
        """Seconds; NaN of fewer than two estimates."""
        times = self._times[min(self._settling, len(self._times) // 2) :]
        return (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else float("nan")
