"""A truth that looks like one of something else is noted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from posetrack_cli.evaluation.measuring.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.evaluation.reading.truth_tables import truth_warnings
from posetrack_cli.results.reader import read_result
from posetrack_cli.results.writer import ResultWriter
from support.tracks import hand_track
from support.truth import CAMERA, HAND, estimates


def result_of(path: Path, recording: str | None) -> Path:
    run = {"tracker": "hand"} | ({} if recording is None else {"input.sha256": recording})
    with ResultWriter(path, HAND, CAMERA, run) as writer:
        for one in estimates(HAND, 5):
            writer.write(one)
        writer.finish({})
    return path


@pytest.mark.parametrize(
    ("mine", "its", "noted"),
    [("aa", "bb", True), ("aa", "aa", False), (None, "bb", False), ("aa", None, False)],
)
def test_estimates_from_another_recording_are_noted(
    tmp_path: Path, mine: str | None, its: str | None, noted: bool
) -> None:
    own, other = result_of(tmp_path / "own.mcap", mine), result_of(tmp_path / "other.mcap", its)
    notes = evaluate(own, EvalOptions(truth=other)).notes
    said = "the ground truth other.mcap is of another recording than the result"
    assert notes == ((said,) if noted else ())


def scaled(track: Track, factor: float, *, points: bool) -> Track:
    """The track in other units; of a truth of points alone there is no position."""
    assert track.points is not None and track.position is not None
    position = None if points else factor * track.position
    return replace(track, position=position, points=factor * track.points)


@pytest.mark.parametrize("points", [False, True])
@pytest.mark.parametrize(("factor", "noted"), [(1e-3, True), (1.1e-3, True), (1.0, False), (0.1, False)])
def test_a_truth_in_metres_is_noted(tmp_path: Path, factor: float, noted: bool, points: bool) -> None:
    result = read_result(result_of(tmp_path / "own.mcap", "aa"))
    track, truth = hand_track("own", 9, 5.0), scaled(hand_track("truth", 9, 0.0), factor, points=points)
    notes = list(truth_warnings(result, track, truth, None))
    assert [note.startswith("the ground truth may be in metres") for note in notes] == (
        [True] if noted else []
    )


def test_what_tells_no_distance_is_not_doubted(tmp_path: Path) -> None:
    result = read_result(result_of(tmp_path / "own.mcap", "aa"))
    track, truth = hand_track("own", 3, 5.0), hand_track("truth", 3, 0.0)
    rotations = replace(truth, position=None, points=None)
    assert list(truth_warnings(result, track, rotations, None)) == []
    assert list(truth_warnings(result, track, hand_track("empty", 0, 0.0), None)) == []
