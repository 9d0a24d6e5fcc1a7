"""``posetrack hand run --filter pso``: the optimiser through the same command, result and evaluation."""

from __future__ import annotations

import filecmp
import sys
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.cli.running import progress
from posetrack_cli.evaluation.measuring.evaluate import evaluate
from posetrack_cli.evaluation.measuring.evaluation import Statistics
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.run import HandRun, RunOptions
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.rendering.devices import open_fastest_device
from posetrack_cli.results import load_arrays, read_result
from support.terminal import Terminal

FRAMES = 10
SWARM = {"particles": 32, "generations": 12}
OPTIONS = ["--filter", "pso", "--particles", "32", "--set", "pso.generations=12"]
RIGHT = ["--hand-side", "right"]
FLUSHING = ["--set", "output.flush_frames=2", "--end", "6"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("synth") / "hand.mcap"
    assert run(["hand", "synth", "--frames", str(FRAMES), "--seed", "3", "--no-drops", "-o", str(path)]) == 0
    return path


def track(recording: Path, output: Path, *more: str) -> int:
    told = [*RIGHT, "--init", str(recording)]
    return run(["hand", "run", str(recording), "-o", str(output), *told, *OPTIONS, *more])


@pytest.fixture(scope="module")
def result(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("result") / "r.mcap"
    assert track(recording, path) == 0
    return path


def test_it_tracks_from_the_true_start(result: Path) -> None:
    """hand.md: 11 mm with 64 x 25 of the plain swarm; a quarter of that budget over ten frames, 20 mm."""
    measured = evaluate(result)
    errors = measured.metrics["joint_error_mm"]
    assert measured.coverage.share == 1.0
    assert isinstance(errors, Statistics) and errors.mean < 20.0


def test_what_it_evaluated_is_counted_and_what_it_does_not_know_is_left_out(result: Path) -> None:
    arrays = load_arrays(result)
    assert arrays["evaluations"].tolist() == [32 * 12 + 1] * FRAMES
    for unknown in ("pose_variance", "effective_sample_size"):
        assert np.isnan(arrays[unknown]).all()
    assert np.isfinite(arrays["twist"]).all() and (arrays["twist_variance"] > 0.0).all()
    measured = evaluate(result)
    evaluations = measured.metrics["evaluations"]
    assert isinstance(evaluations, Statistics) and evaluations.mean == 385.0
    assert measured.metrics["particles"] == 32.0
    assert measured.absent["ess"] == "the tracker does not use weighted particles"
    assert measured.absent["nees"] == "the result has no covariance"


@pytest.mark.parametrize("command", ["info", "eval", "export"])
def test_every_command_reads_the_result(result: Path, tmp_path: Path, command: str) -> None:
    more = ["-o", str(tmp_path / "r.csv")] if command == "export" else []
    assert run([command, str(result), *more]) == 0


def test_the_shipped_configuration_is_the_default_swarm(recording: Path, tmp_path: Path) -> None:
    """Both ways to ask for it give the same bytes."""
    first, second = tmp_path / "a.mcap", tmp_path / "b.mcap"
    common = [str(recording), "--end", "1", "--init", str(recording), *RIGHT]
    assert run(["hand", "run", *common, "-o", str(first), "--filter", "pso"]) == 0
    assert run(["hand", "run", *common, "-o", str(second), "--config", "hand-pso"]) == 0
    assert filecmp.cmp(first, second, shallow=False)
    assert load_arrays(first)["evaluations"].tolist() == [64 * 25 + 1]


def test_an_interrupted_run_resumes_to_the_same_bytes(recording: Path, result: Path, tmp_path: Path) -> None:
    output, seen = tmp_path / "r.mcap", list[int]()
    flushing = {"flush_frames": 2}
    tables = {
        "hand": {"side": "right", "count": "1"},
        "filter": {"kind": "pso", "particles": 32},
        "pso": SWARM,
    }
    config = HandConfig.model_validate(tables)
    assert HandConfig.model_validate_json(read_result(result).run["configuration"]) == config
    whole = tmp_path / "whole.mcap"
    assert track(recording, whole, *FLUSHING) == 0
    config = config.model_copy(update={"output": config.output.model_copy(update=flushing)})
    options = RunOptions(output, init=str(recording), end=6)
    with closing(open_fastest_device()) as device:  # as the command does
        stopped = HandRun(open_recording(recording), config, options, device).track(
            lambda estimate: seen.append(estimate.frame_index), lambda: len(seen) == 3
        )
    assert stopped.stopped and stopped.frames == 3
    assert track(recording, output, *FLUSHING, "--resume") == 0
    assert filecmp.cmp(output, whole, shallow=False)


def test_the_progress_bar_shows_no_particles_where_none_are_weighted(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress(10, 0, 1, "hand") as report:
        report(SimpleNamespace(frame_index=3, effective_sample_size=None, status="tracking"))
    (shown,) = terminal.lines
    assert " 4/10 [" in shown and shown.endswith("frame/s, tracking]")


def test_a_swarm_that_would_not_converge_is_one_line(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "r.mcap"
    assert track(recording, output, "--set", "pso.cognitive=1") == 1
    assert "would not converge" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
