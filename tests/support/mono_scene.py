"""A one-camera tracker and a drawn face whose motion is known; told where the face is, it detects none."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.detection.detector import Detection
from posetrack_cli.head.detection.finders import FaceGuess
from posetrack_cli.head.detection.points import FacePoints
from posetrack_cli.head.face.points import POINT_COUNT
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.initialisation.clicked import ClickedPoints
from posetrack_cli.head.multilinear.face_model import FaceModel, load_face_model
from posetrack_cli.head.skin import map as skin_map
from posetrack_cli.head.skin import matching
from posetrack_cli.head.subject import mono_subject
from posetrack_cli.head.tracker import mono, person
from posetrack_cli.head.tracker.codecs import MonoState
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.results.fields import check_estimate
from support.textured_face import SHAPE, TexturedFace, moving, pose_at, stereo, textured_face

FRAME_NS = 33_333_333
(CAMERA,) = stereo(1)
FACE = textured_face()
FEW = HeadMonoConfig.model_validate({"particles": {"count": 150}, "adjustment": {"views": 8}})
NOISE = 2.0
"""Grey levels."""


def drawn_model() -> FaceModel:
    """The shipped model, moved so that its mean person at rest is the drawn face."""
    model = load_face_model()
    mean = model.of_person(model.identity_mean).mean
    return replace(model, mean=model.mean + SHAPE - mean)


MODEL = drawn_model()


def map_skin_soon(patched: pytest.MonkeyPatch, every_ns: int = 100_000_000, most: int = 120) -> None:
    """Make maps of a face with skin about its points only, which is seen for less than a second."""
    patched.setattr(matching, "EVERY_NS", every_ns)
    patched.setattr(person, "MOST_VIEWS", most)
    patched.setattr(skin_map, "LEAST_POINTS", 6)
    patched.setattr(skin_map, "ENOUGH_POINTS", 20)


@dataclass
class Told:
    """A detector that knows where the face is, a pixel beside it, when there is one."""

    index: int = 0
    there: bool = True
    asked: int = 0

    def detect(self, image: np.ndarray, *, wanted: int = 1, roll: float | None = None) -> Detection:
        self.asked += 1
        if not self.there:
            return Detection((), 0.3)
        pose = pose_at(self.index)
        pixels = project((CAMERA,), pose.points(SHAPE)).pixels[0] + [1.0, -1.0]
        scale = CAMERA.fx / pose.position[2]
        guess = FaceGuess(pixels[:4].mean(axis=0), 63.0 * scale, 0.0, 0.9)
        return Detection((FacePoints(pixels, np.full(POINT_COUNT, 0.9), scale, np.zeros(3), guess),), 0.9)

    def detect_quickly(self, image: np.ndarray, index: int, *, wanted: int = 1) -> Detection:
        return self.detect(image, wanted=wanted)

    def detect_near(self, image: np.ndarray, pixels: np.ndarray) -> Detection:
        return self.detect(image)


@dataclass
class Scene:
    """A tracker, and the recording it goes through."""

    face: TexturedFace = FACE
    config: HeadMonoConfig = FEW
    told: Told = field(default_factory=Told)
    known: dict[str, np.ndarray] | None = None
    clicked: np.ndarray | None = None
    tracker: mono.MonoTracker = field(init=False)
    subject: Subject = field(default_factory=lambda: mono_subject("camera", MODEL))
    state: MonoState | None = None
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def __post_init__(self) -> None:
        clicked = None if self.clicked is None else ClickedPoints(Path("clicked.csv"), self.clicked[None])
        with patch.object(mono, "FaceDetector", lambda settings, twice: self.told):
            people = mono.MonoPeople(self.config, CAMERA, MODEL, clicked=clicked, known=self.known)
            self.tracker = mono.HeadTracker(people)

    def frame(self, index: int, blank: bool = False) -> Frame:
        (image,) = moving(self.face, (CAMERA,), index, NOISE)
        return Frame(index, index * FRAME_NS, (np.full_like(image, 110) if blank else image.copy(),))

    def step(self, index: int, blank: bool = False) -> Estimate:
        frame = self.frame(index, blank)
        self.told.index = index
        if self.state is None:
            self.state = self.tracker.start(frame, self.rng)
        self.state, estimate = self.tracker.step(self.state, frame, self.rng)
        check_estimate(estimate, self.subject)
        return estimate
