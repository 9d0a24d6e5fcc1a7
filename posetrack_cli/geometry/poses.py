"""Poses ``camera_T_object`` as position t and quaternion of R: p = R m + t goes from object to camera axes.

Positions and points share a unit, mm in estimates. Leading axes broadcast.
"""

from __future__ import annotations

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rotations import conjugate, rotate


def in_camera(points: FloatArray, position: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Return p = R m + t, (..., 3), of points m (..., 3) in object axes; unit quaternions (..., 4)."""
    return rotate(quaternion, points) + position


def in_object(points: FloatArray, position: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Return m = R^T (p - t), (..., 3), of points p (..., 3) in camera axes."""
    return rotate(conjugate(quaternion), points - position)
