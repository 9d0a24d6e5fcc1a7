"""A recording of two cameras in memory, and a head tracker that finds, learns and wanders at random."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_COUNT, HeadPose
from posetrack_cli.head.subject import StereoDiagnostics
from posetrack_cli.head.tracker.frame_tracker import NO_SIGNS
from posetrack_cli.losses import Loss
from posetrack_cli.recording.base import Frame, TruthMessage
from posetrack_cli.recording.pixels import Pixels
from posetrack_cli.results.columns import floats
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.state_codec import Fields, Value, whole

FRAME_NS = 33_333_333
COMPONENTS = 2
OF_THIS_RECORDING = "of_this_recording"
"""Name of what a second pass alone begins with."""
ASIDE = ((1.0, 0.0, 0.0, -120.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 5.0))
CAMERAS = (
    Camera(64, 48, 90.0, 90.0, 31.5, 23.5, (0.05, -0.01, 0.0, 0.0), name="left"),
    Camera(64, 48, 91.0, 92.0, 32.5, 23.0, name="right", camera_T_reference=ASIDE),
)


@dataclass(frozen=True)
class Memory:
    """A recording whose images are all grey, dark up to the frame in which a face appears."""

    count: int = 12
    appears: int = 2
    cameras: tuple[Camera, ...] = CAMERAS
    pixels: tuple[Pixels, ...] = ()
    true: tuple[TruthMessage, ...] = ()
    losses: tuple[Loss, ...] = ()
    notes: tuple[str, ...] = ()
    path: Path = Path("/somewhere/secret/memory")

    @property
    def frame_count(self) -> int | None:
        return self.count

    def identity(self) -> Mapping[str, str]:
        return {"name": "memory", "kind": "folder", "sha256": "0" * 64}

    def frames(self, *, start: int = 0, end: int | None = None, stride: int = 1) -> Iterator[Frame]:
        for k in range(start, self.count if end is None else min(end, self.count), stride):
            image = np.full((48, 64), 100 + k if k >= self.appears else 0, np.uint8)
            yield Frame(k, k * FRAME_NS, tuple(image for _ in self.cameras))

    def sample(self, count: int, *, start: int = 0, stride: int = 1, frames: int) -> Iterator[Frame]:
        return self.frames(start=start, end=start + frames * stride, stride=stride * max(1, frames // count))

    def truth(self) -> Iterator[TruthMessage]:
        yield from self.true


@dataclass(frozen=True, eq=False)
class FakeState:
    """How many frames had a face, what they made of the face, and how many had none."""

    seen: int = 0
    searched: int = 0
    mean: np.ndarray = field(default_factory=lambda: np.zeros((POINT_COUNT, 3)))


class FakeTracker:
    """A head that wanders by random steps; its learned mean grows by what each frame's image holds."""

    def __init__(self, known: Mapping[str, np.ndarray[Any, Any]] | None) -> None:
        self.known = None if known is None else dict(known)

    def start(self, frame: Frame, rng: np.random.Generator) -> FakeState:
        return FakeState() if self.known is None else FakeState(mean=self.known["mean"])

    def step(self, state: FakeState, frame: Frame, rng: np.random.Generator) -> tuple[FakeState, Estimate]:
        brightness = float(frame.images[0].mean())
        if not brightness:
            return replace(state, searched=state.searched + 1), self._estimate(state, frame, np.zeros(3))
        state = replace(state, seen=state.seen + 1, mean=state.mean + 0.001 * brightness)
        return state, self._estimate(state, frame, rng.standard_normal(3))

    def _estimate(self, state: FakeState, frame: Frame, moved: np.ndarray) -> Estimate:
        pose = HeadPose(np.array([0.0, 0.0, 700.0]) + moved, np.array([1.0, 0.0, 0.0, 0.0]))
        tangent = np.zeros(6 + COMPONENTS)
        ratio = 0.5 if state.seen > 1 else np.nan
        return Estimate(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            status=Status.TRACKING if state.seen else Status.LOST,
            confidence=0.5 if state.seen else 0.0,
            position=pose.position,
            quaternion=pose.quaternion,
            shape=np.array([float(state.seen), 0.0]),
            pose_rate=np.zeros(7 + COMPONENTS),
            twist=tangent,
            pose_variance=tangent,
            twist_variance=tangent,
            points=pose.points(MEAN_SHAPE + state.mean),
            effective_sample_size=None,
            resampled=False,
            numbers=np.concatenate(
                [StereoDiagnostics(np.array([4.0]), ratio, state.seen, 0.8).numbers(COMPONENTS), NO_SIGNS]
            ),
        )

    def learned(self, state: FakeState, *, for_second_pass: bool = False) -> dict[str, np.ndarray[Any, Any]]:
        learned = {"mean": state.mean, "counts": np.array([state.seen])}
        return learned | {OF_THIS_RECORDING: np.zeros(1)} if for_second_pass else learned

    def not_found(self, state: FakeState) -> str:
        return "" if state.seen else f"{state.searched} frames searched, best score 0.31"

    def remarks(self, state: FakeState) -> tuple[str, ...]:
        return (f"face seen in {state.seen} frames",)

    codec = Fields(FakeState, seen=whole(), searched=whole(), mean=Value(floats(10, 3)))
