"""The study of scripts/reproduce heads-strangers: what it makes, measures and says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.cli.head_mono import head_mono
from posetrack_cli.cli.head_stereo import head_stereo
from posetrack_cli.evaluation.metrics.head_metrics import HEAD_POSE
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry.euler import head_quaternion_from_roll_pitch_yaw, head_roll_pitch_yaw
from reproduction import heads_strangers
from reproduction.head_strangers import adjusting, measuring, mono
from reproduction.head_strangers.options import Options
from reproduction.one_camera.measuring import Compared
from reproduction.running import Targets
from support.heads import FRAME_NS, heads_folder, judged, pose

FRAMES = 100


def compared(yaw_gain: float) -> Compared:
    """A result whose yaw is seen with a gain, and which is 4 deg off for the first two seconds, then 1."""
    true = np.array([pose(index).quaternion for index in range(FRAMES)])
    angles = head_roll_pitch_yaw(true)
    angles[:, 2] *= yaw_gain
    seen = head_quaternion_from_roll_pitch_yaw(angles)
    position = np.array([pose(index).position for index in range(FRAMES)])
    stamps, lost = np.arange(FRAMES) * FRAME_NS, np.zeros(FRAMES, dtype=np.bool_)
    tracks = [
        Track(
            "t",
            "head",
            (),
            (),
            (),
            stamp_ns=stamps,
            lost=lost,
            position=position,
            quaternion=quaternion,
            points=position[:, None] + np.array([0.0, offset, 0.0]),
        )
        for quaternion, offset in ((seen, 7.0), (true, 0.0))
    ]
    off = np.where(np.arange(FRAMES) < measuring.EARLY_FRAMES, 4.0, 1.0)
    ones = np.ones((FRAMES, 6))
    return Compared(*tracks, ~lost, ~lost, ones, off, off, ones, ones, 1.0)


def test_early_errors_and_the_gain_of_yaw_are_told() -> None:
    found = measuring.shares(compared(0.9))
    assert (found["early_deg"], found["late_deg"], found["early_ratio"]) == (4.0, 1.0, 4.0)
    assert found["yaw_gain"] == pytest.approx(0.9)


def test_points_are_compared_in_the_first_tracked_image(tmp_path: Path) -> None:
    camera = measuring.cameras_of(heads_folder(tmp_path, "p") / "p" / "calibration.json")[0]
    tracked = np.arange(FRAMES) > 2
    one = replace(compared(1.0), tracked=tracked)
    depth = pose(3).position[2]
    np.testing.assert_allclose(
        measuring.first_points(one, camera), [[0.0, camera.fy * 7.0 / depth]], atol=1e-9
    )


def test_what_a_detector_does_with_other_people_is_removed_and_nothing_of_ones_own() -> None:
    others = np.array([[[1.0, 0.0]], [[3.0, 0.0]], [[8.0, 3.0]]])
    np.testing.assert_allclose(
        measuring.without_others(others), [[np.hypot(4.5, 1.5)], [1.5 * np.sqrt(2.0)], [np.hypot(6.0, 3.0)]]
    )
    np.testing.assert_allclose(measuring.without_others(others[2:]), [[np.hypot(8.0, 3.0)]])


def test_every_step_is_a_command_that_is_understood_and_tracks_everybody(tmp_path: Path) -> None:
    folder = heads_folder(tmp_path, "person-c", "person-d")
    options = Options(tmp_path / "out", folder)
    steps = [step for part in heads_strangers.PARTS for chain in part.chains(options) for step in chain.steps]
    commands = {"mono": head_mono, "stereo": head_stereo}
    for step in steps:
        subject, name, *rest = step.command(tmp_path)
        assert subject == "head"
        commands[name].make_context(name, rest)
    assert len({step.output for step in steps}) == len(steps) == 2 * (1 + 1 + 2 + len(adjusting.ENTRANTS) + 1)
    told = next(step for step in steps if "--interpupillary-mm" in step.arguments)
    assert told.arguments[-1] == "63.00"  # of the mean face
    left_out = replace(options, left_out=tmp_path)
    (step, *_) = next(chain for chain in mono.Mono().chains(left_out) if "person-d" in chain.name).steps
    assert step.arguments[-2:] == ("--face-model", str(tmp_path / "person-d-model.npz"))
    assert f"start.detection.features={tmp_path / 'person-d-features.npz'}" in step.arguments
    alone = replace(options, only=("person-d",))
    assert [one.name for one in alone.everybody] == ["person-d"]


def person(error: float, factor: float, confidence: float) -> measuring.Judged:
    figures = dict.fromkeys(HEAD_POSE, error) | {"factor": factor, "early_ratio": 1.0, "tracked": 1.0}
    wrong = np.full(10, error > measuring.WRONG_DEG)
    inside = np.zeros((10, 6), dtype=np.bool_)
    inside[:8] = True
    return measuring.Judged(
        figures, np.zeros((10, 2)), np.full(10, confidence), wrong, inside, np.ones(10, dtype=np.bool_)
    )


def test_strangers_are_judged_together() -> None:
    targets = Targets()
    people = {"c": person(0.3, 1.0, 0.9), "d": person(0.3, 1.2, 0.9), "e": person(9.0, 0.8, 0.1)}
    mono.judge_strangers(people, targets)
    mono.judge_honesty(people, "mono", measuring.Measured(Path("nowhere")), targets)
    said = judged(targets)
    assert said["depth factors"] == ("2 outside", "**missed**")
    assert said["yaw, deg, median person"] == ("0.30", "reached")
    assert said["z, mm, worst person"] == ("9.00", "reached")
    assert said["yaw, deg, worst person"] == ("9.00", "**missed**")
    assert said["90 % intervals hold, all"] == ("80.0 %", "reached")
    assert said["confidence against rotation > 3 deg, ROC area"] == ("1.000", "reached")


def test_nothing_measured_is_said_to_be_so(tmp_path: Path) -> None:
    options, targets = Options(tmp_path, tmp_path), Targets()
    assert list(mono.Mono().lines(options, measuring.Measured(tmp_path), targets))
    assert {said for _, _, _, said in targets.rows} == {"not measured"}
