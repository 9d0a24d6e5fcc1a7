"""Laws of the space of hand poses, its limits, and its rates."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.errors import PosetrackError
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.config import ComponentSettings
from posetrack_cli.hand.model.anatomy import ANGLE_LIMITS, ANGLE_NAMES
from posetrack_cli.hand.model.hand import AdditiveSpace, inside_limits, tangent_vector
from posetrack_cli.tracking.velocity import BodySpace, pose_rates
from support.hand import pose_strategy, random_poses

SPACE = BodySpace()
ROUNDING = 1e-9
"""Positions below 1e3 mm and unit quaternions, a few dozen operations."""
units = st.floats(-1.0, 1.0, allow_subnormal=False)
# rotation vectors shorter than pi: |r| <= sqrt(3) 1.8
tangents = arrays(np.float64, 21, elements=units).map(
    lambda d: d * np.array([300.0] * 3 + [1.8] * 3 + [3.0] * 15)
)
relaxed = settings(deadline=None)


@relaxed
@given(pose_strategy(), tangents)
def test_local_undoes_retract(pose: np.ndarray, delta: np.ndarray) -> None:
    x = pose[None]
    moved = SPACE.retract(x, delta[None])
    np.testing.assert_allclose(SPACE.local(x, moved)[0], delta, atol=ROUNDING)
    assert abs(np.linalg.norm(moved[0, 3:7]) - 1.0) < ROUNDING
    assert moved[0, 6] >= 0.0


@relaxed
@given(pose_strategy(), pose_strategy())
def test_retract_undoes_local(x: np.ndarray, y: np.ndarray) -> None:
    there = SPACE.retract(x[None], SPACE.local(x[None], y[None]))
    np.testing.assert_allclose(there[0, :3], y[:3], atol=ROUNDING)
    np.testing.assert_allclose(there[0, 7:], y[7:], atol=ROUNDING)
    assert rotations.angle_between(there[0, 3:7], y[3:7]) < ROUNDING  # half turns have two quaternions


@relaxed
@given(pose_strategy(), pose_strategy(), tangents)
def test_rotations_are_those_of_the_arrays(x: np.ndarray, y: np.ndarray, delta: np.ndarray) -> None:
    turned = rotations.canonical(rotations.multiply(x[3:7], rotations.exponential(delta[3:6])))
    np.testing.assert_allclose(SPACE.retract(x[None], delta[None])[0, 3:7], turned, atol=ROUNDING)
    between = rotations.logarithm(rotations.multiply(rotations.conjugate(x[3:7]), y[3:7]))
    np.testing.assert_allclose(SPACE.local(x, y)[3:6], between, atol=ROUNDING)


ADDITIVE = AdditiveSpace()


@relaxed
@given(pose_strategy(), tangents)
def test_additive_quaternions_are_sums(pose: np.ndarray, delta: np.ndarray) -> None:
    """(44) component by component, with the rate of p4..p7 that the tangent vector stands for."""
    moved = ADDITIVE.retract(pose[None], delta[None])[0]
    added = pose + pose_rates(pose, delta)
    added[3:7] = rotations.canonical(added[3:7])
    np.testing.assert_allclose(moved, added, atol=ROUNDING)
    back = ADDITIVE.local(pose, moved)
    np.testing.assert_allclose(back, delta, atol=ROUNDING)


def test_additive_is_the_manifold_to_first_order() -> None:
    """q + q (w, 0) / 2 turns by 2 atan(|w| / 2) = |w| - |w|^3 / 12."""
    x, delta = random_poses(20), np.random.default_rng(3).normal(size=(20, 21))
    for small in (1e-1, 1e-2):
        step = small * delta
        apart = rotations.angle_between(ADDITIVE.retract(x, step)[:, 3:7], SPACE.retract(x, step)[:, 3:7])
        length = np.linalg.norm(step[:, 3:6], axis=1)
        np.testing.assert_allclose(apart, length - 2.0 * np.arctan(0.5 * length), atol=1e-7)


def test_the_additive_mean_is_that_of_the_components() -> None:
    """(62): of turns by 0 and a, weighted 3 to 1, half the mean's has tan = sin(a/2) / (3 + cos(a/2))."""
    poses = np.tile(random_poses(1), (2, 1))
    turn = np.zeros((2, 21))
    turn[1, 3] = 1.2
    poses = SPACE.retract(poses, turn)
    mean = ADDITIVE.mean(poses, np.array([0.75, 0.25]))
    expected = 2.0 * np.arctan2(np.sin(0.6), 3.0 + np.cos(0.6))
    assert rotations.angle_between(poses[0, 3:7], mean[3:7]) == pytest.approx(expected)


