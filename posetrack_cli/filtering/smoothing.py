"""Smoothing of a filtered track by its moments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.filters import FilterState, MarginalState
from posetrack_cli.filtering.model import Dynamics, Gaussian, StateSpace, constant_velocity, kalman_smooth
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.resampling import effective_count, normalise

# Gaussian smoother: each frame's particles are replaced by a Gaussian of pose and velocity.
#
# This is the smoother of Rauch, Tung and Striebel (1965) on the filter's moments, exact for linear-Gaussian
# models as the number of particles grows. Multiple modes are reduced to mean and spread: in ambiguous frames
# the spread is wide, the gain close to 1, and the mean follows the unambiguous frames.
#
# The information from later frames alone, without a state's own prior and likelihood, is the backward half of
# a two-filter smoother (Mayne 1966; Fraser and Potter 1969), in information form:
#
#     log p(y_t+1, .. | x_t (+) e)  =  b . e - e^T L e / 2  + const.
#
# L may be singular: a single later frame has no information on velocities. Its product with the prediction
# from the past equals the Rauch-Tung-Striebel result, but here the prediction from all *other* frames is
# available before the frame's own likelihood, which can then be re-expanded about it.


@dataclass(frozen=True, eq=False)
class StateGaussian:
    """Mean pose (S,) and velocity (D,), and the covariance (2D, 2D) of both in the mean's tangent space."""

    pose: FloatArray
    velocity: FloatArray
    covariance: FloatArray

    @property
    def smoothed(self) -> Smoothed:
        """Means and variances."""
        pose_variance, velocity_variance = np.split(np.diag(self.covariance), 2)
        return Smoothed(self.pose, pose_variance, self.velocity, velocity_variance)


class GaussianSmoother:
    """Backward pass as a ``Smoother`` that stores the moments of each frame.

    Args:
        dynamics: noise of the filter, see ``noise_of``.
        space: space of poses.
    """

    def __init__(self, dynamics: Dynamics, space: StateSpace) -> None:
        self._dynamics, self._space = dynamics, space
        self._later: StateGaussian | None = None

    def remember(self, state: FilterState, step: Step | None = None) -> Memory:
        """Return the moments; see ``Smoother``."""
        weights = normalise(state.log_weights)[0]
        moving = state.with_velocity(self._dynamics.pose_noise.size)
        return vars(state_gaussian(moving, weights, self._space))

    def resume(self, last: Memory) -> None:
        """Do nothing, as earlier frames are not needed; see ``Smoother``."""

    def begin(self, last: Memory) -> Smoothed:
        """Start at a chain's last frame; see ``Smoother``."""
        self._later = StateGaussian(**last)
        return self._later.smoothed

    def back(self, memory: Memory, dt: float) -> Smoothed:
        """Continue with the previous frame; see ``Smoother``."""
        if self._later is None:
            raise FilterError("a backward pass begins with the last frame")
        self._later = smooth_gaussian(StateGaussian(**memory), self._later, dt, self._dynamics, self._space)
        return self._later.smoothed

    def stay(self, memory: Memory, later: Smoothed) -> Smoothed:
        """Return the result of the later frame; see ``Smoother``."""
        return later


def state_gaussian(state: MarginalState, weights: FloatArray, space: StateSpace) -> StateGaussian:
    """Return the moments of particles with weights (N,), with the covariance shrunk (``shrunk``)."""
    pose, velocity = space.mean(state.poses, weights), weights @ state.velocities
    away = np.hstack([space.local(pose, state.poses), state.velocities - velocity])
    covariance = shrunk((weights[:, None] * away).T @ away, effective_count(weights))
    # Law of total variance: the particles share P in addition to the spread of their means.
    own = np.concatenate([np.zeros_like(velocity), state.velocity_variance])
    return StateGaussian(pose, velocity, covariance + np.diag(own))


def shrunk(covariance: FloatArray, count: float) -> FloatArray:
    """Return a sample covariance (2D, 2D) with spurious correlations reduced.

    Correlations r between different components are multiplied by 1 - rho, those of a component with its own
    velocity are kept; rho = sum (1 - r^2)^2 / (count - 1) / sum r^2, at most 1 (Schaefer and Strimmer 2005,
    with the variance of a correlation in a Gaussian sample).

    Args:
        covariance: covariance of a weighted sample.
        count: its effective sample size.
    """
    sd = np.sqrt(np.diag(covariance))
    scale = np.where(sd > 0.0, sd, 1.0)
    others = _between_components(len(covariance))
    squares = np.square(covariance / np.outer(scale, scale))[others]
    by_chance, found = np.square(1.0 - squares).sum(), max(count - 1.0, 0.0) * squares.sum()
    rho = 1.0 if found <= by_chance else by_chance / found
    return np.where(others, (1.0 - rho) * covariance, covariance)


def smooth_gaussian(
    filtered: StateGaussian, later: StateGaussian, dt: float, dynamics: Dynamics, space: StateSpace
) -> StateGaussian:
    """Smooth one frame, in the tangent space of its filtered mean.

    The smoothed covariance is used unchanged in the tangent space of the smoothed mean, which neglects
    terms of the order of the angle between the two.

    Args:
        filtered: filtered belief after the frame.
        later: smoothed belief of the next frame.
        dt: time between the two, s.
        dynamics: dynamics of the filter.
        space: space of poses.

    Raises:
        FilterError: dt is not > 0.
    """
    F, Q = constant_velocity(dynamics.over(dt), dt)
    here = Gaussian(
        np.concatenate([np.zeros_like(filtered.velocity), filtered.velocity]), filtered.covariance
    )
    offset = np.concatenate([space.local(filtered.pose, later.pose), later.velocity])
    smoothed = kalman_smooth(here, Gaussian(offset, later.covariance), F, Q)
    moved, velocity = np.split(smoothed.mean, 2)
    return StateGaussian(space.retract(filtered.pose[None], moved[None])[0], velocity, smoothed.covariance)


