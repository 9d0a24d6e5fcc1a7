"""A recording in memory in which no hand is, and what a quick run over it is configured with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.losses import Loss
from posetrack_cli.recording.base import Frame, TruthMessage
from posetrack_cli.recording.depth import Depth
from posetrack_cli.recording.pixels import Pixels

CAMERA = Camera(120, 100, 90.0, 91.0, 59.5, 49.5, (0.01, 0.0, 0.0, 0.0), name="kinect")
CONFIG = HandConfig.model_validate(
    {
        "filter": {"particles": 6, "proposal": "marginal"},  # what is filmed is no hand
        "init": {"method": "center"},
        "observation": {"tile_px": 16, "cost": "paper"},
        "output": {"mesh": "none", "flush_frames": 2},
    }
)
FRAME_NS = 33_333_333
IDENTITY = {"name": "memory.mcap", "sha256": "0" * 64}


@dataclass(frozen=True)
class Memory:
    """A recording whose frames all have a reading everywhere, but for the blank ones."""

    count: int = 12
    blank: tuple[int, ...] = ()
    true: tuple[TruthMessage, ...] = ()
    losses: tuple[Loss, ...] = ()
    notes: tuple[str, ...] = ()
    known: bool = True
    path: Path = Path("/somewhere/secret/memory.mcap")

    @property
    def cameras(self) -> tuple[Camera, ...]:
        return (CAMERA,)

    @property
    def pixels(self) -> tuple[Pixels, ...]:
        return (Depth(CAMERA.width, CAMERA.height, "16UC1"),)

    @property
    def frame_count(self) -> int | None:
        return self.count if self.known else None

    def identity(self) -> Mapping[str, str]:
        return IDENTITY

    def frames(self, *, start: int = 0, end: int | None = None, stride: int = 1) -> Iterator[Frame]:
        for k in range(start, self.count if end is None else min(end, self.count), stride):
            reading = 0.0 if k in self.blank else 650.0
            yield Frame(k, k * FRAME_NS, (np.full((100, 120), reading, np.float32),))

    def sample(self, count: int, *, start: int = 0, stride: int = 1, frames: int) -> Iterator[Frame]:
        return self.frames(start=start, end=start + frames * stride, stride=stride * max(1, frames // count))

    def truth(self) -> Iterator[TruthMessage]:
        yield from self.true


def after(frames: int) -> Callable[[], bool]:
    """A stop flag that is up once it has been asked so often."""
    asked = iter(range(1, 1000))
    return lambda: next(asked) >= frames
