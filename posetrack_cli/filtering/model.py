"""What a filter is given: the space of poses, how they move, and how well they fit an observation.

Poses are rows of an (N, S) array, in whatever representation suits; small motions are rows of an (N, D)
array in the tangent space. For the hand S = 22 (with a unit quaternion) and D = 21.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias, get_args

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import nearest_name
from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.kalman import (
    GAIN_FORMS,
    Discretisation,
    GainForm,
    StepNoise,
    check_discretisation,
    step_noise,
)
from posetrack_cli.filtering.resampling import Resampling

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
        discretisation: ``exact`` **[ours]** or ``euler``; see `posetrack_cli.filtering.kalman`.
        constrain: **[ours]** puts sampled poses back inside their limits, or None. The velocity then learns
            from the motion that was left, not from the one that was sampled.
        gain: L of (56), ``corrected`` **[fix]** or ``printed``; see `posetrack_cli.filtering.kalman`.

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
