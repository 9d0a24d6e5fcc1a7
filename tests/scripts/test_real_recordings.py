"""The parts of the study about real recordings, on made-up ones of their kind."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.evaluation.evaluate import EvalOptions, evaluate
from posetrack_cli.hand.anatomy import ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.run import RunOptions, run_record
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results import Estimate, ResultWriter, Status, Subject
from reproduction.accuracy import real
from reproduction.accuracy.measuring import Measured
from reproduction.accuracy.options import Options
from reproduction.accuracy.real import HeadMounted, Kinect
from reproduction.made import command
from reproduction.running import Targets
from support.cvar import make_folder as make_annotated
from support.viewing import make_folder, make_recording, truth_of

FRAMES = 6


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return open_recording(make_recording(tmp_path_factory.mktemp("made") / "made.mcap", FRAMES))


def judged(targets: Targets) -> dict[str, tuple[str, str]]:
    return {what: (measured, said) for what, _, measured, said in targets.rows}


def write_result(path: Path, recording: Recording, estimates: Iterable[Estimate]) -> None:
    """A result of a recording whose frames have these estimates, whatever their stamps were."""
    camera = recording.cameras[0]
    record = run_record(recording, camera, HandConfig(), RunOptions(path), "none")
    subject = Subject("hand", camera.name, ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)
    with ResultWriter(path, subject, camera, record) as writer:
        for message in recording.truth():
            writer.add_truth(message)
        for frame, estimate in zip(recording.frames(), estimates, strict=True):
            writer.write(replace(estimate, frame_index=frame.index, stamp_ns=frame.stamp_ns))
        writer.finish({})


def test_a_recording_without_truth(tmp_path: Path, made: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    """The estimates are the truth; from frame 4 on they say that they are lost."""
    make_folder(tmp_path / "images", made, camera=False)
    camera = made.cameras[0]
    intrinsics = "".join(f"{name} = {getattr(camera, name)}\n" for name in ("fx", "fy", "cx", "cy"))
    monkeypatch.setattr(real, "KINECT_CAMERA", intrinsics)
    chosen, targets = Options(tmp_path, kinect=tmp_path / "images"), Targets()
    chosen.runs.mkdir()
    (task,) = Kinect().tasks(chosen)
    command(*task.recording, str(tmp_path / "in.mcap"))
    result = task.result(chosen.runs, "hand")
    estimates = [replace(e, status=Status.LOST) if e.frame_index >= 4 else e for e in truth_of(made)]
    write_result(result, open_recording(tmp_path / "in.mcap"), estimates)
    text = "\n".join(Kinect().lines(chosen, Measured(chosen.runs), targets))
    overlap = evaluate(result, EvalOptions(recording=tmp_path / "in.mcap")).series["region_overlap"]
    said = judged(targets)
    assert said["Kinect: starts within 5 frames"] == ("1", "reached")
    assert said["Kinect: no unrecovered loss"] == ("lost at the end", "**missed**")
    assert said["Kinect: region overlap, median"][0] == f"{np.median(overlap):.3f}"
    assert said["Kinect: region overlap in 95 % of frames"][0] == f"{np.percentile(overlap, 5):.3f}"
    assert "| lost frames | 2 of 6 |" in text
    for name in ("kinect2-hand.png", "kinect2-hand-overlap.png"):
        assert name in text and (tmp_path / name).exists()


def test_annotated_recordings(tmp_path: Path, made: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hand and joints that stand still are apart by constants alone, which are taken out whole here."""
    monkeypatch.setattr("posetrack_cli.evaluation.joint_offsets.MOST_MM", np.inf)
    for name in real.CVAR_SEQUENCES:
        make_annotated(tmp_path / name)
    chosen, targets = Options(tmp_path / "out", cvar=tmp_path), Targets()
    chosen.runs.mkdir(parents=True)
    still = next(iter(truth_of(made)))
    for task in HeadMounted().tasks(chosen):
        recording = tmp_path / f"{task.name}.mcap"
        command(*task.recording, str(recording))
        write_result(task.result(chosen.runs, "hand"), open_recording(recording), [still] * 3)
    text = "\n".join(HeadMounted().lines(chosen, Measured(chosen.runs), targets))
    said = judged(targets)
    assert said["P1: mean joint error after offsets, mm"] == ("0.0", "reached")
    assert said["P4: frames tracked"] == ("100.0 %", "reached")
    assert "cvar-curve.png" in text and (chosen.output / "cvar-curve.png").exists()