def test_the_additive_volume_is_that_of_the_rotations() -> None:
    """Against a determinant by differences, of rotation vectors at the sum, and the exponential's volume."""
    x, delta, step = random_poses(1), np.zeros((1, 21)), 1e-5
    delta[0, 3:6] = 0.4, -0.3, 0.7
    columns = []
    for k in range(3):
        more = np.zeros((1, 21))
        more[0, 3 + k] = step
        there = [SPACE.local(x, ADDITIVE.retract(x, delta + sign * more))[0, 3:6] for sign in (-1.0, 1.0)]
        columns.append((there[1] - there[0]) / (2.0 * step))
    at = SPACE.local(x, ADDITIVE.retract(x, delta))
    wanted = np.log(abs(np.linalg.det(np.array(columns)))) + SPACE.log_volume(at)[0]
    assert ADDITIVE.log_volume(delta)[0] == pytest.approx(wanted, abs=1e-6)


def test_half_a_turn_apart_the_additive_difference_is_finite() -> None:
    x = np.eye(1, 22, 6)
    half = np.eye(1, 22, 3)
    assert np.isfinite(ADDITIVE.local(x, half)).all()


def test_half_a_turn_is_told_by_its_axis_alone() -> None:
    x = np.zeros((6, 22))
    x[:, 6] = 1.0
    delta = np.zeros((6, 21))
    delta[:3, 3:6], delta[3:, 3:6] = np.pi * np.eye(3), -np.pi * np.eye(3)
    moved = SPACE.retract(x, delta)
    np.testing.assert_allclose(rotations.angle_between(moved[:3, 3:7], moved[3:, 3:7]), 0.0, atol=ROUNDING)
    half = x.copy()
    half[:, 3:7] = 0.0
    half[:3, 3:6], half[3:, 3:6] = np.eye(3), -np.eye(3)  # with w = 0 exactly
    np.testing.assert_allclose(SPACE.local(x, half)[:, 3:6], np.tile(np.pi * np.eye(3), (2, 1)), atol=1e-15)


def test_parts_of_arrays_and_one_pose_beside_many_are_taken() -> None:
    poses = random_poses(12)
    wide = np.zeros((12, 30))
    wide[:, 4:26] = poses
    frozen = poses.copy()
    frozen.flags.writeable = False
    expected = SPACE.local(np.repeat(poses[:1], 6, axis=0), poses[::2])
    for one in (poses, wide[:, 4:26], np.asfortranarray(poses), frozen):
        np.testing.assert_array_equal(SPACE.local(one[0], one[::2]), expected)
        np.testing.assert_array_equal(SPACE.local(one[::2].reshape(2, 3, 22), one[0]).shape, [2, 3, 21])
        moved = SPACE.retract(np.repeat(one[:1], 6, axis=0), expected)
        np.testing.assert_allclose(moved[:, 7:], poses[::2, 7:], atol=ROUNDING)
        assert rotations.angle_between(moved[:, 3:7], poses[::2, 3:7]).max() < ROUNDING


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_rotation_that_is_not_finite_is_refused(value: float) -> None:
    delta = np.zeros((3, 21))
    delta[1, 4] = value
    with pytest.raises(PosetrackError, match="invalid quaternion"):
        SPACE.retract(random_poses(3), delta)


@relaxed
@given(pose_strategy(), tangents)
def test_volume_is_the_determinant_of_retract(pose: np.ndarray, delta: np.ndarray) -> None:
    """The Jacobian by central differences: x (+) (delta + step) as seen from x (+) delta."""
    step = 1e-5
    poses, steps = np.repeat(pose[None], 21, axis=0), step * np.eye(21)
    moved = [SPACE.retract(poses, delta + sign * steps) for sign in (1.0, -1.0)]
    centre = SPACE.retract(pose[None], delta[None])
    ahead, behind = (SPACE.local(np.repeat(centre, 21, axis=0), y) for y in moved)
    log_determinant = np.linalg.slogdet((ahead - behind) / (2.0 * step))[1]
    # rounding of 300 mm over the step, and the third derivative times step^2
    np.testing.assert_allclose(SPACE.log_volume(delta[None])[0], log_determinant, atol=1e-6)


