"""Euler angles against scipy's, their laws, and what they mean for a head."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from posetrack_cli.geometry import rotations as rot

ROUNDING = 64 * np.finfo(np.float64).eps
"""A few dozen roundings of numbers of size about 1."""

LOCKED = rot.GIMBAL_LOCK + ROUNDING
"""Setting roll to 0 within GIMBAL_LOCK of gimbal lock turns a rotation by at most that much."""

components = st.floats(-1.0, 1.0, allow_subnormal=False)
quaternions = (
    arrays(np.float64, (5, 4), elements=components)
    .filter(lambda q: bool(np.all(np.linalg.norm(q, axis=1) > 1e-3)))
    .map(rot.canonical)
)
full_turns = st.one_of(st.floats(-np.pi, np.pi), st.sampled_from([0.0, np.pi, -np.pi, np.pi / 2]))
near_lock = st.sampled_from([1e-3, 1e-6, 1e-8, 1e-12, 0.0]).map(lambda d: np.pi / 2 - d)
pitches = st.one_of(st.floats(-np.pi / 2, np.pi / 2), near_lock, near_lock.map(lambda pitch: -pitch))
angles = st.tuples(full_turns, pitches, full_turns).map(np.array)

relaxed = settings(deadline=None)


def scipy_quaternion(roll: float, pitch: float, yaw: float) -> np.ndarray:
    return rot.canonical(Rotation.from_euler("YXZ", [yaw, pitch, roll]).as_quat())


@relaxed
@given(angles)
def test_quaternion_is_scipys(given_angles: np.ndarray) -> None:
    q = rot.quaternion_from_roll_pitch_yaw(given_angles)
    assert rot.angle_between(q, scipy_quaternion(*given_angles)) < ROUNDING


@relaxed
@given(quaternions)
def test_angles_are_scipys_away_from_gimbal_lock(q: np.ndarray) -> None:
    q = q[np.abs(rot.matrices_from_quaternions(q)[:, 1, 2]) < 1.0 - 1e-6]  # scipy warns at gimbal lock
    yaw, pitch, roll = Rotation.from_quat(q).as_euler("YXZ").T
    found = rot.roll_pitch_yaw(q)
    # an angle is determined to one rounding over the cosine of pitch, here above 1e-3; +-pi is one direction
    for ours, theirs in zip(found.T, (roll, pitch, yaw), strict=True):
        turn = np.abs(np.exp(1j * ours) - np.exp(1j * theirs))
        np.testing.assert_array_less(turn, 1e3 * ROUNDING)


@relaxed
@given(st.one_of(quaternions, angles.map(lambda a: scipy_quaternion(*a))))
def test_rotation_comes_back_from_its_angles_also_at_gimbal_lock(q: np.ndarray) -> None:
    back = rot.quaternion_from_roll_pitch_yaw(rot.roll_pitch_yaw(q))
    np.testing.assert_array_less(rot.angle_between(back, q), LOCKED)


@relaxed
@given(angles)
def test_angles_come_back_from_their_rotation(given_angles: np.ndarray) -> None:
    back = rot.roll_pitch_yaw(rot.quaternion_from_roll_pitch_yaw(given_angles))
    cosine = np.cos(given_angles[1])
    assert back[1] == pytest.approx(given_angles[1], abs=ROUNDING)
    if cosine > rot.GIMBAL_LOCK * 10:
        np.testing.assert_array_less(np.abs(np.exp(1j * back) - np.exp(1j * given_angles)), ROUNDING / cosine)


@relaxed
@given(quaternions, st.floats(1e-3, 1e3))
def test_sign_and_length_of_the_quaternion_do_not_matter(q: np.ndarray, scale: float) -> None:
    expected, found = rot.roll_pitch_yaw(q), rot.roll_pitch_yaw(-scale * q)
    cosine = np.cos(expected[..., 1:2])
    determined = cosine[:, 0] > 1e-6
    difference = np.abs(np.exp(1j * found) - np.exp(1j * expected)) * cosine
    np.testing.assert_array_less(difference[determined], ROUNDING)


@relaxed
@given(quaternions)
def test_ranges(q: np.ndarray) -> None:
    roll, pitch, yaw = rot.roll_pitch_yaw(q).T
    assert np.all(np.abs(pitch) <= np.pi / 2)
    for angle in (roll, yaw):
        assert np.all((angle > -np.pi) & (angle <= np.pi))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("roll", "yaw"), [(0.3, 0.5), (-2.0, 1.0), (0.0, 0.0), (np.pi, 0.1)])
def test_roll_is_zero_at_gimbal_lock(sign: float, roll: float, yaw: float) -> None:
    q = scipy_quaternion(roll, sign * np.pi / 2, yaw)
    found = rot.roll_pitch_yaw(q)
    assert found[0] == 0.0
    assert found[1] == pytest.approx(sign * np.pi / 2, abs=ROUNDING)
    # nose straight up or down, roll and yaw turn about the same axis: only yaw -+ roll is left
    assert np.exp(1j * found[2]) == pytest.approx(np.exp(1j * (yaw - sign * roll)), abs=ROUNDING)


def test_each_angle_turns_about_its_own_axis_of_the_camera() -> None:
    quarter = np.sqrt(0.5)
    assert rot.roll_pitch_yaw(np.array([0, 0, quarter, quarter])) == pytest.approx([np.pi / 2, 0, 0])
    tenth = np.array([np.sin(0.05), 0.0, 0.0, np.cos(0.05)])
    assert rot.roll_pitch_yaw(tenth) == pytest.approx([0, 0.1, 0])
    assert rot.roll_pitch_yaw(np.array([0, quarter, 0, quarter])) == pytest.approx([0, 0, np.pi / 2])


def test_matrix_is_the_product_that_the_headers_state() -> None:
    roll, pitch, yaw = 0.2, -0.4, 1.1
    s, c = np.sin, np.cos
    R_z = np.array([[c(roll), -s(roll), 0], [s(roll), c(roll), 0], [0, 0, 1]])
    R_x = np.array([[1, 0, 0], [0, c(pitch), -s(pitch)], [0, s(pitch), c(pitch)]])
    R_y = np.array([[c(yaw), 0, s(yaw)], [0, 1, 0], [-s(yaw), 0, c(yaw)]])
    found = rot.matrices_from_quaternions(rot.quaternion_from_roll_pitch_yaw(np.array([roll, pitch, yaw])))
    np.testing.assert_allclose(found, R_y @ R_x @ R_z, atol=ROUNDING)


def test_facing_head_has_no_angles_and_looks_at_the_camera() -> None:
    facing = np.array(rot.FACING)
    np.testing.assert_array_equal(rot.head_roll_pitch_yaw(facing), 0.0)
    # camera axes are x right, y down, z forward
    np.testing.assert_array_equal(rot.rotate(facing, np.array([0.0, 0.0, 1.0])), [0.0, 0.0, -1.0])
    np.testing.assert_array_equal(rot.rotate(facing, np.array([0.0, 1.0, 0.0])), [0.0, -1.0, 0.0])


def test_head_that_turns_to_its_left_yaws_by_the_angle_towards_the_image_right() -> None:
    # the subject's left is the image's right: its nose moves to camera +x
    q = rot.head_quaternion_from_roll_pitch_yaw(np.array([0.0, 0.0, -0.3]))
    np.testing.assert_allclose(
        rot.rotate(q, np.array([0.0, 0.0, 1.0])), [np.sin(0.3), 0.0, -np.cos(0.3)], atol=ROUNDING
    )


def test_signs_of_a_head_s_angles() -> None:
    """The face looks along z of the head, its top along y; camera axes are x right, y down, z forward."""
    face, top = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    for axis, seen, to_camera in (
        (0, top, [np.sin(0.3), -np.cos(0.3), 0.0]),  # roll: the top goes to the image's right, its own left
        (1, face, [0.0, np.sin(0.3), -np.cos(0.3)]),  # pitch: the face goes down
        (2, face, [-np.sin(0.3), 0.0, -np.cos(0.3)]),  # yaw: the face goes to the image's left, its own right
    ):
        q = rot.multiply(rot.quaternion_from_roll_pitch_yaw(0.3 * np.eye(3)[axis]), np.array(rot.FACING))
        np.testing.assert_allclose(rot.rotate(q, seen), to_camera, atol=ROUNDING)
        np.testing.assert_allclose(rot.head_roll_pitch_yaw(q), 0.3 * np.eye(3)[axis], atol=ROUNDING)


@relaxed
@given(quaternions)
def test_head_rotation_comes_back_from_its_angles(q: np.ndarray) -> None:
    back = rot.head_quaternion_from_roll_pitch_yaw(rot.head_roll_pitch_yaw(q))
    np.testing.assert_array_less(rot.angle_between(back, q), LOCKED)
