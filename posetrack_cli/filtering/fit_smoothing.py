"""Kalman smoother over the local fits of the frames, instead of the filter's particles.

With one fit's quadratic as a frame's likelihood and a smooth motion as prior, the recording is a
linear-Gaussian model about the fits: a Kalman filter forwards, and the message from later frames
(``smoothing.BackwardMessage``) backwards. The forward pass selects and weights each frame's fit under the
prediction from earlier frames, the backward pass again under the prediction from all other frames. The
backward pass may also refit the frame from that prediction: this re-expands the likelihood about a better
pose, as in an iterated Kalman smoother (Bell 1994), and can recover fingers that the filter's fits lost.

The fit with the greatest evidence is selected. If it contradicts the prediction, its information is reduced
as by a Student-t density: errors of fits are mostly small but sometimes far larger than their quadratic,
e.g. when a finger is confused with another.

Compared with smoothing particles this has no Monte Carlo error, which exceeds the gain from later frames
for a well-visible hand. Its motion model may also be smoother than the filter's, which must follow
unforeseen motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.filtering.errors import FilterError, check_time_step
from posetrack_cli.filtering.filters import FilterState
from posetrack_cli.filtering.model import Dynamics, StateSpace, constant_velocity
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.resampling import normalise, truncated
from posetrack_cli.filtering.smoothing import (
    BackwardMessage,
    Memory,
    Smoothed,
    StateGaussian,
    Step,
    earlier_message,
    joined,
    no_message,
    recentred,
    state_gaussian,
    with_fit,
)

BELIEF = ("pose", "velocity", "covariance")
_RIDGE = 1e-9
"""Minimum information, per unit^2: makes singular fits invertible, far below any prior's."""


class FrameFits(Protocol):
    """Local fits of a frame, computed from its stored data."""

    def known(self, frame: Memory) -> LikelihoodModes | None:
        """Return the filter's fits, or None if it had none; deterministic."""
        ...

    def more(self, frame: Memory, known: LikelihoodModes, belief: StateGaussian) -> LikelihoodModes:
        """Return these and further fits, started from the prediction of all other frames."""
        ...


class FitSmoother:
    """Backward pass as a ``Smoother``.

    Stores the frame, and a Kalman filter's prediction of it without the frame's own fits.

    Args:
        dynamics: smooth motion model, or a function returning that of the steps to and from a frame given
            its stored data.
        space: space of poses.
        fits: fits of the frames.
        groups: components that err together, for down-weighting.
        freedom: nu of the Student-t density of a fit's error; None disables down-weighting.
    """

    def __init__(
        self,
        dynamics: Dynamics | Callable[[Memory], Dynamics],
        space: StateSpace,
        fits: FrameFits,
        groups: Sequence[IntArray] = (),
        freedom: float | None = None,
    ) -> None:
        self._dynamics, self._space, self._fits = dynamics, space, fits
        self._step_dynamics: Dynamics | None = None  # of the step to the frame smoothed last
        self._groups, self._freedom = groups, freedom
        self._belief: StateGaussian | None = None
        self._message: BackwardMessage | None = None

    def remember(self, state: FilterState | StateGaussian, step: Step | None = None) -> Memory:
        """Return the prediction of a frame; a chain starts with the particles' moments.

        Trackers without particles pass the Gaussian itself for the chain's first frame.
        """
        if self._belief is None or step is None or step.cut:
            expected, first = self._moments(state), True
        else:
            dynamics = self._dynamics_of(step.frame)
            expected, first = predicted(self._belief, step.dt, dynamics, self._space), False
        frame = {} if step is None else step.frame
        kept = {**vars(expected), "first": int(first), **frame}
        self.resume(kept)
        return kept

    def resume(self, last: Memory) -> None:
        """Continue after a previously stored frame."""
        expected = _belief_of(last)
        modes = None if last["first"] else self._fits.known(last)
        self._belief = expected
        if modes is not None:
            self._belief = fitted(expected, self._chosen(expected, modes), 0, self._space)

    def begin(self, last: Memory) -> Smoothed:
        """Start at a chain's last frame; see ``Smoother``."""
        self._message = no_message(last["pose"], len(last["velocity"]))
        return self._smoothed(last, self._message)

    def back(self, memory: Memory, dt: float) -> Smoothed:
        """Continue with the previous frame; see ``Smoother``."""
        if self._message is None or self._step_dynamics is None:
            raise FilterError("a backward pass begins with the last frame")
        check_time_step(dt)
        earlier = earlier_message(self._message, dt, self._step_dynamics)
        return self._smoothed(memory, recentred(earlier, memory["pose"], self._space))

    def stay(self, memory: Memory, later: Smoothed) -> Smoothed:
        """Include the fits of the frame at which the filter paused; see ``Smoother``."""
        if self._message is None:
            raise FilterError("a backward pass begins with the last frame")
        return self._smoothed(memory, recentred(self._message, memory["pose"], self._space))

    def _smoothed(self, memory: Memory, message: BackwardMessage) -> Smoothed:
        """Combine the information from before and after a frame with its own fits."""
        belief, self._message = joined(_belief_of(memory), message, self._space), message
        self._step_dynamics = self._dynamics_of(memory)
        known = None if memory["first"] else self._fits.known(memory)
        if known is None:
            return belief.smoothed
        fit = self._chosen(belief, self._fits.more(memory, known, belief))
        self._message = with_fit(message, fit, 0, self._space)
        return fitted(belief, fit, 0, self._space).smoothed

    def _chosen(self, belief: StateGaussian, modes: LikelihoodModes) -> LikelihoodModes:
        """Return the best fit, down-weighted where it contradicts the belief."""
        fit = only(modes, likeliest(belief, modes, self._space))
        if self._freedom is None:
            return fit
        return down_weighted(belief, fit, self._groups, self._freedom, self._space)

    def _dynamics_of(self, frame: Memory) -> Dynamics:
        return self._dynamics if isinstance(self._dynamics, Dynamics) else self._dynamics(frame)

    def _moments(self, state: FilterState | StateGaussian) -> StateGaussian:
        if isinstance(state, StateGaussian):
            return state
        moving = state.with_velocity(self._space.local(state.poses[:1], state.poses[:1]).shape[-1])
        return state_gaussian(moving, truncated(normalise(state.log_weights)[0]), self._space)


