"""The one-camera tracker in its second pass, in which the skin of the drawn face tells, too."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import PosetrackError
from posetrack_cli.geometry.rotations import angle_between
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.particles.particles import velocity_between
from posetrack_cli.head.skin.map import LEAST_VIEWS, pose_on_map
from posetrack_cli.head.subject import SIGN_NAMES
from posetrack_cli.head.tracker.codecs import ONE, MonoState
from posetrack_cli.head.tracker.frame_tracker import MONO, MONO_WITH_SKIN, FrameFit, SeededFrame, TrackState
from posetrack_cli.head.tracker.mono import MonoPeople
from posetrack_cli.head.tracker.person import scaled_pose
from posetrack_cli.results.columns import LayoutError
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.confidence import RunningSigns
from posetrack_cli.tracking.state_codec import codec_of
from support.codecs import assert_lawful, assert_same_arrays
from support.damage import Arrays
from support.mono_cases import assert_same
from support.mono_scene import CAMERA, FEW, FRAME_NS, Scene, map_skin_soon

EVERY_NS = 100_000_000
WITHOUT = HeadMonoConfig.model_validate(FEW.model_dump() | {"skin": {"use": False}})
LARGE = HeadMonoConfig.model_validate(FEW.model_dump() | {"person": {"interpupillary_mm": 72.0}})
"""Somebody who is known to be larger than heads usually are."""
FIRST, SECOND = 25, 8
"""Frames of the passes."""
SHARE, SHARED = 0.6, "person0.skin_map.share"
"""A map that is believed so far; of this face, whose points do not slide, it would be hardly at all."""
TURNED_RAD = np.radians(1.0)
"""By how much heads are turned that are adjusted to the same points in pixels of half the size: the priors
count for a quarter then."""
APART_RAD = np.radians(2.0)
"""Points are 40 mm from the middle, and planes about them drawn where skin is expected a mm beside."""
ROUNDING = 1e-9
"""mm, rad and pixels, of numbers below 1000."""


@pytest.fixture(scope="module", autouse=True)
def _soon() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        map_skin_soon(patched, EVERY_NS)
        yield


@cache
def first_pass(config: HeadMonoConfig = FEW) -> Scene:
    scene = Scene(config=config)
    for index in range(FIRST):
        scene.step(index)
    return scene


def learned(config: HeadMonoConfig = FEW) -> Arrays:
    scene = first_pass(config)
    return scene.tracker.learned(scene.state, for_second_pass=True)


def believed(config: HeadMonoConfig = FEW) -> Arrays:
    return learned(config) | {SHARED: np.array(SHARE)}


def second_pass(known: Arrays, config: HeadMonoConfig = FEW) -> Iterator[tuple[Estimate, MonoState]]:
    scene = Scene(config=config, known=known)
    for index in range(SECOND):
        estimate = scene.step(index)
        assert scene.state is not None
        yield estimate, scene.state


def pose_of(estimate: Estimate) -> HeadPose:
    return HeadPose(estimate.position, estimate.quaternion)


def of_skin(arrays: Arrays) -> set[str]:
    return {name for name in arrays if ".skin" in name}


# What is kept and learned


def test_a_first_pass_keeps_a_frame_now_and_then() -> None:
    state = first_pass().state
    assert state is not None
    stamps = [one.view.stamp_ns for one in state.person.skin.views]
    assert len(stamps) >= LEAST_VIEWS and np.all(np.diff(stamps) >= EVERY_NS)
    assert np.all(np.diff(stamps) < EVERY_NS + FRAME_NS)
    assert state.person.skin_map is None and state.stated is None


def test_the_skin_is_learned_for_a_second_pass_alone() -> None:
    """No model has it: it holds for these images."""
    scene = first_pass()
    assert of_skin(scene.tracker.learned(scene.state)) == {"person0.skin.every_ns"}
    for_second = learned()
    assert SHARED in for_second and "person0.skin.views.crops" not in for_second
    assert len(for_second["person0.skin_map.stamps"]) >= LEAST_VIEWS
    others = {name: array for name, array in for_second.items() if ".skin_map." not in name}
    assert_same(others, scene.tracker.learned(scene.state))


def test_without_its_use_no_skin_is_kept_and_nothing_else_changes() -> None:
    scene = first_pass(WITHOUT)
    assert scene.state is not None and scene.state.person.skin.views == ()
    assert of_skin(learned(WITHOUT)) == {"person0.skin.every_ns"}
    assert_same(
        {name: array for name, array in learned().items() if ".skin" not in name},
        {name: array for name, array in learned(WITHOUT).items() if ".skin" not in name},
    )


def test_too_few_frames_are_no_map() -> None:
    scene = Scene()
    for index in range(FEW.start.frames + 3):
        scene.step(index)
    assert scene.state is not None and 0 < len(scene.state.person.skin.views) < LEAST_VIEWS
    known = scene.tracker.learned(scene.state, for_second_pass=True)
    assert of_skin(known) == {"person0.skin.every_ns"}


def test_a_frame_without_an_image_is_not_kept() -> None:
    scene, state = Scene(), first_pass().state
    assert state is not None
    frame = replace(scene.frame(FIRST), images=(None,))
    after, _ = scene.tracker.step(state, frame, np.random.default_rng(0))
    assert len(after.person.skin.views) == len(state.person.skin.views)


# What a second pass states


def signs_of_frame(scene: Scene, estimate: Estimate) -> np.ndarray:
    """(5,) the signs that a result holds."""
    numbers = dict(zip(scene.subject.number_names, estimate.numbers, strict=True))
    return np.array([numbers[name] for name in SIGN_NAMES])


def test_without_skin_there_is_none_to_look_for() -> None:
    scene = Scene(config=WITHOUT, known=learned(WITHOUT))
    for index in range(SECOND):
        signs = signs_of_frame(scene, estimate := scene.step(index))
        assert signs[-1] == 0.0 and estimate.confidence == MONO.probability(signs)


@pytest.mark.parametrize("config", [FEW, LARGE], ids=["of any size", "of a size that was told"])
def test_a_pose_between_track_and_skin_is_stated(config: HeadMonoConfig) -> None:
    """As far from the track as the map is believed; the track goes on from its points. A map is as large as
    heads usually are."""
    scene = Scene(config=config, known=believed(config))
    apart: list[np.ndarray] = []
    running = RunningSigns.before(1)
    for index in range(SECOND):
        estimate = scene.step(index)
        state = scene.state
        assert state is not None and state.track is not None and state.stated is not None
        found, told = state.person.skin_map, state.track.pose
        assert found is not None
        factor, (image,) = state.person.factor, scene.frame(index).images
        assert (factor > 1.05) == (config is LARGE)
        usual, whole = scaled_pose(told, 1.0 / factor), replace(found, share=1.0)
        on_skin = pose_on_map(whole, (image,), estimate.stamp_ns, usual, (CAMERA,))
        apart.append(usual.difference(scaled_pose(pose_of(estimate), 1.0 / factor)))
        np.testing.assert_allclose(apart[-1], SHARE * usual.difference(on_skin.pose), atol=ROUNDING)
        assert_same(pose_of(estimate), state.stated.pose)
        running, signs = running.after(np.array([on_skin.unmatched])), signs_of_frame(scene, estimate)
        assert estimate.confidence == MONO_WITH_SKIN.probability(signs)
        assert signs[-1] == pytest.approx(running.signs[0], abs=ROUNDING)
    assert np.linalg.norm(apart, axis=1).min() > 1e-3, "the two say something else"


def anchor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the points of all frames from now on count as found anew."""
    fit = MonoPeople.fit

    def anchored(
        self: MonoPeople, state: MonoState, track: TrackState, frame: SeededFrame
    ) -> tuple[MonoState, FrameFit]:
        state, found = fit(self, state, track, frame)
        return state, replace(found, is_anchored=True)

    monkeypatch.setattr(MonoPeople, "fit", anchored)


