"""Which frames are right, and what confidence and status say of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.evaluation.measuring.honesty import JudgedFrames
from posetrack_cli.evaluation.measuring.measures import Matched, Measures
from posetrack_cli.evaluation.measuring.subjects import KINDS
from posetrack_cli.evaluation.measuring.without_truth import (
    ALL_RIGHT,
    ALL_WRONG,
    HONESTY,
    NO_CONFIDENCE,
    OF_CONFIDENCE,
    honesty_metrics,
    judged_frames,
)
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry import rotations
from support.metrics import NOTHING, all_pairs, measure, number
from support.tracks import hand_track, random_head

UP = np.array([0.0, 1.0, 0.0])


def judge(estimate: Track, truth: Track) -> tuple[Measures, JudgedFrames | None]:
    measures, _ = measure(estimate, truth)
    matched = Matched(estimate, truth, all_pairs(len(estimate)))
    judged = judged_frames(measures, matched, KINDS[estimate.subject])
    if judged is not None:
        honesty_metrics(measures, judged)
    return measures, judged


def hand_off_by(*errors_mm: float, **changes: object) -> tuple[Track, Track]:
    """A hand whose joints are all off by so much in each frame, and its truth."""
    truth = hand_track("truth", len(errors_mm), 0.0)
    assert truth.position is not None and truth.points is not None
    away = np.array(errors_mm)[:, None] * UP
    return (
        replace(truth, position=truth.position + away, points=truth.points + away[:, None], **changes),
        truth,
    )


def test_hands_are_right_to_20_mm_and_far_off_beyond_40() -> None:
    lost = np.array([False, True, False, True, False, False])
    confidence = np.array([0.9, 0.7, 0.8, 0.1, 0.2, 0.75])
    measures, judged = judge(
        *hand_off_by(1.0, 19.9, 20.1, 41.0, 39.9, 41.0, lost=lost, confidence=confidence)
    )
    assert judged is not None
    assert judged.right.tolist() == [True, True, False, False, False, False]
    assert judged.far.tolist() == [False, False, False, True, False, True]
    assert judged.right_if == "mean joint error at most 20 mm"
    assert judged.far_if == "mean joint error above 40 mm"
    assert number(measures, "frames_wrong") == pytest.approx(4 / 6)
    assert number(measures, "frames_far_tracked") == pytest.approx(1 / 6)  # the other far one says it is lost
    assert number(measures, "frames_right_lost") == pytest.approx(1 / 2)
    # pairs of right 0.9, 0.7 and wrong 0.8, 0.1, 0.2, 0.75: all four, then two
    assert number(measures, "confidence_roc_area") == pytest.approx(6 / 8)
    assert measures.counts["frames_right_lost"].of == 2


def test_heads_are_right_to_3_degrees_and_5_mm_of_their_points() -> None:
    truth = random_head(5)
    assert truth.quaternion is not None and truth.points is not None and truth.position is not None
    turns = np.radians([0.0, 2.9, 3.1, 0.0, 10.1])[:, None] * UP
    quaternion = rotations.canonical(rotations.multiply(truth.quaternion, rotations.exponential(turns)))
    in_head = rotations.rotate(
        rotations.conjugate(truth.quaternion)[:, None], truth.points - truth.position[:, None]
    )
    off = in_head + np.array([0.0, 4.9, 0.0, 5.1, 0.0])[:, None, None] * UP
    points = rotations.rotate(quaternion[:, None], off) + truth.position[:, None]
    sure = np.array([0.9, 0.8, 0.3, 0.7, 0.1])
    estimate = replace(truth, quaternion=quaternion, points=points, confidence=sure)
    measures, judged = judge(estimate, truth)
    assert judged is not None
    assert judged.right.tolist() == [True, True, False, False, False]
    assert judged.far.tolist() == [False] * 4 + [True]
    assert judged.right_if == "rotation error at most 3 deg and mean point error at most 5 mm"
    assert number(measures, "frames_far_tracked") == pytest.approx(1 / 5)
    assert number(measures, "confidence_roc_area") == 1.0
    _, without_points = judge(estimate, replace(truth, points=None))
    assert without_points is not None
    assert without_points.right.tolist() == [True, True, False, True, False]
    assert without_points.right_if == "rotation error at most 3 deg"


@pytest.mark.parametrize(
    ("changes", "reason"), [({"quaternion": None}, "the ground truth has no rotation"), ({}, None)]
)
def test_what_nothing_judges_by_has_no_figure(changes: dict[str, None], reason: str | None) -> None:
    estimate, truth = random_head(4, 1), replace(random_head(4, 2), **changes)  # type: ignore[arg-type]
    measures, judged = judge(estimate, truth)
    assert (judged is None) == (reason is not None)
    if reason is not None:
        assert {measures.absent[name] for name in HONESTY} == {reason}
        assert not set(HONESTY) & set(measures.metrics)


@pytest.mark.parametrize(
    ("error_mm", "reason"), [(1.0, ALL_RIGHT), (30.0, ALL_WRONG)], ids=["all right", "all wrong"]
)
def test_frames_of_one_kind_tell_nothing_apart(error_mm: float, reason: str) -> None:
    measures, _ = judge(*hand_off_by(error_mm, error_mm))
    assert measures.absent["confidence_roc_area"] == reason
    assert ("frames_right_lost" in measures.metrics) == (reason == ALL_RIGHT)
    right = 1.0 if reason == ALL_RIGHT else 0.0  # the track says 0.8
    assert number(measures, "confidence_brier_score") == pytest.approx((0.8 - right) ** 2)
    assert number(measures, "confidence_calibration_error") == pytest.approx(abs(0.8 - right))


def test_no_frame_at_all_has_reasons() -> None:
    estimate, truth = hand_off_by()
    measures, judged = judge(estimate, truth)
    assert judged is None and {measures.absent[name] for name in HONESTY} == {NOTHING}


def test_frames_without_confidence_are_judged_by_their_status_alone() -> None:
    measures, _ = judge(*hand_off_by(1.0, 50.0, confidence=None))
    assert {measures.absent[name] for name in OF_CONFIDENCE} == {NO_CONFIDENCE}
    assert number(measures, "frames_far_tracked") == 0.5
    half = np.array([0.4, np.nan])
    measures, _ = judge(*hand_off_by(1.0, 50.0, confidence=half))
    assert number(measures, "confidence_brier_score") == pytest.approx(0.36)
    assert measures.absent["confidence_roc_area"] == ALL_RIGHT


@pytest.mark.parametrize("absurd", [1e308, -0.1, 1.1, np.inf, np.nan])
def test_what_is_no_probability_is_no_confidence(absurd: float) -> None:
    stated = np.array([0.9, absurd, 0.2])
    measures, judged = judge(*hand_off_by(1.0, 50.0, 30.0, confidence=stated))
    assert judged is not None and judged.scored[0].tolist() == [0.9, 0.2]
    assert number(measures, "confidence_brier_score") == pytest.approx((0.01 + 0.04) / 2)


def test_frames_whose_error_is_unknown_are_not_judged() -> None:
    estimate, truth = hand_off_by(1.0, 50.0, 30.0)
    assert truth.points is not None
    points = truth.points.copy()
    points[1, 3] = np.nan
    _, judged = judge(estimate, replace(truth, points=points))
    assert judged is not None and judged.right.tolist() == [True, False]


def test_a_kind_without_limits_is_not_judged() -> None:
    estimate, truth = hand_off_by(1.0)
    measures, _ = measure(estimate, truth)
    kind = replace(KINDS["hand"], right={}, far={})
    assert judged_frames(measures, Matched(estimate, truth, all_pairs(1)), kind) is None
    assert not set(HONESTY) & set(measures.absent)
