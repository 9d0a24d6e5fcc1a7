"""A stereo tracker on a drawn face whose motion is known; where the face is found is told, not detected."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from posetrack_cli.head.config import HeadStereoConfig
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.initialisation.search import NO_FACE, InitFailure
from posetrack_cli.head.initialisation.stereo import StereoInitialisation
from posetrack_cli.head.subject import head_subject
from posetrack_cli.head.tracker.head_tracker import HeadTracker
from posetrack_cli.head.tracker.stereo import StereoFace, StereoTracker
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.results.fields import check_estimate
from support.textured_face import SHAPE, TexturedFace, moving, pose_at, stereo, textured_face

FRAME_NS = 33_333_333
CAMERAS = stereo()
FACE = textured_face()
FEW = HeadStereoConfig.model_validate({"particles": {"count": 200}})
NOISE = 2.0
"""Grey levels. A patch of 256 pixels with slopes of some 10 levels a pixel then places a point to 0.02 px:
0.015 mm across, 0.1 mm in depth with a base of 120 mm at 700 mm; ten points share the pose."""


@dataclass
class Told:
    """Says where the face is, 1 mm beside it, when there is one."""

    index: int = 0
    there: bool = True
    failure: InitFailure = field(default_factory=lambda: InitFailure(NO_FACE, 0.3))
    asked: int = 0

    def from_landmarks(self, frame: object, tracked: object = None) -> None:
        """No landmarks tell anything."""

    def find(self, frame: object, *, is_first: bool, is_known: bool) -> StereoInitialisation | InitFailure:
        self.asked += 1
        if not self.there:
            return self.failure
        pose = pose_at(self.index).moved(np.array([1.0, -1.0, 1.0, 0.0, 0.0, 0.0]))
        pixels = project(CAMERAS, pose.points(SHAPE)).pixels
        known = np.ones(len(SHAPE), dtype=bool)
        return StereoInitialisation(pose, SHAPE.copy(), pixels, known, 0.9)


@dataclass
class Scene:
    """A tracker, and the recording it goes through."""

    face: TexturedFace = FACE
    config: HeadStereoConfig = FEW
    told: Told = field(default_factory=Told)
    tracker: StereoTracker = field(init=False)
    state: object = None
    known: dict[str, np.ndarray] | None = None
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def __post_init__(self) -> None:
        self.tracker = HeadTracker(StereoFace(self.config, CAMERAS, self.told, self.known))

    def frame(self, index: int, seen: tuple[bool, ...] = (True, True), blank: bool = False) -> Frame:
        images = [image.copy() for image in moving(self.face, tuple(CAMERAS), index, NOISE)]
        if blank:
            images = [np.full_like(image, 110) for image in images]
        kept = tuple(image if there else None for image, there in zip(images, seen, strict=True))
        return Frame(index, index * FRAME_NS, kept)

    def step(self, index: int, **how) -> Estimate:
        frame = self.frame(index, **how)
        self.told.index = index
        if self.state is None:
            self.state = self.tracker.start(frame, self.rng)
        self.state, estimate = self.tracker.step(self.state, frame, self.rng)
        check_estimate(estimate, head_subject("left", 5))
        return estimate
