"""Trackers timed frame by frame in alternation, so that a drifting clock rate affects all of them."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.hand import average_hand
from posetrack_cli.hand.run import make_tracker
from posetrack_cli.hand.start import centre_pose
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.hand.frames import CAMERA

Name = TypeVar("Name")
FRAME_NS = 33_333_333


class Walker:
    """A tracker that is timed frame by frame."""

    def __init__(self, tracker: Any, state: Any, rng: np.random.Generator) -> None:
        self._tracker, self._state, self._rng = tracker, state, rng

    def step(self, index: int, shown: Any) -> float:
        """Track one frame; return the duration in seconds."""
        frame = Frame(index, (index + 1) * FRAME_NS, shown)
        began = time.perf_counter()
        self._state, _ = self._tracker.step(self._state, frame, self._rng)
        return time.perf_counter() - began


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
