"""The plain particle filter: poses do a random walk, the likelihood weighs them (hand paper, section 2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.errors import FilterError, check_time_step
from posetrack_cli.filtering.laplace import Prediction
from posetrack_cli.filtering.model import Dynamics, LogLikelihood, StateSpace
from posetrack_cli.filtering.posterior import Posterior, summarise
from posetrack_cli.filtering.proposed import Proposer
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.step import (
    choose_ancestors,
    equal_log_weights,
    propose,
    scatter,
    weigh,
)
from posetrack_cli.filtering.weights import truncated


@dataclass(frozen=True, eq=False)
class ParticleState:
    """Weighted poses: (N, S) and the logarithms (N,) of their weights."""

    poses: FloatArray
    log_weights: FloatArray

    def __post_init__(self) -> None:
        if self.poses.ndim != 2 or self.log_weights.shape != self.poses.shape[:1]:
            raise FilterError(
                "particles do not match", found=f"poses {self.poses.shape}, weights {self.log_weights.shape}"
            )


def initialise_particle(
    mean: FloatArray, sd: FloatArray, count: int, space: StateSpace, rng: np.random.Generator
) -> ParticleState:
    """Return `count` equally weighted poses mean (+) N(0, diag sd^2), mean (S,), sd (D,).

    Raises:
        FilterError: count < 1, or an sd is negative or not finite.
    """
    return ParticleState(scatter(space, mean, sd, count, rng), equal_log_weights(count))


def particle_step(
    state: ParticleState,
    dt: float,
    dynamics: Dynamics,
    space: StateSpace,
    log_likelihood: LogLikelihood | None,
    resampling: Resampling,
    rng: np.random.Generator,
    guide: Proposer | None = None,
) -> tuple[ParticleState, Posterior]:
    """Advance the filter by one frame: x_t = x_{t-1} (+) w, w ~ N(0, dt Q^n); w_t = w_{t-1} p(y_t | x_t).

    Args:
        state: after the frame before; left as it is.
        dt: time since then, s.
        dynamics: noise and limits of the motion.
        space: the poses' space.
        log_likelihood: log p(y_t | x) of poses; None when nothing was observed: poses then spread, weights
            stay, and nothing is resampled.
        resampling: scheme and threshold.
        rng: source of randomness.
        guide: a proposal that looks at the frame, `Guide` or `Annealing`; the weights are then (24),
            ancestors chosen before and not after, and no limit constrains.

    Raises:
        FilterError: dt is not > 0, or the likelihood is NaN, infinite or zero for all particles.
    """
    check_time_step(dt)
    variance = dt * dynamics.pose_noise
    if guide and log_likelihood is not None:
        drift = np.zeros((len(state.poses), variance.size))
        prediction = Prediction(state.poses, drift, variance, state.log_weights)
        proposed = guide.propose(prediction, space, log_likelihood, resampling.scheme, rng)
        posterior = summarise(
            space,
            proposed.poses,
            None,
            proposed.weighing,
            resampled=True,
            weights=truncated(proposed.weighing.weights),
        )
        return ParticleState(proposed.poses, proposed.weighing.log_weights), posterior
    poses, _ = propose(space, state.poses, None, variance, dynamics.constrain, rng)
    weighing = weigh(state.log_weights, poses, log_likelihood)
    ancestors = None if log_likelihood is None else choose_ancestors(weighing, resampling, rng)
    posterior = summarise(space, poses, None, weighing, resampled=ancestors is not None)
    if ancestors is None:
        return ParticleState(poses, weighing.log_weights), posterior
    return ParticleState(poses[ancestors], equal_log_weights(len(poses))), posterior
