"""Rotations: quaternions, rotation vectors, Euler angles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import PosetrackError

# Rotations as unit quaternions, vectorised over leading axes.
#
# Quaternions are stored as ``x y z w``, the scalar **last**, as in ROS, Foxglove and scipy. The canonical
# form has unit length and w >= 0; q and -q are the same rotation. Products are Hamilton products:
# ``matrices_from_quaternions(multiply(p, q)) = matrices_from_quaternions(p) @ matrices_from_quaternions(q)``.
# Rotation vectors are axis times angle, rad. All functions return new float64 arrays and broadcast.
#
# ``scipy.spatial.transform.Rotation`` has the same conventions, and tests compare with it. It is used for few
# rotations (Euler angles, ``hand.model.webxr``). Per-frame work uses these functions, which are plain array
# expressions with results independent of the scipy version. Particles' poses are moved and subtracted by
# kernels (``tracking.velocity``).

IDENTITY = (0.0, 0.0, 0.0, 1.0)

ORTHONORMAL_TOLERANCE = 1e-4
"""Largest |R R^T - I| of a rotation: far above ten float32 products, far below a scale in mm."""

SMALL_HALF_ANGLE = 1e-8
"""Below it, arctan(s / w) / s = 1 / w to the last bit: the next term is s^2 / 3 < 4e-17."""


def canonical(q: FloatArray) -> FloatArray:
    """Return the unit quaternion of the same rotation with w >= 0.

    If w = 0 (half a turn), the first non-zero of x, y, z is made positive.

    Args:
        q: (..., 4) quaternions of any non-zero length.

    Raises:
        PosetrackError: a quaternion is zero, NaN or infinite.
    """
    q = np.asarray(q, dtype=np.float64)
    length = np.sqrt(np.einsum("...i,...i->...", q, q))
    known = (length > 0.0) & (length < np.inf)
    if not (known if q.ndim == 1 else known.all()):
        raise invalid_quaternion()
    unit: FloatArray = q * (_canonical_sign(q) / length)[..., None]
    return unit


def invalid_quaternion() -> PosetrackError:
    """Return the error for a quaternion that is zero, NaN or infinite."""
    return PosetrackError(
        "invalid quaternion", found="length 0, NaN or infinite", expected="a finite length > 0"
    )


def multiply(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the Hamilton product p q: first q, then p, about fixed axes. Shapes (..., 4); any length."""
    p, q = np.asarray(p, dtype=np.float64), np.asarray(q, dtype=np.float64)
    px, py, pz, pw = _components(p)
    qx, qy, qz, qw = _components(q)
    return _joined(
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
        pw * qw - px * qx - py * qy - pz * qz,
    )


def conjugate(q: FloatArray) -> FloatArray:
    """Return (-x, -y, -z, w), the inverse rotation of a unit quaternion. Shape (..., 4)."""
    opposite: FloatArray = np.multiply(q, [-1.0, -1.0, -1.0, 1.0])
    return opposite


def rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """Return the vectors q v q*: v + 2 u x (u x v + w v), with u = (x, y, z).

    Args:
        q: (..., 4) unit quaternions.
        v: (..., 3) vectors, any unit.
    """
    q, v = np.asarray(q, dtype=np.float64), np.asarray(v, dtype=np.float64)
    u, w = q[..., :3], q[..., 3:]
    return v + 2.0 * _cross(u, _cross(u, v) + w * v)


def matrices_from_quaternions(q: FloatArray) -> FloatArray:
    """Return the (..., 3, 3) rotation matrices of unit quaternions (..., 4)."""
    q = np.asarray(q, dtype=np.float64)
    x, y, z, w = _components(q)
    rows = _joined(
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )
    return rows.reshape(*q.shape[:-1], 3, 3)


def quaternions_from_matrices(R: FloatArray) -> FloatArray:
    """Return the canonical quaternions (..., 4) of rotation matrices (..., 3, 3).

    4 q q^T is linear in R; its row with the largest diagonal is normalised (Shepperd 1978), which avoids
    divisions by small numbers at any angle.

    Raises:
        PosetrackError: a matrix is not a rotation: not orthonormal, a reflection, or not finite.
    """
    R = np.asarray(R, dtype=np.float64)
    _check_rotations(R)
    outer = _four_outer_products(R)
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    if R.ndim == 2:
        return canonical(outer[largest])
    rows = np.take_along_axis(outer, largest[..., None, None], axis=-2)
    return canonical(rows[..., 0, :])


def exponential(rotation_vectors: FloatArray) -> FloatArray:
    """Return the canonical quaternions (..., 4) of rotation vectors (..., 3), rad.

    q = (r sin(a/2) / a, cos(a/2)) with a = |r|, any angle.
    """
    r = np.asarray(rotation_vectors, dtype=np.float64)
    half = 0.5 * np.sqrt(np.einsum("...i,...i->...", r, r))
    q = np.empty((*r.shape[:-1], 4))
    q[..., :3] = 0.5 * np.sinc(half / np.pi)[..., None] * r  # sinc is 1 at 0, without a branch
    q[..., 3] = np.cos(half)
    return q * _canonical_sign(q)[..., None]


