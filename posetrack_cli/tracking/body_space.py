"""The space of bodies that move and deform: R^3 x SO(3) x R^K, as results count it.

A pose is (position, mm, camera axes; quaternion x y z w of ``camera_T_body``, w >= 0; shape); a tangent
vector (position; rotation vector, rad, in the body's frame; shape). Of a hand the shape is 15 angles.
"""

from __future__ import annotations

import math

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.kernels import (
    quaternion_from_vector,
    quaternion_product,
    vector_from_quaternion,
)


@inlined
def _sign(x: float, y: float, z: float, w: float) -> float:
    """The sign of w, or where w is 0 of the first of x, y, z that is not (``rotations.canonical``)."""
    for value in (w, x, y, z):
        if value != 0.0:
            return math.copysign(1.0, value)
    return 1.0


@kernel
def _retract_each(x: FloatArray, delta: FloatArray, out: FloatArray) -> bool:
    """Write x (+) delta of poses (N, 7 + K) and tangent vectors (N, 6 + K); False if one has no direction."""
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


@kernel
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
    """Poses (N, 7 + K) with tangent vectors (N, 6 + K); rotations move in the body's frame."""

    def retract(self, x: FloatArray, delta: FloatArray) -> FloatArray:
        """Return x (+) delta: position and shape add, q becomes q exp(delta), unit and w >= 0.

        Raises:
            PosetrackError: a rotation is not finite.
        """
        x, delta = (np.array(rows, dtype=np.float64, order="C") for rows in (x, delta))
        out = np.empty_like(x)
        if not _retract_each(x, delta, out):
            raise rotations.without_direction()
        return out

    def local(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return y (-) x (..., 6 + K), the tangent vectors that take x (..., 7 + K) to y."""
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
        """Return log of (sin(a/2) / (a/2))^2 (...), a the angle turned: what exp does to volume."""
        half_turns = np.sqrt(np.einsum("...i,...i->...", delta[..., 3:6], delta[..., 3:6])) / (2.0 * np.pi)
        log_volume: FloatArray = 2.0 * np.log(np.sinc(half_turns))
        return log_volume


def pose_rates(pose: FloatArray, twist: FloatArray) -> FloatArray:
    """Time derivative (7 + K,) of a pose (7 + K,) that moves with a tangent velocity (6 + K,)."""
    rotation = rotations.quaternion_rate(pose[3:7], twist[3:6])
    return np.concatenate([twist[:3], rotation, twist[6:]])
