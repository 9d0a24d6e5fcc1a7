"""Velocities in results, estimated from poses."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import borrowing, inlined
from posetrack_cli.filtering.model import step_noise
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.kernels import quaternion_from_vector, quaternion_product, vector_from_quaternion
from posetrack_cli.results.columns import LayoutError
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.loop import Step, VelocityBelief
from posetrack_cli.units import NS_PER_S

# The space of poses of a deforming body, R^3 x SO(3) x R^K.
#
# A pose is (position, mm, camera axes; quaternion x y z w of ``camera_T_body``, w >= 0; shape), a tangent
# vector (position; rotation vector, rad, body frame; shape). The shape of a hand is its 15 angles.


@inlined
def _sign(x: float, y: float, z: float, w: float) -> float:
    """Return the sign of w or, if it is 0, of the first non-zero of x, y, z (``rotations.canonical``)."""
    for value in (w, x, y, z):
        if value != 0.0:
            return math.copysign(1.0, value)
    return 1.0


@borrowing
def _retract_each(x: FloatArray, delta: FloatArray, out: FloatArray) -> bool:
    """Write x (+) delta of poses (N, 7 + K) and tangent vectors (N, 6 + K); False on invalid rotations."""
    for n in range(len(x)):
        for i in range(3):
            out[n, i] = x[n, i] + delta[n, i]
        ex, ey, ez, ew = quaternion_from_vector(delta[n, 3], delta[n, 4], delta[n, 5])
        qx, qy, qz, qw = quaternion_product(x[n, 3], x[n, 4], x[n, 5], x[n, 6], ex, ey, ez, ew)
        length = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
        if not 0.0 < length < math.inf:
            return False
        share = _sign(qx, qy, qz, qw) / length
        out[n, 3], out[n, 4], out[n, 5], out[n, 6] = share * qx, share * qy, share * qz, share * qw
        for i in range(7, x.shape[1]):
            out[n, i] = x[n, i] + delta[n, i - 1]
    return True


@borrowing
def _subtract_each(x: FloatArray, y: FloatArray, out: FloatArray) -> None:
    """Write y (-) x, tangent vectors (N, 6 + K), of poses (N, 7 + K)."""
    for n in range(len(x)):
        for i in range(3):
            out[n, i] = y[n, i] - x[n, i]
        qx, qy, qz, qw = quaternion_product(
            -x[n, 3], -x[n, 4], -x[n, 5], x[n, 6], y[n, 3], y[n, 4], y[n, 5], y[n, 6]
        )
        sign = _sign(qx, qy, qz, qw)
        rx, ry, rz = vector_from_quaternion(sign * qx, sign * qy, sign * qz, abs(qw))
        out[n, 3], out[n, 4], out[n, 5] = rx, ry, rz
        for i in range(7, x.shape[1]):
            out[n, i - 1] = y[n, i] - x[n, i]


class BodySpace:
    """Poses (N, 7 + K) with tangent vectors (N, 6 + K); rotation vectors are in the body frame."""

    def retract(self, x: FloatArray, delta: FloatArray) -> FloatArray:
        """Return x (+) delta: position and shape add, q becomes q exp(delta), unit and w >= 0.

        Raises:
            PosetrackError: a rotation is not finite.
        """
        x, delta = (np.array(rows, dtype=np.float64, order="C") for rows in (x, delta))
        out = np.empty_like(x)
        if not _retract_each(x, delta, out):
            raise rotations.invalid_quaternion()
        return out

    def local(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return y (-) x (..., 6 + K), the tangent vectors from x (..., 7 + K) to y."""
        shape, size = np.broadcast_shapes(x.shape, y.shape)[:-1], x.shape[-1]
        first, second = (
            np.array(np.broadcast_to(poses, (*shape, size)), dtype=np.float64, order="C").reshape(-1, size)
            for poses in (x, y)
        )
        out = np.empty((len(first), size - 1))
        _subtract_each(first, second, out)
        return out.reshape(*shape, size - 1)

    def mean(self, x: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the weighted mean (7 + K,); rotations by Markley et al. 2007."""
        out = weights @ x
        out[3:7] = rotations.mean_quaternion(x[:, 3:7], weights)
        return out

    def log_volume(self, delta: FloatArray) -> FloatArray:
        """Return log of (sin(a/2) / (a/2))^2 (...) for rotation angles a: the volume factor of exp."""
        half_turns = np.sqrt(np.einsum("...i,...i->...", delta[..., 3:6], delta[..., 3:6])) / (2.0 * np.pi)
        log_volume: FloatArray = 2.0 * np.log(np.sinc(half_turns))
        return log_volume


def pose_rates(pose: FloatArray, twist: FloatArray) -> FloatArray:
    """Return the time derivative (7 + K,) of a pose (7 + K,) given its tangent velocity (6 + K,)."""
    rotation = rotations.quaternion_rate(pose[3:7], twist[3:6])
    return np.concatenate([twist[:3], rotation, twist[6:]])


# The velocity of a tracked body, estimated from its poses with a lag of one frame.
#
# The difference of two poses is the velocity half a frame earlier, and a filter's velocity lags further. The
# next frame's pose removes this lag: an estimate is written after the next frame is tracked, with its
# velocity given both. Everything else in the estimate stays as the tracker computed it.
#
# Each entry of the tangent vector has its own filter, with white acceleration of density q^2 and pose errors
# of standard deviation r (Kalman 1960; F and noise as in ``filtering.model``, exact, without pose noise)::
#
#     pose' = pose + dt v + w^n,    v' = v + w^l;    the tracked pose is pose + e,  e ~ N(0, r^2)
#
# The velocity of frame t given frame t + 1 follows by one step of Rauch, Tung and Striebel (1965). With the
# predicted mean m' and covariance P', and G = P F^T P'^-1::
#
#     m_t + G (m_t+1 - m'),    P_t + G (P_t+1 - P') G^T
#
# Bodies alternate between rest and fast motion, and some poses are wrong, so both noises are known only up to
# a common factor. With an inverse gamma prior on the factor (Roth, Özkan and Gustafsson 2013), variances are
# multiplied by (nu + d_t^2 + d_t+1^2) / (nu + 2), where d are the normalised innovations.
#
# Smoothed tracks use the same estimator on their poses, in the order in which the smoother yields the frames.

FREEDOM = 2.0
"""nu: the prior densities have the weight of two innovations. Tuned on data not used in benchmarks."""
LONGEST_S = 10.0
"""Longer gaps start a new chain, as do clock changes."""
_SPACE = BodySpace()


@dataclass(frozen=True, eq=False)
class VelocityModel:
    """Noise of a body's velocity and of its tracked poses.

    The entries are the first D of the tangent vector, in mm and rad; u is an entry's unit.

    Attributes:
        acceleration: (D,) q, square root of the acceleration's density, u/s per square root of a second.
        pose_sd: (D,) r, standard deviation of the tracked poses' errors, u.
        start_sd: (D,) standard deviation of the velocity at the start of a track, u/s.
    """

    acceleration: FloatArray
    pose_sd: FloatArray
    start_sd: FloatArray


class _Later(NamedTuple):
    """Effect of a frame on the previous frame's velocity: additions to mean and variance, and d^2."""

    velocity: FloatArray
    variance: FloatArray
    surprise: FloatArray


class VelocityEstimator:
    """Adds velocities to the estimates of a track, with a lag of one frame.

    A chain of poses ends at a lost frame, which keeps the tracker's velocity if it has one. A new chain
    begins where the track is reinitialised or the clock stops or jumps.

    Args:
        model: velocity model.
        belief: belief after the last estimate before an interruption.
        backward: whether estimates come in reverse order.

    Attributes:
        belief: belief after the latest estimate; None if it was lost.
    """

    def __init__(
        self, model: VelocityModel, belief: VelocityBelief | None = None, *, backward: bool = False
    ) -> None:
        self.belief = belief
        self._model, self._direction = model, -1.0 if backward else 1.0
        self._waiting: Estimate | None = None

    def take(self, estimate: Estimate) -> Estimate | None:
        """Return the previous estimate with its velocity given this one too; None at the first."""
        waiting, before = self._waiting, self.belief
        later = self._advance(estimate)
        self._waiting = estimate
        return None if waiting is None else self._revised(waiting, before, later)

    def last(self) -> Estimate | None:
        """Return the latest estimate with its velocity given the earlier ones; None without any."""
        return None if self._waiting is None else self._revised(self._waiting, self.belief, None)

    def _advance(self, estimate: Estimate) -> _Later | None:
        """Update the belief; return the effect on the previous frame, or None in a new chain."""
        before, model = self.belief, self._model
        if estimate.status is Status.LOST:
            self.belief = None
            return None
        size = len(model.pose_sd)
        pose = np.concatenate([estimate.position, estimate.quaternion, estimate.shape])[: size + 1]
        dt = 0.0 if before is None else self._direction * (estimate.stamp_ns - before.stamp_ns) / NS_PER_S
        if before is None or not 0.0 < dt <= LONGEST_S or self._is_cut(estimate):
            covariance = np.stack([np.square(model.pose_sd), np.zeros(size), np.square(model.start_sd)])
            self.belief = VelocityBelief(estimate.stamp_ns, pose, np.zeros(size), covariance, np.ones(size))
            return None
        expected = _SPACE.retract(before.pose[None], dt * before.velocity[None])[0]
        pp, pv, vv = before.covariance
        noise = step_noise(np.zeros(size), np.square(model.acceleration), dt)
        # P': variance of the pose, covariance, variance of the velocity.
        a = pp + 2.0 * dt * pv + dt**2 * vv + noise.pose
        b = pv + dt * vv + noise.cross
        c = vv + noise.velocity
        error = np.square(model.pose_sd)
        innovation, spread = _SPACE.local(expected, pose), a + error
        gain, surprise = np.stack([a, b]) / spread, np.square(innovation) / spread
        change = gain * innovation
        fall = np.stack([gain[0] * a, gain[0] * b, gain[1] * b])
        moved = _SPACE.retract(expected[None], change[:1])[0]
        after = np.stack([gain[0] * error, gain[1] * error, c - fall[2]])  # a - a^2 / s = a r^2 / s
        self.belief = VelocityBelief(estimate.stamp_ns, moved, before.velocity + change[1], after, surprise)
        # Velocity row of G: (pv + dt vv, vv) P'^-1.
        g = ((pv + dt * vv) * c - vv * b) / (a * c - b**2)
        h = (vv * a - (pv + dt * vv) * b) / (a * c - b**2)
        return _Later(
            g * change[0] + h * change[1],
            -(g**2 * fall[0] + 2.0 * g * h * fall[1] + h**2 * fall[2]),
            surprise,
        )

    def _is_cut(self, estimate: Estimate) -> bool:
        """Return whether the track was reinitialised between the previous estimate and this one."""
        later = estimate if self._direction > 0.0 else self._waiting
        return later is not None and later.status is Status.REINITIALISED

    def _revised(self, estimate: Estimate, belief: VelocityBelief | None, later: _Later | None) -> Estimate:
        """Return the estimate with its velocity, using the next pose if it is in the same chain."""
        if belief is None:
            own = estimate.twist_variance
            if own is None or own.any():
                return estimate
            # A filter without a velocity state reports 0 with variance 0: the velocity is unknown.
            return replace(estimate, twist=None, twist_variance=None, pose_rate=None)
        known, size = len(belief.velocity), len(estimate.shape) + 6
        unknown = np.zeros(known)
        added, fall, surprise = later or _Later(unknown, unknown, np.ones(known))
        twist = np.zeros(size) if estimate.twist is None else estimate.twist.copy()
        variance = np.zeros(size) if estimate.twist_variance is None else estimate.twist_variance.copy()
        twist[:known] = self._direction * (belief.velocity + added)
        factor = (FREEDOM + belief.surprise + surprise) / (FREEDOM + 2.0)
        variance[:known] = (belief.covariance[2] + fall) * factor
        pose = np.concatenate([estimate.position, estimate.quaternion, estimate.shape])
        return replace(estimate, twist=twist, twist_variance=variance, pose_rate=pose_rates(pose, twist))


def check_belief(belief: VelocityBelief | None, model: VelocityModel | None) -> None:
    """Raise LayoutError unless a checkpoint's belief has the dimensions of the model."""
    if belief is None or model is None:
        return
    size = len(model.pose_sd)
    if (len(belief.velocity), len(belief.pose)) != (size, size + 1):
        found = f"{len(belief.velocity)} velocities for a pose of {len(belief.pose)} numbers"
        raise LayoutError(f"{found}, expected {size} for {size + 1}")


def with_velocities(
    steps: Iterable[Step], model: VelocityModel, beliefs: Sequence[VelocityBelief | None] = ()
) -> Iterator[Step]:
    """Yield the steps of a pass with velocities, each after the next frame is tracked.

    Args:
        steps: steps of the pass.
        model: velocity model.
        beliefs: belief about each subject after the last step yielded before an interruption.
    """
    estimators, waiting = [VelocityEstimator(model, belief) for belief in beliefs], None
    for step in steps:
        estimators = estimators or [VelocityEstimator(model) for _ in step.estimates]
        found = [of.take(estimate) for of, estimate in zip(estimators, step.estimates, strict=True)]
        if waiting is not None:
            yield _with_known(waiting, found)
        # All steps share the generator, and tracking the next frame advances it before this step is saved.
        known = tuple(of.belief for of in estimators)
        after = step.after._replace(rng=copy.deepcopy(step.after.rng), velocities=known)
        waiting = step._replace(after=after)
    if waiting is not None:
        yield _with_known(waiting, [of.last() for of in estimators])


def _with_known(step: Step, found: Sequence[Estimate | None]) -> Step:
    known = tuple(estimate for estimate in found if estimate is not None)
    return step._replace(estimates=known)


def smoothed_velocities(
    estimates: Iterable[Estimate], model: VelocityModel | None, *, backward: bool = False
) -> Iterator[Estimate]:
    """Yield the estimates of a smoothed track with velocities; unchanged without a model."""
    if model is None:
        yield from estimates
        return
    estimator = VelocityEstimator(model, backward=backward)
    for estimate in estimates:
        before = estimator.take(estimate)
        if before is not None:
            yield before
    last = estimator.last()
    if last is not None:
        yield last
