"""Metrics of a hand: examples worked out by hand, brute-force loops, and their laws."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.measuring.catalogue import addresses
from posetrack_cli.evaluation.measuring.evaluation import Statistics, statistics
from posetrack_cli.evaluation.measuring.hand_metrics import WITHIN_MM
from posetrack_cli.evaluation.reading.tracks import Pairs, Track
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.model.anatomy import ANGLE_NAMES, FINGERS, JOINT_NAMES
from support.metrics import NOTHING, figures, measure, number, relaxed
from support.tracks import moved, random_hand

ROUNDING_MM = 1e-9
"""Positions of 1000 mm carry 1e-13 mm; a few dozen operations stay far below."""
SEEDS = st.integers(0, 2**32 - 1)


def joints_only(name: str, points: FloatArray, names: tuple[str, ...] = ("wrist", "index_tip")) -> Track:
    """A track of points, as a CSV of joints gives it."""
    stamps = np.arange(len(points), dtype=np.int64)
    parents = (-1,) + (0,) * (len(names) - 1)
    return Track(name, "hand", (), names, parents, stamp_ns=stamps, points=points)


@pytest.fixture
def small() -> tuple[Track, Track]:
    """Three frames of two joints; errors 5 12 | 0 25 | 400 300 mm; the last one lost."""
    truth = np.array([[[0.0, 0.0, 600.0], [0.0, 100.0, 600.0]]] * 3)
    offsets = [[[3.0, 4, 0], [0, 0, 12]], [[0, 0, 0], [0, 25, 0]], [[0, 0, 400], [300, 0, 0]]]
    estimate = joints_only("estimate", truth + np.array(offsets))
    lost = np.array([False, False, True])
    return replace(estimate, lost=lost), joints_only("truth", truth)


def test_joint_errors_by_hand(small: tuple[Track, Track]) -> None:
    measures, _ = measure(*small)
    overall = figures(measures, "joint_error_mm")
    assert (overall.mean, overall.max, overall.count) == (pytest.approx(742 / 6), 400.0, 6)
    assert overall.median == pytest.approx((12 + 25) / 2)
    assert figures(measures, "joint_error_mm.wrist").mean == pytest.approx(135.0)
    assert figures(measures, "joint_error_mm.index_tip").mean == pytest.approx((12 + 25 + 300) / 3)
    assert figures(measures, "largest_joint_error_mm").mean == pytest.approx((12 + 25 + 400) / 3)
    np.testing.assert_allclose(measures.series["joint_error_mm"], [8.5, 12.5, 350.0])
    np.testing.assert_allclose(measures.series["largest_joint_error_mm"], [12.0, 25.0, 400.0])


def test_fingers_leave_out_the_wrist(small: tuple[Track, Track]) -> None:
    measures, _ = measure(*small)
    for address in ("finger_error_mm", "finger_error_mm.index", "fingertip_error_mm"):
        assert figures(measures, address).mean == pytest.approx((12 + 25 + 300) / 3)
    assert measures.absent["finger_error_mm.thumb"] == "the ground truth has other joints"


def test_lost_frames_count_but_where_the_name_says_they_do_not(small: tuple[Track, Track]) -> None:
    measures, _ = measure(*small)
    tracked = figures(measures, "joint_error_tracked_mm")
    assert (tracked.mean, tracked.count) == (pytest.approx((5 + 12 + 0 + 25) / 4), 4)
    estimate, truth = small
    measures, _ = measure(replace(estimate, lost=np.ones(3, dtype=np.bool_)), truth)
    assert measures.absent["joint_error_tracked_mm"] == "all frames with ground truth are lost"
    assert figures(measures, "joint_error_mm").count == 6


def test_shares_are_of_the_frames_due(small: tuple[Track, Track]) -> None:
    measures, curve = measure(*small, missed=1)
    within = {threshold: number(measures, f"frames_within_{threshold}mm") for threshold in WITHIN_MM}
    assert within == {10: 0.0, 20: 0.25, 30: 0.5, 40: 0.5, 50: 0.5, 80: 0.5}
    mean = {threshold: number(measures, f"frames_mean_within_{threshold}mm") for threshold in WITHIN_MM}
    assert mean == {10: 0.25, 20: 0.5, 30: 0.5, 40: 0.5, 50: 0.5, 80: 0.5}  # means 8.5, 12.5 and more
    assert curve is not None
    at = dict(zip(curve.thresholds_mm.tolist(), curve.share.tolist(), strict=True))
    assert (at[0.0], at[12.0], at[13.0], at[25.0], at[26.0], at[100.0]) == (0.0, 0.0, 0.25, 0.25, 0.5, 0.5)


def test_a_truth_of_joints_alone_has_a_wrist_and_reasons_for_the_rest(small: tuple[Track, Track]) -> None:
    measures, _ = measure(*small)
    assert figures(measures, "wrist_position_mm").mean == pytest.approx((5 + 0 + 400) / 3)
    assert measures.absent["wrist_rotation_deg"] == "the ground truth has no rotation"
    assert measures.absent["angle_error_deg"] == "the ground truth has no finger angles"
    assert measures.absent["velocity_error_mm_s"] == "the ground truth has no velocity"
    assert measures.absent["nees"] == "the ground truth has no position"


def test_angles_by_hand() -> None:
    truth = random_hand(2)
    assert truth.shape is not None
    shape = truth.shape.copy()
    shape[0, 3] += np.radians(10.0)
    shape[1, 3] -= np.radians(20.0)
    measures, _ = measure(replace(truth, shape=shape), truth)
    one = figures(measures, f"angle_error_deg.{ANGLE_NAMES[3]}")
    assert (one.mean, one.sd, one.max) == (pytest.approx(15.0), pytest.approx(5.0), pytest.approx(20.0))
    assert figures(measures, "angle_error_deg").mean == pytest.approx(30.0 / (2 * 15))
    assert figures(measures, f"angle_error_deg.{ANGLE_NAMES[2]}").max == 0.0
    np.testing.assert_allclose(measures.series["angle_error_deg"], [10.0 / 15, 20.0 / 15])


def brute_force(estimate: Track, truth: Track) -> Iterator[tuple[str, list[float]]]:
    """Every error of joints, wrist and angles by loops and scipy."""
    assert estimate.points is not None
    assert truth.points is not None
    joint: dict[str, list[float]] = {name: [] for name in JOINT_NAMES}
    for mine, theirs in zip(estimate.points, truth.points, strict=True):
        for name, a, b in zip(JOINT_NAMES, mine, theirs, strict=True):
            joint[name].append(sum((x - y) ** 2 for x, y in zip(a, b, strict=True)) ** 0.5)
    yield from ((f"joint_error_mm.{name}", errors) for name, errors in joint.items())
    yield "joint_error_mm", [error for errors in joint.values() for error in errors]
    for finger in FINGERS:
        yield f"finger_error_mm.{finger}", [e for n, es in joint.items() if finger in n for e in es]
    yield "finger_error_mm", [error for name, errors in joint.items() if name != "wrist" for error in errors]
    yield "fingertip_error_mm", [error for name, errors in joint.items() if "tip" in name for error in errors]
    yield "largest_joint_error_mm", [max(frame) for frame in zip(*joint.values(), strict=True)]
    yield "wrist_position_mm", joint["wrist"]
    turns = Rotation.from_quat(estimate.quaternion).inv() * Rotation.from_quat(truth.quaternion)
    yield "wrist_rotation_deg", np.degrees(turns.magnitude()).tolist()
    assert estimate.shape is not None
    assert truth.shape is not None
    angles = np.degrees(np.abs(estimate.shape - truth.shape))
    yield "angle_error_deg", angles.ravel().tolist()
    yield from ((f"angle_error_deg.{name}", angles[:, i].tolist()) for i, name in enumerate(ANGLE_NAMES))


@pytest.mark.parametrize("frames", [1, 40])
def test_every_error_is_that_of_a_loop(frames: int) -> None:
    estimate, truth = random_hand(frames, 1), random_hand(frames, 2)
    measures, _ = measure(estimate, truth)
    for address, errors in brute_force(estimate, truth):
        expected, got = statistics(errors), figures(measures, address)
        assert got.count == len(errors)
        for name in ("mean", "sd", "median", "p95", "max"):
            assert getattr(got, name) == pytest.approx(getattr(expected, name), abs=1e-5), address


def test_only_pairs_are_compared() -> None:
    estimate, truth = random_hand(9, 1), random_hand(7, 2)
    pairs = Pairs(np.array([1, 4, 8]), np.array([0, 3, 5]))
    measures, _ = measure(estimate, truth, pairs)
    assert estimate.points is not None
    assert truth.points is not None
    expected = np.linalg.norm(estimate.points[pairs.estimate] - truth.points[pairs.truth], axis=2)
    assert figures(measures, "joint_error_mm").mean == pytest.approx(expected.mean())
    np.testing.assert_allclose(measures.series["joint_error_mm"], expected.mean(axis=1))


def test_joints_and_angles_are_found_by_name_whatever_their_order() -> None:
    truth = random_hand(5, 2)
    assert truth.points is not None
    assert truth.shape is not None
    assert truth.twist is not None
    columns = [0, 1, 2, 3, 4, 5, *range(20, 5, -1)]
    turned = replace(
        truth,
        point_names=truth.point_names[::-1],
        points=truth.points[:, ::-1],
        shape_names=truth.shape_names[::-1],
        shape=truth.shape[:, ::-1],
        twist=truth.twist[:, columns],
    )
    estimate = random_hand(5, 1)
    measures, curve = measure(estimate, truth)
    other, other_curve = measure(estimate, turned)
    assert other.metrics == measures.metrics
    assert curve is not None
    assert other_curve is not None
    assert curve.share.tolist() == other_curve.share.tolist()


def test_joints_that_the_truth_lacks_are_named() -> None:
    truth = random_hand(3)
    assert truth.points is not None
    fewer = replace(truth, points=truth.points[:, 1:], point_names=truth.point_names[1:])
    measures, _ = measure(truth, fewer)
    assert measures.notes == ["joint errors over 20 of 21 joints: the ground truth has no wrist"]
    assert "joint_error_mm.wrist" not in measures.metrics
    assert figures(measures, "joint_error_mm").count == 60


def test_a_truth_of_other_joints_is_not_compared() -> None:
    truth = random_hand(3)
    other = replace(truth, point_names=tuple(f"p{i}" for i in range(21)))
    measures, curve = measure(truth, other)
    assert curve is None
    assert measures.absent["joint_error_mm"] == "the ground truth has other joints"
    assert measures.absent["frames_within_20mm"] == "the ground truth has other joints"


def test_a_truth_of_the_wrist_alone_has_no_fingers() -> None:
    estimate, truth = random_hand(3, 1), random_hand(3, 2)
    assert truth.points is not None
    wrist = replace(truth, point_names=JOINT_NAMES[:1], point_parents=(-1,), points=truth.points[:, :1])
    measures, _ = measure(estimate, wrist)
    for address in ("finger_error_mm", "fingertip_error_mm", "finger_error_mm.index"):
        assert measures.absent[address] == "the ground truth has other joints"
    assert measures.metrics["joint_error_mm"] == measures.metrics["joint_error_mm.wrist"]


def test_the_wrist_of_a_truth_of_joints_is_found_by_name() -> None:
    estimate, truth = random_hand(3, 1), random_hand(3, 2)
    assert truth.points is not None
    bare = replace(truth, position=None, point_names=JOINT_NAMES[::-1], points=truth.points[:, ::-1])
    expected, _ = measure(estimate, truth)
    measures, _ = measure(estimate, bare)
    np.testing.assert_allclose(
        measures.series["wrist_position_mm"], expected.series["wrist_position_mm"], atol=ROUNDING_MM
    )


@pytest.mark.parametrize("joints", [JOINT_NAMES[1:], ()])
def test_a_truth_without_any_wrist_says_so(joints: tuple[str, ...]) -> None:
    estimate, truth = random_hand(3, 1), random_hand(3, 2)
    points = None if truth.points is None or not joints else truth.points[:, 1:]
    measures, _ = measure(estimate, replace(truth, position=None, point_names=joints, points=points))
    assert measures.absent["wrist_position_mm"] == "the ground truth has no position"


def test_a_truth_of_other_angles_says_so() -> None:
    estimate, truth = random_hand(3, 1), random_hand(3, 2)
    others = tuple(f"other_{name}" for name in truth.shape_names)
    measures, _ = measure(estimate, replace(truth, shape_names=others))
    assert measures.absent["angle_error_deg"] == "the ground truth has other finger angles"
    assert measures.absent["nees"] == f"the ground truth has no angle {ANGLE_NAMES[0]}"


def test_a_truth_without_joints_says_so() -> None:
    estimate, truth = random_hand(3, 1), random_hand(3, 2)
    measures, curve = measure(estimate, replace(truth, points=None, point_names=()))
    assert curve is None
    for address in ("joint_error_mm", "largest_joint_error_mm", "frames_within_20mm"):
        assert measures.absent[address] == "the ground truth has no points"


def test_without_any_pair_nothing_is_measured_and_every_frame_due_is_missed() -> None:
    none = Pairs(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
    measures, curve = measure(random_hand(3), random_hand(4), none, missed=4)
    assert measures.absent["joint_error_mm"] == NOTHING
    assert measures.absent["joint_error_tracked_mm"] == NOTHING
    assert measures.absent["nees"] == NOTHING
    assert measures.absent["velocity_error_mm_s"] == NOTHING
    assert number(measures, "frames_within_80mm") == 0.0
    assert curve is not None
    assert not curve.share.any()
    measures, curve = measure(random_hand(3), random_hand(0), none)
    assert measures.absent["frames_within_80mm"] == NOTHING
    assert curve is None


def test_a_perfect_estimate_has_no_errors() -> None:
    truth = random_hand(20)
    measures, curve = measure(truth, truth)
    for address, value in measures.metrics.items():
        if isinstance(value, Statistics):
            assert value.max <= 1e-6  # deg: the arc tangent of a quaternion's rounding
        elif address.startswith("joint_bias"):
            assert value == 0.0
        else:
            assert value == 1.0  # every share
    assert curve is not None
    assert curve.share.tolist() == curve.mean_share.tolist() == [0.0] + [1.0] * 100
    assert set(measures.metrics) <= set(addresses("hand"))


@relaxed
@given(SEEDS, st.tuples(*[st.floats(-200.0, 200.0)] * 3))
def test_a_constant_shift_is_exactly_the_wrist_s_error(seed: int, shift: tuple[float, ...]) -> None:
    truth = random_hand(4, seed)
    estimate = moved(truth, np.array(rotations.IDENTITY), np.array(shift))
    measures, _ = measure(estimate, truth)
    length = float(np.linalg.norm(shift))
    for address in ("wrist_position_mm", "joint_error_mm", "largest_joint_error_mm"):
        got = figures(measures, address)
        assert got.mean == pytest.approx(length, abs=ROUNDING_MM)
        assert got.sd == pytest.approx(0.0, abs=ROUNDING_MM)
    assert figures(measures, "wrist_rotation_deg").max == pytest.approx(0.0, abs=1e-6)
    assert figures(measures, "angle_error_deg").max == 0.0


@relaxed
@given(SEEDS, SEEDS, SEEDS)
def test_errors_do_not_depend_on_where_the_camera_is(seed: int, other: int, motion: int) -> None:
    rng = np.random.default_rng(motion)
    turn = rotations.canonical(rng.standard_normal(4))
    shift = 300.0 * rng.standard_normal(3)
    estimate, truth = random_hand(4, seed), random_hand(4, other)
    here, _ = measure(estimate, truth)
    there, _ = measure(moved(estimate, turn, shift), moved(truth, turn, shift))
    for address in ("joint_error_mm", "wrist_position_mm", "wrist_rotation_deg", "angle_error_deg"):
        np.testing.assert_allclose(there.series[address], here.series[address], atol=1e-5)
