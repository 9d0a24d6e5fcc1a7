"""A mean face laid over response maps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posetrack_cli.head.detection.finders import NO_EYES
from posetrack_cli.head.detection.fit import PRIOR_MEAN, fit_face, projected, relief_of
from posetrack_cli.head.detection.responses import HEIGHT, PIXELS_PER_MM, WIDTH
from posetrack_cli.head.face.points import FEATURES, FITTED

IN_CAMERA = np.diag([1.0, -1.0, -1.0])


def rotation(angles: np.ndarray) -> np.ndarray:
    """Rz Ry Rx by scipy: intrinsic rotations about z, the new y, the new x."""
    return Rotation.from_euler("ZYX", angles).as_matrix() @ IN_CAMERA


def test_projection_is_weak_perspective_with_scipys_rotation() -> None:
    pose = np.array([100.0, 80.0, 0.9, 0.1, -0.3, 0.2, 0.0, 0.0])
    expected = pose[:2] + 0.9 * (FITTED @ rotation(pose[3:6]).T)[:, :2]
    np.testing.assert_allclose(projected(pose[None])[0], expected, atol=1e-9)


def test_the_mouth_moves_up_and_widens_and_nothing_else_does() -> None:
    still = PRIOR_MEAN
    smiling = still + np.array([0, 0, 0, 0, 0, 0, 5.0, 3.0])
    moved = projected(np.stack([still, smiling]))
    difference = (moved[1] - moved[0]) / PIXELS_PER_MM
    np.testing.assert_allclose(difference[4:6], [[-3.0, -5.0], [3.0, -5.0]], atol=1e-9)
    np.testing.assert_allclose(np.delete(difference, [4, 5], axis=0), 0.0, atol=1e-12)


def test_relief_is_how_much_farther_points_are() -> None:
    angles = np.array([0.2, 0.4, -0.1])
    np.testing.assert_allclose(relief_of(angles), (FEATURES @ rotation(angles).T)[:, 2], atol=1e-9)


def maps_of(pose: np.ndarray) -> np.ndarray:
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    places = projected(pose[None])[0]
    squares = [(columns - x) ** 2 + (rows - y) ** 2 for x, y in places]
    return np.exp(-0.5 * np.array(squares) / 2.0**2).astype(np.float32)


@pytest.mark.parametrize(
    "change",
    [
        np.zeros(8),
        np.array([3.0, -4.0, 0.05, 0.15, 0.4, 0.1, 0.0, 0.0]),
        np.array([-3.0, 2.0, -0.05, -0.2, -0.5, -0.1, 4.0, 1.0]),
    ],
)
def test_a_pose_is_recovered_from_the_maps_that_it_makes(change: np.ndarray) -> None:
    truth = PRIOR_MEAN + change
    found = fit_face(maps_of(truth), NO_EYES)
    distances = np.linalg.norm(projected(found[None])[0] - projected(truth[None])[0], axis=1)
    # The last cloud is a tenth of the prior wide, about 1.5 pixels a point; the points' peaks have sd 2.
    assert distances.mean() < 2.0
    assert abs(found[4] - truth[4]) < 0.15


def test_the_eyes_that_a_detector_found_pull_where_the_maps_say_nothing() -> None:
    nothing = np.zeros((len(FITTED), HEIGHT, WIDTH), np.float32)
    eyes = (np.array([[84.0, 80.0]]), np.array([[144.0, 80.0]]))
    pixels = projected(fit_face(nothing, eyes)[None])[0]
    middle = pixels[:4].mean(axis=0)
    without = projected(fit_face(nothing, NO_EYES)[None])[0][:4].mean(axis=0)
    assert np.hypot(*(middle - [114.0, 80.0])) < np.hypot(*(without - [114.0, 80.0]))
