"""The worst frames of a result as pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.errors import RenderingError
from posetrack_cli.evaluation.measuring.evaluate import evaluate
from posetrack_cli.evaluation.viewing.drawing import TRUTH
from posetrack_cli.evaluation.viewing.pictures import worst_frame_pictures
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results import Estimate
from support.viewing import lost_from, make_recording, make_result, moved, truth_of

FRAMES = 75  # two and a half seconds
WORST = {70: 30.0, 69: 29.0, 20: 60.0, 40: 5.0}
"""Frame to error, mm. Frame 69 is of the same moment as 70, and 40 is nearer than a second to both others."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return open_recording(make_recording(tmp_path_factory.mktemp("made") / "hand.mcap", FRAMES))


def worse(estimate: Estimate) -> Estimate:
    return moved(WORST.get(estimate.frame_index, 0.0))(estimate)


def decoded(png: bytes) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture


def test_the_worst_frames_come_first_with_their_errors(tmp_path: Path, recording: Recording) -> None:
    path = make_result(tmp_path / "r.mcap", recording, worse, with_truth=True)
    pictures = worst_frame_pictures(evaluate(path), recording, 8)
    stamps = [truth.stamp_ns for truth in truth_of(recording)]
    assert [picture.frame_index for picture in pictures[:2]] == [20, 70]
    assert [picture.stamp_ns for picture in pictures[:2]] == [stamps[20], stamps[70]]
    seconds = [(stamps[frame] - stamps[0]) * 1e-9 for frame in (20, 70)]
    assert (
        pictures[0].caption == f"frame 20, {seconds[0]:.3f} s, tracking, joint error 60.0 mm, confidence 0.75"
    )
    assert (
        pictures[1].caption == f"frame 70, {seconds[1]:.3f} s, tracking, joint error 30.0 mm, confidence 0.75"
    )


def test_pictures_show_the_hand_and_the_truth_beside_it(tmp_path: Path, recording: Recording) -> None:
    path = make_result(tmp_path / "r.mcap", recording, worse, with_truth=True)
    pictures = [decoded(p.png) for p in worst_frame_pictures(evaluate(path), recording, 2)]
    assert pictures[0].shape == pictures[1].shape, "a page lays them out in a grid"
    observed, over = np.hsplit(pictures[0], 2)
    green = (np.abs(over.astype(int) - TRUTH) <= 2).all(axis=2)
    assert green.sum() > 200 and not (np.abs(observed.astype(int) - TRUTH) <= 2).all(axis=2).any()


def test_without_truth_lost_frames_and_high_costs_are_worst(tmp_path: Path, recording: Recording) -> None:
    costs = {3: 20.0, 36: 30.0}

    def change(estimate: Estimate) -> Estimate:
        return lost_from(72)(replace(estimate, cost=costs.get(estimate.frame_index, 1.0)))

    pictures = worst_frame_pictures(
        evaluate(make_result(tmp_path / "r.mcap", recording, change)), recording, 3
    )
    assert [picture.frame_index for picture in pictures] == [72, 36, 3]
    assert pictures[0].caption.endswith("lost, confidence 0.75, cost 1.0 mm")
    assert pictures[1].caption.endswith("tracking, confidence 0.75, cost 30.0 mm")
    first = np.hsplit(decoded(pictures[0].png), 2)[1]
    assert first[0].tolist() == [[60, 60, 255]] * first.shape[1], "a lost frame has a red border"


def test_frames_that_the_recording_lacks_are_left_out(tmp_path: Path, recording: Recording) -> None:
    path = make_result(tmp_path / "r.mcap", recording, worse, with_truth=True)
    short = open_recording(make_recording(tmp_path / "short.mcap", 30))
    assert [p.frame_index for p in worst_frame_pictures(evaluate(path), short, 2)] == [20]


def test_none_are_asked_for_or_there_are_none(tmp_path: Path, recording: Recording) -> None:
    evaluation = evaluate(make_result(tmp_path / "r.mcap", recording))
    assert worst_frame_pictures(evaluation, recording, 0) == []
    empty = make_result(tmp_path / "e.mcap", recording, keep=lambda estimate: False)
    assert worst_frame_pictures(evaluate(empty), recording, 3) == []


def test_no_renderer_is_told(tmp_path: Path, recording: Recording) -> None:
    evaluation = evaluate(make_result(tmp_path / "r.mcap", recording))
    with pytest.raises(RenderingError):
        worst_frame_pictures(evaluation, recording, 1, device=99)
