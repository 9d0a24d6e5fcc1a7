"""What a run expects of any tracker."""

from __future__ import annotations

from typing import Protocol, TypeVar

import numpy as np

from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.state_codec import Codec

State = TypeVar("State")


class Tracker(Protocol[State]):
    """A tracker: pure steps from one state to the next, and states that can be saved.

    How a state begins differs between hands and heads; their own protocols add it.
    """

    def step(self, state: State, frame: Frame, rng: np.random.Generator) -> tuple[State, Estimate]:
        """Advance by one frame; the state given is left as it is."""

    @property
    def codec(self) -> Codec[State]:
        """How states become arrays, for a checkpoint, and back."""
