"""Metrics of a head: examples by hand, scipy by loops, and the layout of the thesis's tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posetrack_cli.evaluation.measuring.catalogue import addresses
from posetrack_cli.evaluation.measuring.evaluation import Statistics
from posetrack_cli.evaluation.measuring.head_metrics import HEAD_POSE
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from support.metrics import figures, measure, relaxed
from support.tracks import HEAD_POINTS, moved, random_head

SEEDS = st.integers(0, 2**32 - 1)


def facing(position: list[list[float]], roll_pitch_yaw_deg: list[list[float]], name: str) -> Track:
    """A head with one point, 50 mm in front of its origin."""
    t, q = np.array(position), head_quaternion_from_roll_pitch_yaw(np.radians(roll_pitch_yaw_deg))
    points = rotations.rotate(q, np.array([0.0, 0.0, 50.0])) + t
    stamps = np.arange(len(t), dtype=np.int64)
    return Track(
        name, "head", (), ("nose",), (-1,), stamp_ns=stamps, position=t, quaternion=q, points=points[:, None]
    )


def test_a_table_of_the_thesis_by_hand() -> None:
    truth = facing([[0.0, 0, 700], [10, 0, 700]], [[0.0, 0, 0], [0, 0, 170]], "truth")
    estimate = facing([[1.0, -2, 710], [7, 6, 680]], [[1.0, -2, 5], [-3, 4, -175]], "estimate")
    measures, _ = measure(estimate, truth)
    table = {name: (figures(measures, name).mean, figures(measures, name).sd) for name in HEAD_POSE}
    expected = {
        "x_mm": (2.0, 1.0),
        "y_mm": (4.0, 2.0),
        "z_mm": (15.0, 5.0),
        "roll_deg": (2.0, 1.0),
        "pitch_deg": (3.0, 1.0),
        "yaw_deg": (10.0, 5.0),  # 5, and from 170 on to -175: 15
    }
    for name, (mean, sd) in expected.items():
        assert table[name] == (pytest.approx(mean), pytest.approx(sd)), name
    assert figures(measures, "position_mm").max == pytest.approx(np.sqrt(9 + 36 + 400))


def test_the_point_s_error_is_that_of_the_shape_not_of_the_pose() -> None:
    truth = facing([[0.0, 0, 700]], [[0.0, 0, 0]], "truth")
    estimate = facing([[90.0, 0, 600]], [[20.0, 10, -40]], "estimate")
    measures, _ = measure(estimate, truth)
    assert figures(measures, "point_error_mm.nose").max == pytest.approx(0.0, abs=1e-9)
    assert estimate.quaternion is not None
    assert estimate.points is not None
    shift = rotations.rotate(estimate.quaternion, np.array([3.0, 0.0, 4.0]))
    measures, _ = measure(replace(estimate, points=estimate.points + shift), truth)
    assert figures(measures, "point_error_mm.nose").mean == pytest.approx(5.0)


def test_every_error_is_that_of_a_loop() -> None:
    estimate, truth = random_head(30, 1), random_head(30, 2)
    measures, _ = measure(estimate, truth)
    turns = [Rotation.from_quat(track.quaternion) for track in (estimate, truth)]
    in_head = [
        np.array(
            [[turn.inv().apply(point - t) for point in points] for turn, points, t in zip(*of, strict=True)]
        )
        for of in zip(
            turns, (estimate.points, truth.points), (estimate.position, truth.position), strict=True
        )
    ]
    errors = np.linalg.norm(in_head[0] - in_head[1], axis=2)
    np.testing.assert_allclose(measures.series["point_error_mm"], errors.mean(axis=1))
    for column, name in enumerate(HEAD_POINTS):
        assert figures(measures, f"point_error_mm.{name}").max == pytest.approx(errors[:, column].max())
    between = np.degrees((turns[0].inv() * turns[1]).magnitude())
    np.testing.assert_allclose(measures.series["rotation_deg"], between, atol=1e-6)
    half = Rotation.from_quat([1.0, 0.0, 0.0, 0.0])
    yaw, pitch, roll = np.moveaxis([(turn * half).as_euler("YXZ", degrees=True) for turn in turns], 2, 0)
    for name, (mine, theirs) in (("yaw_deg", yaw), ("pitch_deg", pitch), ("roll_deg", roll)):
        difference = np.abs(mine - theirs)
        np.testing.assert_allclose(
            measures.series[name], np.minimum(difference, 360.0 - difference), atol=1e-6
        )


def test_a_perfect_estimate_has_no_errors() -> None:
    truth = random_head(10)
    measures, curve = measure(truth, truth)
    assert curve is None
    assert set(measures.metrics) <= set(addresses("head", HEAD_POINTS))
    for value in measures.metrics.values():
        assert (value.max <= 1e-6) if isinstance(value, Statistics) else (value == 1.0)


@relaxed
@given(SEEDS, SEEDS)
def test_points_in_head_coordinates_do_not_see_the_camera_move(seed: int, motion: int) -> None:
    rng = np.random.default_rng(motion)
    estimate, truth = random_head(3, seed), random_head(3, seed + 1)
    here, _ = measure(estimate, truth)
    turned = moved(estimate, rotations.canonical(rng.standard_normal(4)), 100.0 * rng.standard_normal(3))
    there, _ = measure(turned, truth)
    np.testing.assert_allclose(there.series["point_error_mm"], here.series["point_error_mm"], atol=1e-6)


def test_what_the_truth_lacks_is_told() -> None:
    estimate, truth = random_head(3, 1), random_head(3, 2)
    measures, _ = measure(estimate, replace(truth, points=None, quaternion=None))
    assert measures.absent["roll_deg"] == "the ground truth has no rotation"
    assert measures.absent["rotation_deg"] == "the ground truth has no rotation"
    assert measures.absent["point_error_mm"] == "the ground truth has no points"
    assert figures(measures, "x_mm").count == 3
    measures, _ = measure(estimate, replace(truth, point_names=("a", "b", "c", "d")))
    assert measures.absent["point_error_mm"] == "the ground truth has other points"
    assert truth.points is not None
    measures, _ = measure(estimate, replace(truth, point_names=HEAD_POINTS[1:], points=truth.points[:, 1:]))
    assert measures.notes == ["point errors without left_eye_inner: missing in the ground truth"]