def test_frames_whose_points_are_found_anew_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()
    for index in range(10):
        scene.step(index)
    assert scene.state is not None
    before = len(scene.state.person.skin.views)
    anchor(monkeypatch)
    for index in range(10, 20):
        scene.step(index)
    assert len(scene.state.person.skin.views) > before


def test_frames_whose_points_are_found_anew_are_compared_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    anchor(monkeypatch)
    scene = Scene(known=believed())
    for index in range(SECOND):
        estimate = scene.step(index)
        assert scene.state is not None and scene.state.track is not None
        assert np.any(estimate.quaternion != scene.state.track.pose.quaternion)


def test_points_stay_where_they_are_seen() -> None:
    """The face that is stated deforms so that its points lie on the rays on which they were found."""
    for estimate, state in second_pass(believed()):
        assert state.track is not None
        seen, tracked = (
            project((CAMERA,), points).pixels[0]
            for points in (estimate.points, state.track.pose.points(state.track.shape))
        )
        np.testing.assert_allclose(seen, tracked, atol=1e-6)  # through the pose and back


def assert_moves(estimate: Estimate, velocity: np.ndarray) -> None:
    """A twist turns about the head's axes, a velocity about the camera's."""
    wanted = np.concatenate([velocity[:3], pose_of(estimate).rotation.T @ velocity[3:]])
    np.testing.assert_allclose(estimate.twist[:6], wanted, atol=1e-6)


