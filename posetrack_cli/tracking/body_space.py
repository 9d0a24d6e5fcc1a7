"""The space of bodies that move and deform: R^3 x SO(3) x R^K, as results count it.

A pose is (position, mm, camera axes; quaternion x y z w of ``camera_T_body``, w >= 0; shape); a tangent
vector (position; rotation vector, rad, in the body's frame; shape). Of a hand the shape is 15 angles.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations

SHAPE = slice(7, None)
"""Of a pose, the entries that say how the body is deformed."""
TANGENT_SHAPE = slice(6, None)
"""The same of a tangent vector."""


class BodySpace:
    """Poses (N, 7 + K) with tangent vectors (N, 6 + K); rotations move in the body's frame."""

    def retract(self, x: FloatArray, delta: FloatArray) -> FloatArray:
        """Return x (+) delta: position and shape add, q becomes q exp(delta), unit and w >= 0."""
        out = np.empty_like(x)
        out[:, :3] = x[:, :3] + delta[:, :3]
        turned = rotations.multiply(x[:, 3:7], rotations.exponential(delta[:, 3:6]))
        out[:, 3:7] = rotations.canonical(turned)
        out[:, SHAPE] = x[:, SHAPE] + delta[:, TANGENT_SHAPE]
        return out

    def local(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return y (-) x (..., 6 + K), the tangent vectors that take x (..., 7 + K) to y."""
        out = np.empty((*np.broadcast_shapes(x.shape[:-1], y.shape[:-1]), x.shape[-1] - 1))
        np.subtract(y[..., :3], x[..., :3], out=out[..., :3])
        between = rotations.multiply(rotations.conjugate(x[..., 3:7]), y[..., 3:7])
        out[..., 3:6] = rotations.logarithm(between)
        np.subtract(y[..., SHAPE], x[..., SHAPE], out=out[..., TANGENT_SHAPE])
        return out

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
