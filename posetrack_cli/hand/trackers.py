"""Which hand tracker a configuration asks for, and how each of them begins."""

from __future__ import annotations

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
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.tracking.protocol import Tracker

State = TypeVar("State")


class HandTrackerProtocol(Tracker[State], Protocol[State]):
    """A hand tracker: begins at a pose, or without one."""

    def start(self, pose: FloatArray, stamp_ns: int, rng: np.random.Generator) -> State:
        """Return the state about a pose (22,) before the first frame, whose stamp is given."""

    def start_unknown(self, pose: FloatArray, frame: Frame, rng: np.random.Generator) -> State:
        """Return the state before a first frame in which the hand is not found yet, else at a pose (22,)."""


def make_tracker(
    config: HandConfig, hand: HandModel, camera: Camera, device: RenderingDevice
) -> HandTrackerProtocol[Any]:
    """Return the tracker of ``filter.kind``.

    Args:
        config: parameters.
        hand: whose motion is tracked.
        camera: of the depth images.
        device: draws the poses.

    Raises:
        RenderingError: a window that the device cannot draw.
        FilterError: a swarm that would not converge.
    """
    scorer = RenderedCosts(device, hand, camera, config.observation, config.filter.particles)
    segmenting = Observer(config, hand.anatomy, camera, segment=True)
    finder = None
    if config.filter.proposal in ("guided", "annealed") or config.init.method == "auto":
        finder = Acquisition(config, hand, camera, scorer, segmenting, Guiding(config, hand, camera))
    if config.filter.kind == "pso":
        objective = RenderedObjective(device, hand, camera, config)
        return SwarmTracker(config, hand.anatomy, camera, objective, finder)
    # the paper's cost takes all readings for the hand's; fits have to know which are
    plain = config.observation.cost == "paper" and config.filter.proposal != "guided"
    observer = Observer(config, hand.anatomy, camera, segment=False) if plain else segmenting
    return HandTracker(config, hand.anatomy, camera, scorer, observer, finder)