def test_the_velocity_stated_is_that_of_the_poses_stated() -> None:
    """So is how fast the face deforms. The first frame of all is at rest."""
    before: tuple[Estimate, MonoState] | None = None
    for estimate, state in second_pass(believed()):
        assert state.stated is not None
        if before is None:
            np.testing.assert_array_equal(estimate.twist, 0.0)
        else:
            dt = (estimate.stamp_ns - before[0].stamp_ns) * 1e-9
            last = before[1].stated
            assert last is not None
            wanted = velocity_between(last.pose, state.stated.pose, dt)
            np.testing.assert_allclose(estimate.pose_rate[:3], wanted[:3], atol=1e-6)
            assert_moves(estimate, wanted)
            rate = (state.stated.coefficients - last.coefficients) / dt
            np.testing.assert_allclose(estimate.twist[len(wanted) :], rate, atol=1e-6)
        before = estimate, state


@pytest.mark.parametrize("known", [learned, believed])
def test_the_track_is_that_of_a_run_without_skin_to_the_bit(known: Any) -> None:
    codec = codec_of(TrackState, ONE)
    with_skin, without = second_pass(known()), second_pass(learned(WITHOUT), WITHOUT)
    for (estimate, one), (other_estimate, other) in zip(with_skin, without, strict=True):
        assert one.track is not None and other.track is not None
        assert_same_arrays(codec.to_arrays(one.track), codec.to_arrays(other.track))
        assert other.stated is None and one.stated is not None
        assert estimate.status is other_estimate.status is Status.TRACKING
        assert np.any(estimate.position != other_estimate.position)


def test_a_map_that_is_not_believed_states_the_track() -> None:
    """The pose, to rounding; the deformation is the likeliest, which is not the track's to the bit."""
    for estimate, state in second_pass(learned() | {SHARED: np.array(0.0)}):
        assert state.track is not None
        np.testing.assert_allclose(estimate.position, state.track.pose.position, atol=ROUNDING)
        np.testing.assert_allclose(estimate.quaternion, state.track.pose.quaternion, atol=ROUNDING)


def test_a_second_pass_keeps_no_frames() -> None:
    for _, state in second_pass(believed()):
        assert state.person.skin.views == ()


def test_a_velocity_over_a_gap_is_that_of_what_was_stated_before_and_after_it() -> None:
    """Divided by how long it took; and the next one is that of the next two."""
    scene = Scene(known=believed())
    before = [scene.step(index) for index in range(6)][-1]
    scene.told.there = False
    for index in range(6, 12):
        assert scene.step(index, blank=True).status is Status.LOST
    scene.told.there = True
    back, following = scene.step(12), scene.step(13)
    assert back.status is Status.REINITIALISED
    for one, other in ((before, back), (back, following)):
        dt = (other.stamp_ns - one.stamp_ns) * 1e-9
        assert_moves(other, velocity_between(pose_of(one), pose_of(other), dt))


@pytest.mark.parametrize("eyes_px", [130.0, 176.0])
def test_a_small_face_is_compared_in_enlarged_images(eyes_px: float) -> None:
    """Skin and points say about the same there, too; at another scale they would be far apart."""
    config = HeadMonoConfig.model_validate(FEW.model_dump() | {"start": {"eye_distance_px": eyes_px}})
    scene = first_pass(config)
    assert scene.state is not None and scene.state.scale is not None and scene.state.scale > 1.0
    known = learned(config) | {SHARED: np.array(1.0)}
    for estimate, state in second_pass(known, config):
        assert state.track is not None
        apart = angle_between(estimate.quaternion, state.track.pose.quaternion)
        assert 0.0 < apart < APART_RAD


