"""Euler angles of rotations: one order for every report, table and file.

R = R_y(yaw) R_x(pitch) R_z(roll), intrinsic y-x'-z'': first yaw, then pitch about the turned x axis, then
roll about the twice turned z axis. In camera axes (x right, y down, z forward) roll turns the image, yaw
shakes the head and pitch nods. Angles are computed from the quaternion itself, as Bernardes and Viollet 2022
("Quaternion to Euler angles conversion", PLOS ONE) do, so none loses digits near gimbal lock, where
scipy only warns.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rotations import canonical, conjugate, multiply

EULER_ORDER = (
    "R = R_y(yaw) R_x(pitch) R_z(roll), intrinsic y-x'-z'', camera axes (x right, y down, z forward)"
)
"""For the headers of files and tables."""

FACING = (1.0, 0.0, 0.0, 0.0)
"""Rotation of a head that looks into the camera: half a turn about x.

A head's own axes are x to the subject's left, y up, z out of the face.
"""

GIMBAL_LOCK = 1e-9
"""How near to +-90 deg, rad, pitch leaves only the sum or the difference of roll and yaw determined.

Roll is set to 0 there, which turns the rotation by no more than this.
"""


def roll_pitch_yaw(q: FloatArray) -> FloatArray:
    """Return roll, pitch, yaw (..., 3), rad, in this order, of quaternions (..., 4) of any length but zero.

    With the half angles a of yaw, b of pitch, c of roll and q = q_y(a) q_x(b) q_z(c)::

        (w + x, y - z) = (cos b + sin b) (cos(a - c), sin(a - c))
        (w - x, y + z) = (cos b - sin b) (cos(a + c), sin(a + c))

    Pitch lies in [-pi/2, pi/2], roll and yaw in (-pi, pi]. Where pitch is within ``GIMBAL_LOCK`` of +-pi/2,
    one of the two vectors vanishes: roll is 0 then and yaw takes all of the turn. q and -q give the same
    angles.
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
    from scipy.spatial.transform import Rotation  # half of the time that `info` takes to start

    angles = np.asarray(angles, dtype=np.float64)
    turned = Rotation.from_euler("YXZ", angles[..., [2, 1, 0]].reshape(-1, 3))
    return canonical(turned.as_quat()).reshape(*angles.shape[:-1], 4)


def head_roll_pitch_yaw(q: FloatArray) -> FloatArray:
    """Return roll, pitch, yaw (..., 3), rad, of heads: how far each is turned from looking at the camera.

    They are the angles of camera_T_head FACING^-1, in camera axes: all three are 0 for a head that looks
    along the camera's axis at the camera. As axes go (x right, y down, z forward), roll is positive when the
    head tilts to its own left shoulder (clockwise in the image), pitch when the face is lowered, yaw when it
    turns to its own right (the image's left).

    Args:
        q: (..., 4) rotations of ``camera_T_head``.
    """
    return roll_pitch_yaw(multiply(q, conjugate(np.array(FACING))))


def head_quaternion_from_roll_pitch_yaw(angles: FloatArray) -> FloatArray:
    """Return the rotations (..., 4) of ``camera_T_head``, canonical: what ``head_roll_pitch_yaw`` undoes."""
    return canonical(multiply(quaternion_from_roll_pitch_yaw(angles), np.array(FACING)))


def _wrapped(angle: FloatArray) -> FloatArray:
    """Return angles of (-2 pi, 2 pi] as angles of (-pi, pi], without a rounding where nothing changes."""
    turns: FloatArray = np.where(angle > np.pi, 2.0 * np.pi, np.where(angle <= -np.pi, -2.0 * np.pi, 0.0))
    return angle - turns
