"""Images scaled to the size that patches are made for, and when the one-camera tracker does so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.errors import ResultError
from posetrack_cli.evaluation.measuring.pose_metrics import rotation_errors_deg
from posetrack_cli.geometry.camera import Camera, pixels_from_points
from posetrack_cli.head.config import LARGEST_SCALE, HeadMonoConfig
from posetrack_cli.head.detection.detector import Detection
from posetrack_cli.head.detection.finders import FaceGuess
from posetrack_cli.head.detection.points import FacePoints
from posetrack_cli.head.face.points import (
    LARGEST_SIDE_PX,
    LEAST_REDUCTION,
    MARGIN_PX,
    POINT_COUNT,
    RESCALE_RATIO,
    STEP,
    UNSCALED,
    HeadPose,
    Scaling,
    enlarged,
    reduced,
    scaled_camera,
    scaled_pixels,
)
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.initialisation.clicked import ClickedPoints
from posetrack_cli.head.tracker import mono
from posetrack_cli.head.tracker.codecs import MonoState
from posetrack_cli.head.tracker.frame_tracker import SeededFrame
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
USUAL = Scaling(80.0, LARGEST_SCALE, CAMERA)
ROUNDING = 1e-9
EVEN = 0.5
"""A scale at which 640 x 480 pixels become a whole number."""
WANTED_PX = 40.0
"""Between the eyes: half of what the drawn face has, so that its images are reduced."""
SMALL = HeadMonoConfig.model_validate({"particles": {"count": 50}, "start": {"eye_distance_px": WANTED_PX}})
ONE_FRAME = SMALL.model_copy(update={"start": SMALL.start.model_copy(update={"frames": 1})})
AS_IT_IS = SMALL.model_copy(update={"start": SMALL.start.model_copy(update={"eye_distance_px": 80.0})})
"""The drawn face has so much, so that nothing is scaled."""
TINY = 0.25
"""What is left of the drawn face, whose eyes are then 22 pixels apart."""


class Told:
    """A detector that knows where the drawn face is in images of any size, and notes the sizes."""

    def __init__(self) -> None:
        self.sizes: list[tuple[int, ...]] = []
        self.there, self.index, self.pose = True, 0, pose_at

    def detect(self, image: np.ndarray, *, wanted: int = 1, roll: float | None = None) -> Detection:
        self.sizes.append(image.shape)
        if not self.there:
            return Detection((), 0.3)
        scale = image.shape[1] / SCENE_CAMERA.width
        pose = self.pose(self.index)
        pixels = scaled_pixels(project((SCENE_CAMERA,), pose.points(SHAPE)).pixels[0], scale)
        per_mm = scale * SCENE_CAMERA.fx / pose.position[2]
        guess = FaceGuess(pixels[:4].mean(axis=0), 63.0 * per_mm, 0.0, 0.9)
        return Detection((FacePoints(pixels, np.full(POINT_COUNT, 0.9), per_mm, np.zeros(3), guess),), 0.9)

    def detect_quickly(self, image: np.ndarray, index: int, *, wanted: int = 1) -> Detection:
        return self.detect(image, wanted=wanted)

    def detect_near(self, image: np.ndarray, pixels: np.ndarray) -> Detection:
        return self.detect(image)


class Scene:
    """A tracker of the drawn face, in images of so much of their size."""

    def __init__(self, config: HeadMonoConfig = SMALL, size: float = UNSCALED, **how: object) -> None:
        self.told, self.rng, self.size = Told(), np.random.default_rng(0), size
        camera = scaled_camera(SCENE_CAMERA, size)
        with patch.object(mono, "FaceDetector", lambda settings, twice: self.told):
            self.tracker = mono.HeadTracker(mono.MonoPeople(config, camera, MODEL, **how))
        self.state: MonoState | None = None

    def step(self, index: int) -> Estimate:
        (image,) = FACE.render((SCENE_CAMERA,), self.told.pose(index), SHAPE, noise=2.0, seed=index)
        frame, self.told.index = reduced(Frame(index, index * FRAME_NS, (image,)), self.size), index
        if self.state is None:
            self.state = self.tracker.start(frame, self.rng)
        self.state, estimate = self.tracker.step(self.state, frame, self.rng)
        return estimate


def eyes_px() -> float:
    """Between the drawn face's eyes in the first frame, as the tracker measures it."""
    scene = Scene(AS_IT_IS)
    scene.step(0)
    assert scene.state is not None and scene.state.scale == UNSCALED
    return scene.state.candidates[0].eye_distance


