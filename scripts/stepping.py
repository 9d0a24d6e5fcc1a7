"""Trackers that are timed step by step, in turn, so that a drifting clock rate touches all alike."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, TypeVar

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


class Stepping(Protocol):
    """Whatever tracks a frame and tells how long it took."""

    def step(self, index: int, shown: Any) -> float:
        """Track what a frame shows; return the seconds it took."""


class Walker:
    """A hand tracker that is timed step by step.

    Args:
        device: draws the poses.
        config: of the tracker.
        first: depth image that it starts in the middle of.
    """

    def __init__(self, device: RenderingDevice, config: HandConfig, first: Any) -> None:
        hand = average_hand()
        self.tracker = make_tracker(config, hand, CAMERA, device)
        self.rng = np.random.default_rng(0)
        pose = centre_pose(first, CAMERA, hand.anatomy, config.init.depth_mm)
        self.state: Any = self.tracker.start(pose, 0, self.rng)

    def step(self, index: int, shown: Any) -> float:
        """Track one depth image; return the seconds it took."""
        frame = Frame(index, index * FRAME_NS, (shown,))
        began = time.perf_counter()
        self.state, _ = self.tracker.step(self.state, frame, self.rng)
        return time.perf_counter() - began


def in_turn(
    walkers: Mapping[Name, Stepping], recorded: Sequence[Any], warm_up: int
) -> dict[Name, list[float]]:
    """Let walkers track the same frames, one by one in turn and in both orders.

    Returns:
        For each the seconds of every frame after the first ``warm_up``.
    """
    times: dict[Name, list[float]] = {name: [] for name in walkers}
    for index, shown in enumerate(recorded):
        for name in list(walkers)[:: 1 if index % 2 else -1]:
            seconds = walkers[name].step(index, shown)
            if index >= warm_up:
                times[name].append(seconds)
    return times
