"""The marginalised particle smoother: what all frames, also the later ones, say about each.

Backward simulation for mixed linear and nonlinear models (Lindsten, Bunch, Saerkkae, Schoen and Godsill
2016): M trajectories of poses are drawn from the last frame to the first, among the particles that the filter
had. The velocity is never drawn. What a trajectory's later poses say about the velocity v at its first is

    p(x_{t+1}, ..., x_T | x_t, v) proportional to exp(lambda v - Omega v^2 / 2)        per component

in which Omega is the same for all trajectories, as P is for all particles. A trajectory at frame t + 1 comes
from particle i at t with a probability proportional to

    w_i N(z_i; dt v_i, N) exp((lambda v'_i - Omega v'_i^2 / 2) / (1 + Omega P'))

with z_i = x_{t+1} (-) x_i, v'_i = v_i + L (z_i - dt v_i), and N, L, P' of (55)-(57). One frame earlier, with
A, B, C of `StepNoise`, a = 1 - dt B / A, b = B / A and r = 1 / (1 + Omega (C - B^2 / A)),

    Omega <- dt^2 / A + a^2 r Omega            lambda <- dt z / A + a r (lambda - Omega b z)

A frame's estimate is the mean over all pairs of trajectory and particle, not only over those drawn. Joint
limits are not known to the smoother, nor how a particle was proposed: only its weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.filters import FilterState, MarginalState
from posetrack_cli.filtering.kalman import StepNoise, VelocityGain, velocity_gain
from posetrack_cli.filtering.model import Dynamics, StateSpace
from posetrack_cli.filtering.modes import precisions
from posetrack_cli.filtering.resampling import normalise, resample
from posetrack_cli.filtering.smoothing import Memory, Smoothed, Step
from posetrack_cli.filtering.step import pose_moments, velocity_moments

SMALLEST_SHARE = 1e-12
"""Of the increment's variance that is pose noise, at the least: no step tells the velocity exactly."""


@dataclass(frozen=True, eq=False)
class Trajectories:
    """M equally likely continuations of the past, known from one frame to the last.

    Attributes:
        poses: (M, S) at the first of these frames.
        velocity_information: (D,) Omega, and
        velocity_vectors: (M, D) lambda: what the later poses say about the velocity at that frame.
    """

    poses: FloatArray
    velocity_information: FloatArray
    velocity_vectors: FloatArray


class ParticleSmoother:
    """Backward simulation as a `Smoother`; it remembers all particles.

    Args:
        dynamics: the noise that the filter had, see `noise_of`.
        space: the poses' space.
        trajectories: M; each frame costs M times the number of particles.
        rng: source of randomness.
    """

    def __init__(
        self, dynamics: Dynamics, space: StateSpace, trajectories: int, rng: np.random.Generator
    ) -> None:
        self._dynamics, self._space = dynamics, space
        self._count, self._rng = trajectories, rng
        self._later: Trajectories | None = None

    def remember(self, state: FilterState, step: Step | None = None) -> Memory:
        """Return the particles; see `Smoother`."""
        return vars(state.with_velocity(self._dynamics.pose_noise.size))

    def resume(self, last: Memory) -> None:
        """Nothing is needed of what was remembered before; see `Smoother`."""

    def begin(self, last: Memory) -> Smoothed:
        """Draw the trajectories' ends; there smoothed and filtered are the same. See `Smoother`.

        Raises:
            FilterError: less than one trajectory.
        """
        state = MarginalState(**last)
        weights = normalise(state.log_weights)[0]
        poses = state.poses[resample("systematic", weights, self._rng, self._count)]
        nothing = np.zeros((self._count, state.velocity_variance.size))
        velocity = velocity_moments(state.velocities, state.velocity_variance, weights)
        self._later = Trajectories(poses, nothing[0], nothing)
        return Smoothed(*pose_moments(self._space, state.poses, weights), *velocity)

    def back(self, memory: Memory, dt: float) -> Smoothed:
        """Continue the trajectories to the frame before; see `Smoother`.

        Raises:
            FilterError: dt is not > 0, or no particle of the frame can have been before any of the next.
        """
        later = self._later
        if later is None:
            raise FilterError("a backward pass begins with the last frame")
        state, noise = MarginalState(**memory), self._dynamics.over(dt)
        P = state.velocity_variance
        gain = velocity_gain(P, noise, dt)
        increments = self._space.local(state.poses, later.poses[:, None])
        shares = _shares(state, later, increments, dt, gain, self._space)
        information, vectors = _velocity_before(later, increments, dt, noise, gain)
        weights = shares.mean(axis=0)
        variance = P / (1.0 + P * information)
        means = (state.velocities + P * vectors) / (1.0 + P * information)
        pairs = shares.ravel() / len(shares)
        velocity = velocity_moments(means.reshape(pairs.size, -1), variance, pairs)
        smoothed = Smoothed(*pose_moments(self._space, state.poses, weights), *velocity)
        chosen = _choose(shares, self._rng)
        rows = np.arange(len(chosen))
        self._later = Trajectories(state.poses[chosen], information, vectors[rows, chosen])
        return smoothed

    def stay(self, memory: Memory, later: Smoothed) -> Smoothed:
        """Return what came of the later frame; see `Smoother`."""
        return later


def _shares(
    state: MarginalState,
    later: Trajectories,
    increments: FloatArray,
    dt: float,
    gain: VelocityGain,
    space: StateSpace,
) -> FloatArray:
    """Return (M, N): the probability that trajectory j comes from particle i; rows sum to 1."""
    unexpected = increments - dt * state.velocities
    log_shares = state.log_weights - space.log_volume(increments)
    log_shares -= 0.5 * np.square(unexpected) @ precisions(gain.increment_variance, state.poses)
    information = later.velocity_information
    velocities = state.velocities + gain.gain * unexpected
    told = (later.velocity_vectors[:, None] - 0.5 * information * velocities) * velocities
    log_shares += told @ (1.0 / (1.0 + information * gain.variance))
    largest = log_shares.max(axis=1, keepdims=True)
    if not np.all(np.isfinite(largest)):
        raise FilterError("no particle can have been before the next frame's", found="weights zero or NaN")
    shares: FloatArray = np.exp(log_shares - largest)
    shares /= shares.sum(axis=1, keepdims=True)
    return shares


def _velocity_before(
    later: Trajectories, increments: FloatArray, dt: float, noise: StepNoise, gain: VelocityGain
) -> tuple[FloatArray, FloatArray]:
    """Return Omega (D,) and, for each pair, lambda (M, N, D) one frame earlier."""
    A, B, C = noise
    frozen = gain.increment_variance <= 0.0
    A = np.where(frozen, 1.0, np.maximum(A, SMALLEST_SHARE * gain.increment_variance))
    told = np.where(frozen, 0.0, dt / A)
    b = np.where(frozen, 0.0, B / A)
    a = 1.0 - dt * b
    wander = 1.0 / (1.0 + later.velocity_information * (C - b * B))
    information = later.velocity_information * wander
    vectors = (a * wander * later.velocity_vectors)[:, None] + (told - a * b * information) * increments
    return dt * told + a**2 * information, vectors


def _choose(shares: FloatArray, rng: np.random.Generator) -> IntArray:
    """Return for each row of shares (M, N) an index, drawn independently."""
    cumulative = np.cumsum(shares, axis=1)
    queries = rng.random((len(shares), 1)) * cumulative[:, -1:]  # below the last, so that some exceeds it
    chosen: IntArray = np.argmax(cumulative > queries, axis=1).astype(np.int64, copy=False)
    return chosen
