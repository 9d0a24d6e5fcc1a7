"""The marginalised (Rao-Blackwellized) particle filter: particles for poses, Kalman for velocities.

Given a particle's whole path of poses its velocity is Gaussian, and the variance P does not depend on the
path. So a particle carries a pose and a mean velocity, and all share one P: velocity costs next to nothing.
Hand paper (49)-(63), corrected; Schoen, Gustafsson and Nordlund 2005. Rotations: velocities live in the
tangent space, x_t = x_{t-1} (+) (dt v + w) **[ours]**.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import nearest_name
from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.kalman import VelocityGain, velocity_gain
from posetrack_cli.filtering.laplace import Prediction
from posetrack_cli.filtering.model import Dynamics, LogLikelihood, StateSpace, checked_variance
from posetrack_cli.filtering.posterior import Posterior, summarise, velocity_moments
from posetrack_cli.filtering.proposed import Proposed, Proposer
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.step import (
    choose_ancestors,
    equal_log_weights,
    propose,
    scatter,
    weigh,
)
from posetrack_cli.filtering.weights import truncated

Proposal: TypeAlias = Literal["marginal", "paper"]
PROPOSALS: tuple[str, ...] = get_args(Proposal)


@dataclass(frozen=True, eq=False)
class MarginalState:
    """Weighted poses, each with a Gaussian velocity N(v_i, diag P).

    Attributes:
        poses: (N, S).
        velocities: (N, D) means v_i, in each pose's tangent space, u/s.
        velocity_variance: (D,) P, the same for all particles, (u/s)^2.
        log_weights: (N,).
    """

    poses: FloatArray
    velocities: FloatArray
    velocity_variance: FloatArray
    log_weights: FloatArray

    def __post_init__(self) -> None:
        count, dimension = len(self.log_weights), self.velocity_variance.size
        if (
            self.poses.ndim != 2
            or len(self.poses) != count
            or self.velocities.shape != (count, dimension)
            or self.velocity_variance.ndim != 1
        ):
            raise FilterError(
                "particles do not match",
                found=f"poses {self.poses.shape}, velocities {self.velocities.shape}, velocity variance "
                f"{self.velocity_variance.shape}, weights {self.log_weights.shape}",
            )


def initialise_marginal(
    mean: FloatArray,
    sd: FloatArray,
    velocity_sd: FloatArray,
    count: int,
    space: StateSpace,
    rng: np.random.Generator,
) -> MarginalState:
    """Return equally weighted poses mean (+) N(0, diag sd^2) with velocities N(0, diag velocity_sd^2).

    Args:
        mean: (S,) pose.
        sd: (D,) standard deviation of the pose in the tangent space, u.
        velocity_sd: (D,) standard deviation of the velocity, u/s; it becomes P, no velocity is sampled.
        count: number of particles.
        space: the poses' space.
        rng: source of randomness.

    Raises:
        FilterError: count < 1, or a standard deviation is negative or not finite.
    """
    variance = checked_variance(np.square(velocity_sd), "velocity variance")
    poses = scatter(space, mean, sd, count, rng)
    return MarginalState(poses, np.zeros((count, variance.size)), variance, equal_log_weights(count))


def marginal_step(
    state: MarginalState,
    dt: float,
    dynamics: Dynamics,
    space: StateSpace,
    log_likelihood: LogLikelihood | None,
    resampling: Resampling,
    rng: np.random.Generator,
    proposal: str = "marginal",
    guide: Proposer | None = None,
) -> tuple[MarginalState, Posterior]:
    """Advance the filter by one frame: sample (52), weigh (54), velocity (55)-(61), estimate, resample (7).

    Args:
        state: after the frame before; left as it is.
        dt: time since then, s.
        dynamics: noise and limits of the motion.
        space: the poses' space.
        log_likelihood: log p(y_t | x) of poses; None when nothing was observed: poses and velocities then
            move on by the same recursion (exactly the prediction), weights stay, nothing is resampled.
        resampling: scheme and threshold.
        rng: source of randomness.
        proposal: ``marginal`` **[fix]**, variance N of (55), or ``paper``, dt Q^n as printed in (51). Both
            with the weights (54), which are right for ``marginal`` only.
        guide: a proposal that looks at the frame, `Guide` or `Annealing`; the weights are then (24),
            ancestors chosen before and not after, no limit constrains, and the prior is that of ``marginal``.

    Raises:
        FilterError: dt is not > 0, the proposal is not known, or the likelihood is NaN, infinite or zero for
            all particles.
    """
    P, velocities = state.velocity_variance, state.velocities
    gain = velocity_gain(P, dynamics.pose_noise, dynamics.velocity_noise, dt, dynamics.discretisation)
    drift = dt * velocities
    variance = _proposal_variance(proposal, gain, dynamics, dt)
    if guide and log_likelihood is not None:
        prediction = Prediction(state.poses, drift, gain.increment_variance, state.log_weights)
        proposed = guide.propose(prediction, space, log_likelihood, resampling.scheme, rng)
        return _guided(proposed, velocities, drift, gain, space)
    poses, increments = propose(space, state.poses, drift, variance, dynamics.constrain, rng)
    weighing = weigh(state.log_weights, poses, log_likelihood)
    velocities = velocities + gain.gain * (increments - drift)  # (59)
    ancestors = None if log_likelihood is None else choose_ancestors(weighing, resampling, rng)
    velocity = velocity_moments(velocities, gain.variance, weighing.weights)
    posterior = summarise(space, poses, velocity, weighing, resampled=ancestors is not None)
    if ancestors is None:
        return MarginalState(poses, velocities, gain.variance, weighing.log_weights), posterior
    log_weights = equal_log_weights(len(poses))
    return MarginalState(poses[ancestors], velocities[ancestors], gain.variance, log_weights), posterior


def _guided(
    proposed: Proposed, velocities: FloatArray, drift: FloatArray, gain: VelocityGain, space: StateSpace
) -> tuple[MarginalState, Posterior]:
    """Move the ancestors' velocities on (59); the estimate is taken with truncated weights."""
    poses, increments, ancestors, weighing = proposed
    velocities = velocities[ancestors] + gain.gain * (increments - drift[ancestors])
    weights = truncated(weighing.weights)
    velocity = velocity_moments(velocities, gain.variance, weights)
    posterior = summarise(space, poses, velocity, weighing, resampled=True, weights=weights)
    return MarginalState(poses, velocities, gain.variance, weighing.log_weights), posterior


def _proposal_variance(proposal: str, gain: VelocityGain, dynamics: Dynamics, dt: float) -> FloatArray:
    """Return the variance (D,) to sample increments with: N **[fix]**, or dt Q^n as printed in (51)."""
    if proposal == "marginal":
        return gain.increment_variance
    if proposal == "paper":
        return dt * dynamics.pose_noise
    raise FilterError("no such proposal", found=proposal, hint=nearest_name(proposal, PROPOSALS))