def frame(index: int) -> Frame:
    image = np.random.default_rng(index).integers(0, 256, (480, 640), dtype=np.uint8)
    return Frame(index, index * 33_333_333, (image,))


@pytest.mark.parametrize("camera", LENSES.values(), ids=LENSES.keys())
@given(st.integers(0, 10_000))
def test_a_scaled_camera_sees_points_at_scaled_pixels(camera: Camera, seed: int) -> None:
    points = np.random.default_rng(seed).uniform([-150.0, -120.0, 500.0], [150.0, 120.0, 900.0], (20, 3))
    whole, _ = pixels_from_points(camera, points)
    small, _ = pixels_from_points(scaled_camera(camera, EVEN), points)
    np.testing.assert_allclose(small, scaled_pixels(whole, EVEN), atol=ROUNDING)


@given(st.sampled_from(np.arange(1.0 + STEP, LARGEST_SCALE + STEP, STEP).tolist()), st.integers(0, 1000))
def test_a_camera_of_enlarged_images_sees_points_there_exactly(scale: float, seed: int) -> None:
    """Also where sides are no whole number of pixels."""
    camera = replace(CAMERA, width=639, height=477)
    points = np.random.default_rng(seed).uniform([-150.0, -120.0, 500.0], [150.0, 120.0, 900.0], (20, 3))
    whole, _ = pixels_from_points(camera, points)
    large, _ = pixels_from_points(scaled_camera(camera, scale), points)
    np.testing.assert_allclose(large, scaled_pixels(whole, scale), atol=1e-6)


@given(st.floats(0.1, 0.9))
def test_at_any_scale_but_for_the_size_in_whole_pixels(scale: float) -> None:
    """Sides are rounded by half a pixel at most, which is that part of the way to a pixel."""
    corners = np.array([[0.0, 0.0], [639.0, 479.0]])
    small = scaled_camera(CAMERA, scale)
    rays = (corners - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy]
    found = rays * [small.fx, small.fy] + [small.cx, small.cy]
    assert np.abs(found - scaled_pixels(corners, scale)).max() <= 0.5 + ROUNDING


def test_an_image_is_reduced_with_its_camera() -> None:
    """A bright spot of 8 x 8 pixels: its middle is where the reduced camera sees it."""
    image = np.zeros((480, 640), np.uint8)
    image[200:208, 400:408] = 255
    small = reduced(Frame(0, 5, (image,)), 0.25)
    rows, columns = np.nonzero(small.images[0])
    middle = np.array([columns.mean(), rows.mean()])
    np.testing.assert_allclose(middle, scaled_pixels(np.array([403.5, 203.5]), 0.25), atol=ROUNDING)
    assert small.stamp_ns == 5 and small.images[0].shape == (120, 160)
    camera = scaled_camera(CAMERA, 0.25)
    assert (camera.height, camera.width) == small.images[0].shape


def test_nothing_changes_at_full_size() -> None:
    whole, missing = frame(0), Frame(1, 2, (None,))
    assert reduced(whole, 1.0) is whole and reduced(missing, 0.5) is missing
    assert scaled_camera(CAMERA, 1.0) is CAMERA


