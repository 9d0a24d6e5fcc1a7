"""A smoothed run over drawn hands: nearer to the truth than filtered, and the same after an interruption."""

from __future__ import annotations

import filecmp
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.run import HandRun, RunOptions, smoothing_path
from posetrack_cli.losses import Loss
from posetrack_cli.recording.base import Frame, TruthMessage
from posetrack_cli.results import load_arrays
from posetrack_cli.results.tracks import TRACKS, estimate_topic
from support.hand import KINECT
from support.hand_scene import HANDS, Stage, relaxed

FRAME_NS, COUNT = 33_333_333, 12
CONFIG = HandConfig.model_validate(
    {"hand": {"side": "right"}, "output": {"mesh": "none", "flush_frames": 3}, "filter": {"particles": 16}}
)


def poses() -> list[FloatArray]:
    """A hand that comes nearer, turns and closes two fingers, ever faster."""
    out = []
    for t in np.linspace(0.0, 1.0, COUNT):
        pose = relaxed(x=40.0 * t * t, z=650.0 - 30.0 * t, turn=(0.15, -0.2 + 0.3 * t * t, 0.1))
        pose[[10, 12, 13, 15]] += 0.6 * t * t
        out.append(pose)
    return out


@dataclass(frozen=True)
class Drawn:
    """A recording of drawn hands with the noise of a sensor."""

    depths: tuple[np.ndarray, ...]
    path: Path = Path("/somewhere/drawn.mcap")
    losses: tuple[Loss, ...] = ()

    @property
    def cameras(self) -> tuple[Camera, ...]:
        return (KINECT,)

    @property
    def frame_count(self) -> int:
        return len(self.depths)

    def identity(self) -> Mapping[str, str]:
        return {"name": "drawn.mcap", "sha256": "0" * 64}

    def frames(self, *, start: int = 0, end: int | None = None, stride: int = 1) -> Iterator[Frame]:
        for k in range(start, len(self.depths) if end is None else end, stride):
            yield Frame(k, k * FRAME_NS, (self.depths[k],))

    def truth(self) -> Iterator[TruthMessage]:
        return iter(())


@pytest.fixture(scope="module")
def drawn(context: Any) -> Drawn:
    stage, rng = Stage(context, HANDS["right"]), np.random.default_rng(4)
    return Drawn(
        tuple((stage.depth(p) + rng.normal(0.0, 3.0, (424, 512))).astype(np.float32) for p in poses())
    )


@pytest.fixture
def track(context: Any, tmp_path: Path, drawn: Drawn) -> Callable[..., Path]:
    first = poses()[0]
    start = {"position_mm": first[:3], "quaternion_xyzw": first[3:7], "angles_rad": first[7:]}
    pose = tmp_path / "start.json"
    pose.write_text(json.dumps({name: list(values) for name, values in start.items()}))

    def run(name: str, stopped: Callable[[], bool] = lambda: False, **options: Any) -> Path:
        chosen = RunOptions(tmp_path / name, init=str(pose), smooth=True, **options)
        HandRun(drawn, CONFIG, chosen, context).track(lambda estimate: None, stopped)
        return tmp_path / name

    return run


def test_smoothed_joints_are_nearer_to_the_truth(context: Any, track: Callable[..., Path]) -> None:
    path, stage = track("r.mcap"), Stage(context, HANDS["right"])
    errors = []
    for name in TRACKS:
        found = load_arrays(path, estimate_topic("hand", name))
        estimated = np.hstack([found["position"], found["quaternion"], found["shape"]])
        errors.append(np.mean([stage.error(e, p) for e, p in zip(estimated, poses(), strict=True)]))
    assert errors[0] < 3.0
    assert errors[1] < 0.9 * errors[0]
    assert not smoothing_path(path).exists()


def test_an_interrupted_run_smooths_to_the_same_bytes(track: Callable[..., Path]) -> None:
    """It stops two frames past a checkpoint; what they left behind is dropped."""
    whole = track("whole.mcap")
    asked = iter(range(1, 100))
    stopped = track("r.mcap", lambda: next(asked) >= 8)
    assert smoothing_path(stopped).exists()
    assert filecmp.cmp(whole, track("r.mcap", resume=True), shallow=False)
