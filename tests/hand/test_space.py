"""Laws of the space of hand poses, its limits, and its rates."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.geometry import rotations
from posetrack_cli.hand.anatomy import ANGLE_LIMITS, ANGLE_NAMES
from posetrack_cli.hand.config import ComponentSettings
from posetrack_cli.hand.space import inside_limits, tangent_vector
from posetrack_cli.tracking.body_space import BodySpace, pose_rates
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
