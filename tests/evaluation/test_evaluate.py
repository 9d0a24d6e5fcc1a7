"""Whole evaluations of result files: values, reasons, notes and losses, from files written here."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import PosetrackError, ResultError, TruthError, UsageError
from posetrack_cli.evaluation.measuring.catalogue import CATALOGUE, addresses, is_measured, metric_of
from posetrack_cli.evaluation.measuring.evaluate import (
    DEFAULT_OPTIONS,
    NO_RECORDING,
    NO_TRUTH,
    EvalOptions,
    evaluate,
)
from posetrack_cli.evaluation.measuring.evaluation import Evaluation, Statistics
from posetrack_cli.evaluation.measuring.subjects import KINDS
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results import (
    ESTIMATE_SCHEMA_NAME,
    Estimate,
    Result,
    ResultWriter,
    Status,
    Subject,
    estimate_to_json,
)
from support.metrics import SINGLE_MM
from support.truth import CAMERA, HAND, HEAD, estimates, pose_columns, write_csv, write_result

MS = 1_000_000
SHIFT = np.array([2.0, 3.0, 6.0])
"""7 mm long."""


def truths(own: Sequence[Estimate], subject: str = "hand") -> list[TruthMessage]:
    """Estimates as the truth that a result carries."""
    topic = f"/truth/{subject}/estimate"
    messages = ((one.stamp_ns, estimate_to_json(one)) for one in own)
    return [
        TruthMessage(topic, ESTIMATE_SCHEMA_NAME, "jsonschema", b"{}", "json", stamp, data)
        for stamp, data in messages
    ]


def shifted(own: Sequence[Estimate], by: np.ndarray = SHIFT) -> list[Estimate]:
    return [replace(one, position=one.position + by, points=one.points + by) for one in own]


def at(own: Sequence[Estimate], offset_ns: int) -> list[Estimate]:
    return [replace(one, stamp_ns=one.stamp_ns + offset_ns) for one in own]


def mean(evaluation: Evaluation, address: str) -> float:
    value = evaluation.metrics[address]
    assert isinstance(value, Statistics), address
    return value.mean


def is_complete(evaluation: Evaluation) -> bool:
    """Every address is measured or has a reason, none both, all in the order of the catalogue."""
    track = evaluation.track
    known = addresses(evaluation.subject, track.point_names, track.shape_names)
    measured, absent = list(evaluation.metrics), list(evaluation.absent)
    assert sorted([*measured, *absent]) == sorted(known)
    assert measured == [address for address in known if address in evaluation.metrics]
    assert all(evaluation.absent.values())
    for address, value in evaluation.metrics.items():
        assert metric_of(address).scalar == isinstance(value, float), address
        assert not isinstance(value, Statistics) or value.count > 0, address
    assert all(len(series) == len(evaluation.series_stamp_ns) for series in evaluation.series.values())
    assert set(evaluation.series) <= set(evaluation.metrics)
    return True


def test_a_result_with_its_own_truth(tmp_path: Path) -> None:
    true = estimates(HAND, 10)
    path = write_result(tmp_path / "shifted.mcap", HAND, shifted(true), truths(true))
    got = evaluate(path)
    assert (got.name, got.path, got.subject) == ("shifted", path, "hand")
    assert mean(got, "joint_error_mm") == pytest.approx(7.0)
    assert mean(got, "joint_error_mm.index_tip") == pytest.approx(7.0)
    assert mean(got, "wrist_position_mm") == pytest.approx(7.0)
    assert mean(got, "angle_error_deg") == 0.0
    assert mean(got, "velocity_error_mm_s") == 0.0
    variances = np.array([one.pose_variance[:3] for one in true])
    assert mean(got, "nees") == pytest.approx((SHIFT**2 / variances).sum(axis=1).mean())
    assert (got.metrics["coverage"], got.metrics["matched"]) == (1.0, 10.0)
    assert got.metrics["frames_within_10mm"] == 1.0
    assert got.curve is not None
    assert got.curve.share[7:9].tolist() == [0.0, 1.0]
    assert got.series_stamp_ns.tolist() == [one.stamp_ns for one in true]
    assert (got.notes, got.losses) == ((), ())
    assert got.absent["residual_mm"] == NO_RECORDING
    assert is_complete(got)


def test_truth_from_a_file_has_precedence(tmp_path: Path) -> None:
    true = estimates(HAND, 6)
    path = write_result(tmp_path / "a.mcap", HAND, true, truths(true))
    other = write_result(tmp_path / "b.mcap", HAND, shifted(true))
    got = evaluate(path, EvalOptions(truth=other))
    assert mean(got, "joint_error_mm") == pytest.approx(7.0)
    assert mean(evaluate(path), "joint_error_mm") == 0.0


def test_lost_and_missing_frames_are_seen(tmp_path: Path) -> None:
    true = estimates(HAND, 20)
    own = [
        replace(one, status=Status.LOST) if one.frame_index in (4, 5) else one
        for one in true
        if one.frame_index not in (10, 11, 12)
    ]
    got = evaluate(write_result(tmp_path / "a.mcap", HAND, own, truths(true[:19])))
    assert {name: got.metrics[name] for name in ("frames", "tracked", "lost", "matched", "unmatched")} == {
        "frames": 17.0,
        "tracked": 15.0,
        "lost": 2.0,
        "matched": 16.0,
        "unmatched": 1.0,
    }
    assert got.metrics["missed"] == 3.0
    assert got.metrics["coverage"] == pytest.approx(14 / 20)
    assert got.metrics["frames_within_10mm"] == pytest.approx(16 / 19)  # the unmatched one is not due
    assert got.metrics["gaps"] == 1.0
    assert is_complete(got)


def test_without_truth_it_is_measured_by_itself(tmp_path: Path) -> None:
    got = evaluate(write_result(tmp_path / "a.mcap", HAND, estimates(HAND, 7, lost=[6])))
    assert got.truth is None
    assert got.pairs is None
    assert got.curve is None
    for metric in CATALOGUE:
        if metric.group in ("accuracy", "velocity", "covariance") and is_measured(metric, KINDS["hand"]):
            assert got.absent[metric.name] == NO_TRUTH
    assert got.metrics["coverage"] == pytest.approx(6 / 7)
    assert got.absent["missed"] == NO_TRUTH
    assert mean(got, "cost_mm") == pytest.approx((4.0 + 7.0 + 10.0) / 3)
    assert got.metrics["status_changes"] == 1.0
    assert len(got.series_stamp_ns) == 7
    np.testing.assert_array_equal(got.series["ess"], 100.0 + np.arange(7))
    assert got.notes == ()
    assert is_complete(got)


def test_the_truth_of_another_subject_is_none(tmp_path: Path) -> None:
    true = estimates(HAND, 3)
    got = evaluate(write_result(tmp_path / "a.mcap", HAND, true, truths(true, "head")))
    assert got.truth is None
    assert got.absent["joint_error_mm"] == NO_TRUTH


def test_a_truth_of_other_joints_is_refused(tmp_path: Path) -> None:
    true = estimates(HAND, 3)
    fewer = [replace(one, points=one.points[1:]) for one in true]
    with pytest.raises(TruthError, match="different number of shape entries or points"):
        evaluate(write_result(tmp_path / "a.mcap", HAND, true, truths(fewer)))


def test_images_are_looked_at_when_the_recording_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_result(tmp_path / "a.mcap", HAND, estimates(HAND, 3))
    asked: list[object] = []
    nan = np.nan
    answers: list[dict[str, np.ndarray]] = [
        {"residual_mm": np.array([1.0, nan, 3.0]), "region_overlap": np.array([0.5, 0.0, 1.0])},
        {},
        {"residual_mm": np.full(3, nan), "region_overlap": np.array([0.0, nan, 0.0])},
    ]

    def image_consistency(result: Result, recording: object, which: str) -> dict[str, np.ndarray]:
        assert which == "filtered"
        asked.append((result.path, recording))
        return answers[len(asked) - 1]

    monkeypatch.setattr(
        "posetrack_cli.evaluation.measuring.image_consistency.image_consistency", image_consistency
    )
    monkeypatch.setattr(
        "posetrack_cli.evaluation.reading.recording_of.required_recording",
        lambda result, given: ("opened", given),
    )
    options = EvalOptions(recording=tmp_path / "recording.mcap")
    found, nothing, apart = (evaluate(path, options) for _ in answers)
    assert asked == [(path, ("opened", options.recording))] * 3
    assert (mean(found, "residual_mm"), mean(found, "region_overlap")) == (2.0, 0.5)
    assert nothing.absent["residual_mm"] == "the recording has none of the result's frames"
    assert apart.absent["residual_mm"] == "the estimate overlaps the observed hand in no frame"
    assert mean(apart, "region_overlap") == 0.0
    np.testing.assert_array_equal(found.series["residual_mm"], [1.0, nan, 3.0])
    np.testing.assert_array_equal(apart.series["region_overlap"], [0.0, nan, 0.0])
    assert "residual_mm" not in apart.series
    np.testing.assert_array_equal(found.track_series["residual_mm"], [1.0, nan, 3.0])
    assert all(map(is_complete, (found, nothing, apart)))


def test_another_recording_is_an_error(tmp_path: Path) -> None:
    path = write_result(tmp_path / "a.mcap", HAND, estimates(HAND, 3))
    with pytest.raises(PosetrackError, match=r"nowhere\.mcap"):
        evaluate(path, EvalOptions(recording=tmp_path / "nowhere.mcap"))


def test_an_empty_result_has_reasons_and_coverage_0(tmp_path: Path) -> None:
    true = estimates(HAND, 3)
    for messages in ([], truths(true)):
        path = tmp_path / f"empty{len(messages)}.mcap"
        got = evaluate(write_result(path, HAND, [], messages))
        assert got.metrics["coverage"] == 0.0
        assert got.metrics["frames"] == 0.0
        assert got.absent["ess"] == "the result has no estimates"
        assert got.absent["joint_error_mm"] == ("the result has no estimates" if messages else NO_TRUTH)
        assert is_complete(got)


def test_one_frame_is_enough(tmp_path: Path) -> None:
    true = estimates(HAND, 1)
    got = evaluate(write_result(tmp_path / "a.mcap", HAND, shifted(true), truths(true)))
    assert mean(got, "joint_error_mm") == pytest.approx(7.0)
    assert got.absent["jitter_mm"] == "fewer than three consecutive frames"
    assert got.absent["largest_gap_s"] == "fewer than two frames"
    assert is_complete(got)


def test_when_no_stamp_matches_the_nearest_is_told(tmp_path: Path) -> None:
    true = estimates(HAND, 5)
    path = write_result(tmp_path / "a.mcap", HAND, true, truths(at(true, 12 * MS)))
    got = evaluate(path)
    reason = (
        "no estimate has ground truth within 5 ms, the nearest is 12 ms away; "
        "see --truth-tolerance-ms and --time-offset-s"
    )
    assert got.notes == (reason,)
    assert got.absent["joint_error_mm.wrist"] == reason
    assert (got.metrics["coverage"], got.metrics["unmatched"]) == (0.0, 5.0)
    assert is_complete(got)
    assert evaluate(path, EvalOptions(tolerance_ms=12.0)).metrics["matched"] == 5.0
    assert evaluate(path, EvalOptions(time_offset_s=-0.012)).metrics["matched"] == 5.0


def test_another_clock_is_told_in_seconds(tmp_path: Path) -> None:
    true = estimates(HAND, 5)
    path = write_result(tmp_path / "a.mcap", HAND, true, truths(at(true, 1_700_000_000 * 1000 * MS)))
    got = evaluate(path)
    assert "the nearest is 1699999999.867 s away" in got.notes[0]  # from the last of five frames
    assert evaluate(path, EvalOptions(time_offset_s=-1.7e9)).metrics["matched"] == 5.0


def test_a_truth_without_velocity_or_angles_has_reasons(tmp_path: Path) -> None:
    own = estimates(HAND, 5)
    true = [replace(one, pose_rate=None, twist=None, twist_variance=None) for one in own]
    path = write_result(tmp_path / "a.mcap", HAND, own, truths(true))
    got = evaluate(path)
    assert got.absent["velocity_error_mm_s"] == "the ground truth has no velocity"
    assert got.absent["velocity_nees"] == "the ground truth has no velocity"
    assert mean(got, "nees") == 0.0
    csv = write_csv(tmp_path / "poses.csv", pose_columns(true))
    got = evaluate(path, EvalOptions(truth=csv))
    assert got.absent["joint_error_mm"] == "the ground truth has no points"
    assert got.absent["joint_error_mm.wrist"] == "the ground truth has no points"
    assert got.absent["frames_within_20mm"] == "the ground truth has no points"
    assert got.absent["angle_error_deg"] == "the ground truth has no finger angles"
    assert got.curve is None
    assert mean(got, "wrist_position_mm") == 0.0
    assert is_complete(got)


def test_a_head(tmp_path: Path) -> None:
    true = estimates(HEAD, 8)
    path = write_result(tmp_path / "head.mcap", HEAD, shifted(true), truths(true, "head"))
    got = evaluate(path)
    means = [mean(got, f"{axis}_mm") for axis in "xyz"]
    assert means == pytest.approx(SHIFT)
    assert mean(got, "position_mm") == pytest.approx(7.0)
    assert mean(got, "yaw_deg") == 0.0
    assert mean(got, "point_error_mm.nose") == pytest.approx(0.0, abs=SINGLE_MM)
    assert "joint_error_mm" not in {**got.metrics, **got.absent}
    assert is_complete(got)


def test_a_constant_offset_is_removed_and_said_so(tmp_path: Path) -> None:
    true = estimates(HEAD, 8)
    path = write_result(tmp_path / "head.mcap", HEAD, true, truths(true, "head"))
    rng = np.random.default_rng(1)
    dots = [replace(one, points=one.points + rng.standard_normal((3, 3))) for one in true]
    other = write_result(tmp_path / "other.mcap", HEAD, dots)
    plain = evaluate(path, EvalOptions(truth=other))
    aligned = evaluate(path, EvalOptions(truth=other, align="rigid+points"))
    assert plain.notes == ()
    assert "removed constant rigid offset" in aligned.notes[0]
    assert "each point" in aligned.notes[0]
    assert mean(aligned, "point_error_mm") < mean(plain, "point_error_mm")


def test_an_unfinished_run_is_measured_over_what_it_holds(tmp_path: Path) -> None:
    true = estimates(HAND, 25)
    path = tmp_path / "a.mcap"
    with ResultWriter(path, HAND, CAMERA, {}) as writer:
        for message in truths(true):
            writer.add_truth(message)
        for one in shifted(true):
            writer.write(one)
    part = tmp_path / "a.mcap.part"
    os.truncate(part, part.stat().st_size * 9 // 10)  # as a killed writer leaves it
    got = evaluate(part)
    assert got.name == "a"
    assert got.notes[0] == "unfinished run: evaluated over the frames written so far"
    assert got.losses
    assert 0 < got.metrics["frames"] < 25
    assert mean(got, "joint_error_mm") == pytest.approx(7.0)
    assert is_complete(got)


def test_what_the_run_itself_lost_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with ResultWriter(path, HAND, CAMERA, {}) as writer:
        for one in estimates(HAND, 2):
            writer.write(one)
        writer.finish({"losses": "frames without any reading: 3, first frame 7"})
    got = evaluate(path)
    assert got.notes == (
        "part of the run's input was unusable: frames without any reading: 3, first frame 7",
    )
    assert got.losses == ()


def test_a_truth_that_is_damaged_is_a_loss(tmp_path: Path) -> None:
    true = estimates(HAND, 40)
    path = write_result(tmp_path / "a.mcap", HAND, true)
    other = write_result(tmp_path / "b.mcap", HAND, true)
    os.truncate(other, other.stat().st_size * 2 // 3)
    got = evaluate(path, EvalOptions(truth=other))
    assert [loss.what.startswith(f"ground truth {other.name}: ") for loss in got.losses] == [True]
    assert 0 < got.metrics["matched"] < 40


def test_nothing_else_has_metrics(tmp_path: Path) -> None:
    foot = Subject("foot", "camera", (), ("toe",), (-1,))
    path = write_result(tmp_path / "a.mcap", foot, estimates(foot, 2))
    with pytest.raises(ResultError, match=r"a.mcap: no metrics for this subject, found subject 'foot'"):
        evaluate(path)


def test_the_truth_is_of_the_same_subject(tmp_path: Path) -> None:
    hand = write_result(tmp_path / "a.mcap", HAND, estimates(HAND, 2))
    head = write_result(tmp_path / "b.mcap", HEAD, estimates(HEAD, 2))
    with pytest.raises(TruthError, match="wrong subject"):
        evaluate(hand, EvalOptions(truth=head))


@pytest.mark.parametrize("content", [None, b"", b"text", b"\x89MCAP0\r\n"])
def test_what_is_no_result_is_one_line(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "ünï cödé.mcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PosetrackError, match=r"ünï cödé\.mcap") as caught:
        evaluate(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"tolerance_ms": -1.0}, "tolerance out of range, found -1.0 ms, expected 0 to 1e9 ms"),
        ({"tolerance_ms": float("nan")}, "tolerance out of range"),
        ({"tolerance_ms": float("inf")}, "tolerance out of range"),
        ({"time_offset_s": float("nan")}, "time offset out of range"),
        ({"align": "points"}, "unknown alignment, found 'points', expected one of none, rigid, rigid.points"),
    ],
)
def test_options_that_cannot_be_meant(values: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        EvalOptions(**values)  # type: ignore[arg-type]


def test_a_tolerance_is_exact_in_nanoseconds() -> None:
    assert DEFAULT_OPTIONS.tolerance_ns == 5 * MS
    assert EvalOptions(tolerance_ms=0.1).tolerance_ns == 100_000
    assert EvalOptions(tolerance_ms=0.0).tolerance_ns == 0


def test_measuring_loads_no_drawing_and_no_compiler(tmp_path: Path) -> None:
    """A compiler takes .3 s and 100 MiB; metrics of joints need their derivatives, too."""
    own = estimates(HAND, 3)
    path = write_result(tmp_path / "a.mcap", HAND, own, truths(own))
    code = (
        "import sys, pathlib, numpy; from posetrack_cli.evaluation.measuring.evaluate import evaluate; "
        "from posetrack_cli.hand.model import anatomy, kinematics; evaluate(pathlib.Path(sys.argv[1])); "
        "kinematics.joint_jacobian(anatomy.make_anatomy(), numpy.ones((1, 22))); "
        "print([name for name in sys.modules if 'evaluation.viewing' in name or 'evaluation.html' in name "
        "or name in ('numba', 'scipy', 'cv2')])"
    )
    command = [sys.executable, "-c", code, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
