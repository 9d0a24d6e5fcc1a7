"""Filters over weighted poses: the plain particle filter and the marginalised one.

A filter is represented by the class of its states, registered under its configuration name; states
implement the step and its posterior. Poses of the plain filter follow a random walk (hand paper, section
2).

The marginalised (Rao-Blackwellized) filter samples poses and uses Kalman recursions for velocities. Given a
particle's path of poses, its velocity is Gaussian with a variance P independent of the path. A particle
therefore has a pose and a mean velocity, and all share one P, so velocities add hardly any cost. Hand paper
(49)-(63), corrected; Schoen, Gustafsson and Nordlund 2005. Rotations: velocities live in the tangent space,
x_t = x_{t-1} (+) (dt v + w) **[ours]**.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.filtering.errors import FilterError, Registry, check_time_step
from posetrack_cli.filtering.guided import Guide
from posetrack_cli.filtering.model import (
    FilterModel,
    LogLikelihood,
    StateSpace,
    VelocityGain,
    checked_variance,
    velocity_gain,
)
from posetrack_cli.filtering.resampling import truncated
from posetrack_cli.filtering.step import (
    Posterior,
    Prediction,
    Proposed,
    Weighing,
    choose_ancestors,
    equal_log_weights,
    pose_moments,
    propose,
    scatter,
    velocity_moments,
    weigh,
)


class Prior(NamedTuple):
    """Prior before the first frame: pose N(mean, diag sd^2), velocity N(0, diag velocity_sd^2).

    Attributes:
        mean: (S,) pose.
        sd: (D,) of the pose in the tangent space, u.
        velocity_sd: (D,) of the velocity, u/s; ignored by filters without velocity.
    """

    mean: FloatArray
    sd: FloatArray
    velocity_sd: FloatArray


class Motion(NamedTuple):
    """Expected motion of the particles in one step.

    Attributes:
        drift: (N, D) mean increments.
        variance: (D,) of the increments.
        sampled: (D,) variance used for sampling the increments.
        gain: effect of the step on the velocities; None for filters without velocity.
    """

    drift: FloatArray
    variance: FloatArray
    sampled: FloatArray
    gain: VelocityGain | None = None


class FilterState(ABC):
    """Weighted poses, and further per-particle state of a filter.

    Attributes:
        has_velocity: whether the filter estimates velocities.
        shapes: shapes of the state's arrays by name, for N particles with S numbers and D degrees of
            freedom.
        poses: (N, S).
        log_weights: (N,).
    """

    has_velocity: ClassVar[bool] = False
    shapes: ClassVar[dict[str, tuple[str, ...]]]
    poses: FloatArray
    log_weights: FloatArray

    def __post_init__(self) -> None:
        lengths: dict[str, int] = {}
        for name, stated in self.shapes.items():
            shape = getattr(self, name).shape
            known = tuple(
                lengths.setdefault(axis, length) for axis, length in zip(stated, shape, strict=False)
            )
            if len(shape) != len(stated) or shape != known:
                found = ", ".join(f"{each} {getattr(self, each).shape}" for each in self.shapes)
                raise FilterError("particles do not match", found=found)

    @classmethod
    @abstractmethod
    def initial(cls, prior: Prior, count: int, space: StateSpace, rng: np.random.Generator) -> FilterState:
        """Return ``count`` equally weighted particles drawn from a prior.

        Raises:
            FilterError: count < 1, or a standard deviation is negative or not finite.
        """

    def step(
        self,
        dt: float,
        model: FilterModel,
        log_likelihood: LogLikelihood | None,
        rng: np.random.Generator,
        guide: Guide | None = None,
    ) -> tuple[FilterState, Posterior]:
        """Advance by one frame: sample (52), weight (54), velocity (55)-(61), estimate, resample (7).

        The state is not modified.

        Args:
            dt: time since the previous frame, s.
            model: motion, proposal and resampling.
            log_likelihood: log p(y_t | x) of poses; None without an observation: particles follow the same
                recursion (an exact prediction) and keep their weights, without resampling.
            rng: source of randomness.
            guide: proposal that uses the frame. Weights are then (24), ancestors are drawn before instead
                of after, limits are not enforced, and the estimate uses truncated weights.

        Raises:
            FilterError: dt is not > 0, or the likelihood is NaN, infinite or zero for all particles.
        """
        check_time_step(dt)
        motion = self._motion(dt, model)
        if guide and log_likelihood is not None:
            prediction = Prediction(self.poses, motion.drift, motion.variance, self.log_weights)
            proposed = guide.propose(prediction, model, log_likelihood, rng)
            state, weights = self._moved(motion, proposed), truncated(proposed.weighing.weights)
            return state, state._posterior(model.space, proposed.weighing, resampled=True, weights=weights)
        proposed = self._sampled(motion, model, log_likelihood, rng)
        state, weighing = self._moved(motion, proposed), proposed.weighing
        chosen = None if log_likelihood is None else choose_ancestors(weighing, model.resampling, rng)
        posterior = state._posterior(model.space, weighing, resampled=chosen is not None)
        return state if chosen is None else state._resampled(chosen), posterior

    def summary(self, space: StateSpace) -> Posterior:
        """Return the posterior of the current state, without time step or observation."""
        return self._posterior(space, weigh(self.log_weights, self.poses, None), resampled=False)

    @abstractmethod
    def with_velocity(self, dimension: int) -> MarginalState:
        """Return the state with a velocity (D,), which is 0 and certain if the filter has none."""

    @abstractmethod
    def _motion(self, dt: float, model: FilterModel) -> Motion:
        """Return the expected motion in dt seconds."""

    @abstractmethod
    def _moved(self, motion: Motion, proposed: Proposed) -> FilterState:
        """Return the state with the particles moved from their ancestors as proposed."""

    def _sampled(
        self, motion: Motion, model: FilterModel, score: LogLikelihood | None, rng: np.random.Generator
    ) -> Proposed:
        """Sample every particle's next pose, within the limits."""
        drift = motion.drift if self.has_velocity else None
        constrain = model.dynamics.constrain
        poses, increments = propose(model.space, self.poses, drift, motion.sampled, constrain, rng)
        weighing = weigh(self.log_weights, poses, score)
        return Proposed(poses, increments, np.arange(len(poses)), weighing)

    @abstractmethod
    def _velocity(self, weights: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return mean and variance (D,) of the velocity under weights (N,); None without velocity."""

    def _posterior(
        self, space: StateSpace, weighing: Weighing, *, resampled: bool, weights: FloatArray | None = None
    ) -> Posterior:
        """Return the posterior before resampling, (62)-(63).

        Args:
            space: space of poses.
            weighing: weights of the poses.
            resampled: whether the next state is resampled.
            weights: (N,) for means and variances, if other than those of the weighing.
        """
        moments = weighing.weights if weights is None else weights
        pose, pose_variance = pose_moments(space, self.poses, moments)
        none = np.zeros_like(pose_variance), np.zeros_like(pose_variance)
        velocity, velocity_variance = self._velocity(moments) or none
        best = int(np.argmax(weighing.weights))
        return Posterior(
            pose=pose,
            pose_variance=pose_variance,
            velocity=velocity,
            velocity_variance=velocity_variance,
            effective_sample_size=weighing.effective_sample_size,
            log_evidence=weighing.log_evidence,
            resampled=resampled,
            best=best,
            best_pose=self.poses[best].copy(),
        )

    def _resampled(self, chosen: IntArray) -> FilterState:
        """Return the chosen particles with equal weights."""
        arrays = {name: getattr(self, name) for name in self.shapes}
        of_particles = (name for name, shape in self.shapes.items() if shape[0] == "N")
        arrays |= {name: arrays[name][chosen] for name in of_particles}
        return type(self)(**arrays | {"log_weights": equal_log_weights(len(chosen))})


FILTERS: Registry[type[FilterState]] = Registry("filter")
"""Filters by configuration name."""


@FILTERS.register("pf")
@dataclass(frozen=True, eq=False)
class ParticleState(FilterState):
    """Poses with a random walk, x_t = x_{t-1} (+) w, w ~ N(0, dt Q^n); w_t = w_{t-1} p(y_t | x_t)."""

    shapes: ClassVar[dict[str, tuple[str, ...]]] = {"poses": ("N", "S"), "log_weights": ("N",)}
    poses: FloatArray
    log_weights: FloatArray

    @classmethod
    def initial(cls, prior: Prior, count: int, space: StateSpace, rng: np.random.Generator) -> ParticleState:
        """Return equally weighted poses; see ``FilterState``."""
        return cls(scatter(space, prior.mean, prior.sd, count, rng), equal_log_weights(count))

    def with_velocity(self, dimension: int) -> MarginalState:
        """Return the state with a velocity of exactly 0."""
        still = np.zeros((len(self.poses), dimension))
        return MarginalState(self.poses, still, np.zeros(dimension), self.log_weights)

    def _motion(self, dt: float, model: FilterModel) -> Motion:
        variance = dt * model.dynamics.pose_noise
        return Motion(np.zeros((len(self.poses), variance.size)), variance, variance)

    def _moved(self, motion: Motion, proposed: Proposed) -> ParticleState:
        return ParticleState(proposed.poses, proposed.weighing.log_weights)

    def _velocity(self, weights: FloatArray) -> None:
        return None


@FILTERS.register("rbpf")
@dataclass(frozen=True, eq=False)
class MarginalState(FilterState):
    """Weighted poses, each with a Gaussian velocity N(v_i, diag P).

    Attributes:
        poses: (N, S).
        velocities: (N, D) means v_i, in each pose's tangent space, u/s.
        velocity_variance: (D,) P, the same for all particles, (u/s)^2.
        log_weights: (N,).
    """

    has_velocity: ClassVar[bool] = True
    shapes: ClassVar[dict[str, tuple[str, ...]]] = {
        "poses": ("N", "S"),
        "velocities": ("N", "D"),
        "velocity_variance": ("D",),
        "log_weights": ("N",),
    }
    poses: FloatArray
    velocities: FloatArray
    velocity_variance: FloatArray
    log_weights: FloatArray

    @classmethod
    def initial(cls, prior: Prior, count: int, space: StateSpace, rng: np.random.Generator) -> MarginalState:
        """Return equally weighted poses; P is the prior velocity variance, velocities are not sampled."""
        variance = checked_variance(np.square(prior.velocity_sd), "velocity variance")
        poses = scatter(space, prior.mean, prior.sd, count, rng)
        return cls(poses, np.zeros((count, variance.size)), variance, equal_log_weights(count))

    def with_velocity(self, dimension: int) -> MarginalState:
        """Return the state itself."""
        return self

    def _motion(self, dt: float, model: FilterModel) -> Motion:
        dynamics = model.dynamics
        gain = velocity_gain(self.velocity_variance, dynamics.over(dt), dt, dynamics.gain)
        sampled = dt * dynamics.pose_noise if model.sampling == "paper" else gain.increment_variance
        return Motion(dt * self.velocities, gain.increment_variance, sampled, gain)

    def _moved(self, motion: Motion, proposed: Proposed) -> MarginalState:
        assert motion.gain is not None  # set by `_motion`
        poses, increments, ancestors, weighing = proposed
        unexpected = increments - motion.drift[ancestors]
        velocities = self.velocities[ancestors] + motion.gain.gain * unexpected  # (59)
        return MarginalState(poses, velocities, motion.gain.variance, weighing.log_weights)

    def _velocity(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        return velocity_moments(self.velocities, self.velocity_variance, weights)
