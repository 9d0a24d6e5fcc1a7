"""Tracks of two hands and heads against the ground truth of two: assignment, switches, missed and false."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.errors import ResultError
from posetrack_cli.evaluation.judging.assessment import Request, assess
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions, evaluate
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.results.writer import ResultWriter
from support.eval_command import truth_message
from support.truth import CAMERA, HAND, HEAD, estimates

FRAMES = 40


def moving(subject, from_mm: float, to_mm: float, *, lost: Sequence[int] = (), off_mm: float = 0.0):
    """A subject that moves along x, 800 mm away, with the points of one frame around it."""
    like = estimates(subject, FRAMES, lost=lost)
    around = 0.3 * like[0].points
    moved = []
    for one, x in zip(like, np.linspace(from_mm, to_mm, FRAMES), strict=True):
        place = np.array([x + off_mm, 0.0, 800.0])
        moved.append(replace(one, position=place, points=around + place, quaternion=like[0].quaternion))
    return moved


def written(
    path: Path,
    tracks: Mapping[str, Sequence[Estimate]],
    truths: Mapping[str, Sequence[Estimate]],
    subject=HAND,
) -> Path:
    subjects = [replace(subject, label=label) for label in tracks]
    with ResultWriter(path, subjects, CAMERA, {"tracker": subject.name, "input.sha256": "aa"}) as writer:
        for index in range(FRAMES):
            for label, truth in truths.items():
                topic = "/".join(filter(None, (f"/truth/{subject.name}", label, "estimate")))
                writer.add_truth(truth_message(topic, truth[index]))
            writer.write_frame([track[index] for track in tracks.values()])
        writer.finish({})
    return path


def crossing(subject=HAND):
    return moving(subject, -200.0, 200.0), moving(subject, 200.0, -200.0)


def measured(path: Path, label: str) -> dict[str, float]:
    return dict(evaluate(path, EvalOptions(label=label)).metrics)  # type: ignore[arg-type]


def test_named_tracks_meet_the_ground_truth_of_their_name(tmp_path: Path) -> None:
    left, right = crossing()
    off = moving(HAND, 200.0, -200.0, off_mm=7.0)
    path = written(tmp_path / "r.mcap", {"left": left, "right": off}, {"right": right, "left": left})
    for label, error in {"left": 0.0, "right": 7.0}.items():
        found = evaluate(path, EvalOptions(label=label))
        assert found.metrics["joint_error_mm"].mean == pytest.approx(error)  # type: ignore[union-attr]
        assert found.metrics["identity_switches"] == found.metrics["false_tracks"] == 0
        assert found.name == "r"


def test_numbered_tracks_are_assigned_by_distance_and_swaps_are_counted(tmp_path: Path) -> None:
    one, two = crossing(HEAD)
    path = written(tmp_path / "r.mcap", {"1": two, "2": one}, {"1": one, "2": two}, HEAD)
    assert all(measured(path, label)["identity_switches"] == 0 for label in "12")
    assert evaluate(path, EvalOptions(label="2")).metrics["point_error_mm"].max == 0.0  # type: ignore[union-attr]
    half = FRAMES // 2
    bounced = {"1": [*one[:half], *two[half:]], "2": [*two[:half], *one[half:]]}
    path = written(tmp_path / "swapped.mcap", bounced, {"1": one, "2": two}, HEAD)
    assert sum(measured(path, label)["identity_switches"] for label in "12") == 2


def test_missed_and_false_tracks_are_counted_and_pooled(tmp_path: Path) -> None:
    one, two = crossing(HEAD)
    elsewhere = moving(HEAD, 700.0, 700.0)
    path = written(tmp_path / "r.mcap", {"1": elsewhere, "2": one}, {"1": one, "2": two}, HEAD)
    found = assess(Request(results=(path,)))
    assert [one.name for one in found.evaluations] == ["r 1", "r 2"]
    pooled = found.pools[0].metrics
    assert (pooled["false_tracks"], pooled["missed_tracks"], pooled["frames"]) == (1, 1, 2 * FRAMES)
    assert "no track of: 2" in found.evaluations[0].notes
    assert found.comparison is None


def test_a_single_track_is_assigned_to_one_of_several_subjects(tmp_path: Path) -> None:
    one, two = crossing(HEAD)
    found = evaluate(written(tmp_path / "r.mcap", {"": two}, {"1": one, "2": two}, HEAD))
    assert found.metrics["point_error_mm"].max == 0.0  # type: ignore[union-attr]
    assert found.metrics["missed_tracks"] == 1


def test_lost_frames_are_no_switches(tmp_path: Path) -> None:
    one, two = crossing(HEAD)
    hidden = [replace(e, status=Status.LOST) if 15 < e.frame_index < 25 else e for e in two]
    path = written(tmp_path / "r.mcap", {"1": one, "2": hidden}, {"1": one, "2": two}, HEAD)
    assert measured(path, "2")["identity_switches"] == 0
    assert measured(path, "2")["lost"] == 9


def test_eval_prints_each_track_and_the_pool(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, right = crossing()
    path = written(tmp_path / "r.mcap", {"left": left, "right": right}, {"left": left, "right": right})
    out = tmp_path / "evaluated.mcap"
    assert run(["eval", str(path), "--mcap", str(out), "--html", str(tmp_path / "r.html")]) == 0
    shown = capsys.readouterr().out
    assert "r left" in shown
    assert "pooled" in shown
    topics = {channel.topic for _, channel in McapFile(out).channels()}
    assert {"/eval/hand/left", "/eval/hand/right"} <= topics
    assert run(["eval", str(path), "--of", "left"]) == 0
    assert "r right" not in capsys.readouterr().out
    assert run(["eval", str(path), "--of", "up"]) == 1


def test_one_track_must_be_chosen_in_python(tmp_path: Path) -> None:
    left, right = crossing()
    path = written(tmp_path / "r.mcap", {"left": left, "right": right}, {})
    with pytest.raises(ResultError, match="has several tracks"):
        evaluate(path)
