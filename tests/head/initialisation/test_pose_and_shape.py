"""The head's frame from its points."""

from __future__ import annotations

import numpy as np

from posetrack_cli.head.face.points import FEATURES
from posetrack_cli.head.initialisation.stereo import pose_and_shape
from support.rig import turned_head


def test_an_average_faces_pose_is_found_exactly() -> None:
    truth = turned_head(0.3, -0.2)
    pose, shape = pose_and_shape(truth.points(FEATURES))
    np.testing.assert_allclose(truth.difference(pose), 0.0, atol=1e-9)
    np.testing.assert_allclose(shape, FEATURES, atol=1e-9)


def test_pose_and_shape_give_the_points_back() -> None:
    points = turned_head().points(FEATURES) + np.random.default_rng(3).normal(0.0, 4.0, FEATURES.shape)
    pose, shape = pose_and_shape(points)
    np.testing.assert_allclose(pose.points(shape), points, atol=1e-9)
    np.testing.assert_allclose(shape[:4].mean(axis=0), 0.0, atol=1e-9)


def test_a_larger_head_has_the_same_pose() -> None:
    truth = turned_head()
    pose, shape = pose_and_shape(truth.points(1.2 * FEATURES))
    np.testing.assert_allclose(truth.difference(pose), 0.0, atol=1e-9)
    np.testing.assert_allclose(shape, 1.2 * FEATURES, atol=1e-9)
