"""What a run expects of any tracker."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, TypeVar

import numpy as np

from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate

State = TypeVar("State")


class Tracker(Protocol[State]):
    """A tracker: pure steps from one state to the next, and states that can be saved.

    How a state begins differs between hands and heads; their own protocols add it.
    """

    def step(self, state: State, frame: Frame, rng: np.random.Generator) -> tuple[State, Estimate]:
        """Advance by one frame; the state given is left as it is."""

    def state_parts(self, state: State) -> tuple[dict[str, np.ndarray[Any, Any]], dict[str, int]]:
        """Take a state apart into arrays and whole numbers, for a checkpoint."""

    def state_from_parts(
        self, arrays: Mapping[str, np.ndarray[Any, Any]], numbers: Mapping[str, int]
    ) -> State:
        """Put a state together from what ``state_parts`` made of it.

        Raises:
            LayoutError: of these no state of this tracker is made; see ``results.layouts``.
        """