def _between_components(size: int) -> BoolArray:
    """Return (2D, 2D): whether a covariance entry relates different components."""
    component = np.arange(size) % (size // 2)
    different: BoolArray = component[:, None] != component
    return different


@dataclass(frozen=True, eq=False)
class BackwardMessage:
    """Quadratic in (pose, velocity), with the pose in the tangent space of a reference.

    Attributes:
        reference: (S,) pose.
        information: (2D, 2D) L, symmetric, positive semi-definite.
        vector: (2D,) b.
    """

    reference: FloatArray
    information: FloatArray
    vector: FloatArray


def no_message(reference: FloatArray, dimension: int) -> BackwardMessage:
    """Return a message without information on a state of D pose components."""
    return BackwardMessage(reference, np.zeros((2 * dimension, 2 * dimension)), np.zeros(2 * dimension))


def recentred(message: BackwardMessage, reference: FloatArray, space: StateSpace) -> BackwardMessage:
    """Return the message in another pose's tangent space.

    The spaces are assumed to differ by a shift, which neglects terms of the order of the angle between
    them.
    """
    shift = np.zeros_like(message.vector)
    shift[: len(shift) // 2] = space.local(message.reference, reference)
    return BackwardMessage(reference, message.information, message.vector - message.information @ shift)


def earlier_message(message: BackwardMessage, dt: float, dynamics: Dynamics) -> BackwardMessage:
    """Return the message to the state dt seconds earlier; unchanged for dt = 0.

    F^T (1 + L Q)^-1 L F and F^T (1 + L Q)^-1 b.
    """
    if dt <= 0.0:
        return message
    F, Q = constant_velocity(dynamics.over(dt), dt)
    L = message.information
    back = np.linalg.solve((np.eye(len(L)) + L @ Q).T, F).T
    information = back @ L @ F
    symmetric = 0.5 * (information + information.T)
    return BackwardMessage(message.reference, symmetric, back @ message.vector)


def with_fit(message: BackwardMessage, modes: LikelihoodModes, k: int, space: StateSpace) -> BackwardMessage:
    """Return the message multiplied by the k-th fit of the likelihood."""
    size, H = modes.gradients.shape[1], modes.information[k]
    away = space.local(message.reference, modes.poses[k])
    information, vector = message.information.copy(), message.vector.copy()
    information[:size, :size] += H
    vector[:size] += modes.gradients[k] + H @ away
    return BackwardMessage(message.reference, information, vector)


def joined(belief: StateGaussian, message: BackwardMessage, space: StateSpace) -> StateGaussian:
    """Return the belief times the message: C' = (1 + C L)^-1 C, mean moved by C' (b - L m).

    m is the belief's mean in the message's tangent space; the covariance is used unchanged in the belief's.
    """
    size, C, L = belief.velocity.size, belief.covariance, message.information
    mean = np.concatenate([space.local(message.reference, belief.pose), belief.velocity])
    joint = np.linalg.solve(np.eye(2 * size) + C @ L, C)
    moved, quicker = np.split(joint @ (message.vector - L @ mean), 2)
    pose = space.retract(belief.pose[None], moved[None])[0]
    return StateGaussian(pose, belief.velocity + quicker, 0.5 * (joint + joint.T))


# Results and interface of smoothers

Memory: TypeAlias = Mapping[str, Any]
"""Data that a smoother stores per frame: arrays and numbers with constant names and shapes."""
NOTHING: Memory = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Estimate of one frame from the whole recording; units as in ``Posterior``.

    Attributes:
        pose: (S,) mean.
        pose_variance: (D,) about it, in the tangent space.
        velocity: (D,) mean; zeros for filters without velocity.
        velocity_variance: (D,).
    """

    pose: FloatArray
    pose_variance: FloatArray
    velocity: FloatArray
    velocity_variance: FloatArray


class Step(NamedTuple):
    """Step of the filter to a frame's state.

    Attributes:
        dt: seconds by which it advanced; 0 if it did not.
        cut: whether the state does not follow from the previous frame's.
        frame: data of the frame itself, for smoothers that refit it; must not reuse the smoother's names.
    """

    dt: float
    cut: bool
    frame: Memory = NOTHING


class Smoother(Protocol):
    """Backward pass: frames are stored in the forward pass and smoothed in the backward pass."""

    def remember(self, state: FilterState, step: Step | None = None) -> Memory:
        """Return the data to store of the filter's state and step after a frame."""
        ...

    def resume(self, last: Memory) -> None:
        """Continue after a frame stored by another smoother, in an interrupted run."""
        ...

    def begin(self, last: Memory) -> Smoothed:
        """Start at a chain's last frame, whose smoothed and filtered estimates are equal."""
        ...

    def back(self, memory: Memory, dt: float) -> Smoothed:
        """Continue with the frame dt seconds (filter time) before the one smoothed last.

        Raises:
            FilterError: dt is not > 0.
        """
        ...

    def stay(self, memory: Memory, later: Smoothed) -> Smoothed:
        """Continue with the previous frame if the filter did not advance: both frames share one state.

        Args:
            memory: data of the previous frame.
            later: result of the frame smoothed last.
        """
        ...


def noise_of(dynamics: Dynamics, moving: bool) -> Dynamics:
    """Return the noise of a filter, without velocity noise if the filter has no velocity."""
    return dynamics if moving else replace(dynamics, velocity_noise=np.zeros_like(dynamics.velocity_noise))
