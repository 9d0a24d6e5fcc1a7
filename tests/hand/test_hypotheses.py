"""Poses that are tried on a detected hand: where they lie, where they point, how densely they stand."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.model.anatomy import ANGLE_LIMITS, ANGLES, HandAnatomy, make_anatomy
from posetrack_cli.hand.model.kinematics import joint_positions, mirrored_poses
from posetrack_cli.hand.observe.detection import Detection
from posetrack_cli.hand.search import detected_poses, turned_poses
from posetrack_cli.rendering.port import Window
from support.hand import random_poses

ANATOMIES = {"right": make_anatomy(), "left": make_anatomy("left")}
PALM = np.array([120.0, -80.0, 700.0])
ARM = np.array([0.6, -0.64, 0.48])
each_hand = pytest.mark.parametrize("name", list(ANATOMIES))
HALF_STEP = np.deg2rad(15.0)  # of the turns about the hand's length


def detection(arm: FloatArray | None, palm: FloatArray = PALM) -> Detection:
    wrist = None if arm is None else palm - 50.0 * arm
    return Detection(Window(0, 0, 1, 4, 4), np.ones((4, 4), bool), palm, 30.0, wrist, arm, 100.0, 1.0, 0.0)


def palms(poses: FloatArray, anatomy: HandAnatomy) -> FloatArray:
    """Means of the wrist and the fingers' knuckles (N, 3)."""
    return joint_positions(anatomy, poses)[:, [0, 5, 9, 13, 17]].mean(axis=1)


@each_hand
@pytest.mark.parametrize("arm", [ARM, np.array([0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0]), None])
def test_the_palm_s_middle_lies_under_the_surface_that_was_found(name: str, arm: FloatArray | None) -> None:
    anatomy = ANATOMIES[name]
    poses = detected_poses(detection(arm), anatomy)
    beneath = PALM * (1.0 + 12.0 / np.linalg.norm(PALM))
    np.testing.assert_allclose(palms(poses, anatomy), np.tile(beneath, (len(poses), 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(poses[:, 3:7], axis=1), 1.0)
    assert (poses[:, 6] >= 0.0).all()
    np.testing.assert_array_equal(poses[:, ANGLES], np.clip(poses[:, ANGLES], *ANGLE_LIMITS.T))
    assert len(np.unique(np.round(poses, 9), axis=0)) == len(poses)


@each_hand
@pytest.mark.parametrize("arm", [ARM, np.array([0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0])])
def test_the_hand_goes_on_where_the_arm_ends(name: str, arm: FloatArray) -> None:
    """Within the wrist's tilts of 35 degrees, and straight for a third of them."""
    poses = detected_poses(detection(arm), ANATOMIES[name])
    along = -rotations.matrices_from_quaternions(poses[:, 3:7])[:, :, 1]
    angles = np.rad2deg(np.arccos(np.clip(along @ arm, -1.0, 1.0)))
    np.testing.assert_allclose(angles[angles > 1e-3], 35.0)
    assert np.mean(angles < 1e-3) == pytest.approx(1.0 / 3.0)


@each_hand
def test_any_turn_about_the_arm_is_half_a_step_from_one(name: str) -> None:
    poses = detected_poses(detection(ARM), ANATOMIES[name])
    tilt = rotations.exponential(np.array([np.deg2rad(35.0), 0.0, 0.0]))
    straight = rotations.multiply(poses[0, 3:7], tilt)  # the first is tilted back
    for turn in np.deg2rad(np.arange(0.0, 360.0, 7.0)):
        one = rotations.multiply(straight, rotations.exponential(np.array([0.0, turn, 0.0])))
        apart = 2.0 * np.arccos(np.clip(np.abs(poses[:, 3:7] @ one), 0.0, 1.0))
        assert apart.min() <= HALF_STEP + 1e-6


@each_hand
def test_without_a_forearm_fingers_point_everywhere_in_the_image(name: str) -> None:
    poses = detected_poses(detection(None), ANATOMIES[name])
    along = -rotations.matrices_from_quaternions(poses[:, 3:7])[:, :, 1]
    np.testing.assert_allclose(along[:, 2], 0.0, atol=1e-9)
    ways = np.unique(np.round(np.rad2deg(np.arctan2(along[:, 0], -along[:, 1]))) % 360.0)
    np.testing.assert_array_equal(ways, np.arange(0.0, 360.0, 30.0))


def as_set(poses: FloatArray) -> FloatArray:
    """Rows in an order of their own; a rotation by 180 degrees has two signs."""
    rows = poses.copy()
    flip = np.abs(rows[:, 6]) < 1e-9
    sign = np.sign(np.where(np.abs(rows[:, 3:6]) > 1e-9, rows[:, 3:6], 0.0))
    first = np.array([next((s for s in row if s), 1.0) for row in sign])
    rows[flip, 3:7] *= first[flip, None]
    rows = np.round(rows, 6) + 0.0
    return rows[np.lexsort(rows.T)]


@pytest.mark.parametrize("arm", [ARM, None])
def test_a_left_hand_is_tried_in_the_mirrored_poses(arm: FloatArray | None) -> None:
    mirror = np.array([-1.0, 1.0, 1.0])
    right = detected_poses(detection(arm), ANATOMIES["right"])
    seen = detection(None if arm is None else arm * mirror, PALM * mirror)
    left = detected_poses(seen, ANATOMIES["left"])
    np.testing.assert_allclose(as_set(left), as_set(mirrored_poses(right)), atol=1e-5)


@each_hand
def test_a_lost_pose_is_tried_turned_about_its_length_with_its_own_fingers_and_others(name: str) -> None:
    anatomy = ANATOMIES[name]
    for pose in random_poses(5, 2):
        poses = turned_poses(pose, anatomy)
        expected = np.tile(palms(pose[None], anatomy), (len(poses), 1))
        np.testing.assert_allclose(palms(poses, anatomy), expected, atol=1e-9)
        along = rotations.matrices_from_quaternions(poses[:, 3:7])[:, :, 1]
        own = rotations.matrices_from_quaternions(pose[None, 3:7])[0, :, 1]
        np.testing.assert_allclose(along, np.tile(own, (len(poses), 1)), atol=1e-9)
        same = (poses[:, ANGLES] == pose[ANGLES]).all(axis=1)
        assert same.sum() == 12
        assert np.abs(poses - pose).max(axis=1).min() < 1e-9  # the pose itself is one of them
