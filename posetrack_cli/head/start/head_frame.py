"""The head's frame from its ten points."""

from __future__ import annotations

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
    rotation, _ = rigid_alignment(FEATURES, points, FEATURE_SD**-2)
    origin = points[EYES].mean(axis=0)
    return HeadPose(origin, quaternions_from_matrices(rotation)), (points - origin) @ rotation
