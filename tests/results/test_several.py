"""Results of several subjects: two hands, written by the writer directly."""

from __future__ import annotations

import csv
import filecmp
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.outputs import part_path
from posetrack_cli.results import Checkpoint, Estimate, ResultWriter, Status, read_result
from posetrack_cli.results.messages import FrameTransforms, Odometry
from support.results import CAMERA, RUN, SUBJECT, make_estimate, make_vertices

LEFT, RIGHT = (replace(SUBJECT, label=label) for label in ("left", "right"))
FRAMES = 23


def both(index: int) -> tuple[Estimate, Estimate]:
    left = make_estimate(index)
    return left, replace(make_estimate(index + 500), frame_index=index, stamp_ns=left.stamp_ns)


def add_frames(writer: ResultWriter, first: int, last: int) -> None:
    for index in range(first, last):
        flushed = writer.write_frame(both(index), (make_vertices(index), make_vertices(index + 500)))
        if flushed:
            writer.save_checkpoint(Checkpoint(index, writer.frames_written))


def written(path: Path, *, smoothed: bool = False) -> Path:
    with ResultWriter(path, (LEFT, RIGHT), CAMERA, RUN, flush_frames=4) as writer:
        add_frames(writer, 0, FRAMES)
        for subject in range(2) if smoothed else ():
            for index in reversed(range(FRAMES)):
                writer.write_smoothed(both(index)[subject], make_vertices(index), subject)
        writer.finish({})
    return path


def test_each_subject_has_its_own_topics_and_frames(tmp_path: Path) -> None:
    path = written(tmp_path / "two.mcap", smoothed=True)
    topics = [channel.topic for _, channel in McapFile(path).channels()]
    assert len(set(topics)) == len(topics)
    for prefix in ("/hand/left", "/hand/right", "/smoothed/hand/left", "/smoothed/hand/right"):
        assert {f"{prefix}/{name}" for name in ("estimate", "odometry", "joint_states", "scene")} <= {*topics}
    items = list(McapFile(path).messages(["/tf"]))
    frames = {FrameTransforms.FromString(item[2].data).transforms[0].child_frame_id for item in items}
    assert frames == {"hand_left", "hand_right"}
    bodies = {
        Odometry.FromString(m.data).body_frame_id
        for _, _, m in McapFile(path).messages(["/hand/left/odometry"])
    }
    assert bodies == {"hand_left"}


def test_parts_read_like_results_of_one_subject(tmp_path: Path) -> None:
    result = read_result(written(tmp_path / "two.mcap", smoothed=True))
    assert result.labels == ("left", "right")
    for number, part in enumerate(result.parts):
        expected = np.array([both(index)[number].position for index in range(FRAMES)])
        assert np.array_equal(part.to_numpy()["position"], expected)
        assert np.array_equal(part.to_numpy("smoothed")["position"], expected)
        lost = sum(both(index)[number].status is Status.LOST for index in range(FRAMES))
        assert result.summary[f"{part.subject.label}.lost"] == str(lost)
    assert result.of("right").subject.label == "right"


def test_a_result_of_several_subjects_asks_for_one(tmp_path: Path) -> None:
    result = read_result(written(tmp_path / "two.mcap"))
    with pytest.raises(ResultError, match=r"has several tracks.*left, right.*--of"):
        result.to_numpy()
    with pytest.raises(ResultError, match=r"has no track 'up'.*'left', 'right'"):
        result.of("up")
    with pytest.raises(ResultError, match="a single track"):
        replace(result, subjects=(SUBJECT,)).of("left")


def test_labels_must_be_unique_and_simple(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="unique labels"):
        ResultWriter(tmp_path / "r.mcap", (LEFT, LEFT), CAMERA, RUN)
    with pytest.raises(ResultError, match="unique labels"):
        ResultWriter(tmp_path / "r.mcap", (LEFT, SUBJECT), CAMERA, RUN)
    with pytest.raises(ResultError, match="invalid subject label"):
        replace(SUBJECT, label="a/b")


def test_all_estimates_of_a_frame_are_required(tmp_path: Path) -> None:
    with ResultWriter(tmp_path / "r.mcap", (LEFT, RIGHT), CAMERA, RUN) as writer:
        with pytest.raises(ResultError, match="not of one frame"):
            writer.write(make_estimate(0))
        with pytest.raises(ResultError, match="not of one frame"):
            writer.write_frame((make_estimate(0), make_estimate(1)))


def test_a_resumed_result_equals_an_uninterrupted_one(tmp_path: Path) -> None:
    whole, path = written(tmp_path / "whole.mcap"), tmp_path / "r.mcap"
    with ResultWriter(path, (LEFT, RIGHT), CAMERA, RUN, flush_frames=4) as writer:
        add_frames(writer, 0, 14)
    assert len(list(read_result(part_path(path)).of("left").estimates())) == 14
    with pytest.raises(UsageError, match=r"another run|has no posetrack"):
        ResultWriter.resume(path, (LEFT, replace(RIGHT, colour=(0, 0, 0, 1))), CAMERA, RUN, flush_frames=4)
    writer, checkpoint = ResultWriter.resume(path, (LEFT, RIGHT), CAMERA, RUN, flush_frames=4)
    with writer:
        assert writer.frames_written == 12
        add_frames(writer, checkpoint.frame_index + 1, FRAMES)
        writer.finish({})
    assert filecmp.cmp(whole, path, shallow=False)


def test_export_writes_every_track(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path / "two.mcap")
    assert run(["export", str(path)]) == 0
    rows = list(csv.DictReader(capsys.readouterr().out.splitlines()))
    assert [row["track"] for row in rows] == ["left"] * FRAMES + ["right"] * FRAMES
    assert float(rows[FRAMES]["x_mm"]) == both(0)[1].position[0]
    for ending in ("npz", "tum", "mcap", "json"):
        assert run(["export", str(path), "-o", str(tmp_path / f"out.{ending}")]) == 0
        assert {file.name for file in tmp_path.glob(f"out*.{ending}")} == {
            f"out-left.{ending}",
            f"out-right.{ending}",
        }
    with np.load(tmp_path / "out-right.npz") as arrays:
        assert np.array_equal(arrays["position"][3], both(3)[1].position)
    assert run(["export", str(path), "--format", "tum"]) == 2
    assert run(["export", str(path), "--format", "tum", "--of", "left"]) == 0
    assert run(["export", str(path), "--schemas", "protobuf", "-o", str(tmp_path / "all.mcap")]) == 0
    topics = {channel.topic for _, channel in McapFile(tmp_path / "all.mcap").channels()}
    assert {"/hand/left/estimate", "/hand/right/estimate"} <= topics
    assert run(["export", str(path), "-o", str(tmp_path / "study" / "sub-01_task-reach_motion.tsv")]) == 0
    motions = {file.name for file in (tmp_path / "study").rglob("*_motion.tsv")}
    assert motions == {f"sub-01_task-reach_tracksys-hand{side}_motion.tsv" for side in ("left", "right")}


def test_info_lists_every_track(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(written(tmp_path / "two.mcap"))]) == 0
    shown = capsys.readouterr().out
    assert "topic /hand/left/estimate" in shown
    assert "metadata posetrack.subject.right" in shown
