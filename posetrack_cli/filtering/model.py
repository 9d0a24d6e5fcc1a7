"""Motion model of the filters: discretisation and Kalman recursions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, TypeAlias, get_args

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import nearest_name
from posetrack_cli.filtering.errors import FilterError, check_time_step
from posetrack_cli.filtering.resampling import Resampling

# Kalman recursions, for linear-Gaussian models and for the marginalised velocity.
#
# State-space model, hand paper (37)-(48), per component of the pose (all matrices are diagonal):
#
#     x <- x + dt v + w^n    pose        v <- v + w^l    velocity
#
# The *discretisation* defines w^n and w^l over a step of dt:
#
#     euler   independent, variances dt Q^n and dt Q^l: the paper's.
#     exact   **[ours]** dx = v dt + dW^n, dv = dW^l integrated: the velocity also wanders within the step, so
#             var w^n = dt Q^n + dt^3/3 Q^l,  cov(w^n, w^l) = dt^2/2 Q^l,  var w^l = dt Q^l.
#             Two steps of dt then equal one of 2 dt; euler deviates by terms of order dt^3 Q^l.
#
# Units: u is the component's unit, mm or rad. Q^n is in u^2/s, Q^l in (u/s)^2/s, P in (u/s)^2, dt in s.


Discretisation: TypeAlias = Literal["exact", "euler"]
DISCRETISATIONS: tuple[str, ...] = get_args(Discretisation)
GainForm: TypeAlias = Literal["corrected", "printed"]
GAIN_FORMS: tuple[str, ...] = get_args(GainForm)

SMALLEST_VARIANCE = float(np.finfo(np.float64).tiny)
"""Smaller increment variances count as frozen, as quotients of subnormal numbers lose all digits."""


class StepNoise(NamedTuple):
    """Second moments, each (D,), of the noise of one step: var w^n, cov(w^n, w^l), var w^l."""

    pose: FloatArray
    cross: FloatArray
    velocity: FloatArray


@dataclass(frozen=True, eq=False)
class VelocityGain:
    """Effect of one step on the velocity's Gaussian, equal for all particles.

    Attributes:
        increment_variance: N of (55), (D,), u^2: predictive variance of the pose increment.
        gain: L of (56), (D,), 1/s: gain from an unexpected increment to the velocity.
        variance: P of (57) after the step, (D,), (u/s)^2.
    """

    increment_variance: FloatArray
    gain: FloatArray
    variance: FloatArray


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Normal distribution with mean (D,) and covariance (D, D)."""

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
        FilterError: dt is not > 0, or the discretisation is unknown.
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

    The last form of P' cannot become negative by cancellation, as B^2 / N is at most 3/4 of C A / N. A
    component without pose noise and with an exactly known velocity (N = 0) is frozen: L = 0, P' = P + C.
    The printed form is L = P / N and P' = P + C - P^2 / N, which is negative unless P is small relative to
    Q^n.

    Args:
        variance: (D,) P, the velocity's variance before the step, (u/s)^2.
        noise: noise of the step.
        dt: length of the step, s.
        form: form of L: ``corrected`` or ``printed``.

    Raises:
        FilterError: the printed form gives a negative variance.
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
    if np.any(variance < 0.0):
        raise FilterError(
            "the printed gain P / N makes the velocity's variance negative",
            found=f"{variance.min():.3g} after a step of {dt:.3g} s",
            expected="motion.velocity and init.velocity that are small against motion.pose",
            hint="--set filter.gain=corrected",
        )
    return variance


