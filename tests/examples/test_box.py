"""A third subject goes the whole way with what hands and heads go it with: the seams hold."""

from __future__ import annotations

import filecmp
import json
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from examples.box import BOX, CAMERA, BoxRun, BoxSettings, true_pose, write_boxes
from posetrack_cli.cli.main import run
from posetrack_cli.evaluation.measuring.subjects import KINDS
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results import read_result
from posetrack_cli.tracking.options import RunOptions
from support.codecs import assert_lawful
from support.numpy_renderer import NumpyDevice

FRAMES = 12
CORNER_MM = 12.0
"""A pixel shows 6.7 mm at 600 mm, and a box's six numbers rest on some 400 of them; the filter adds what its
400 particles leave between them: a few mm. A box that is lost is 100 mm away after a second."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory, device: RenderingDevice) -> Path:
    path = tmp_path_factory.mktemp("boxes") / "boxes.mcap"
    write_boxes(path, FRAMES, device)
    return path


@pytest.fixture(scope="module")
def result(recording: Path, device: RenderingDevice) -> Path:
    path = recording.with_name("result.mcap")
    track(recording, path, device)
    return path


def track(
    recording: Path, output: Path, device: RenderingDevice, stop_after: int = FRAMES + 1, **options: bool
) -> None:
    seen: list[int] = []
    made = BoxRun(
        open_recording(recording), BoxSettings(), RunOptions(output, **options), device, true_pose(0)
    )
    made.track(lambda estimate: seen.append(estimate.frame_index), lambda: len(seen) >= stop_after)


def test_a_box_is_tracked_and_its_result_explains_itself(result: Path) -> None:
    read = read_result(result)
    estimates = list(read.estimates())
    assert read.subject.name == "box" and len(estimates) == FRAMES
    assert read.camera().width == CAMERA.width


def test_an_interrupted_run_goes_on_to_the_same_bytes(
    recording: Path, result: Path, device: RenderingDevice, tmp_path: Path
) -> None:
    other = tmp_path / "result.mcap"
    track(recording, other, device, stop_after=7)
    assert not other.exists()
    track(recording, other, device, resume=True)
    assert filecmp.cmp(result, other, shallow=False)


def test_it_is_measured_by_the_command_line(
    result: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(KINDS, "box", BOX)
    report = tmp_path / "report.json"
    assert run(["eval", str(result), "--json", str(report), "--html", str(tmp_path / "report.html")]) == 0
    (figures,) = [one["metrics"] for one in json.loads(report.read_text())["results"]]
    assert figures["coverage"]["value"] == 1.0
    assert figures["corner_error_mm"]["mean"] < CORNER_MM


def test_it_is_drawn_by_the_command_line(recording: Path, result: Path, tmp_path: Path) -> None:
    sheet = tmp_path / "sheet.png"
    assert (
        run(["view", str(result), "--recording", str(recording), "--select", "spread:3", "-o", str(sheet)])
        == 0
    )
    assert sheet.stat().st_size > 1000


def test_its_states_obey_the_laws_and_another_renderer_serves(recording: Path) -> None:
    opened = open_recording(recording)
    settings = BoxSettings(particles=4)
    made = BoxRun(opened, settings, RunOptions(Path("unused.mcap")), NumpyDevice(), true_pose(0))
    frames: Iterator = opened.frames()
    with closing(frames):
        first = next(frames)
    state = made.start_state(first, np.random.default_rng(0))
    state, estimate = made.tracker.step(state, first, np.random.default_rng(0))
    assert_lawful(made.tracker.codec, state)
    assert np.isfinite(estimate.position).all()