@pytest.mark.parametrize(("width", "height"), [(640, 480), (641, 479)])
@pytest.mark.parametrize(
    "corner", [(300.0, 200.0), (2.0, 3.0), (620.0, 470.0)], ids=["middle", "corner", "end"]
)
@given(st.sampled_from([1.25, 2.0, 2.75, LARGEST_SCALE]))
def test_what_is_enlarged_about_a_face_is_a_piece_of_the_whole_enlarged(
    width: int, height: int, corner: tuple[float, float], scale: float
) -> None:
    """All that patches reach is there, whatever else is black; edges alone are interpolated otherwise."""
    image = np.random.default_rng(0).integers(1, 256, (height, width), dtype=np.uint8)
    pixels = scaled_pixels(np.array([corner, corner]) + np.array([[0.0, 0.0], [15.0, 4.0]]), scale)
    found = enlarged(Frame(3, 5, (image,)), scale, pixels)
    (large,) = found.images
    camera = scaled_camera(replace(CAMERA, width=width, height=height), scale)
    assert large is not None and large.shape == (camera.height, camera.width) and found.index == 3
    whole = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    near = MARGIN_PX - 4 * scale  # a cubic looks two pixels ahead
    low, high = np.floor(pixels.min(axis=0) - near), np.ceil(pixels.max(axis=0) + near)
    left, top = np.maximum(low, 0).astype(int)
    right, bottom = np.minimum(high, (camera.width, camera.height)).astype(int)
    np.testing.assert_array_equal(large[top:bottom, left:right], whole[top:bottom, left:right])
    far = np.ones(large.shape, dtype=bool)
    margin = MARGIN_PX + 8 * scale
    low, high = pixels.min(axis=0) - margin, pixels.max(axis=0) + margin
    left, top = np.maximum(low, 0).astype(int)
    far[top : int(high[1]), left : int(high[0])] = False
    assert not large[far].any()


@pytest.mark.parametrize(
    "pixels", [np.full((10, 2), -1e9), np.full((10, 2), 1e9), np.full((10, 2), np.nan)], ids=str
)
@pytest.mark.filterwarnings("ignore:All-NaN")
def test_a_face_outside_is_looked_for_in_the_dark(pixels: np.ndarray) -> None:
    (large,) = enlarged(frame(0), 2.0, pixels).images
    assert large is not None and large.shape == (960, 1280)
    assert not large[MARGIN_PX + 8 :, MARGIN_PX + 8 :].any()


@pytest.mark.parametrize("eyes", [80.0 * LEAST_REDUCTION, 80.0, 80.0 / LEAST_REDUCTION - 0.01])
def test_faces_of_nearly_the_size_wanted_stay(eyes: float) -> None:
    assert USUAL.for_face(eyes) == UNSCALED


@given(st.floats(1.0, 2000.0))
def test_others_come_to_the_size_wanted_or_near_it(eyes: float) -> None:
    scale = USUAL.for_face(eyes)
    assert scale <= LARGEST_SCALE and (scale < UNSCALED or scale % STEP == 0.0)
    if eyes > 80.0 / LARGEST_SCALE:
        assert 80.0 * LEAST_REDUCTION <= scale * eyes <= 80.0 / LEAST_REDUCTION


def test_no_image_is_enlarged_beyond_a_size() -> None:
    wide = replace(CAMERA, width=4000)
    assert USUAL.usable(10.0) == LARGEST_SCALE
    assert USUAL._replace(camera=wide).usable(10.0) * wide.width <= LARGEST_SIDE_PX
    assert USUAL._replace(camera=replace(CAMERA, width=20_000)).usable(10.0) == UNSCALED
    assert USUAL.usable(0.3) == 0.3
    never = USUAL._replace(largest=UNSCALED)
    assert never.for_face(5.0) == UNSCALED and never.for_face(160.0) == 0.5


@given(st.floats(10.0, 500.0), st.floats(10.0, 500.0))
def test_a_scale_is_changed_only_where_another_is_much_better(first: float, later: float) -> None:
    scale = USUAL.for_face(first)
    changed = USUAL.updated(scale, later)
    if 1.0 / RESCALE_RATIO < scale * later / 80.0 < RESCALE_RATIO:
        assert changed == scale
    else:
        assert changed == USUAL.for_face(later)
        assert USUAL.updated(changed, later) == changed


def test_a_large_face_is_tracked_in_reduced_images_from_the_frame_in_which_it_is_found() -> None:
    scene, scale = Scene(), WANTED_PX / eyes_px()
    assert scene.step(0).status is Status.TRACKING
    assert scene.state is not None and scene.state.scale == scale
    (candidate,) = scene.state.candidates  # begun afresh: nothing of the whole image
    assert candidate.eye_distance == pytest.approx(WANTED_PX, rel=0.02)
    small = scaled_camera(SCENE_CAMERA, scale)
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
    state, later = faces.prepare(stranger, Frame(1, FRAME_NS, (image,)))
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


