"""Trackers timed frame by frame in alternation, so that a drifting clock rate affects all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.hand import average_hand
from posetrack_cli.hand.run import make_tracker
from posetrack_cli.hand.start import centre_pose
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.synthesis.hand.frames import CAMERA

Name = TypeVar("Name")
FRAME_NS = 33_333_333
SETTLING = 10  # untimed first frames of a head: face detection, cold caches


class Walker:
    """A tracker that is timed frame by frame; a head tracker initialises in its first frame."""

    def __init__(self, tracker: Any, state: Any = None, rng: np.random.Generator | None = None) -> None:
        self.tracker, self.state = tracker, state
        self._rng = rng or np.random.default_rng(0)
        self.lost = 0
        self.last: Estimate | None = None

    def step(self, index: int, shown: Any) -> float:
        """Track one frame; return the duration in seconds."""
        frame = Frame(index, (index + 1) * FRAME_NS, shown)
        if self.state is None:
            self.state = self.tracker.start(frame, self._rng)
        began = time.perf_counter()
        self.state, self.last = self.tracker.step(self.state, frame, self._rng)
        seconds = time.perf_counter() - began
        self.lost += self.last is not None and self.last.status == Status.LOST
        return seconds


def hand_walker(device: RenderingDevice, config: HandConfig, first: Any) -> Walker:
    """Return a hand tracker that starts at the centre of the depth image ``first``."""
    hand, rng = average_hand(), np.random.default_rng(0)
    tracker = make_tracker(config, hand, CAMERA, device)
    pose = centre_pose(first, CAMERA, hand.anatomy, config.init.depth_mm)
    return Walker(tracker, tracker.start(pose, 0, rng), rng)


def in_turn(walkers: Mapping[Name, Any], recorded: Sequence[Any], warm_up: int) -> dict[Name, list[float]]:
    """Track the same frames with all walkers alternately, in both orders.

    Returns the seconds of every frame after the first ``warm_up`` by walker.
    """
    times: dict[Name, list[float]] = {name: [] for name in walkers}
    for index, shown in enumerate(recorded):
        for name in list(walkers)[:: 1 if index % 2 else -1]:
            seconds = walkers[name].step(index, shown)
            if index >= warm_up:
                times[name].append(seconds)
    return times


class FrameClock:
    """CPU time (all threads) per frame of a head run, without the first ``SETTLING`` estimates."""

    def __init__(self, now: Callable[[], float] = time.process_time) -> None:
        self._now = now
        self._times: list[float] = []

    def note(self, estimate: object) -> None:
        """Record the time of an estimate."""
        self._times.append(self._now())

    @property
    def ms_a_frame(self) -> float:
        """CPU milliseconds per frame; NaN for fewer than two estimates."""
        times = self._times[min(SETTLING, len(self._times) // 2) :]  # keeps half of a short run
        return 1e3 * (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else float("nan")
