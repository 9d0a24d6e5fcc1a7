"""Smoothers of a hand track, and estimates from smoothed states."""

from __future__ import annotations

import numpy as np

from posetrack_cli.filtering.filters import FILTERS
from posetrack_cli.filtering.fit_smoothing import FitSmoother
from posetrack_cli.filtering.model import Dynamics
from posetrack_cli.filtering.smoothing import GaussianSmoother, Memory, Smoothed, Smoother, noise_of
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import ComponentSettings, HandConfig
from posetrack_cli.hand.fit.likelihood import PROPOSALS
from posetrack_cli.hand.fit.local_fits import FOREARM_CONFIDENCE, INNER, HandFits
from posetrack_cli.hand.model.anatomy import HandAnatomy
from posetrack_cli.hand.model.hand import HandModel, space_of, tangent_vector
from posetrack_cli.hand.start import hand_estimate, with_doubt
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.smoothing import Describe, FrameFacts

BLOCKS = (np.arange(6), *np.arange(6, 21).reshape(5, 3))
"""Tangent components with a common error: the palm, then each finger."""
SMOOTH_POSE = ComponentSettings(position_mm=3.0, rotation_rad=0.06, flexion_rad=0.06, abduction_rad=0.03)
SMOOTH_VELOCITY = ComponentSettings(position_mm=900.0, rotation_rad=15.0, flexion_rad=15.0, abduction_rad=3.6)
"""Noise densities of the motion between fits, as in `MotionSettings`; mostly velocity."""
_FREEDOM = 4.0
"""Degrees of freedom of the Student-t density of a fit's error."""


def smoothed_hand(anatomy: HandAnatomy, *, is_calibrated: bool = False) -> Describe[Estimate]:
    """Return a function that makes estimates of smoothed states.

    Status and confidences are the filter's, which assess the frame itself. Inner numbers are those of the
    filter's fits, which the poses are smoothed with.

    Args:
        anatomy: the hand.
        is_calibrated: whether confidence is the probability that an estimate is right.
    """

    def describe(smoothed: Smoothed, facts: FrameFacts, memory: Memory) -> Estimate:
        variance = smoothed.pose_variance
        return hand_estimate(
            anatomy,
            smoothed.pose,
            smoothed.velocity,
            memory.get(INNER),
            forearm_confidence=float(memory.get(FOREARM_CONFIDENCE, np.nan)),
            **facts._asdict(),
            pose_variance=with_doubt(variance, facts.confidence) if is_calibrated else variance,
            twist_variance=smoothed.velocity_variance,
            effective_sample_size=None,
            resampled=False,
        )

    return describe


def frame_fits(config: HandConfig, hand: HandModel, camera: Camera) -> HandFits | None:
    """Return the refitting of frames; None if the proposal fits no frames."""
    return HandFits(config, hand, camera) if PROPOSALS[config.filter.proposal].fits_frames else None


def make_smoother(config: HandConfig, dynamics: Dynamics, fits: HandFits | None = None) -> Smoother:
    """Return the smoother of the local fits, or without them that of the filter's moments.

    Args:
        config: parameters.
        dynamics: of the filter.
        fits: of `frame_fits`.
    """
    space = space_of(config.filter)
    if fits is not None:
        motion = Dynamics(tangent_vector(SMOOTH_POSE) ** 2, tangent_vector(SMOOTH_VELOCITY) ** 2)
        return FitSmoother(motion, space, fits, BLOCKS, _FREEDOM)
    return GaussianSmoother(noise_of(dynamics, FILTERS.find(config.filter.kind).has_velocity), space)
