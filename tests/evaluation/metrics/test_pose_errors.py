"""Errors of poses: hand-computed, against scipy's Rotation, and their laws."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.measuring import pose_metrics
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from support.metrics import relaxed

FEW_ULPS_DEG = 1e-10
"""A dozen float64 roundings of numbers up to 180 deg or 1000 mm stay below."""
HALF_ANGLE_DEG = 2e-6
"""scipy's magnitude and ours differ by less, also near 180 deg where both take arc tangents."""
VECTORS = arrays(np.float64, (5, 3), elements=st.floats(-1e3, 1e3))
QUATERNIONS = arrays(np.float64, (5, 4), elements=st.floats(-1.0, 1.0)).filter(
    lambda q: bool((np.linalg.norm(q, axis=1) > 1e-3).all())
)


def unit(q: FloatArray) -> FloatArray:
    return rotations.canonical(q)


def test_distances_by_hand() -> None:
    estimate = np.array([[[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]])
    truth = np.array([[[3.0, 4.0, 0.0], [1.0, 2.0, 15.0]]])
    assert pose_metrics.distances(estimate, truth).tolist() == [[5.0, 12.0]]


def test_rotation_errors_by_hand() -> None:
    quarter = np.array([[0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]])
    none, half = np.array([[0.0, 0.0, 0.0, 1.0]]), np.array([[0.0, 1.0, 0.0, 0.0]])
    np.testing.assert_allclose(pose_metrics.rotation_errors_deg(quarter, none), [90.0], atol=FEW_ULPS_DEG)
    np.testing.assert_allclose(pose_metrics.rotation_errors_deg(half, none), [180.0], atol=FEW_ULPS_DEG)


@relaxed
@given(QUATERNIONS, QUATERNIONS)
def test_rotation_errors_are_scipy_s_and_symmetric(p: FloatArray, q: FloatArray) -> None:
    p, q = unit(p), unit(q)
    got = pose_metrics.rotation_errors_deg(p, q)
    expected = np.degrees((Rotation.from_quat(p).inv() * Rotation.from_quat(q)).magnitude())
    np.testing.assert_allclose(got, expected, atol=HALF_ANGLE_DEG)
    np.testing.assert_allclose(got, pose_metrics.rotation_errors_deg(q, p), atol=FEW_ULPS_DEG)
    assert (got >= 0.0).all()
    assert (got <= 180.0).all()


@relaxed
@given(QUATERNIONS)
def test_a_quaternion_and_its_negative_are_the_same_rotation(q: FloatArray) -> None:
    q = unit(q)
    np.testing.assert_allclose(pose_metrics.rotation_errors_deg(q, q), 0.0, atol=FEW_ULPS_DEG)
    np.testing.assert_allclose(pose_metrics.rotation_errors_deg(q, -q), 0.0, atol=FEW_ULPS_DEG)


def test_euler_errors_go_the_short_way_round() -> None:
    truth, estimate = np.radians([[179.0, 10.0, -179.0]]), np.radians([[-178.0, 7.5, 179.0]])
    errors = pose_metrics.euler_errors_deg(
        head_quaternion_from_roll_pitch_yaw(estimate), head_quaternion_from_roll_pitch_yaw(truth)
    )
    np.testing.assert_allclose(errors, [[3.0, 2.5, 2.0]], atol=FEW_ULPS_DEG)


@relaxed
@given(arrays(np.float64, (2, 4, 3), elements=st.floats(-80.0, 80.0)))
def test_euler_errors_are_scipy_s(angles_deg: FloatArray) -> None:
    # scipy's intrinsic YXZ: yaw about y, pitch about x, roll about z; a head has half a turn about x besides
    facing = Rotation.from_quat([1.0, 0.0, 0.0, 0.0])
    turns = [Rotation.from_euler("YXZ", side[:, [2, 1, 0]], degrees=True) * facing for side in angles_deg]
    errors = pose_metrics.euler_errors_deg(turns[0].as_quat(), turns[1].as_quat())
    np.testing.assert_allclose(errors, np.abs(angles_deg[0] - angles_deg[1]), atol=1e-8)


def test_a_turning_body_s_velocity_does_not_depend_on_how_far_it_has_turned() -> None:
    """Both spin about the camera's z axis at 2 rad/s, a quarter turn apart, tipped over differently."""
    tipped = Rotation.from_euler("xy", [[20.0, -70.0], [130.0, 10.0]], degrees=True)
    spin = tipped.inv().apply([0.0, 0.0, 2.0])
    errors = pose_metrics.angular_velocity_errors_deg(
        spin[:1], spin[1:], tipped[:1].as_quat(), tipped[1:].as_quat()
    )
    np.testing.assert_allclose(errors, 0.0, atol=FEW_ULPS_DEG)


@relaxed
@given(VECTORS, VECTORS, QUATERNIONS, QUATERNIONS)
def test_angular_velocities_are_compared_in_one_frame(
    w: FloatArray, true_w: FloatArray, q: FloatArray, true_q: FloatArray
) -> None:
    got = pose_metrics.angular_velocity_errors_deg(w, true_w, unit(q), unit(true_q))
    difference = Rotation.from_quat(q).apply(w) - Rotation.from_quat(true_q).apply(true_w)
    np.testing.assert_allclose(got, np.degrees(np.linalg.norm(difference, axis=1)), atol=1e-8)
    twists = np.hstack([np.zeros((5, 3)), w]), np.hstack([np.zeros((5, 3)), true_w])
    in_body = pose_metrics.twist_difference(*twists, unit(q), unit(true_q))
    np.testing.assert_allclose(np.degrees(np.linalg.norm(in_body, axis=1)), got, atol=1e-8)


@relaxed
@given(VECTORS, VECTORS, QUATERNIONS, QUATERNIONS)
def test_the_pose_s_difference_leads_from_the_estimate_to_the_truth(
    t: FloatArray, true_t: FloatArray, q: FloatArray, true_q: FloatArray
) -> None:
    difference = pose_metrics.pose_difference(t, unit(q), true_t, unit(true_q))
    np.testing.assert_allclose(t + difference[:, :3], true_t, atol=1e-9)
    reached = Rotation.from_quat(q) * Rotation.from_rotvec(difference[:, 3:])
    np.testing.assert_allclose((reached.inv() * Rotation.from_quat(true_q)).magnitude(), 0.0, atol=1e-7)


def test_normalised_squares_by_hand() -> None:
    errors = np.array([[3.0, -1.0, 0.0, 1e-12, 0.5, 0.0]])
    variances = np.array([[9.0, 0.25, 0.0, 0.0, 0.0, 4.0]])
    got = pose_metrics.normalised_squares(errors, variances)
    assert got.tolist() == [[1.0, 4.0, 0.0, 0.0, np.inf, 0.0]]
    assert pose_metrics.inside_interval(got).tolist() == [[True, False, True, True, False, True]]


def test_the_interval_holds_ninety_percent() -> None:
    width = pose_metrics.INSIDE_90
    assert abs(norm.cdf(width) - norm.cdf(-width) - 0.9) < 1e-12


def test_shares_are_below_and_not_at_the_threshold() -> None:
    got = pose_metrics.share_below(np.array([20.0, 5.0, 10.0]), np.array([5.0, 10.0, 10.5, 100.0]), due=4)
    assert got.tolist() == [0.0, 0.25, 0.5, 0.75]


@relaxed
@given(st.lists(st.floats(0.0, 200.0), max_size=20), st.integers(1, 5))
def test_shares_are_those_counted(values: list[float], missed: int) -> None:
    thresholds, due = np.arange(0.0, 101.0), len(values) + missed
    expected = [sum(value < threshold for value in values) / due for threshold in thresholds]
    np.testing.assert_allclose(pose_metrics.share_below(np.array(values), thresholds, due), expected)
