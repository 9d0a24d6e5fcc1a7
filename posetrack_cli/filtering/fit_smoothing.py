"""A smoother over the local fits of the frames rather than over the filter's particles.

With one fit's quadratic as a frame's likelihood and a smooth motion as the prior, the whole recording is a
linear-Gaussian model about the fits: a Kalman filter on the way forward, the message from the later frames
(`backward_message`) on the way back. Which fit, and how far it is trusted, is decided under the prediction
of the frame from those before it, and again, on the way back, under that from all others. There the frame may
also be fitted anew, from what all others expect: the likelihood is expanded again about a better pose, as in
an iterated Kalman smoother (Bell 1994), and a finger that the filter's fits lost may be found.

It has no Monte Carlo error, which outweighs all that the future could tell of a hand that is seen well, and
its motion may be smoother than the filter's, which has to catch what the fits did not foresee.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from posetrack_cli.arrays import IntArray
from posetrack_cli.filtering.backward_message import BackwardMessage, before, joined, no_message, recentred
from posetrack_cli.filtering.backward_message import with_fit as message_with_fit
from posetrack_cli.filtering.errors import FilterError, check_time_step
from posetrack_cli.filtering.fit_choice import doubted, likeliest, only
from posetrack_cli.filtering.gaussian_smoothing import StateGaussian, state_gaussian
from posetrack_cli.filtering.kalman import constant_velocity
from posetrack_cli.filtering.marginal import MarginalState
from posetrack_cli.filtering.model import Dynamics, StateSpace
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.particle import ParticleState
from posetrack_cli.filtering.smoothing import Memory, Smoothed, Step, with_velocity
from posetrack_cli.filtering.weights import normalise, truncated

BELIEF = ("pose", "velocity", "covariance")


class FrameFits(Protocol):
    """The local fits of a frame, made from what is kept of it."""

    def known(self, frame: Memory) -> LikelihoodModes | None:
        """Return the filter's fits; None where it had none. The same arrays give the same fits."""
        ...

    def more(self, frame: Memory, known: LikelihoodModes, belief: StateGaussian) -> LikelihoodModes:
        """Return these and further ones, from what all other frames say of this one."""
        ...


class FitSmoother:
    """The backward pass as a `Smoother`.

    It remembers what a Kalman filter expects of each frame, without the frame's own fits, and the frame.

    Args:
        dynamics: of the smooth motion.
        space: the poses' space.
        fits: of the frames.
        groups: components that err together, where fits are doubted.
        freedom: nu of the Student-t density of a fit's error; None: fits are not doubted.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        space: StateSpace,
        fits: FrameFits,
        groups: Sequence[IntArray] = (),
        freedom: float | None = None,
    ) -> None:
        self._dynamics, self._space, self._fits = dynamics, space, fits
        self._groups, self._freedom = groups, freedom
        self._belief: StateGaussian | None = None
        self._message: BackwardMessage | None = None

    def remember(self, state: ParticleState | MarginalState, step: Step | None = None) -> Memory:
        """Return what is expected of a frame; a chain begins with the particles' own moments."""
        if self._belief is None or step is None or step.cut:
            expected, first = self._moments(state), True
        else:
            expected, first = predicted(self._belief, step.dt, self._dynamics, self._space), False
        frame = {} if step is None else step.frame
        kept = {**vars(expected), "first": int(first), **frame}
        self.resume(kept)
        return kept

    def resume(self, last: Memory) -> None:
        """Go on after a frame that was remembered before."""
        expected = _belief_of(last)
        modes = None if last["first"] else self._fits.known(last)
        self._belief = expected if modes is None else self._updated(expected, modes)

    def begin(self, last: Memory) -> Smoothed:
        """Start from a chain's last frame; see `Smoother`."""
        self._message = no_message(last["pose"], len(last["velocity"]))
        return self._smoothed(last, self._message)

    def back(self, memory: Memory, dt: float) -> Smoothed:
        """Go on to the frame before; see `Smoother`."""
        if self._message is None:
            raise FilterError("a backward pass begins with the last frame")
        check_time_step(dt)
        earlier = before(self._message, dt, self._dynamics)
        return self._smoothed(memory, recentred(earlier, memory["pose"], self._space))

    def stay(self, memory: Memory, later: Smoothed) -> Smoothed:
        """Take in the fits of the frame at which the filter came to a stand; see `Smoother`."""
        if self._message is None:
            raise FilterError("a backward pass begins with the last frame")
        return self._smoothed(memory, recentred(self._message, memory["pose"], self._space))

    def _smoothed(self, memory: Memory, message: BackwardMessage) -> Smoothed:
        """Join what is known before and after a frame with its own fits."""
        belief, self._message = joined(_belief_of(memory), message, self._space), message
        known = None if memory["first"] else self._fits.known(memory)
        if known is None:
            return belief.smoothed
        fit = self._chosen(belief, self._fits.more(memory, known, belief))
        self._message = message_with_fit(message, fit, 0, self._space)
        return fitted(belief, fit, 0, self._space).smoothed

    def _updated(self, belief: StateGaussian, modes: LikelihoodModes) -> StateGaussian:
        return fitted(belief, self._chosen(belief, modes), 0, self._space)

    def _chosen(self, belief: StateGaussian, modes: LikelihoodModes) -> LikelihoodModes:
        """The fit that explains a frame best, trusted as far as it agrees with the others."""
        fit = only(modes, likeliest(belief, modes, self._space))
        if self._freedom is None:
            return fit
        return doubted(belief, fit, self._groups, self._freedom, self._space)

    def _moments(self, state: ParticleState | MarginalState) -> StateGaussian:
        moving = with_velocity(state, self._dynamics.pose_noise.size)
        return state_gaussian(moving, truncated(normalise(state.log_weights)[0]), self._space)


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


def _belief_of(memory: Memory) -> StateGaussian:
    return StateGaussian(*(memory[name] for name in BELIEF))
