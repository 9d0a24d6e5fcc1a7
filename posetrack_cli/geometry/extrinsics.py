"""Rigid transforms between cameras: (3, 4) matrices [R | t] that take points p to R p + t, mm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import PosetrackError
from posetrack_cli.geometry.camera import IN_PLACE, Camera

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