def logarithm(q: FloatArray) -> FloatArray:
    """Return the rotation vectors (..., 3), rad, of length <= pi: 2 atan2(|u|, |w|) u / |u|, u = (x, y, z).

    q and -q give the same vector. Unlike the arc cosine of w or of the trace, atan2 is accurate near 0 and
    pi.

    Args:
        q: (..., 4) unit quaternions.
    """
    q = np.asarray(q, dtype=np.float64)
    u, w = q[..., :3], np.abs(q[..., 3])
    s = np.sqrt(np.einsum("...i,...i->...", u, u))
    small = s < SMALL_HALF_ANGLE
    if q.ndim == 1:
        factor = 2.0 / w if small else 2.0 * np.arctan2(s, w) / s
    else:
        factor = 2.0 * np.arctan2(s, w) / np.where(small, 1.0, s)
        factor = np.where(small, 2.0 / np.where(small, w, 1.0), factor)
    return (factor * _canonical_sign(q))[..., None] * u


def mean_quaternion(q: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the weighted mean rotation: the dominant eigenvector of sum_i w_i q_i q_i^T.

    Markley, Cheng, Crassidis and Oshman 2007, eqs. (12)-(13). It minimises the weighted sum of squared
    chordal distances and is independent of the signs of the q_i. If the two largest eigenvalues are equal
    (evenly spread rotations), the mean is undefined and an arbitrary eigenvector is returned.

    Args:
        q: (N, 4) unit quaternions.
        weights: (N,) weights >= 0, with any positive sum.

    Returns:
        (4,) canonical quaternion.
    """
    q, weights = np.asarray(q, dtype=np.float64), np.asarray(weights, dtype=np.float64)
    _, vectors = np.linalg.eigh(q.T @ (weights[:, None] * q))
    return canonical(vectors[:, -1])


def angle_between(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the angle (...), rad in [0, pi], of the rotation from p to q, unit quaternions (..., 4)."""
    difference = multiply(conjugate(p), q)
    u = difference[..., :3]
    s = np.sqrt(np.einsum("...i,...i->...", u, u))
    angle: FloatArray = 2.0 * np.arctan2(s, np.abs(difference[..., 3]))
    return angle


def quaternion_rate(q: FloatArray, body_angular_velocity: FloatArray) -> FloatArray:
    """Return the time derivative of q, per second: q' = 1/2 q (omega, 0).

    Args:
        q: (..., 4) unit quaternions.
        body_angular_velocity: (..., 3) angular velocity in the rotating body's axes, rad/s.
    """
    omega = np.asarray(body_angular_velocity, dtype=np.float64)
    pure = np.zeros((*omega.shape[:-1], 4))
    pure[..., :3] = omega
    return 0.5 * multiply(q, pure)


def _canonical_sign(q: FloatArray) -> FloatArray:
    """Return the sign (...) of w or, if it is 0, of the first non-zero of x, y, z."""
    sign = np.sign(q[..., 3])
    if sign if q.ndim == 1 else sign.all():
        return sign
    for component in range(3):
        sign = np.where(sign == 0.0, np.sign(q[..., component]), sign)
    return np.where(sign == 0.0, 1.0, sign)


def _components(q: FloatArray) -> Sequence[Any]:
    """Return the components of (..., n): floats for a single one, which are ten times as fast as arrays."""
    return q.tolist() if q.ndim == 1 else [q[..., i] for i in range(q.shape[-1])]


def _joined(*components: Any) -> FloatArray:
    """Return components, floats or arrays of one shape, as (..., n)."""
    if isinstance(components[0], float):
        return np.array(components)
    joined = np.empty((*components[0].shape, len(components)))
    for i, component in enumerate(components):
        joined[..., i] = component
    return joined


def cross_matrices(v: FloatArray) -> FloatArray:
    """Return [v]_x, (..., 3, 3), of vectors (..., 3): [v]_x u = v x u."""
    matrices = np.zeros((*v.shape, 3))
    matrices[..., 0, 1], matrices[..., 0, 2] = -v[..., 2], v[..., 1]
    matrices[..., 1, 0], matrices[..., 1, 2] = v[..., 2], -v[..., 0]
    matrices[..., 2, 0], matrices[..., 2, 1] = -v[..., 1], v[..., 0]
    return matrices


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross product of (..., 3) vectors; np.cross is several times slower on small arrays."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    product[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    product[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    product[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product


def _four_outer_products(R: FloatArray) -> FloatArray:
    """Return 4 q q^T (..., 4, 4), linear in R (..., 3, 3)."""
    outer = np.empty((*R.shape[:-2], 4, 4))
    transposed = np.swapaxes(R, -1, -2)
    diagonal = np.diagonal(R, axis1=-2, axis2=-1)
    trace = diagonal.sum(axis=-1)
    outer[..., :3, :3] = R + transposed
    for i in range(3):
        outer[..., i, i] = 1.0 + 2.0 * diagonal[..., i] - trace
    skew = R - transposed
    for i, (row, column) in enumerate(((2, 1), (0, 2), (1, 0))):
        outer[..., i, 3] = outer[..., 3, i] = skew[..., row, column]
    outer[..., 3, 3] = 1.0 + trace
    return outer


def _check_rotations(R: FloatArray) -> None:
    """Raise unless every matrix (..., 3, 3) is a rotation to within ORTHONORMAL_TOLERANCE."""
    error = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3))
    if not np.all(error < ORTHONORMAL_TOLERANCE):
        raise PosetrackError(
            "matrix is not a rotation", found=f"|R R^T - I| {np.max(error):.3g}", expected="orthonormal rows"
        )
    if np.any(np.linalg.det(R) < 0.0):
        raise PosetrackError(
            "matrix is not a rotation", found="determinant -1", expected="1", hint="the axes are left-handed"
        )


