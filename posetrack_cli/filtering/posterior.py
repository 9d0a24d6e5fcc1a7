"""What a filter believes after one frame, taken from the weighted particles before resampling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.model import StateSpace
from posetrack_cli.filtering.step import Weighing


@dataclass(frozen=True, eq=False)
class Posterior:
    """Estimate of one frame; u is the component's unit, mm or rad.

    Attributes:
        pose: (S,) weighted mean pose, hand paper (62).
        pose_variance: (D,) weighted variance about it in the tangent space, u^2.
        velocity: (D,) weighted mean velocity, (63), u/s; zeros for the plain particle filter.
        velocity_variance: (D,) (u/s)^2, by the law of total variance P + weighted variance of the particles'
            velocities; zeros for the plain particle filter, which has no velocity.
        effective_sample_size: 1 / sum w^2, in [1, N].
        log_evidence: log p(y_t | y_1..t-1), up to the likelihood's constant; 0 without an observation.
        resampled: whether the next state's particles were resampled.
        best: index of the heaviest particle, before resampling.
        best_pose: (S,) its pose.
    """

    pose: FloatArray
    pose_variance: FloatArray
    velocity: FloatArray
    velocity_variance: FloatArray
    effective_sample_size: float
    log_evidence: float
    resampled: bool
    best: int
    best_pose: FloatArray


def pose_moments(space: StateSpace, poses: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the weighted mean pose (S,) and the variance (D,) of the tangent vectors from it."""
    mean = space.mean(poses, weights)
    deviations = space.local(np.broadcast_to(mean, poses.shape), poses)
    return mean, weights @ np.square(deviations)


def velocity_moments(
    velocities: FloatArray, variance: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance (D,) of the mixture sum_i w_i N(v_i, diag P): total variance P + var v_i.

    Args:
        velocities: (N, D) v_i.
        variance: (D,) P.
        weights: (N,) of sum 1.
    """
    mean = weights @ velocities
    return mean, variance + weights @ np.square(velocities - mean)


def summarise(
    space: StateSpace,
    poses: FloatArray,
    velocity: tuple[FloatArray, FloatArray] | None,
    weighing: Weighing,
    resampled: bool,
    weights: FloatArray | None = None,
) -> Posterior:
    """Put the posterior together from particles and their weights, before resampling (62)-(63).

    Args:
        space: the poses' space.
        poses: (N, S).
        velocity: mean and variance, each (D,); None for a filter without velocity.
        weighing: weights of the poses.
        resampled: whether the next state is resampled.
        weights: (N,) for mean and variance of the pose, if not those of the weighing.
    """
    moments = weighing.weights if weights is None else weights
    pose, pose_variance = pose_moments(space, poses, moments)
    if velocity is None:
        velocity = np.zeros_like(pose_variance), np.zeros_like(pose_variance)
    best = int(np.argmax(weighing.weights))
    return Posterior(
        pose=pose,
        pose_variance=pose_variance,
        velocity=velocity[0],
        velocity_variance=velocity[1],
        effective_sample_size=weighing.effective_sample_size,
        log_evidence=weighing.log_evidence,
        resampled=resampled,
        best=best,
        best_pose=poses[best].copy(),
    )
