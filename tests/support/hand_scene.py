"""Drawn hands before a wall, and trackers that look for them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.anatomy_terms import RELAXED
from posetrack_cli.hand.fit.likelihood import RenderedCosts
from posetrack_cli.hand.model.anatomy import ANGLES, POSE_SIZE
from posetrack_cli.hand.model.hand import HandModel, average_hand
from posetrack_cli.hand.model.kinematics import joint_positions, skinning_transforms
from posetrack_cli.hand.search import Acquisition
from posetrack_cli.hand.tracker import HandTracker
from posetrack_cli.losses import Loss
from posetrack_cli.recording.base import Frame, TruthMessage
from posetrack_cli.recording.depth import Depth
from posetrack_cli.recording.pixels import Pixels
from posetrack_cli.rendering.port import RenderingDevice, Window
from support.hand import KINECT

WALL_MM = 1500.0
FRAME_NS = 33_333_333
HANDS = {"right": average_hand(), "left": average_hand("left")}


def relaxed(
    x: float = 0.0, y: float = 60.0, z: float = 650.0, turn: tuple[float, float, float] = (0.15, -0.2, 0.1)
) -> FloatArray:
    """A relaxed hand's pose (22,), its palm to the camera, turned by a rotation vector, rad."""
    pose = np.zeros(POSE_SIZE)
    pose[:3] = x, y, z
    pose[3:7] = rotations.canonical(rotations.exponential(np.array(turn)))
    pose[ANGLES] = RELAXED
    return pose


def closing_hand(count: int) -> list[FloatArray]:
    """Poses of a hand that comes nearer, turns and closes two fingers, ever faster."""
    out = []
    for t in np.linspace(0.0, 1.0, count):
        pose = relaxed(x=40.0 * t * t, z=650.0 - 30.0 * t, turn=(0.15, -0.2 + 0.3 * t * t, 0.1))
        pose[[10, 12, 13, 15]] += 0.6 * t * t
        out.append(pose)
    return out


def turned_about_its_length(pose: FloatArray, angle: float) -> FloatArray:
    """The pose with the back of the hand where the palm was, at 180 degrees."""
    out = pose.copy()
    turn = rotations.exponential(np.array([0.0, angle, 0.0]))
    out[3:7] = rotations.canonical(rotations.multiply(pose[3:7], turn))
    return out


class Stage:
    """Draws what a perfect sensor sees of hands before a wall."""

    def __init__(self, device: RenderingDevice, hand: HandModel) -> None:
        self.hand = hand
        self._renderer = device.depth_renderer(hand.smooth, (KINECT.width, KINECT.height), 1)

    def depth(self, *poses: FloatArray, wall: float = WALL_MM) -> Float32Array:
        """Depth (424, 512), mm, of hands at poses (22,)."""
        nearest = np.full((KINECT.height, KINECT.width), wall, dtype=np.float32)
        for pose in poses:
            transforms = skinning_transforms(self.hand.anatomy, pose[None])
            drawn = self._renderer.depth(transforms, KINECT, Window.whole(KINECT))[0]
            nearest = np.where((drawn > 0) & (drawn < nearest), drawn, nearest)
        return nearest

    def error(self, found: FloatArray, truth: FloatArray) -> float:
        """Mean distance of the joints, mm, of two poses (22,)."""
        first, second = joint_positions(self.hand.anatomy, np.stack([found, truth]))
        return float(np.linalg.norm(first - second, axis=1).mean())


@dataclass(frozen=True)
class Drawn:
    """A recording of drawn hands."""

    depths: tuple[Float32Array, ...]
    path: Path = Path("/somewhere/drawn.mcap")
    losses: tuple[Loss, ...] = ()
    notes: tuple[str, ...] = ()
    pixels: tuple[Pixels, ...] = (Depth(KINECT.width, KINECT.height, "32FC1"),)

    @classmethod
    def of(cls, stage: Stage, poses: Sequence[FloatArray]) -> Drawn:
        """What a sensor with noise of 3 mm sees of a hand at poses (22,)."""
        rng = np.random.default_rng(4)
        return cls(
            tuple((stage.depth(p) + rng.normal(0.0, 3.0, (424, 512))).astype(np.float32) for p in poses)
        )

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

    def sample(self, count: int, *, start: int = 0, stride: int = 1, frames: int) -> Iterator[Frame]:
        return self.frames(start=start, end=start + frames * stride, stride=stride * max(1, frames // count))

    def truth(self) -> Iterator[TruthMessage]:
        return iter(())


def pose_file(path: Path, pose: FloatArray) -> Path:
    """A pose (22,) as ``--init`` reads it."""
    start = {"position_mm": pose[:3], "quaternion_xyzw": pose[3:7], "angles_rad": pose[7:]}
    path.write_text(json.dumps({name: list(values) for name, values in start.items()}))
    return path


def acquisition(hand: HandModel, config: HandConfig | None = None) -> Acquisition:
    """What looks for a hand without a prediction."""
    return Acquisition(config or HandConfig(), hand, KINECT)


def tracker(device: RenderingDevice, hand: HandModel, config: HandConfig | None = None) -> HandTracker:
    """The tracker with all that it asks."""
    config = config or HandConfig()
    finder = acquisition(hand, config)
    scorer = RenderedCosts(device, hand, KINECT, config.observation, config.filter.particles)
    return HandTracker(config, hand.anatomy, scorer, finder.observer, finder)