def predicted(belief: StateGaussian, dt: float, dynamics: Dynamics, space: StateSpace) -> StateGaussian:
    """Return the belief dt seconds later; unchanged for dt = 0."""
    if dt <= 0.0:
        return belief
    F, Q = constant_velocity(dynamics.over(dt), dt)
    pose = space.retract(belief.pose[None], dt * belief.velocity[None])[0]
    return StateGaussian(pose, belief.velocity, F @ belief.covariance @ F.T + Q)


def fitted(belief: StateGaussian, modes: LikelihoodModes, k: int, space: StateSpace) -> StateGaussian:
    """Return the belief multiplied by the k-th fit of the likelihood.

    In the tangent space of the belief's pose, with d the fit's pose in it, the fit's gradient is g + H d.
    With C the covariance and C_p its first D columns, the mean moves by C_p (1 + H C_pp)^-1 (g + H d), and
    the covariance decreases by C_p (1 + H C_pp)^-1 H C_p^T; H may be singular.
    """
    size, C, H = belief.velocity.size, belief.covariance, modes.information[k]
    away = space.local(belief.pose[None], modes.poses[k][None])[0]
    gain = C[:, :size] @ np.linalg.inv(np.eye(size) + H @ C[:size, :size])
    moved, quicker = np.split(gain @ (modes.gradients[k] + H @ away), 2)
    covariance = C - gain @ H @ C[:size]
    pose = space.retract(belief.pose[None], moved[None])[0]
    return StateGaussian(pose, belief.velocity + quicker, 0.5 * (covariance + covariance.T))


def log_evidence(belief: StateGaussian, modes: LikelihoodModes, k: int, space: StateSpace) -> float:
    """Return the log of the integral of the belief's pose times the k-th fit's quadratic.

    With d the fit's pose and b = g + H d the gradient at the belief's mean, C the pose's covariance:
    h - g . d - d^T H d / 2 - log det(1 + C H) / 2 + b^T (1 + C H)^-1 C b / 2.
    """
    size, H, g = belief.velocity.size, modes.information[k], modes.gradients[k]
    C = belief.covariance[:size, :size]
    d = space.local(belief.pose, modes.poses[k])
    b, spread = g + H @ d, np.eye(size) + C @ H
    at_mean = modes.log_heights[k] - g @ d - 0.5 * d @ H @ d
    return float(at_mean + 0.5 * (b @ np.linalg.solve(spread, C @ b) - np.linalg.slogdet(spread)[1]))


def likeliest(belief: StateGaussian, modes: LikelihoodModes, space: StateSpace) -> int:
    """Return the index of the fit with the greatest evidence."""
    if len(modes) == 1:
        return 0
    return int(np.argmax([log_evidence(belief, modes, k, space) for k in range(len(modes))]))


def only(modes: LikelihoodModes, k: int) -> LikelihoodModes:
    """Return the k-th fit alone."""
    k = range(len(modes))[k]
    one = slice(k, k + 1)
    return LikelihoodModes(
        modes.poses[one], modes.gradients[one], modes.information[one], modes.log_heights[one]
    )


def down_weighted(
    belief: StateGaussian,
    modes: LikelihoodModes,
    groups: Sequence[IntArray],
    freedom: float,
    space: StateSpace,
) -> LikelihoodModes:
    """Return a single fit with reduced information on groups of components that contradict the belief.

    Per group of d components, with e its part of (the fit's maximum - the belief's mean) and V that of C +
    H^-1, the weight is w = min(1, (nu + d) / (nu + e^T V^-1 e)), the expected precision of a Student-t
    density with nu degrees of freedom given e. H becomes W^1/2 H W^1/2 with the weights on W's diagonal,
    and the maximum is kept.

    Args:
        belief: belief about the frame, without the fit.
        modes: one fit.
        groups: components that err together.
        freedom: nu.
        space: space of poses.
    """
    size, H = belief.velocity.size, modes.information[0]
    inverse = np.linalg.inv(H + _RIDGE * np.eye(size))
    best = inverse @ modes.gradients[0]
    off = space.local(belief.pose, modes.poses[0]) + best
    spread = belief.covariance[:size, :size] + inverse
    roots = np.ones(size)
    for group in groups:
        chi2 = off[group] @ np.linalg.solve(spread[np.ix_(group, group)], off[group])
        roots[group] = np.sqrt(min(1.0, (freedom + len(group)) / (freedom + chi2)))
    weighted: FloatArray = roots[:, None] * H * roots
    return LikelihoodModes(modes.poses, (weighted @ best)[None], weighted[None], modes.log_heights)


def _belief_of(memory: Memory) -> StateGaussian:
    return StateGaussian(*(memory[name] for name in BELIEF))
