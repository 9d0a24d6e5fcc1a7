"""True joints inside the intervals that follow from a pose's: drawn errors, and what cannot be told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError
from posetrack_cli.evaluation.measuring import hand_metrics as module
from posetrack_cli.evaluation.measuring.hand_metrics import METRICS, joints_by_pose, propagated
from posetrack_cli.evaluation.measuring.measures import Matched, Measures
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.hand.model.anatomy import JOINT_NAMES, HandAnatomy, make_anatomy
from posetrack_cli.hand.model.kinematics import joint_jacobian, joint_positions
from support.metrics import NOTHING, all_pairs, number
from support.tracks import hand_track, random_hand

DRAWS = 2000
LINEAR = 0.01
"""What a first-order approximation may change a share by, of errors of 0.01 rad and mm."""


def drawn(seed: int = 0, sd: float = 0.01) -> tuple[Track, Track]:
    """Estimates with Gaussian errors of the stated sd in every entry, and the truth that does not move."""
    rng = np.random.default_rng(seed)
    pose = np.zeros(22)
    pose[2], pose[6], pose[7:] = 600.0, 1.0, 0.2
    moved = np.repeat(pose[None], DRAWS, axis=0)
    steps = rng.normal(0.0, sd, (DRAWS, 21))
    moved[:, :3] += steps[:, :3]
    moved[:, 3:6], moved[:, 7:] = steps[:, 3:6] / 2, pose[7:] + steps[:, 6:]  # a small turn w: (w / 2, 1)
    moved[:, 6] = np.sqrt(1.0 - (moved[:, 3:6] ** 2).sum(axis=1))
    return hand(moved, np.full((DRAWS, 21), sd**2)), hand(np.repeat(pose[None], DRAWS, axis=0), None)


def hand(poses: FloatArray, variance: FloatArray | None) -> Track:
    plain = hand_track("hand", len(poses), 0.0)
    return replace(
        plain,
        position=poses[:, :3],
        quaternion=poses[:, 3:7],
        shape=poses[:, 7:],
        points=joint_positions(make_anatomy(), poses),
        pose_variance=variance,
    )


def measured(estimate: Track, truth: Track, anatomy: object = make_anatomy) -> Measures:
    measures = Measures(NOTHING)
    joints_by_pose(measures, Matched(estimate, truth, all_pairs(len(estimate))), anatomy)  # type: ignore[arg-type]
    return measures


@pytest.mark.parametrize("percent", [50, 90])
def test_intervals_hold_as_often_as_they_say(percent: int) -> None:
    measures = measured(*drawn())
    share = percent / 100
    tolerance = 4.0 * np.sqrt(share * (1.0 - share) / DRAWS) + LINEAR
    names = [f"joint_inside_{percent}.{name}" for name in JOINT_NAMES]
    # three coordinates of one draw hang together: as if there were one
    for address in (f"joint_inside_{percent}", *names):
        assert number(measures, address) == pytest.approx(share, abs=tolerance)
    assert measures.counts[f"joint_inside_{percent}"].of == DRAWS * 21 * 3


def test_intervals_that_are_too_narrow_or_too_wide_are_found_out() -> None:
    estimate, truth = drawn()
    assert estimate.pose_variance is not None
    narrow = measured(replace(estimate, pose_variance=estimate.pose_variance / 16.0), truth)
    wide = measured(replace(estimate, pose_variance=estimate.pose_variance * 16.0), truth)
    assert number(narrow, "joint_inside_90") < 0.4 and number(wide, "joint_inside_50") > 0.98


def test_the_wrist_s_variances_are_those_of_the_position() -> None:
    track = random_hand(7, 3)
    assert track.position is not None and track.quaternion is not None and track.shape is not None
    poses, variances = np.hstack([track.position, track.quaternion, track.shape]), track.pose_variance
    assert variances is not None
    jacobian = joint_jacobian(make_anatomy(), poses)
    np.testing.assert_allclose(propagated(jacobian, variances)[:, 0], variances[:, :3])


def test_long_tracks_are_worked_off_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    estimate, truth = random_hand(11, 1), random_hand(11, 2)
    whole = measured(estimate, truth)
    monkeypatch.setattr(module, "BLOCK_FRAMES", 4)
    assert measured(estimate, truth).metrics == whole.metrics


def test_a_truth_of_some_joints_is_compared_by_name() -> None:
    estimate, truth = drawn()
    assert truth.points is not None
    some = [20, 0, 8]
    part = replace(truth, points=truth.points[:, some], point_names=tuple(JOINT_NAMES[k] for k in some))
    measures, whole = measured(estimate, part), measured(estimate, truth)
    for name in part.point_names:
        assert measures.metrics[f"joint_inside_90.{name}"] == whole.metrics[f"joint_inside_90.{name}"]
    assert measures.counts["joint_inside_90"].of == DRAWS * 3 * 3


def test_what_no_pose_can_be_is_outside_and_no_error() -> None:
    estimate, truth = drawn()
    assert estimate.position is not None and estimate.points is not None
    position, points = estimate.position.copy(), estimate.points.copy()
    position[: DRAWS // 2], points[: DRAWS // 2] = 1e308, np.nan
    measures = measured(replace(estimate, position=position, points=points), truth)
    assert number(measures, "joint_inside_90") == pytest.approx(0.45, abs=0.05)


def unknown_bones() -> HandAnatomy:
    raise ResultError("hand file of the run not found")


@pytest.mark.parametrize(
    ("change", "of_truth", "reason"),
    [
        ({"pose_variance": None}, {}, "the result has no pose with covariance"),
        ({"point_names": ("a",) * 21}, {}, "the result has other joints or angles than the hand model"),
        ({"shape_names": ("a",) * 15}, {}, "the result has other joints or angles than the hand model"),
        ({}, {"points": None}, "the ground truth has no points"),
        ({}, {"point_names": ("a",) * 21}, "the ground truth has other joints"),
    ],
)
def test_what_cannot_be_told_has_a_reason(
    change: dict[str, object], of_truth: dict[str, object], reason: str
) -> None:
    estimate, truth = random_hand(3, 1), random_hand(3, 2)
    measures = measured(replace(estimate, **change), replace(truth, **of_truth), unknown_bones)  # type: ignore[arg-type]
    assert {measures.absent[name] for name in METRICS} == {reason} and not measures.metrics


def test_bones_that_are_not_known_are_a_reason_and_no_error() -> None:
    measures = measured(random_hand(3, 1), random_hand(3, 2), unknown_bones)
    reason = "unknown hand anatomy: hand file of the run not found"
    assert {measures.absent[name] for name in METRICS} == {reason}
