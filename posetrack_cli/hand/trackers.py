"""Which hand tracker a configuration asks for."""

from __future__ import annotations

from typing import Any

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.acquisition import Acquisition
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.keypoints.file import KeypointFile
from posetrack_cli.hand.keypoints.told import ToldHands
from posetrack_cli.hand.likelihood import RenderedCosts
from posetrack_cli.hand.model import HandModel
from posetrack_cli.hand.observer import Observer
from posetrack_cli.hand.proposals import PROPOSALS
from posetrack_cli.hand.protocol import HandTrackerProtocol
from posetrack_cli.hand.swarm import RenderedObjective, SwarmTracker
from posetrack_cli.hand.tracker import HandTracker
from posetrack_cli.rendering.port import RenderingDevice


def make_tracker(
    config: HandConfig,
    hand: HandModel,
    camera: Camera,
    device: RenderingDevice,
    keypoints: KeypointFile | None = None,
) -> HandTrackerProtocol[Any]:
    """Return the tracker of ``filter.kind``.

    Args:
        config: parameters.
        hand: whose motion is tracked.
        camera: of the depth images.
        device: draws the poses.
        keypoints: from elsewhere, for a proposal that fits frames.

    Raises:
        RenderingError: a window that the device cannot draw.
        FilterError: a swarm that would not converge.
    """
    scorer = RenderedCosts(device, hand, camera, config.observation, config.filter.particles)
    finder, proposal = None, PROPOSALS[config.filter.proposal]
    if proposal.fits_frames or config.init.method == "auto":
        finder = Acquisition(config, hand, camera)
    is_swarm = config.filter.kind == "pso"
    # the paper's cost takes all readings for the hand's; fits, and a swarm, have to know which are
    segment = is_swarm or proposal.fits_frames or config.observation.cost != "paper"
    with_arm = segment and not is_swarm
    observer = Observer(config, hand.anatomy, camera, segment=segment, with_arm=with_arm, follows=True)
    if is_swarm:
        objective = RenderedObjective(device, hand, camera, config)
        return SwarmTracker(config, hand.anatomy, objective, observer, finder)
    told = None if keypoints is None else ToldHands(keypoints, camera, hand.anatomy)
    return HandTracker(config, hand.anatomy, scorer, observer, finder, told)
