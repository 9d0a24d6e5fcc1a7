"""Parts of a filter step: proposal, weighting, choice of ancestors, posterior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.model import Constrain, LogLikelihood, StateSpace
from posetrack_cli.filtering.resampling import Resampling, effective_count, normalise, resample


class Weighing(NamedTuple):
    """Weights after an observation (N,), their logarithms (N,), log p(y_t | y_1..t-1), and 1 / sum w^2."""

    weights: FloatArray
    log_weights: FloatArray
    log_evidence: float
    effective_sample_size: float


class Prediction(NamedTuple):
    """Belief before a frame, sum_i w_i p_i(x), with x = x_i (+) (d_i + e), e ~ N(0, diag variance).

    Attributes:
        poses: (N, S) x_i.
        drift: (N, D) d_i.
        variance: (D,) equal for all particles.
        log_weights: (N,) log w_i.
    """

    poses: FloatArray
    drift: FloatArray
    variance: FloatArray
    log_weights: FloatArray


class Proposed(NamedTuple):
    """Weighted poses drawn for one frame.

    Attributes:
        poses: (N, S).
        increments: (N, D) from their ancestors' poses.
        ancestors: (N,) indices of their ancestors.
        weighing: their weights, hand paper (24).
    """

    poses: FloatArray
    increments: FloatArray
    ancestors: IntArray
    weighing: Weighing


def equal_log_weights(count: int) -> FloatArray:
    """Return (count,) logarithms of 1 / count."""
    return np.full(count, -np.log(count))


def propose(
    space: StateSpace,
    poses: FloatArray,
    drift: FloatArray | None,
    variance: FloatArray,
    constrain: Constrain | None,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Sample x_t = x_{t-1} (+) (drift + w), w ~ N(0, diag variance); hand paper (52).

    Args:
        space: space of poses.
        poses: (N, S) x_{t-1}.
        drift: (N, D) mean increments; None for none.
        variance: (D,) of the increments.
        constrain: moves poses back within their limits, or None.
        rng: source of randomness.

    Returns:
        (N, S) new poses and (N, D) z = x_t (-) x_{t-1}, (58), **after** constraining.
    """
    # Drawn for all components, even frozen ones, so that the random stream does not depend on the noise.
    increments = rng.standard_normal((len(poses), variance.size))
    increments *= np.sqrt(variance)
    if drift is not None:
        increments += drift
    moved = space.retract(poses, increments)
    if constrain is None:
        return moved, increments  # not space.local(): it would lose turns of more than pi
    moved = constrain(moved)
    return moved, space.local(poses, moved)


def weigh(log_weights: FloatArray, poses: FloatArray, log_likelihood: LogLikelihood | None) -> Weighing:
    """Return w_t proportional to w_{t-1} p(y_t | x_t), hand paper (54); w_{t-1} without an observation.

    The log evidence is log sum_i w_{t-1,i} p(y_t | x_{t,i}), with w_{t-1} normalised.

    Raises:
        FilterError: the likelihood has the wrong shape, a NaN or an infinity, or is zero for all particles.
    """
    before, log_before = normalise(log_weights)
    if log_likelihood is None:
        return Weighing(before, log_weights - log_before, 0.0, effective_count(before))
    weighing = weigh_drawn(log_weights, poses, log_likelihood)
    return weighing._replace(log_evidence=weighing.log_evidence - log_before)


def weigh_drawn(log_weights: FloatArray, poses: FloatArray, log_likelihood: LogLikelihood) -> Weighing:
    """Return weights proportional to p(y_t | x_t) exp(log_weights), hand paper (24).

    The log evidence is log sum_i p(y_t | x_{t,i}) exp(log_weights_i), without normalising the weights:
    ratios of prior to proposal sum to 1 only in expectation.

    Raises:
        FilterError: see ``weigh``.
    """
    scores = scored(poses, log_likelihood) + log_weights
    weights, log_sum = normalise(scores)
    return Weighing(weights, scores - log_sum, log_sum, effective_count(weights))


def scored(poses: FloatArray, log_likelihood: LogLikelihood) -> FloatArray:
    """Return log p(y | x) of poses (N, S), (N,).

    Raises:
        FilterError: the likelihood has the wrong shape.
    """
    scores = np.asarray(log_likelihood(poses), dtype=np.float64)
    if scores.shape != (len(poses),):
        raise FilterError("log-likelihood has the wrong shape", found=scores.shape, expected=(len(poses),))
    return scores


def choose_ancestors(weighing: Weighing, resampling: Resampling, rng: np.random.Generator) -> IntArray | None:
    """Return the ancestors (N,) of the next step's particles, or None if resampling is not due; (7)."""
    if not resampling.is_due(weighing.effective_sample_size, weighing.weights.size):
        return None
    return resample(resampling.scheme, weighing.weights, rng)


def scatter(
    space: StateSpace, mean: FloatArray, sd: FloatArray, count: int, rng: np.random.Generator
) -> FloatArray:
    """Return (count, S) poses mean (+) N(0, diag sd^2) about one pose (S,), with sd (D,).

    Raises:
        FilterError: count < 1, or an sd is negative or not finite.
    """
    if count < 1:
        raise FilterError("invalid number of particles", found=count, expected="count >= 1")
    if not np.all(np.isfinite(sd)) or np.any(sd < 0.0):
        raise FilterError("invalid initial spread", found=sd, expected="finite, >= 0")
    start = np.tile(np.asarray(mean, dtype=np.float64), (count, 1))
    return propose(space, start, None, np.square(sd), None, rng)[0]


@dataclass(frozen=True, eq=False)
class Posterior:
    """Estimate of one frame; u is the component's unit, mm or rad.

    Attributes:
        pose: (S,) weighted mean pose, hand paper (62).
        pose_variance: (D,) weighted variance about it in the tangent space, u^2.
        velocity: (D,) weighted mean velocity, (63), u/s; zeros for the plain particle filter.
        velocity_variance: (D,) (u/s)^2, P + weighted variance of the particles' velocities (law of total
            variance); zeros for the plain particle filter, which has no velocity.
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
    """Return mean and variance (D,) of sum_i w_i N(v_i, diag P): total variance P + var v_i.

    Args:
        velocities: (N, D) v_i.
        variance: (D,) P.
        weights: (N,) summing to 1.
    """
    mean = weights @ velocities
    return mean, variance + weights @ np.square(velocities - mean)