def test_a_small_face_is_looked_for_in_recorded_images_and_tracked_in_enlarged_ones() -> None:
    scene = Scene(AS_IT_IS, TINY)
    for index in range(8):
        assert scene.step(index).status is Status.TRACKING
    assert scene.state is not None and scene.state.track is not None
    assert scene.state.scale == USUAL.for_face(TINY * eyes_px()) > 3.0
    assert set(scene.told.sizes) == {(120, 160)}
    assert_lawful(scene.tracker.codec, scene.state)


def test_the_turn_of_a_small_face_is_seen_in_enlarged_images() -> None:
    """Where patches of 16 pixels cover three points each they all seem to move alike."""

    def wrong_deg(config: HeadMonoConfig) -> float:
        scene, errors = Scene(config, TINY), []
        for index in range(50):
            estimate = scene.step(index)
            errors.append(rotation_errors_deg(estimate.quaternion, pose_at(index).quaternion))
        return float(np.mean(errors[20:]))

    as_recorded = AS_IT_IS.start.model_copy(update={"largest_scale": UNSCALED})
    assert wrong_deg(AS_IT_IS) < 0.5 * wrong_deg(AS_IT_IS.model_copy(update={"start": as_recorded}))


@pytest.mark.parametrize(("first_mm", "last_mm"), [(1400.0, 600.0), (600.0, 1500.0)], ids=["nearer", "away"])
def test_a_head_that_comes_nearer_or_goes_away_is_looked_at_at_another_scale(
    first_mm: float, last_mm: float
) -> None:
    scene, scales, frames = Scene(SMALL), [], 60
    middle = pose_at(0)

    def pose(index: int) -> HeadPose:
        share = np.clip((index - 10) / (frames - 20), 0.0, 1.0)
        along = first_mm + share * (last_mm - first_mm)
        return replace(middle, position=middle.position * along / middle.position[2])

    scene.told.pose = pose
    for index in range(frames):
        estimate = scene.step(index)
        assert scene.state is not None and scene.state.scale is not None
        apparent = scene.state.scale * 63.0 * SCENE_CAMERA.fx / pose(index).position[2]
        assert WANTED_PX / RESCALE_RATIO / 1.1 < apparent < WANTED_PX * RESCALE_RATIO * 1.1
        scales.append(scene.state.scale)
    assert 1 <= len(set(scales[10:])) - 1 <= 2
    assert estimate.position[2] == pytest.approx(last_mm, rel=0.05)


def test_at_another_scale_the_same_is_known() -> None:
    """Points of kept frames are where they were, and what a person looks like knows how large it is."""
    scene = Scene(AS_IT_IS)
    for index in range(12):
        scene.step(index)
    before = scene.state
    assert (
        before is not None and before.scale == UNSCALED and before.person.views and before.person.album.views
    )
    after = before.at_scale(2.5)
    assert after.scale == 2.5 and after.track is before.track
    assert after.person.templates is before.person.templates
    for mine, theirs in (
        (after.person.views, before.person.views),
        (after.person.album.views, before.person.album.views),
    ):
        for large, whole in zip(mine, theirs, strict=True):
            np.testing.assert_allclose(large.pixels, scaled_pixels(whole.pixels, 2.5))
            assert large.pose is whole.pose
    assert before.at_scale(UNSCALED) is before


@pytest.mark.parametrize("config", [SMALL, AS_IT_IS], ids=["reduced", "whole"])
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
    second = Scene(AS_IT_IS, known=known)
    second.step(0)
    assert second.state is not None and second.state.scale == pytest.approx(scene.state.scale)
    assert second.told.sizes == [scene.told.sizes[-1]]
    wider = mono.HeadTracker(
        mono.MonoPeople(AS_IT_IS, SCENE_CAMERA, MODEL, known=known | {"focal_px": np.array(1e5)})
    )
    assert wider.start(frame(0), scene.rng).scale == LARGEST_SCALE, "images are not enlarged beyond"
    del known["focal_px"]
    with pytest.raises(ResultError, match="array 'focal_px' is missing"):
        Scene(known=known)


def test_of_nothing_nothing_is_learned() -> None:
    scene = Scene()
    scene.told.there = False
    scene.step(0)
    assert scene.state is not None and scene.tracker.learned(scene.state) == {}