def constant_velocity(noise: StepNoise, dt: float) -> tuple[FloatArray, FloatArray]:
    """Return transition F and noise Q, each (2D, 2D), of the state (pose, velocity) over dt seconds.

    F = [[1, dt], [0, 1]], Q = [[A, B], [B, C]] in D x D blocks, with (A, B, C) the noise of the step.
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
    """Return the belief given all observations, including later ones (Rauch, Tung and Striebel 1965).

    G = C F^T (F C F^T + Q)^-1;  m + G (m_later - F m),  C + G (C_later - F C F^T - Q) G^T.

    Args:
        filtered: filtered belief of this step.
        later: smoothed belief of the next step.
        transition: F, from this step to the next.
        noise: Q.
    """
    predicted = kalman_predict(filtered, transition, noise)
    frozen = np.diag(np.diag(predicted.covariance) <= 0.0)  # constants: zero gain instead of a singular solve
    gain = np.linalg.solve(predicted.covariance + frozen, transition @ filtered.covariance).T
    covariance = filtered.covariance + gain @ (later.covariance - predicted.covariance) @ gain.T
    return Gaussian(filtered.mean + gain @ (later.mean - predicted.mean), covariance)


def check_discretisation(discretisation: str) -> None:
    """Raise FilterError unless the discretisation is known."""
    if discretisation not in DISCRETISATIONS:
        hint = nearest_name(discretisation, DISCRETISATIONS)
        raise FilterError("unknown discretisation", found=discretisation, hint=hint)


# Inputs of a filter: space of poses, dynamics, likelihood.
#
# Poses are rows of an (N, S) array in any representation; increments are rows of an (N, D) array in the
# tangent space. For the hand S = 22 (with a unit quaternion) and D = 21.

LogLikelihood: TypeAlias = Callable[[FloatArray], FloatArray]
"""log p(y | x) of poses (N, S) -> (N,), up to a constant; -inf for impossible, never NaN."""

Constrain: TypeAlias = Callable[[FloatArray], FloatArray]
"""Poses (N, S) -> (N, S), moved back within their limits."""

Sampling: TypeAlias = Literal["marginal", "paper"]
SAMPLINGS: tuple[str, ...] = get_args(Sampling)


class StateSpace(Protocol):
    """Manifold of poses with its tangent space; retract(x, local(x, y)) = y.

    Methods return new arrays and do not modify their arguments.
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
        """Return log |det d(x (+) delta) / d delta| (...), the volume factor of retract; 0 at 0."""
        ...


class Euclidean:
    """R^D, with addition as (+) and S = D."""

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
    """Process noise of poses and velocities; hand paper (37)-(48).

    Attributes:
        pose_noise: (D,) diagonal of Q^n, u^2/s, u the component's unit (mm or rad).
        velocity_noise: (D,) diagonal of Q^l, (u/s)^2/s; unused by the plain particle filter.
        discretisation: ``exact`` **[ours]** or ``euler``; see ``posetrack_cli.filtering.model``.
        constrain: **[ours]** moves sampled poses back within their limits, or None. The velocity is then
            updated with the constrained motion.
        gain: L of (56), ``corrected`` **[fix]** or ``printed``; see ``posetrack_cli.filtering.model``.

    Raises:
        FilterError: a noise is negative or not finite, the shapes differ, or the discretisation or gain is
            unknown.
    """

    pose_noise: FloatArray
    velocity_noise: FloatArray
    discretisation: Discretisation = "exact"
    constrain: Constrain | None = None
    gain: GainForm = "corrected"

    def __post_init__(self) -> None:
        check_discretisation(self.discretisation)
        if self.gain not in GAIN_FORMS:
            raise FilterError("unknown gain", found=self.gain, hint=nearest_name(self.gain, GAIN_FORMS))
        for name in ("pose_noise", "velocity_noise"):
            object.__setattr__(self, name, checked_variance(getattr(self, name), name))
        if self.pose_noise.shape != self.velocity_noise.shape:
            raise FilterError(
                "noise shapes differ", found=f"{self.pose_noise.shape} and {self.velocity_noise.shape}"
            )

    def over(self, dt: float) -> StepNoise:
        """Return the noise of a step of dt seconds; FilterError unless dt is > 0."""
        return step_noise(self.pose_noise, self.velocity_noise, dt, self.discretisation)


@dataclass(frozen=True, eq=False)
class FilterModel:
    """Configuration of a filter, constant over all steps.

    Attributes:
        dynamics: noise and limits of the motion.
        space: space of poses.
        resampling: scheme and threshold.
        sampling: variance of increments sampled without a guided proposal in filters with velocity:
            ``marginal`` **[fix]** uses N of (55), ``paper`` dt Q^n as printed in (51). Both use the weights
            (54), which are correct only for ``marginal``.

    Raises:
        FilterError: unknown sampling.
    """

    dynamics: Dynamics
    space: StateSpace
    resampling: Resampling
    sampling: Sampling = "marginal"

    def __post_init__(self) -> None:
        if self.sampling not in SAMPLINGS:
            hint = nearest_name(self.sampling, SAMPLINGS)
            raise FilterError("unknown sampling", found=self.sampling, hint=hint)


def checked_variance(values: FloatArray, name: str) -> FloatArray:
    """Return a read-only float64 copy of variances (D,).

    Raises:
        FilterError: some are negative or not finite.
    """
    variance = np.array(values, dtype=np.float64)
    if variance.ndim != 1 or not np.all(np.isfinite(variance)) or np.any(variance < 0.0):
        raise FilterError(
            f"invalid {name}", found=f"{variance.shape} {variance}", expected="(D,), finite, >= 0"
        )
    variance.setflags(write=False)
    return variance
