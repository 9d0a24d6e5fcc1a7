"""A smoothed run over drawn hands: nearer to the truth than filtered, and the same after an interruption."""

from __future__ import annotations

import filecmp
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.run import HandRun, RunOptions
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results import load_arrays
from posetrack_cli.results.topics import TRACKS, estimate_topic
from posetrack_cli.tracking.smoothing import smoothing_path
from support.hand_scene import HANDS, Drawn, Stage, closing_hand, pose_file

COUNT = 12
CONFIG = HandConfig.model_validate(
    {"hand": {"side": "right"}, "output": {"mesh": "none", "flush_frames": 3}, "filter": {"particles": 16}}
)


@pytest.fixture(scope="module")
def drawn(device: RenderingDevice) -> Drawn:
    return Drawn.of(Stage(device, HANDS["right"]), closing_hand(COUNT))


@pytest.fixture
def track(device: RenderingDevice, tmp_path: Path, drawn: Drawn) -> Callable[..., Path]:
    pose = pose_file(tmp_path / "start.json", closing_hand(COUNT)[0])

    def run(name: str, stopped: Callable[[], bool] = lambda: False, **options: Any) -> Path:
        chosen = RunOptions(tmp_path / name, init=str(pose), smooth=True, **options)
        HandRun(drawn, CONFIG, chosen, device).track(lambda estimate: None, stopped)
        return tmp_path / name

    return run


def test_smoothed_joints_are_nearer_to_the_truth(device: RenderingDevice, track: Callable[..., Path]) -> None:
    path, stage = track("r.mcap"), Stage(device, HANDS["right"])
    errors = []
    for name in TRACKS:
        found = load_arrays(path, estimate_topic("hand", name))
        estimated = np.hstack([found["position"], found["quaternion"], found["shape"]])
        errors.append(
            np.mean([stage.error(e, p) for e, p in zip(estimated, closing_hand(COUNT), strict=True)])
        )
    assert errors[0] < 3.0
    assert errors[1] < 0.95 * errors[0]
    assert not smoothing_path(path).exists()


def test_an_interrupted_run_smooths_to_the_same_bytes(track: Callable[..., Path]) -> None:
    """It stops two frames past a checkpoint; what they left behind is dropped."""
    whole = track("whole.mcap")
    asked = iter(range(1, 100))
    stopped = track("r.mcap", lambda: next(asked) >= 8)
    assert smoothing_path(stopped).exists()
    assert filecmp.cmp(whole, track("r.mcap", resume=True), shallow=False)
