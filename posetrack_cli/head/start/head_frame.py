"""The head's frame from its ten points."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rigid_alignment import rigid_alignment
from posetrack_cli.geometry.rotations import quaternions_from_matrices
from posetrack_cli.head.detection.features import FEATURE_SD, FEATURES
from posetrack_cli.head.face import EYES
from posetrack_cli.head.pose import HeadPose


def head_frame(points: FloatArray) -> tuple[HeadPose, FloatArray]:
    """Return the pose and the shape of a head whose ten points are given.

    The rotation lays an average face on the points (weighted least squares); the origin is the mean of the
    eye corners. So R M_k + t are the points.

    Args:
        points: (K, 3) in the reference camera's axes, mm.

    Returns:
        The pose, and the shape (K, 3) in the head's frame, mm.
    """
    rotation, _ = rigid_alignment(face_size(points) * FEATURES, points, FEATURE_SD**-2)
    origin = points[EYES].mean(axis=0)
    return HeadPose(origin, quaternions_from_matrices(rotation)), (points - origin) @ rotation


def face_size(points: FloatArray) -> float:
    """Return how large a face is, 1 for an average one: the ratio of the weighted spreads of its points."""
    return float(np.sqrt(_spread(points) / _spread(FEATURES)))


def face_deviation(shape: FloatArray) -> float:
    """Return how unlike a face a shape (K, 3) in the head's frame is, whatever its size.

    Root mean square, over coordinates, of the differences from an average face in standard deviations; about
    1 for faces.
    """
    rotation, shift = rigid_alignment(shape / face_size(shape), FEATURES, FEATURE_SD**-2)
    differences = shape / face_size(shape) @ rotation.T + shift - FEATURES
    return float(np.sqrt(np.mean((differences / FEATURE_SD[:, None]) ** 2)))


def _spread(points: FloatArray) -> float:
    weights = FEATURE_SD**-2 / np.sum(FEATURE_SD**-2)
    return float(weights @ np.sum((points - weights @ points) ** 2, axis=1))
