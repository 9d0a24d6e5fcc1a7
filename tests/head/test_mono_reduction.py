"""Reduced images: the same rays in fewer pixels, and one scale for a whole run."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import pixels_from_points
from posetrack_cli.head.following import Following
from posetrack_cli.head.mono_reduction import (
    LEAST_REDUCTION,
    ReducedState,
    ReducingTracker,
    reduced,
    reduced_camera,
    reduced_pixels,
)
from posetrack_cli.head.mono_start.detected import EYE_DISTANCE_MM, DetectedFace
from posetrack_cli.head.mono_state import MonoState
from posetrack_cli.head.pose import HeadPose
from posetrack_cli.head.start.search import Search
from posetrack_cli.head.start.start import NO_FACE, NoStart
from posetrack_cli.recording.base import Frame
from posetrack_cli.tracking.state_codec import Fields, whole
from support.codecs import assert_lawful

WANTED_PX = 80.0
CAMERA = Camera(640, 480, 700.0, 702.0, 321.0, 238.0)
LENSES = {
    "no lens": CAMERA,
    "plumb bob": replace(CAMERA, distortion=(-0.25, 0.1, 0.002, -0.003, 0.02)),
    "fisheye": replace(CAMERA, distortion=(0.05, -0.02, 0.01, 0.003), distortion_model="equidistant"),
}
ROUNDING = 1e-9
EVEN = 0.5
"""A scale at which 640 x 480 pixels become a whole number."""
RNG = np.random.default_rng(0)


@dataclass
class FakeTracker:
    """Sees a face ``eyes_px`` apart in images as recorded, and keeps what it was given."""

    camera: Camera
    scale: float
    known: object
    eyes_px: float | None
    how: str = "detected"
    frames: list[Frame] = field(default_factory=list)

    def start(self, frame: Frame, rng: object) -> MonoState:
        return MonoState(clicked=self.face(0) if self.how == "clicked" else None)

    def step(self, state: MonoState, frame: Frame, rng: object) -> tuple[MonoState, str]:
        self.frames.append(frame)
        if self.eyes_px is None:
            return replace(state, search=state.search.failed(NoStart(NO_FACE, 0.3))), "lost"
        if self.how == "detected":
            return replace(state, detected=(*state.detected, self.face(frame.stamp_ns))), "found"
        return replace(state, clicked=None, following=self.following()), "found"

    def following(self) -> Following:
        depth = EYE_DISTANCE_MM * np.sqrt(self.camera.fx * self.camera.fy) / (self.scale * self.eyes_px)
        pose = HeadPose(np.array([0.0, 0.0, depth]), np.array([1.0, 0.0, 0.0, 0.0]))
        return Following(0, pose, np.zeros(6), None, np.zeros((10, 3)), None)

    def face(self, stamp_ns: int) -> DetectedFace:
        pose = HeadPose(np.array([0.0, 0.0, 500.0]), np.array([1.0, 0.0, 0.0, 0.0]))
        distance = self.scale * self.eyes_px
        return DetectedFace(stamp_ns, np.zeros((10, 2)), np.ones(10), 0.9, distance, pose, 0.05)

    def learned(self, state: MonoState) -> dict[str, np.ndarray]:
        return {"people": np.array(1)} if state.detected else {}

    def not_found(self, state: MonoState) -> str:
        return f"at {self.scale:g}: {state.search}"

    def remarks(self, state: MonoState) -> tuple[str, ...]:
        return (f"at {self.scale:g}",)

    codec = Fields(
        lambda lost, searched: MonoState(lost=lost, search=Search(searched)),
        lost=whole(),
        searched=("search.frames", whole()),
    )


@dataclass
class Scene:
    """A reducing tracker over fake ones."""

    eyes_px: float | None = 200.0
    known: dict | None = None
    how: str = "detected"
    made: dict[float, FakeTracker] = field(default_factory=dict)
    tracker: ReducingTracker = field(init=False)

    def __post_init__(self) -> None:
        self.tracker = ReducingTracker(CAMERA, WANTED_PX, self.make, self.known)

    def make(self, camera: Camera, scale: float, known: object) -> FakeTracker:
        assert scale not in self.made, "one tracker a scale"
        self.made[scale] = FakeTracker(camera, scale, known, self.eyes_px, self.how)
        return self.made[scale]

    def first(self) -> tuple[ReducedState, str]:
        return self.tracker.step(self.tracker.start(frame(0), RNG), frame(0), RNG)


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


def test_a_large_face_is_tracked_in_reduced_images_from_the_frame_in_which_it_is_found() -> None:
    scene = Scene(eyes_px=200.0)
    state, estimate = scene.first()
    scale = WANTED_PX / 200.0
    assert state.scale == scale and estimate == "found"
    assert state.inner.eye_distance == pytest.approx(WANTED_PX)
    assert len(state.inner.detected) == 1, "begun anew: nothing of the whole image"
    state, _ = scene.tracker.step(state, frame(1), RNG)
    small = scene.made[scale]
    assert [one.stamp_ns for one in small.frames] == [0, 33_333_333]
    assert all(one.images[0].shape == (192, 256) for one in small.frames)
    assert small.camera.fx == pytest.approx(scale * CAMERA.fx) and len(scene.made[1.0].frames) == 1


@pytest.mark.parametrize("how", ["clicked", "found in one frame"])
def test_a_large_face_that_is_not_waited_for_is_reduced_in_its_first_frame(how: str) -> None:
    """Clicked points begin at once, and so does a face where one frame is enough: none are collected."""
    scene = Scene(eyes_px=200.0, how=how)
    state, estimate = scene.first()
    assert state.scale == pytest.approx(WANTED_PX / 200.0) and estimate == "found"
    assert state.inner.following is not None and state.inner.clicked is None
    assert scene.made[state.scale].frames[0].images[0].shape == (192, 256)


@pytest.mark.parametrize("eyes_px", [30.0, WANTED_PX, WANTED_PX / LEAST_REDUCTION - 0.01])
def test_other_faces_are_tracked_in_whole_images(eyes_px: float) -> None:
    scene = Scene(eyes_px=eyes_px)
    state, _ = scene.first()
    assert state.scale == 1.0 and list(scene.made) == [1.0]
    assert state.inner.eye_distance == eyes_px
    scene.made[1.0].eyes_px = 500.0  # it comes nearer: the scale is that of a whole run
    state, _ = scene.tracker.step(state, frame(1), RNG)
    assert state.scale == 1.0


def test_a_face_that_is_looked_for_longer_is_said_so() -> None:
    """What the search came to in whole images is not forgotten with them."""
    scene = Scene(eyes_px=None)
    state, _ = scene.first()
    state, _ = scene.tracker.step(state, frame(1), RNG)
    assert state.scale is None and "at 1: 2 frames searched" in scene.tracker.not_found(state)
    scene.made[1.0].eyes_px = scene.eyes_px = 160.0
    state, _ = scene.tracker.step(state, frame(2), RNG)
    assert state.scale == 0.5 and "at 0.5: 2 frames searched" in scene.tracker.not_found(state)
    assert scene.tracker.remarks(state) == ("at 0.5",)


@pytest.mark.parametrize("scale", [None, 1.0, 0.4])
def test_a_saved_state_comes_back_at_its_scale(scale: float | None) -> None:
    scene, inner = Scene(), MonoState(lost=3, search=Search(5))
    again = assert_lawful(scene.tracker.codec, ReducedState(scale, inner))
    assert again.scale == scale and again.inner.lost == 3 and again.inner.search.frames == 5


def test_what_was_learned_begins_at_the_size_that_it_was_seen_at() -> None:
    scene = Scene(eyes_px=200.0)
    state, _ = scene.first()
    known = scene.tracker.learned(state)
    assert known["focal_px"] == pytest.approx(0.4 * CAMERA.fx) and known["people"] == 1
    second = Scene(eyes_px=300.0, known=known)
    begun = second.tracker.start(frame(0), RNG)
    assert begun.scale == pytest.approx(0.4) and list(second.made) == [begun.scale]
    assert second.made[begun.scale].known is known
    after, _ = second.tracker.step(begun, frame(0), RNG)
    assert after.scale == begun.scale and second.made[begun.scale].frames[0].images[0].shape == (192, 256)


def test_images_are_never_enlarged_to_what_was_learned() -> None:
    """Of a recording with a longer focal length."""
    scene = Scene(known={"people": np.array(1), "focal_px": np.array(5.0 * CAMERA.fx)})
    assert scene.tracker.start(frame(0), RNG).scale == 1.0


def test_of_nothing_nothing_is_learned() -> None:
    scene = Scene(eyes_px=None)
    state, _ = scene.first()
    assert scene.tracker.learned(state) == {}
