"""Images reduced to the size that patches are made for, and when the one-camera tracker does so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import pixels_from_points
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.detection.detector import Detection
from posetrack_cli.head.detection.finders import FaceGuess
from posetrack_cli.head.detection.points import FacePoints
from posetrack_cli.head.face.points import POINT_COUNT
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.initialisation.clicked import ClickedPoints
from posetrack_cli.head.tracker import mono
from posetrack_cli.head.tracker.frame_tracker import SeededFrame
from posetrack_cli.head.tracker.mono_state import MonoState
from posetrack_cli.head.tracker.reduction import (
    LEAST_REDUCTION,
    WHOLE,
    reduced,
    reduced_camera,
    reduced_pixels,
    scale_for,
)
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status
from support.codecs import assert_lawful
from support.mono_scene import CAMERA as SCENE_CAMERA
from support.mono_scene import FACE, FRAME_NS, MODEL
from support.textured_face import SHAPE, pose_at

CAMERA = Camera(640, 480, 700.0, 702.0, 321.0, 238.0)
LENSES = {
    "no lens": CAMERA,
    "plumb bob": replace(CAMERA, distortion=(-0.25, 0.1, 0.002, -0.003, 0.02)),
    "fisheye": replace(CAMERA, distortion=(0.05, -0.02, 0.01, 0.003), distortion_model="equidistant"),
}
ROUNDING = 1e-9
EVEN = 0.5
"""A scale at which 640 x 480 pixels become a whole number."""
WANTED_PX = 40.0
"""Between the eyes: half of what the drawn face has, so that its images are reduced."""
SMALL = HeadMonoConfig.model_validate({"particles": {"count": 50}, "start": {"eye_distance_px": WANTED_PX}})
ONE_FRAME = SMALL.model_copy(update={"start": SMALL.start.model_copy(update={"frames": 1})})
LARGE = SMALL.model_copy(update={"start": SMALL.start.model_copy(update={"eye_distance_px": 300.0})})


class Told:
    """A detector that knows where the drawn face is in images of any size, and notes the sizes."""

    def __init__(self) -> None:
        self.sizes: list[tuple[int, ...]] = []
        self.there, self.index = True, 0

    def detect(self, image: np.ndarray, *, wanted: int = 1, roll: float | None = None) -> Detection:
        self.sizes.append(image.shape)
        if not self.there:
            return Detection((), 0.3)
        scale = image.shape[1] / SCENE_CAMERA.width
        pose = pose_at(self.index)
        pixels = reduced_pixels(project((SCENE_CAMERA,), pose.points(SHAPE)).pixels[0], scale)
        per_mm = scale * SCENE_CAMERA.fx / pose.position[2]
        guess = FaceGuess(pixels[:4].mean(axis=0), 63.0 * per_mm, 0.0, 0.9)
        return Detection((FacePoints(pixels, np.full(POINT_COUNT, 0.9), per_mm, np.zeros(3), guess),), 0.9)


class Scene:
    """A tracker of the drawn face."""

    def __init__(self, config: HeadMonoConfig = SMALL, **how: object) -> None:
        self.told, self.rng = Told(), np.random.default_rng(0)
        with patch.object(mono, "FaceDetector", lambda settings: self.told):
            self.tracker = mono.HeadTracker(mono.MonoPeople(config, SCENE_CAMERA, MODEL, **how))
        self.state: MonoState | None = None

    def step(self, index: int) -> Estimate:
        (image,) = FACE.render((SCENE_CAMERA,), pose_at(index), SHAPE, seed=index)
        frame, self.told.index = Frame(index, index * FRAME_NS, (image,)), index
        if self.state is None:
            self.state = self.tracker.start(frame, self.rng)
        self.state, estimate = self.tracker.step(self.state, frame, self.rng)
        return estimate


def eyes_px() -> float:
    """Between the drawn face's eyes in the first frame, as the tracker measures it."""
    scene = Scene(LARGE)
    scene.step(0)
    assert scene.state is not None and scene.state.scale == WHOLE
    return scene.state.candidates[0].eye_distance


def frame(index: int) -> Frame:
    image = np.random.default_rng(index).integers(0, 256, (480, 640), dtype=np.uint8)
    return Frame(index, index * 33_333_333, (image,))


@pytest.mark.parametrize("camera", LENSES.values(), ids=LENSES.keys())
@given(st.integers(0, 10_000))
def test_a_reduced_camera_sees_points_at_reduced_pixels(camera: Camera, seed: int) -> None:
    points = np.random.default_rng(seed).uniform([-150.0, -120.0, 500.0], [150.0, 120.0, 900.0], (20, 3))
    whole, _ = pixels_from_points(camera, points)
    small, _ = pixels_from_points(reduced_camera(camera, EVEN), points)
    np.testing.assert_allclose(small, reduced_pixels(whole, EVEN), atol=ROUNDING)


@given(st.floats(0.1, 0.9))
def test_at_any_scale_but_for_the_size_in_whole_pixels(scale: float) -> None:
    """Sides are rounded by half a pixel at most, which is that part of the way to a pixel."""
    corners = np.array([[0.0, 0.0], [639.0, 479.0]])
    small = reduced_camera(CAMERA, scale)
    rays = (corners - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy]
    found = rays * [small.fx, small.fy] + [small.cx, small.cy]
    assert np.abs(found - reduced_pixels(corners, scale)).max() <= 0.5 + ROUNDING


