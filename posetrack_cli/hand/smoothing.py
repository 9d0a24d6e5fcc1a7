"""How a hand is smoothed: which smoother, and what an estimate says of a smoothed state."""

from __future__ import annotations

import numpy as np

from posetrack_cli.filtering.filters import FILTERS
from posetrack_cli.filtering.fit_smoothing import FitSmoother
from posetrack_cli.filtering.gaussian_smoothing import GaussianSmoother
from posetrack_cli.filtering.model import Dynamics
from posetrack_cli.filtering.particle_smoothing import ParticleSmoother
from posetrack_cli.filtering.smoothing import Memory, Smoothed, Smoother, noise_of
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import HandAnatomy
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.local_fits import FOREARM_CONFIDENCE, INNER, HandFits
from posetrack_cli.hand.model import HandModel
from posetrack_cli.hand.proposals import BLOCKS, PROPOSALS
from posetrack_cli.hand.protocol import hand_estimate
from posetrack_cli.hand.space import space_of, tangent_vector
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.smoothing import Describe, FrameFacts


def smoothed_hand(anatomy: HandAnatomy) -> Describe[Estimate]:
    """Return what makes estimates of a hand's smoothed states.

    Status and confidences are those of the filter, which say whether the frame itself was understood; inner
    numbers are those that its fits found, with which poses are smoothed.
    """

    def describe(smoothed: Smoothed, facts: FrameFacts, memory: Memory) -> Estimate:
        return hand_estimate(
            anatomy,
            smoothed.pose,
            smoothed.velocity,
            memory.get(INNER),
            forearm_confidence=float(memory.get(FOREARM_CONFIDENCE, np.nan)),
            **facts._asdict(),
            pose_variance=smoothed.pose_variance,
            twist_variance=smoothed.velocity_variance,
            effective_sample_size=None,
            resampled=False,
        )

    return describe


def frame_fits(config: HandConfig, hand: HandModel, camera: Camera) -> HandFits | None:
    """Return what looks at frames again; None unless local fits are smoothed."""
    wanted = config.smoothing.method == "fits" and PROPOSALS.find(config.filter.proposal).fits_frames
    return HandFits(config, hand, camera) if wanted else None


def make_smoother(
    config: HandConfig, dynamics: Dynamics, rng: np.random.Generator, fits: HandFits | None = None
) -> Smoother:
    """Return the smoother of ``smoothing.method``; ``fits`` is ``gaussian`` where there are no fits.

    Args:
        config: parameters.
        dynamics: those of the filter.
        rng: of backward simulation alone, so that filtered estimates do not depend on it.
        fits: of `frame_fits`.
    """
    moving = FILTERS.find(config.filter.kind).has_velocity
    space, settings = space_of(config.filter), config.smoothing
    if settings.method == "particles":
        return ParticleSmoother(noise_of(dynamics, moving), space, settings.trajectories, rng)
    if fits is not None:
        pose, velocity = tangent_vector(settings.pose), tangent_vector(settings.velocity)
        return FitSmoother(Dynamics(pose**2, velocity**2), space, fits, BLOCKS, settings.freedom)
    return GaussianSmoother(
        noise_of(dynamics, moving), space, guided=PROPOSALS.find(config.filter.proposal).looks_at_frames
    )
