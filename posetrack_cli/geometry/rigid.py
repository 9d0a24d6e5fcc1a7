"""Rigid transforms, mm: an object's pose, a camera's place beside another's, one shape laid on another.

A pose ``camera_T_object`` is a position t and the quaternion of R: p = R m + t goes from object to camera
axes; leading axes broadcast. Between cameras it is a matrix (3, 4), [R | t], that takes points p to R p + t.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import PosetrackError
from posetrack_cli.geometry.camera import IN_PLACE, Camera
from posetrack_cli.geometry.rotations import conjugate, rotate


def in_camera(points: FloatArray, position: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Return p = R m + t, (..., 3), of points m (..., 3) in object axes; unit quaternions (..., 4)."""
    return rotate(quaternion, points) + position


def in_object(points: FloatArray, position: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Return m = R^T (p - t), (..., 3), of points p (..., 3) in camera axes."""
    return rotate(conjugate(quaternion), points - position)


ROUNDED = 1e-3
"""A rotation written with three decimals is one; what differs more is none."""


def inverse(transform: FloatArray) -> FloatArray:
    """Return [R^T | -R^T t] of a transform (3, 4)."""
    rotation = transform[:, :3].T
    return np.column_stack([rotation, -rotation @ transform[:, 3]])


def composed(after: FloatArray, before: FloatArray) -> FloatArray:
    """Return the transform (3, 4) that does ``before`` and then ``after``."""
    rotation = after[:, :3] @ before[:, :3]
    return np.column_stack([rotation, after[:, :3] @ before[:, 3] + after[:, 3]])


def rotation_from_rows(values: Sequence[float], where: object) -> FloatArray:
    """Return the rotation matrix (3, 3) nearest to nine numbers, row after row.

    Raises:
        PosetrackError: they are no rotation, by more than rounding to three decimals explains.
    """
    matrix = np.array(values, dtype=float).reshape(3, 3)
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 2.0:
        raise _no_rotation(matrix, where)
    u, _, vt = np.linalg.svd(matrix)
    nearest: FloatArray = u @ vt
    if np.linalg.det(nearest) < 0 or np.abs(nearest - matrix).max() > ROUNDED:
        raise _no_rotation(matrix, where)
    return nearest


def placed(camera: Camera, camera_T_reference: FloatArray) -> Camera:
    """Return the camera at another place."""
    rows = tuple(tuple(float(value) + 0.0 for value in row) for row in camera_T_reference)  # no -0.0
    return replace(camera, camera_T_reference=rows)


def relative_to(reference: Camera, cameras: Sequence[Camera]) -> tuple[Camera, ...]:
    """Return cameras whose transforms are from the axes of ``reference``, whatever they were from."""
    from_reference = inverse(np.array(reference.camera_T_reference))
    return tuple(
        replace(camera, camera_T_reference=IN_PLACE)
        if camera == reference
        else placed(camera, composed(np.array(camera.camera_T_reference), from_reference))
        for camera in cameras
    )


def _no_rotation(matrix: FloatArray, where: object) -> PosetrackError:
    found = ", ".join(f"{value:g}" for value in matrix.ravel())
    return PosetrackError(
        "is no rotation", where=where, found=found, expected="nine numbers, orthonormal rows"
    )


def rigid_alignment(
    source: FloatArray, target: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return R (..., 3, 3) and t (..., 3) that minimise sum_k w_k |R a_k + t - b_k|^2 (Kabsch 1976).

    With both sets about their weighted means, H = sum_k w_k a_k b_k^T = U S V^T and R = V D U^T, with
    D = diag(1, 1, det(V U^T)) so that no mirror image is taken.

    Args:
        source: (..., K, 3) a.
        target: (..., K, 3) b.
        weights: (..., K) w >= 0, not all zero.
    """
    share = weights / weights.sum(axis=-1, keepdims=True)
    from_middle, to_middle = share[..., None, :] @ source, share[..., None, :] @ target
    covariance = _transposed(source - from_middle) @ (share[..., None] * (target - to_middle))
    U, _, Vt = np.linalg.svd(covariance)
    turn = np.broadcast_to(np.eye(3), covariance.shape).copy()
    turn[..., 2, 2] = np.sign(np.linalg.det(_transposed(Vt) @ _transposed(U)))
    R: FloatArray = _transposed(Vt) @ turn @ _transposed(U)
    return R, to_middle[..., 0, :] - (R @ _transposed(from_middle))[..., 0]


def _transposed(matrices: FloatArray) -> FloatArray:
    return np.swapaxes(matrices, -1, -2)