@relaxed
@given(pose_strategy(), pose_strategy(), tangents)
def test_rotations_move_in_the_body_s_frame(x: np.ndarray, turn: np.ndarray, delta: np.ndarray) -> None:
    # turning the world changes nothing in what the body sees of its own rotation
    def turned(pose: np.ndarray) -> np.ndarray:
        out = pose.copy()
        out[:, 3:7] = rotations.multiply(turn[3:7], pose[:, 3:7])
        return out

    difference = SPACE.local(turned(x[None]), turned(SPACE.retract(x[None], delta[None])))
    np.testing.assert_allclose(difference[0, 3:6], delta[3:6], atol=ROUNDING)


@relaxed
@given(pose_strategy(), arrays(np.float64, 21, elements=units))
def test_the_mean_of_two_equal_weights_lies_half_way(x: np.ndarray, delta: np.ndarray) -> None:
    delta = 0.5 * delta  # less than half a turn between the two: there the mean is defined
    pair = SPACE.retract(np.stack([x, x]), np.stack([delta, -delta]))
    mean = SPACE.mean(pair, np.array([0.5, 0.5]))
    np.testing.assert_allclose(mean[:3], x[:3], atol=ROUNDING)
    np.testing.assert_allclose(mean[7:], x[7:], atol=ROUNDING)
    assert rotations.angle_between(mean[3:7], x[3:7]) < 1e-7  # eigenvector: square root of rounding
    assert mean[6] >= 0.0


def test_the_mean_follows_the_weights() -> None:
    poses = random_poses(4)
    np.testing.assert_allclose(SPACE.mean(poses, np.array([0.0, 1.0, 0.0, 0.0])), poses[1], atol=ROUNDING)
    weights = np.array([0.1, 0.2, 0.3, 0.4])
    expected = np.average(poses, axis=0, weights=weights)
    np.testing.assert_allclose(
        np.delete(SPACE.mean(poses, weights), np.s_[3:7]), np.delete(expected, np.s_[3:7])
    )


def test_arguments_are_left_as_they_are() -> None:
    x, delta = random_poses(3), np.ones((3, 21))
    before = x.copy()
    SPACE.retract(x, delta), SPACE.local(x, x), SPACE.mean(x, np.full(3, 1 / 3)), inside_limits(10.0 * x)
    np.testing.assert_array_equal(x, before)
    np.testing.assert_array_equal(delta, 1.0)


@relaxed
@given(pose_strategy(), tangents)
def test_limits_are_kept_touch_only_angles_and_change_nothing_twice(x: np.ndarray, delta: np.ndarray) -> None:
    wild = SPACE.retract(x[None], delta[None])
    kept = inside_limits(wild)
    low, high = ANGLE_LIMITS.T
    expected = np.minimum(np.maximum(wild[0, 7:], low), high)
    np.testing.assert_array_equal(kept[0, 7:], expected)
    np.testing.assert_array_equal(kept[0, :7], wild[0, :7])
    np.testing.assert_array_equal(inside_limits(kept), kept)


@relaxed
@given(pose_strategy(), arrays(np.float64, 21, elements=units))
def test_rates_are_the_derivative_of_the_22_numbers(x: np.ndarray, twist: np.ndarray) -> None:
    h = 1e-5
    ahead, behind = (SPACE.retract(x[None], s * h * twist[None])[0] for s in (1.0, -1.0))
    for later in (ahead, behind):  # near w = 0 the two quaternions' signs may differ from the pose's
        later[3:7] *= np.sign(later[3:7] @ x[3:7])
    # truncated at h^2 |w|^3 / 48, rounded at 700 eps / h
    tolerance = h**2 + 1e3 * np.finfo(float).eps / h
    np.testing.assert_allclose(pose_rates(x, twist), (ahead - behind) / (2 * h), atol=tolerance)


def test_one_number_for_each_kind_of_component() -> None:
    vector = tangent_vector(
        ComponentSettings(position_mm=1.0, rotation_rad=2.0, flexion_rad=3.0, abduction_rad=4.0)
    )
    expected = [4.0 if name.endswith("abduction") else 3.0 for name in ANGLE_NAMES]
    np.testing.assert_array_equal(vector, [1.0] * 3 + [2.0] * 3 + expected)
    assert expected.count(4.0) == 5