def test_an_image_is_reduced_with_its_camera() -> None:
    """A bright spot of 8 x 8 pixels: its middle is where the reduced camera sees it."""
    image = np.zeros((480, 640), np.uint8)
    image[200:208, 400:408] = 255
    small = reduced(Frame(0, 5, (image,)), 0.25)
    rows, columns = np.nonzero(small.images[0])
    middle = np.array([columns.mean(), rows.mean()])
    np.testing.assert_allclose(middle, reduced_pixels(np.array([403.5, 203.5]), 0.25), atol=ROUNDING)
    assert small.stamp_ns == 5 and small.images[0].shape == (120, 160)
    camera = reduced_camera(CAMERA, 0.25)
    assert (camera.height, camera.width) == small.images[0].shape


def test_nothing_changes_at_full_size() -> None:
    whole, missing = frame(0), Frame(1, 2, (None,))
    assert reduced(whole, 1.0) is whole and reduced(missing, 0.5) is missing
    assert reduced_camera(CAMERA, 1.0) is CAMERA


@pytest.mark.parametrize("eyes", [30.0, 80.0, 80.0 / LEAST_REDUCTION - 0.01])
def test_only_large_faces_are_reduced(eyes: float) -> None:
    assert scale_for(eyes, 80.0) == WHOLE
    assert scale_for(200.0, 80.0) == pytest.approx(0.4)


def test_a_large_face_is_tracked_in_reduced_images_from_the_frame_in_which_it_is_found() -> None:
    scene, scale = Scene(), WANTED_PX / eyes_px()
    assert scene.step(0).status is Status.TRACKING
    assert scene.state is not None and scene.state.scale == scale
    (candidate,) = scene.state.candidates  # begun afresh: nothing of the whole image
    assert candidate.eye_distance == pytest.approx(WANTED_PX, rel=0.02)
    small = reduced_camera(SCENE_CAMERA, scale)
    whole = (SCENE_CAMERA.height, SCENE_CAMERA.width)
    assert scene.told.sizes == [whole, (small.height, small.width)]
    scene.step(1)
    assert scene.told.sizes[2:] == [(small.height, small.width)] and scene.state.scale == scale


def test_a_face_that_is_not_waited_for_is_reduced_in_its_first_frame() -> None:
    """Where one frame is enough none are collected."""
    scene = Scene(ONE_FRAME)
    assert scene.step(0).status is Status.TRACKING
    assert scene.state is not None and scene.state.track is not None
    assert scene.state.scale == pytest.approx(WANTED_PX / eyes_px(), rel=0.02)


def test_clicked_points_tell_the_scale() -> None:
    """Without a look at the whole image."""
    pixels = project((SCENE_CAMERA,), pose_at(0).points(SHAPE)).pixels
    scene = Scene(clicked=ClickedPoints(Path("clicked.csv"), pixels))
    assert scene.step(0).status is Status.TRACKING and scene.told.sizes == []
    assert scene.state is not None and scene.state.track is not None
    assert scene.state.scale == pytest.approx(WANTED_PX / eyes_px())


def test_points_are_clicked_in_the_first_frame_only() -> None:
    """A stranger who comes later begins where a face is found."""
    pixels = project((SCENE_CAMERA,), pose_at(0).points(SHAPE)).pixels
    first = Scene()
    for index in range(8):
        first.step(index)
    known = first.tracker.learned(first.state)
    scene = Scene(clicked=ClickedPoints(Path("clicked.csv"), pixels), known=known)
    scene.step(0)
    assert scene.state is not None and scene.state.person.adjusted_frames > 0
    stranger = replace(scene.state, people=(), track=None)
    faces = scene.tracker._faces
    (image,) = FACE.render((SCENE_CAMERA,), pose_at(1), SHAPE, seed=1)
    state, later = faces.look(stranger, Frame(1, FRAME_NS, (image,)))
    scene.told.index = 1
    state, _ = faces.begin(state, SeededFrame(later, scene.rng))
    assert len(state.candidates) == 1


def test_what_a_search_came_to_in_whole_images_is_not_forgotten_with_them() -> None:
    scene = Scene()
    scene.told.there = False
    scene.step(0)
    scene.step(1)
    assert scene.state is not None and scene.state.scale is None
    assert "2 frames searched" in scene.tracker.not_found(scene.state)
    scene.told.there = True
    scene.step(2)
    assert scene.state.search.frames == 2 and scene.state.scale is not None


@pytest.mark.parametrize("config", [SMALL, LARGE], ids=["reduced", "whole"])
def test_a_saved_state_comes_back_at_its_scale(config: HeadMonoConfig) -> None:
    scene = Scene(config)
    scene.step(0)
    assert scene.state is not None
    assert assert_lawful(scene.tracker.codec, scene.state).scale == scene.state.scale


def test_what_was_learned_begins_at_the_size_that_it_was_seen_at() -> None:
    scene = Scene()
    for index in range(8):
        scene.step(index)
    assert scene.state is not None and scene.state.scale is not None
    known = scene.tracker.learned(scene.state)
    assert known["focal_px"] == pytest.approx(scene.state.scale * SCENE_CAMERA.fx) and known["people"] == 1
    second = Scene(LARGE, known=known)
    second.step(0)
    assert second.state is not None and second.state.scale == pytest.approx(scene.state.scale)
    assert second.told.sizes == [scene.told.sizes[-1]]
    wider = mono.HeadTracker(
        mono.MonoPeople(LARGE, SCENE_CAMERA, MODEL, known=known | {"focal_px": np.array(1e5)})
    )
    assert wider.start(frame(0), scene.rng).scale == WHOLE, "images are never enlarged"
    del known["focal_px"]
    with pytest.raises(ResultError, match="no array 'focal_px'"):
        Scene(known=known)


def test_of_nothing_nothing_is_learned() -> None:
    scene = Scene()
    scene.told.there = False
    scene.step(0)
    assert scene.state is not None and scene.tracker.learned(scene.state) == {}
