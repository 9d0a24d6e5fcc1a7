"""Which tracker a configuration asks for, and what a run expects of any of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, TypeVar

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.acquisition import Acquisition
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.guiding import Guiding
from posetrack_cli.hand.likelihood import RenderedCosts
from posetrack_cli.hand.model import HandModel
from posetrack_cli.hand.observer import Observer
from posetrack_cli.hand.swarm.objective import RenderedObjective
from posetrack_cli.hand.swarm.tracker import SwarmTracker
from posetrack_cli.hand.tracker import HandTracker
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate

State = TypeVar("State")


class Tracker(Protocol[State]):
    """A hand tracker: pure steps from one state to the next, and states that can be saved."""

    def start(self, pose: FloatArray, stamp_ns: int, rng: np.random.Generator) -> State:
        """Return the state about a pose (22,) before the first frame, whose stamp is given."""

    def start_unknown(self, pose: FloatArray, frame: Frame, rng: np.random.Generator) -> State:
        """Return the state before a first frame in which the hand is not found yet, else at a pose (22,)."""

    def step(self, state: State, frame: Frame, rng: np.random.Generator) -> tuple[State, Estimate]:
        """Advance by one frame; the state given is left as it is."""

    def state_parts(self, state: State) -> tuple[dict[str, FloatArray], dict[str, int]]:
        """Take a state apart into arrays and whole numbers, for a checkpoint."""

    def state_from_parts(self, arrays: Mapping[str, FloatArray], numbers: Mapping[str, int]) -> State:
        """Put a state together from what ``state_parts`` made of it."""


def make_tracker(config: HandConfig, hand: HandModel, camera: Camera, context: Any) -> Tracker[Any]:
    """Return the tracker of ``filter.kind``.

    Args:
        config: parameters.
        hand: whose motion is tracked.
        camera: of the depth images.
        context: GL context.

    Raises:
        RenderingError: a window that this GL cannot draw.
        FilterError: a swarm that would not converge.
    """
    scorer = RenderedCosts(context, hand, camera, config.observation, config.filter.particles)
    segmenting = Observer(config, hand.anatomy, camera, segment=True)
    finder = None
    if config.filter.proposal in ("guided", "annealed") or config.init.method == "auto":
        finder = Acquisition(config, hand, camera, scorer, segmenting, Guiding(config, hand, camera))
    if config.filter.kind == "pso":
        objective = RenderedObjective(context, hand, camera, config)
        return SwarmTracker(config, hand.anatomy, camera, objective, finder)
    # the paper's cost takes all readings for the hand's; fits have to know which are
    plain = config.observation.cost == "paper" and config.filter.proposal != "guided"
    observer = Observer(config, hand.anatomy, camera, segment=False) if plain else segmenting
    return HandTracker(config, hand.anatomy, camera, scorer, observer, finder)