# What a checkpoint keeps


@pytest.mark.parametrize("frames", [1, 4], ids=["begun", "followed"])
def test_a_state_on_the_skin_comes_back_and_goes_on_alike(frames: int) -> None:
    scene, other = Scene(known=believed()), Scene(known=believed())
    for index in range(frames):
        scene.step(index)
    assert scene.state is not None and scene.state.stated is not None
    other.state = assert_lawful(scene.tracker.codec, scene.state)
    assert_same(other.state, scene.state)
    other.rng.bit_generator.state = scene.rng.bit_generator.state
    for index in range(frames, frames + 2):
        assert_same(scene.step(index), other.step(index))


def test_a_first_pass_comes_back_with_its_frames_and_makes_the_same_map() -> None:
    scene = first_pass()
    again = assert_lawful(scene.tracker.codec, scene.state)
    assert_same(again, scene.state)
    assert_same(scene.tracker.learned(again, for_second_pass=True), learned())


def test_frames_kept_follow_the_scale_of_the_images() -> None:
    """There and back, as the points of their views do; and a map of them is about the same."""
    state = first_pass().state
    assert state is not None and state.scale is not None
    larger = state.at_scale(2.0 * state.scale)
    back = larger.at_scale(state.scale)
    assert_lawful(first_pass().tracker.codec, larger)
    for one, there, again in zip(*(s.person.skin.views for s in (state, larger, back)), strict=True):
        np.testing.assert_allclose(again.placements, one.placements, atol=ROUNDING)
        np.testing.assert_allclose(again.view.pixels, one.view.pixels, atol=ROUNDING)
        np.testing.assert_allclose(there.placements[:, :, :2], 2.0 * one.placements[:, :, :2])
        assert again.crops is one.crops
    found = first_pass().tracker.learned(larger, for_second_pass=True)
    turned = angle_between(found["person0.skin_map.quaternions"], learned()["person0.skin_map.quaternions"])
    assert turned.max() < TURNED_RAD


WILD = {
    "stamps": [0, -(2**62), 2**62],
    "pixels": [np.nan, 0.0, 1e140],
    "weights": [0.0, 1e9],
    "positions": [0.0, -700.0, 1e9, -1e9],
    "deformations": [0.0, 1e9],
    "placements": [0.0, 1.0, 1e9],
    "crops": [0, 255],
}


@pytest.mark.parametrize("name", WILD)
def test_frames_that_no_camera_took_make_no_harm(name: str) -> None:
    """A map of them, or none; or they are refused. All of them, or one. Warnings are errors."""
    scene = first_pass()
    arrays = scene.tracker.codec.to_arrays(scene.state)
    (full,) = [one for one in arrays if ".skin.views." in one and one.endswith(name)]
    for value, of_them in product(WILD[name], (slice(None), slice(1, 2))):
        wild = arrays[full].copy()
        wild[of_them] = value
        try:
            state = scene.tracker.codec.from_arrays(arrays | {full: wild})
        except LayoutError as error:
            assert name == "placements" and "\n" not in str(error)
            continue
        known = scene.tracker.learned(state, for_second_pass=True)
        try:
            Scene(known=known).step(0)
        except PosetrackError as error:
            assert name == "positions" and "\n" not in str(error)  # farther than any


WILD_MAPS = {
    "stamps": [0, -(2**62), 2**62],
    "crops": [0, 255],
    "positions": [0.0, 1e9, -1e9],
    "images": [0],
    "places": [0.0, -1e9, 1e9],
    "points": [0.0, 1e9, -1e9],
}


@pytest.mark.parametrize("name", WILD_MAPS)
def test_maps_that_no_pass_made_make_no_harm(name: str) -> None:
    known, full = believed(), f"person0.skin_map.{name}"
    for value in WILD_MAPS[name]:
        scene = Scene(known=known | {full: np.full_like(known[full], value)})
        try:
            assert np.isfinite(scene.step(0).position).all()
        except PosetrackError as error:
            assert "\n" not in str(error)
