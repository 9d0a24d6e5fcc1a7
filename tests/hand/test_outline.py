"""A frame in which nothing supports a hand is lost, however well its surface fits one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.hand.run import make_tracker
from posetrack_cli.hand.start import centre_pose
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results.estimate import Status
from support.hand import KINECT
from support.hand_scene import HANDS, Stage, relaxed

HAND = HANDS["right"]
FRAME_NS = 33_333_333
V, U = np.mgrid[: KINECT.height, : KINECT.width]


def noise(sd: float, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, sd, V.shape)


def with_holes(depth: np.ndarray, share: float) -> np.ndarray:
    return np.where(np.random.default_rng(2).random(depth.shape) < share, 0.0, depth)


WALL = np.full(V.shape, 650.0)
HANDLESS = {
    "wall": WALL,
    "noisy wall": WALL + noise(5.0),
    "wall with holes": with_holes(WALL, 0.5),
    "tilted wall": 500.0 + 0.6 * U,
    "step": np.where(U < 250, 600.0, 800.0),
    "edge below": np.where(V < 212, 600.0, 800.0),
    "noise": np.random.default_rng(3).uniform(300.0, 1200.0, V.shape),
    "few readings": with_holes(WALL, 0.99),
    "one reading": np.where((V == 212) & (U == 255), 650.0, 0.0),
    "nothing": np.zeros(V.shape),
}
handless = pytest.mark.parametrize("name", HANDLESS)


@handless
def test_no_wall_has_a_hand_s_outline(name: str) -> None:
    depth = HANDLESS[name].astype(np.float32)
    observer = Observer(HandConfig(), HAND.anatomy, KINECT, segment=True)
    for x, y in ((0.0, 0.0), (40.0, -30.0), (-250.0, 60.0)):
        pose = relaxed(x, y)
        assert not observer.outline(depth, pose).shows_hand(is_known=False)


def test_noise_of_a_hand_s_depth_hardly_ever_has_its_outline() -> None:
    """Contrast is a mean over some hundred pixels: what chance gives it has a spread of an eighth."""
    observer = Observer(HandConfig(), HAND.anatomy, KINECT, segment=True)
    shown = [
        observer.outline((WALL + noise(30.0, seed)).astype(np.float32), relaxed(x, y)).shows_hand(
            is_known=False
        )
        for seed in range(20)
        for x, y in ((0.0, 0.0), (40.0, -30.0), (-250.0, 60.0))
    ]
    assert np.mean(shown) < 0.15


@pytest.mark.parametrize("behind", [620.0, 700.0, 1500.0, 0.0], ids=lambda mm: f"{mm:.0f}mm")
def test_a_hand_stands_out_also_from_what_it_nearly_touches(device: RenderingDevice, behind: float) -> None:
    """A hand some 45 mm deep, the middle of its joints at 570 mm or so, before a wall or before nothing."""
    pose = relaxed(z=560.0)
    drawn = Stage(device, HAND).depth(pose, wall=behind or 9000.0)
    depth = np.where(drawn > 8000.0, 0.0, drawn).astype(np.float32)
    observer = Observer(HandConfig(), HAND.anatomy, KINECT, segment=True)
    assert observer.outline(depth, pose).shows_hand(is_known=False)
    aside = pose.copy()
    aside[0] += 15.0  # a track that is somewhat off
    assert observer.outline(depth, aside).shows_hand(is_known=True)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("rbpf", "wall"),
        ("rbpf", "few readings"),
        ("pf", "step"),
        ("pso", "noisy wall"),
        ("paper", "wall"),
    ],
)
def test_no_tracker_says_that_it_tracks_a_wall(device: RenderingDevice, kind: str, name: str) -> None:
    """Each asks the outline, which ``test_no_wall_has_a_hand_s_outline`` tries with every wall."""
    values: dict[str, Any] = {"filter": {"kind": "rbpf" if kind == "paper" else kind, "particles": 64}}
    values |= {"hand": {"side": "right"}, "pso": {"particles": 16, "generations": 4}}
    values |= {"fit": {"starts": 2, "iterations": 2, "polish": 0}}
    if kind == "paper":
        values["filter"]["proposal"] = "paper"
        values["observation"] = {"cost": "paper", "sigma_mm": 20.0, "clamp_mm": 100.0}
    config = HandConfig.model_validate(values)
    tracker = make_tracker(config, HAND, KINECT, device)
    depth, rng = HANDLESS[name].astype(np.float32), np.random.default_rng(0)
    state = tracker.start(centre_pose(depth, KINECT, HAND.anatomy, None), 0, rng)
    for index in range(3):
        frame = Frame(index, (index + 1) * FRAME_NS, (depth,))
        state, estimate = tracker.step(state, frame, rng)
        assert estimate.status is Status.LOST
        assert estimate.confidence < config.status.lost_below
