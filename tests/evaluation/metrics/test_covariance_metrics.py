"""Consistency of the stated covariance: examples by hand, calibrated errors, what is certain or unknown."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.tracking.velocity import BodySpace
from support.metrics import figures, measure, number, relaxed
from support.tracks import random_hand, random_head

STANDARD_ERRORS = 5.0
"""Tolerance in standard errors: one of two million calibrated filters would fail."""


def disturbed(truth: Track, errors: FloatArray, twist_errors: FloatArray) -> Track:
    """The estimate whose truth lies ``errors`` (N, 6 + K) away in its tangent space, velocities alike."""
    assert truth.position is not None
    assert truth.quaternion is not None
    assert truth.shape is not None
    assert truth.twist is not None
    k = errors.shape[1] - 6
    back = rotations.exponential(-errors[:, 3:6])  # q_true = q_est exp(e), so q_est = q_true exp(-e)
    quaternion = rotations.canonical(rotations.multiply(truth.quaternion, back))
    # the true velocity in the estimate's axes, exp(e) w, is the estimate's and its error
    seen = rotations.rotate(rotations.exponential(errors[:, 3:6]), truth.twist[:, 3:6])
    rigid = np.hstack([truth.twist[:, :3], seen, truth.twist[:, 6:]])
    return replace(
        truth,
        position=truth.position - errors[:, :3],
        quaternion=quaternion,
        shape=truth.shape - errors[:, 6:] if k else truth.shape,
        twist=rigid - twist_errors,
    )


def test_nees_by_hand() -> None:
    truth = random_hand(2)
    errors, twist_errors = np.zeros((2, 21)), np.zeros((2, 21))
    errors[0, 0], errors[1, 4], errors[1, 20] = 6.0, 0.02, 0.3
    twist_errors[0, 5] = 2.0
    variances = np.full((2, 21), 4.0)
    variances[:, 3:] = 0.01
    estimate = replace(
        disturbed(truth, errors, twist_errors), pose_variance=variances, twist_variance=np.ones((2, 21))
    )
    measures, _ = measure(estimate, truth)
    np.testing.assert_allclose(measures.series["nees"], [36.0 / 4.0, 0.0004 / 0.01 + 0.09 / 0.01])
    np.testing.assert_allclose(measures.series["velocity_nees"], [4.0, 0.0], atol=1e-9)
    assert number(measures, "inside_90") == pytest.approx(40 / 42)  # 3 sd twice outside, 0.2 sd inside
    assert number(measures, "inside_90.position") == pytest.approx(5 / 6)
    assert number(measures, "inside_90.rotation") == 1.0
    assert number(measures, "inside_90.angles") == pytest.approx(29 / 30)
    assert number(measures, "inside_50") == pytest.approx(40 / 42)
    assert number(measures, "velocity_inside_50.rotation") == pytest.approx(5 / 6)
    alone = {"x": 0.5, "y": 1.0, "about_y": 1.0, "little_pip_flexion": 0.5, "little_mcp_abduction": 1.0}
    assert {name: number(measures, f"inside_90.{name}") for name in alone} == alone
    assert number(measures, "velocity_inside_90") == pytest.approx(41 / 42)
    assert number(measures, "velocity_inside_90.rotation") == pytest.approx(5 / 6)


def test_errors_are_those_of_the_filter_s_own_space() -> None:
    estimate, truth = random_hand(30, 1), random_hand(30, 2)
    poses = [
        np.hstack([track.position, track.quaternion, track.shape])  # type: ignore[list-item]
        for track in (estimate, truth)
    ]
    errors = BodySpace().local(*poses)
    measures, _ = measure(estimate, truth)
    assert estimate.pose_variance is not None
    expected = (errors**2 / estimate.pose_variance).sum(axis=1)
    np.testing.assert_allclose(measures.series["nees"], expected, rtol=1e-9)


@pytest.mark.parametrize(("random", "dimension"), [(random_hand, 21), (random_head, 6)])
def test_calibrated_gaussian_errors_are_found_consistent(random: object, dimension: int) -> None:
    frames = 4000
    truth = random_hand(frames, 3) if random is random_hand else random_head(frames, 3)
    assert truth.pose_variance is not None
    assert truth.twist_variance is not None
    rng = np.random.default_rng(5)
    # small rotations: the tangent space is flat there
    variances = truth.pose_variance * np.where(np.arange(truth.pose_variance.shape[1]) < 3, 25.0, 0.01)
    errors = rng.standard_normal(variances.shape) * np.sqrt(variances)
    twist_errors = rng.standard_normal(variances.shape) * np.sqrt(truth.twist_variance)
    estimate = replace(disturbed(truth, errors, twist_errors), pose_variance=variances)
    measures, _ = measure(estimate, truth)
    nees_error = STANDARD_ERRORS * math.sqrt(2.0 * dimension / frames)  # chi-square: variance 2 D
    share_error = STANDARD_ERRORS * math.sqrt(0.9 * 0.1 / (frames * dimension))
    for prefix in ("", "velocity_"):
        assert figures(measures, f"{prefix}nees").mean == pytest.approx(dimension, abs=nees_error)
        assert number(measures, f"{prefix}inside_90") == pytest.approx(0.9, abs=share_error)
        assert number(measures, f"{prefix}inside_50") == pytest.approx(0.5, abs=share_error * 5 / 3)
        for part, size in (("position", 3), ("rotation", 3)):
            part_error = share_error * math.sqrt(dimension / size)
            assert number(measures, f"{prefix}inside_90.{part}") == pytest.approx(0.9, abs=part_error)


@relaxed
@given(st.floats(0.1, 10.0), st.integers(0, 1000))
def test_a_variance_too_large_by_a_factor_divides_the_nees(factor: float, seed: int) -> None:
    estimate, truth = random_hand(5, seed), random_hand(5, seed + 1)
    assert estimate.pose_variance is not None
    measures, _ = measure(estimate, truth)
    wider, _ = measure(replace(estimate, pose_variance=factor * estimate.pose_variance), truth)
    np.testing.assert_allclose(wider.series["nees"] * factor, measures.series["nees"], rtol=1e-9)


def test_certainty_is_right_or_infinitely_wrong() -> None:
    truth = random_hand(3)
    certain = replace(truth, pose_variance=np.zeros((3, 21)))
    measures, _ = measure(certain, truth)
    assert figures(measures, "nees").max == 0.0
    assert number(measures, "inside_90") == 1.0
    assert truth.position is not None
    wrong = replace(certain, position=truth.position + np.array([[0.0], [1.0], [0.0]]))
    measures, _ = measure(wrong, truth)
    assert measures.series["nees"].tolist() == [0.0, math.inf, 0.0]
    got = figures(measures, "nees")
    assert (got.mean, got.median, got.max) == (math.inf, 0.0, math.inf)
    assert number(measures, "inside_90.position") == pytest.approx(6 / 9)


def test_a_head_s_deformation_is_not_judged() -> None:
    estimate, truth = random_head(4, 1), random_head(4, 2)
    without = replace(truth, shape=None, shape_names=())
    measures, _ = measure(estimate, truth)
    other, _ = measure(estimate, without)
    assert figures(other, "nees") == figures(measures, "nees")
    assert "inside_90.angles" not in measures.metrics


@pytest.mark.parametrize(
    ("side", "change", "reason"),
    [
        ("truth", {"shape": None}, "the ground truth has no finger angles"),
        ("truth", {"quaternion": None}, "the ground truth has no rotation"),
        ("estimate", {"pose_variance": None}, "the result has no covariance"),
    ],
)
def test_half_a_state_has_no_nees(side: str, change: dict[str, None], reason: str) -> None:
    estimate, truth = random_hand(3, 1), random_hand(3, 2)
    if side == "truth":
        truth = replace(truth, **change)
    else:
        estimate = replace(estimate, **change)
    measures, _ = measure(estimate, truth)
    assert measures.absent["nees"] == reason
    assert measures.absent["inside_90"] == reason
    assert "inside_90.position" not in measures.metrics


@pytest.mark.parametrize(
    ("side", "change", "reason"),
    [
        ("truth", {"twist": None}, "the ground truth has no velocity"),
        ("truth", {"quaternion": None}, "the ground truth has no rotation"),
        ("estimate", {"twist_variance": None}, "the result has no velocity covariance"),
        (
            "estimate",
            {"twist": np.zeros((3, 21)), "twist_variance": None},
            "the run does not estimate velocities",
        ),
    ],
)
def test_half_a_velocity_has_no_nees(side: str, change: dict[str, FloatArray | None], reason: str) -> None:
    tracks = {"estimate": random_hand(3, 1), "truth": random_hand(3, 2)}
    tracks[side] = replace(tracks[side], **change)  # type: ignore[arg-type]
    measures, _ = measure(tracks["estimate"], tracks["truth"])
    assert measures.absent["velocity_nees"] == measures.absent["velocity_inside_90"] == reason
    assert ("nees" in measures.metrics) == ("quaternion" not in change)


def test_frames_whose_velocity_the_truth_does_not_know_are_left_out() -> None:
    estimate, truth = random_hand(3, 1), random_hand(3, 2)
    whole, _ = measure(estimate, truth)
    assert truth.twist is not None
    twist = truth.twist.copy()
    twist[1, 8] = np.nan  # one angle of one frame: its squared error is no sum then
    measures, _ = measure(estimate, replace(truth, twist=twist))
    np.testing.assert_array_equal(
        measures.series["velocity_nees"], np.where([True, False, True], whole.series["velocity_nees"], np.nan)
    )
    assert figures(measures, "velocity_nees").count == 2
    assert figures(measures, "nees") == figures(whole, "nees")


def test_angles_are_matched_by_name_whatever_their_order() -> None:
    estimate, truth = random_hand(4, 1), random_hand(4, 2)
    assert truth.shape is not None and truth.twist is not None
    order = np.random.default_rng(3).permutation(len(truth.shape_names))
    shuffled = replace(
        truth,
        shape_names=tuple(truth.shape_names[i] for i in order),
        shape=truth.shape[:, order],
        twist=np.hstack([truth.twist[:, :6], truth.twist[:, 6:][:, order]]),
    )
    expected, _ = measure(estimate, truth)
    measures, _ = measure(estimate, shuffled)
    for name in ("nees", "velocity_nees"):
        np.testing.assert_array_equal(measures.series[name], expected.series[name])


def test_a_truth_that_lacks_an_angle_has_no_nees() -> None:
    estimate, truth = random_hand(3, 1), random_hand(3, 2)
    assert truth.shape is not None and truth.twist is not None
    fewer = replace(
        truth,
        shape_names=truth.shape_names[1:],
        shape=truth.shape[:, 1:],
        twist=np.delete(truth.twist, 6, axis=1),
    )
    measures, _ = measure(estimate, fewer)
    reason = f"the ground truth has no angle {truth.shape_names[0]}"
    assert measures.absent["nees"] == measures.absent["velocity_nees"] == reason
