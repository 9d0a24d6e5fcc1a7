"""The motion model of a filter: its discretisation, Kalman recursions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, TypeAlias, get_args

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import nearest_name
from posetrack_cli.filtering.errors import FilterError, check_time_step
from posetrack_cli.filtering.resampling import Resampling

# Kalman recursions: the exact filter of a linear-Gaussian model, and the marginalised velocity of ours.
#
# State-space model, hand paper (37)-(48), per component of the pose (all matrices are diagonal):
#
#     x <- x + dt v + w^n    pose        v <- v + w^l    velocity
#
# What w^n and w^l are over a step of dt is the *discretisation*:
#
#     euler   independent, variances dt Q^n and dt Q^l: the paper's.
#     exact   **[ours]** dx = v dt + dW^n, dv = dW^l integrated: the velocity also wanders within the step, so
#             var w^n = dt Q^n + dt^3/3 Q^l,  cov(w^n, w^l) = dt^2/2 Q^l,  var w^l = dt Q^l.
#             Two steps of dt then are one of 2 dt, which euler misses by terms of order dt^3 Q^l.
#
# Units: u is the component's unit, mm or rad. Q^n is in u^2/s, Q^l in (u/s)^2/s, P in (u/s)^2, dt in s.


Discretisation: TypeAlias = Literal["exact", "euler"]
DISCRETISATIONS: tuple[str, ...] = get_args(Discretisation)
GainForm: TypeAlias = Literal["corrected", "printed"]
GAIN_FORMS: tuple[str, ...] = get_args(GainForm)

SMALLEST_VARIANCE = float(np.finfo(np.float64).tiny)
"""Increments that vary less count as frozen: quotients of subnormal numbers have no digits left."""


class StepNoise(NamedTuple):
    """Second moments, each (D,), of the noise of one step: var w^n, cov(w^n, w^l), var w^l."""

    pose: FloatArray
    cross: FloatArray
    velocity: FloatArray


@dataclass(frozen=True, eq=False)
class VelocityGain:
    """What one step does to the velocity's Gaussian, the same for all particles.

    Attributes:
        increment_variance: N of (55), (D,), u^2: predictive variance of the pose increment.
        gain: L of (56), (D,), 1/s: how much of an unexpected increment is velocity.
        variance: P of (57) after the step, (D,), (u/s)^2.
    """

    increment_variance: FloatArray
    gain: FloatArray
    variance: FloatArray


@dataclass(frozen=True, eq=False)
class Gaussian:
    """A normal distribution of mean (D,) and covariance (D, D)."""

    mean: FloatArray
    covariance: FloatArray


def step_noise(
    pose_noise: FloatArray, velocity_noise: FloatArray, dt: float, discretisation: str = "exact"
) -> StepNoise:
    """Return the second moments of the noise over a step of dt seconds.

    Args:
        pose_noise: (D,) Q^n, u^2/s.
        velocity_noise: (D,) Q^l, (u/s)^2/s.
        dt: step, s.
        discretisation: ``exact`` **[ours]** or ``euler`` (the paper's); see the module.

    Raises:
        FilterError: dt is not > 0, or the discretisation is not known.
    """
    check_time_step(dt)
    check_discretisation(discretisation)
    if discretisation == "euler":
        return StepNoise(dt * pose_noise, np.zeros_like(velocity_noise), dt * velocity_noise)
    wander = dt**3 / 3.0 * velocity_noise
    return StepNoise(dt * pose_noise + wander, dt**2 / 2.0 * velocity_noise, dt * velocity_noise)


def velocity_gain(
    variance: FloatArray, noise: StepNoise, dt: float, form: GainForm = "corrected"
) -> VelocityGain:
    """Return (55)-(57) for diagonal matrices.

    With (A, B, C) = var w^n, cov(w^n, w^l), var w^l:

        N = dt^2 P + A                                     (55)
        L = (dt P + B) / N                                 (56)  **[fix]** printed: P / N, without dt
        P' = P + C - L^2 N                                 (57)
           = P (A + dt^2 C - 2 dt B) / N + C A / N - B^2 / N

    Written in the last form P' cannot turn negative by cancellation: of C A / N at most 3/4 is taken away. A
    component without pose noise and with a velocity known exactly (N = 0) is frozen: L = 0, P' = P + C.
    As printed, L = P / N and P' = P + C - P^2 / N, which is negative unless P is small against Q^n.

    Args:
        variance: (D,) P, the velocity's variance before the step, (u/s)^2.
        noise: of the step.
        dt: its length, s.
        form: of L: ``corrected``, or ``printed``.

    Raises:
        FilterError: the printed form makes a variance negative.
    """
    A, B, C = noise
    N = dt**2 * variance + A
    moves = N >= SMALLEST_VARIANCE
    divisor = np.where(moves, N, 1.0)
    if form == "printed":
        gain = np.where(moves, variance / divisor, 0.0)
        return VelocityGain(N, gain, _not_negative(variance + C - gain * gain * N, dt))
    gain = np.where(moves, (dt * variance + B) / divisor, 0.0)
    after = variance * (A + dt**2 * C - 2.0 * dt * B) / divisor + (C * (A / divisor) - B * (B / divisor))
    return VelocityGain(N, gain, np.where(moves, after, variance + C))


def _not_negative(variance: FloatArray, dt: float) -> FloatArray:
    """The variances, as the printed gain leaves them."""
    if np.any(variance < 0.0):
        raise FilterError(
            "the printed gain P / N makes the velocity's variance negative",
            found=f"{variance.min():.3g} after a step of {dt:.3g} s",
            expected="motion.velocity and init.velocity that are small against motion.pose",
            hint="--set filter.gain=corrected",
        )
    return variance


def constant_velocity(noise: StepNoise, dt: float) -> tuple[FloatArray, FloatArray]:
    """Return transition F and noise Q, each (2D, 2D), of the joint state (pose, velocity) over dt seconds.

    F = [[1, dt], [0, 1]], Q = [[A, B], [B, C]] in D x D blocks, of the noise of such a step.
    """
    identity = np.eye(noise.pose.size)
    F = np.block([[identity, dt * identity], [np.zeros_like(identity), identity]])
    pose, cross, velocity = (np.diag(part) for part in noise)
    return F, np.block([[pose, cross], [cross, velocity]])


def kalman_predict(belief: Gaussian, transition: FloatArray, noise: FloatArray) -> Gaussian:
    """Return N(F m, F C F^T + Q), the belief after x <- F x + w, w ~ N(0, Q) (Kalman 1960)."""
    covariance = transition @ belief.covariance @ transition.T + noise
    return Gaussian(transition @ belief.mean, covariance)


def kalman_smooth(filtered: Gaussian, later: Gaussian, transition: FloatArray, noise: FloatArray) -> Gaussian:
    """Return the belief of a step given all observations, also later ones (Rauch, Tung and Striebel 1965).

    G = C F^T (F C F^T + Q)^-1;  m + G (m_later - F m),  C + G (C_later - F C F^T - Q) G^T.

    Args:
        filtered: the filter's belief after the step's own observation.
        later: the smoothed belief of the next step.
        transition: F, from this step to the next.
        noise: Q.
    """
    predicted = kalman_predict(filtered, transition, noise)
    frozen = np.diag(np.diag(predicted.covariance) <= 0.0)  # what never varies has no covariance, and no gain
    gain = np.linalg.solve(predicted.covariance + frozen, transition @ filtered.covariance).T
    covariance = filtered.covariance + gain @ (later.covariance - predicted.covariance) @ gain.T
    return Gaussian(filtered.mean + gain @ (later.mean - predicted.mean), covariance)


def check_discretisation(discretisation: str) -> None:
    """Raise FilterError unless the discretisation is known."""
    if discretisation not in DISCRETISATIONS:
        hint = nearest_name(discretisation, DISCRETISATIONS)
        raise FilterError("no such discretisation", found=discretisation, hint=hint)


# What a filter is given: the space of poses, how they move, and how well they fit an observation.
#
# Poses are rows of an (N, S) array, in whatever representation suits; small motions are rows of an (N, D)
# array in the tangent space. For the hand S = 22 (with a unit quaternion) and D = 21.


LogLikelihood: TypeAlias = Callable[[FloatArray], FloatArray]
"""log p(y | x) of poses (N, S) -> (N,), up to a constant; -inf for impossible, never NaN."""

Constrain: TypeAlias = Callable[[FloatArray], FloatArray]
"""Poses (N, S) -> (N, S), put back inside their limits."""

Sampling: TypeAlias = Literal["marginal", "paper"]
SAMPLINGS: tuple[str, ...] = get_args(Sampling)


class StateSpace(Protocol):
    """A manifold of poses with its tangent space; the law is retract(x, local(x, y)) = y.

    Methods return new arrays and leave their arguments as they are.
    """

    def retract(self, x: FloatArray, delta: FloatArray) -> FloatArray:
        """Return x (+) delta: poses (N, S) moved by tangent vectors (N, D)."""
        ...

    def local(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return y (-) x: the tangent vectors (..., D) that move poses x (..., S) to y; broadcasts."""
        ...

    def mean(self, x: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the weighted mean pose (S,) of poses (N, S) with weights (N,) that sum to 1."""
        ...

    def log_volume(self, delta: FloatArray) -> FloatArray:
        """Return log |det d(x (+) delta) / d delta| (...), 0 at 0: what retract does to volume."""
        ...


class Euclidean:
    """R^D, where (+) is addition and S = D."""

    def retract(self, x: FloatArray, delta: FloatArray) -> FloatArray:
        """Return x + delta."""
        return x + delta

    def local(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return y - x."""
        return y - x

    def mean(self, x: FloatArray, weights: FloatArray) -> FloatArray:
        """Return sum_i w_i x_i."""
        return weights @ x

    def log_volume(self, delta: FloatArray) -> FloatArray:
        """Return zeros (...)."""
        return np.zeros(delta.shape[:-1])


@dataclass(frozen=True, eq=False)
class Dynamics:
    """How poses and velocities wander between two observations; hand paper (37)-(48).

    Attributes:
        pose_noise: (D,) diagonal of Q^n, u^2/s, u the component's unit (mm or rad).
        velocity_noise: (D,) diagonal of Q^l, (u/s)^2/s; the plain particle filter does not look at it.
        discretisation: ``exact`` **[ours]** or ``euler``; see `posetrack_cli.filtering.model`.
        constrain: **[ours]** puts sampled poses back inside their limits, or None. The velocity then learns
            from the motion that was left, not from the one that was sampled.
        gain: L of (56), ``corrected`` **[fix]** or ``printed``; see `posetrack_cli.filtering.model`.

    Raises:
        FilterError: a noise is negative or not finite, the shapes differ, or the discretisation or the gain
            is not known.
    """

    pose_noise: FloatArray
    velocity_noise: FloatArray
    discretisation: Discretisation = "exact"
    constrain: Constrain | None = None
    gain: GainForm = "corrected"

    def __post_init__(self) -> None:
        check_discretisation(self.discretisation)
        if self.gain not in GAIN_FORMS:
            raise FilterError("no such gain", found=self.gain, hint=nearest_name(self.gain, GAIN_FORMS))
        for name in ("pose_noise", "velocity_noise"):
            object.__setattr__(self, name, checked_variance(getattr(self, name), name))
        if self.pose_noise.shape != self.velocity_noise.shape:
            raise FilterError(
                "noises do not match", found=f"{self.pose_noise.shape} and {self.velocity_noise.shape}"
            )

    def over(self, dt: float) -> StepNoise:
        """Return the noise of a step of dt seconds; FilterError unless dt is > 0."""
        return step_noise(self.pose_noise, self.velocity_noise, dt, self.discretisation)


@dataclass(frozen=True, eq=False)
class FilterModel:
    """What stays the same from step to step.

    Attributes:
        dynamics: noise and limits of the motion.
        space: the poses' space.
        resampling: scheme and threshold.
        sampling: how a filter with a velocity samples increments where no proposal looks at the frame:
            ``marginal`` **[fix]**, with the variance N of (55), or ``paper``, dt Q^n as printed in (51). Both
            take the weights (54), which are right for ``marginal`` only.

    Raises:
        FilterError: the sampling is not known.
    """

    dynamics: Dynamics
    space: StateSpace
    resampling: Resampling
    sampling: Sampling = "marginal"

    def __post_init__(self) -> None:
        if self.sampling not in SAMPLINGS:
            hint = nearest_name(self.sampling, SAMPLINGS)
            raise FilterError("no such proposal", found=self.sampling, hint=hint)


def checked_variance(values: FloatArray, name: str) -> FloatArray:
    """Return a read-only float64 copy of variances (D,); FilterError unless all are finite and >= 0."""
    variance = np.array(values, dtype=np.float64)
    if variance.ndim != 1 or not np.all(np.isfinite(variance)) or np.any(variance < 0.0):
        raise FilterError(
            f"{name} cannot be used", found=f"{variance.shape} {variance}", expected="(D,), finite, >= 0"
        )
    variance.setflags(write=False)
    return variance
