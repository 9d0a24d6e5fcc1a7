from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw, head_roll_pitch_yaw
from posetrack_cli.head.face.points import HeadPose

ROUNDING = 1e-9  # mm and rad: far above double precision's for numbers below 1000, far below any pixel
numbers = st.floats(-1.0, 1.0)


def pose(values: list[float]) -> HeadPose:
    angles = np.array(values[3:])
    return HeadPose(100.0 * np.array(values[:3]), head_quaternion_from_roll_pitch_yaw(angles))


@given(st.lists(numbers, min_size=6, max_size=6), st.lists(numbers, min_size=6, max_size=6))
def test_moving_by_the_difference_leads_there(first: list[float], second: list[float]) -> None:
    a, b = pose(first), pose(second)
    there = a.moved(a.difference(b))
    np.testing.assert_allclose(there.position, b.position, atol=ROUNDING)
    np.testing.assert_allclose(there.rotation, b.rotation, atol=ROUNDING)


def test_small_turns_of_a_face_that_looks_at_the_camera_are_pitch_yaw_and_roll() -> None:
    facing = HeadPose(np.zeros(3), head_quaternion_from_roll_pitch_yaw(np.zeros(3)))
    np.testing.assert_allclose(facing.facing, [0.0, 0.0, -1.0], atol=ROUNDING)
    small = np.array([0.01, 0.02, 0.03])  # products of them are what first order leaves out
    roll, pitch, yaw = head_roll_pitch_yaw(facing.moved(np.concatenate([np.zeros(3), small])).quaternion)
    np.testing.assert_allclose([pitch, yaw, roll], small, atol=0.5 * np.sum(np.square(small)))


def test_points_turn_about_the_heads_origin() -> None:
    head = pose([0.1, 0.2, 0.7, 0.1, -0.2, 0.3])
    moved = head.moved(np.array([0.0, 0.0, 0.0, 0.1, 0.2, 0.3]))
    np.testing.assert_allclose(moved.points(np.zeros(3)), head.position, atol=ROUNDING)
    np.testing.assert_allclose(head.points(np.eye(3)) - head.position, head.rotation.T, atol=ROUNDING)
