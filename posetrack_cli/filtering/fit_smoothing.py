"""A smoother over the local fits of the frames rather than over the filter's particles.

The filter says which local fit of each frame is the hand; with that fit's quadratic as the frame's
likelihood and a smooth motion as the prior, the whole recording is a linear-Gaussian model about the fits: a
Kalman filter on the way forward, Rauch, Tung and Striebel's smoother (1965) on the way back. This is one
iteration of the iterated Kalman smoother (Bell 1994). It has no Monte Carlo error, which outweighs all that
the future could tell of a hand that is seen well, and its motion may be smoother than the filter's, which has
to catch what the fits did not foresee.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.gaussian_smoothing import GaussianSmoother, StateGaussian, state_gaussian
from posetrack_cli.filtering.kalman import constant_velocity
from posetrack_cli.filtering.marginal import MarginalState
from posetrack_cli.filtering.model import Dynamics, StateSpace
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.particle import ParticleState
from posetrack_cli.filtering.smoothing import Memory, Smoothed, Step, with_velocity
from posetrack_cli.filtering.weights import normalise, truncated


class FitSmoother:
    """The backward pass as a `Smoother`; it remembers a Kalman filter's belief after each frame.

    Args:
        dynamics: of the smooth motion.
        space: the poses' space.
    """

    def __init__(self, dynamics: Dynamics, space: StateSpace) -> None:
        self._dynamics, self._space = dynamics, space
        self._back = GaussianSmoother(dynamics, space)
        self._belief: StateGaussian | None = None

    def remember(self, state: ParticleState | MarginalState, step: Step | None = None) -> Memory:
        """Return the belief after a frame; a chain begins with the particles' own moments."""
        filtered = self._moments(state)
        if self._belief is None or step is None or step.cut:
            self._belief = filtered
        else:
            belief = predicted(self._belief, step.dt, self._dynamics, self._space)
            if step.modes is not None:
                k = nearest_mode(step.modes, filtered.pose, self._space)
                belief = fitted(belief, step.modes, k, self._space)
            self._belief = belief
        return vars(self._belief)

    def resume(self, last: Memory) -> None:
        """Go on after a frame that was remembered before."""
        self._belief = StateGaussian(**last)

    def begin(self, last: Memory) -> Smoothed:
        """Start from a chain's last frame; see `Smoother`."""
        return self._back.begin(last)

    def back(self, memory: Memory, dt: float) -> Smoothed:
        """Go on to the frame before; see `Smoother`."""
        return self._back.back(memory, dt)

    def _moments(self, state: ParticleState | MarginalState) -> StateGaussian:
        moving = with_velocity(state, self._dynamics.pose_noise.size)
        return state_gaussian(moving, truncated(normalise(state.log_weights)[0]), self._space)


def nearest_mode(modes: LikelihoodModes, pose: FloatArray, space: StateSpace) -> int:
    """Return which fit a pose (S,) belongs to: that of the least e^T information e, e = pose (-) fit."""
    away = space.local(modes.poses, np.broadcast_to(pose, modes.poses.shape))
    return int(np.argmin(np.einsum("ki,kij,kj->k", away, modes.information, away)))


def predicted(belief: StateGaussian, dt: float, dynamics: Dynamics, space: StateSpace) -> StateGaussian:
    """Return the belief dt seconds later; at dt = 0 as it is."""
    if dt <= 0.0:
        return belief
    F, Q = constant_velocity(dynamics.pose_noise, dynamics.velocity_noise, dt, dynamics.discretisation)
    pose = space.retract(belief.pose[None], dt * belief.velocity[None])[0]
    return StateGaussian(pose, belief.velocity, F @ belief.covariance @ F.T + Q)


def fitted(belief: StateGaussian, modes: LikelihoodModes, k: int, space: StateSpace) -> StateGaussian:
    """Return the belief times the k-th fit of the likelihood.

    In the tangent space of the belief's pose, with d the fit's pose in it, the fit's gradient is
    g + H d. With C the covariance and C_p its first D columns, the belief moves by
    C_p (1 + H C_pp)^-1 (g + H d), and its covariance falls by C_p (1 + H C_pp)^-1 H C_p^T: H may be singular.
    """
    size, C, H = belief.velocity.size, belief.covariance, modes.information[k]
    away = space.local(belief.pose[None], modes.poses[k][None])[0]
    gain = C[:, :size] @ np.linalg.inv(np.eye(size) + H @ C[:size, :size])
    moved, quicker = np.split(gain @ (modes.gradients[k] + H @ away), 2)
    covariance = C - gain @ H @ C[:size]
    pose = space.retract(belief.pose[None], moved[None])[0]
    return StateGaussian(pose, belief.velocity + quicker, 0.5 * (covariance + covariance.T))