# Euler angles, in one order for all reports, tables and files.
#
# R = R_y(yaw) R_x(pitch) R_z(roll), intrinsic y-x'-z'': first yaw, then pitch about the rotated x axis, then
# roll about the twice rotated z axis. In camera axes (x right, y down, z forward) roll rotates the image, yaw
# is shaking and pitch nodding of the head. Angles are computed directly from the quaternion (Bernardes and
# Viollet 2022, "Quaternion to Euler angles conversion", PLOS ONE), which stays accurate near gimbal lock.

EULER_ORDER = (
    "R = R_y(yaw) R_x(pitch) R_z(roll), intrinsic y-x'-z'', camera axes (x right, y down, z forward)"
)
"""Definition for headers of files and tables."""

FACING = (1.0, 0.0, 0.0, 0.0)
"""Rotation of a head that looks into the camera: half a turn about x.

Head axes are x to the subject's left, y up, z out of the face.
"""

GIMBAL_LOCK = 1e-9
"""Within this angle, rad, of pitch = +-90 deg only the sum or difference of roll and yaw is defined.

Roll is set to 0 there, which changes the rotation by at most this angle.
"""


def roll_pitch_yaw(q: FloatArray) -> FloatArray:
    """Return roll, pitch, yaw (..., 3), rad, of quaternions (..., 4) of any non-zero length.

    With the half angles a of yaw, b of pitch, c of roll and q = q_y(a) q_x(b) q_z(c)::

        (w + x, y - z) = (cos b + sin b) (cos(a - c), sin(a - c))
        (w - x, y + z) = (cos b - sin b) (cos(a + c), sin(a + c))

    Pitch is in [-pi/2, pi/2], roll and yaw in (-pi, pi]. If pitch is within ``GIMBAL_LOCK`` of +-pi/2, one
    of the two vectors vanishes; roll is then 0. q and -q give the same angles.
    """
    q = np.asarray(q, dtype=np.float64)
    x, y, z, w = (q[..., i] for i in range(4))
    difference, plus = np.arctan2(y - z, w + x), np.hypot(y - z, w + x)
    total, minus = np.arctan2(y + z, w - x), np.hypot(y + z, w - x)
    locked = np.sqrt(0.5) * GIMBAL_LOCK * np.hypot(plus, minus)
    difference = np.where(plus < locked, total, difference)
    total = np.where(minus < locked, difference, total)
    pitch = 2.0 * np.arctan2(plus, minus) - 0.5 * np.pi
    return np.stack([_wrapped(total - difference), pitch, _wrapped(total + difference)], axis=-1)


def quaternion_from_roll_pitch_yaw(angles: FloatArray) -> FloatArray:
    """Return the canonical quaternions (..., 4) of roll, pitch and yaw (..., 3), rad."""
    from scipy.spatial.transform import Rotation  # slow import, half the start-up time of `info`

    angles = np.asarray(angles, dtype=np.float64)
    turned = Rotation.from_euler("YXZ", angles[..., [2, 1, 0]].reshape(-1, 3))
    return canonical(turned.as_quat()).reshape(*angles.shape[:-1], 4)


def head_roll_pitch_yaw(q: FloatArray) -> FloatArray:
    """Return roll, pitch, yaw (..., 3), rad, of heads relative to looking at the camera.

    These are the angles of camera_T_head FACING^-1 in camera axes (x right, y down, z forward): all are 0
    for a head that looks along the camera's axis at the camera. Roll is positive when the head tilts to its
    own left shoulder (clockwise in the image), pitch when the face is lowered, yaw when it turns to its own
    right (the image's left).

    Args:
        q: (..., 4) rotations of ``camera_T_head``.
    """
    return roll_pitch_yaw(multiply(q, conjugate(np.array(FACING))))


def head_quaternion_from_roll_pitch_yaw(angles: FloatArray) -> FloatArray:
    """Return canonical rotations (..., 4) of ``camera_T_head``, the inverse of ``head_roll_pitch_yaw``."""
    return canonical(multiply(quaternion_from_roll_pitch_yaw(angles), np.array(FACING)))


def _wrapped(angle: FloatArray) -> FloatArray:
    """Return angles in (-2 pi, 2 pi] wrapped to (-pi, pi], exact where nothing changes."""
    turns: FloatArray = np.where(angle > np.pi, 2.0 * np.pi, np.where(angle <= -np.pi, -2.0 * np.pi, 0.0))
    return angle - turns
