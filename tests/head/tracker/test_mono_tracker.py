"""The one-camera tracker on a drawn face whose motion is known; where the face is found is told."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import fields, replace
from unittest.mock import patch

import cv2
import numpy as np
import pytest

from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.rotations import angle_between
from posetrack_cli.head.face.rig_images import RigImages, project
from posetrack_cli.head.face.templates import take_templates, tangents
from posetrack_cli.head.initialisation.mono import MonoInitialiser
from posetrack_cli.head.tracker.codecs import MonoState
from posetrack_cli.head.tracker.frame_tracker import FrameFit
from posetrack_cli.head.tracker.head_tracker import UNSEEN
from posetrack_cli.head.tracker.person import PersonFitter
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.two_pass import NothingFoundError
from support.codecs import assert_lawful
from support.mono_cases import assert_same
from support.mono_scene import CAMERA, FACE, FEW, FRAME_NS, MODEL, NOISE, Scene, Told
from support.textured_face import SHAPE, pose_at, textured_face

ACROSS_MM = 0.2
"""0.3 px. Noise places a patch to some 0.02 px; where the features were first found, it is compared with."""
DEPTH_MM = 2.5
"""0.35 % of 700 mm: the size of the face, some 100 mm, is adjusted to 0.35 mm, and depth is in proportion."""
ROTATION_RAD = np.radians(0.8)
"""Points 40 mm from the middle, of which priors and little parallax tell the depth to half a millimetre."""
JUMPED_RAD = np.radians(1.5)
"""In a direction in which no template was taken."""
STARTING = FEW.start.frames
PATIENT = FEW.model_copy(update={"status": FEW.status.model_copy(update={"lost_after_frames": 3})})
ROUNDING = 1e-9
"""mm and pixels, of numbers below 1000."""


def errors(estimates: list[Estimate]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Across and along the camera's axis, mm, less what the first is wrong by, and angles, rad."""
    true = [pose_at(e.frame_index) for e in estimates]
    away = np.array([e.position - t.position for e, t in zip(estimates, true, strict=True)])
    away -= away[0]
    turns = [angle_between(e.quaternion, t.quaternion) for e, t in zip(estimates, true, strict=True)]
    return np.hypot(away[:, 0], away[:, 1]), np.abs(away[:, 2]), np.array(turns)


def assert_near_truth(estimates: list[Estimate]) -> None:
    across, depth, turns = errors(estimates)
    assert across.max() < ACROSS_MM and depth.max() < DEPTH_MM and turns.max() < ROTATION_RAD


def assert_same_estimates(first: Estimate, second: Estimate) -> None:
    for one in fields(Estimate):
        assert_same(getattr(first, one.name), getattr(second, one.name))


def numbers_of(scene: Scene, estimate: Estimate) -> dict[str, float]:
    return dict(zip(scene.subject.number_names, estimate.numbers, strict=True))


def test_a_moving_head_is_followed() -> None:
    scene = Scene()
    found = [scene.step(index) for index in range(45)]
    assert {e.status for e in found} == {Status.TRACKING}
    assert all(e.confidence > 0.9 for e in found[STARTING:])
    assert_near_truth(found)
    assert scene.told.asked == STARTING, "once found, it is not searched for"
    assert scene.tracker.not_found(scene.state) == "" and scene.tracker.remarks(scene.state) == ()


def test_velocity_is_that_of_the_head() -> None:
    """Of differences of two frames, so an error of a frame counts twice, divided by their time."""
    scene = Scene()
    last = [scene.step(index) for index in range(15)][-1]
    wanted = (pose_at(14).position - pose_at(13).position) / (FRAME_NS * 1e-9)
    np.testing.assert_allclose(last.twist[:2], wanted[:2], atol=2 * ACROSS_MM / (FRAME_NS * 1e-9))
    np.testing.assert_allclose(last.twist[:3], last.pose_rate[:3])


def test_points_are_seen_where_they_were_drawn() -> None:
    """Each at its pixel, beside it by as much as the first frame's features were told."""
    scene = Scene()
    for estimate in [scene.step(index) for index in range(20)]:
        seen = project((CAMERA,), estimate.points).pixels[0]
        drawn = project((CAMERA,), pose_at(estimate.frame_index).points(SHAPE)).pixels[0]
        np.testing.assert_allclose(seen - drawn, np.broadcast_to([1.0, -1.0], (10, 2)), atol=0.5)


def test_the_person_is_adjusted_in_every_frame_after_the_start() -> None:
    scene = Scene()
    found = [numbers_of(scene, scene.step(index)) for index in range(STARTING + 4)]
    assert [n["adjusted_frames"] for n in found] == [0.0] * STARTING + [1.0, 2.0, 3.0, 4.0]
    assert all(np.isnan(n["identity_1"]) for n in found[: STARTING - 1])
    assert found[-1]["adjustment_rms_px"] < 0.1  # tracked points fit a face that is the model's own


def test_a_frame_goes_on_from_what_it_was_adjusted_to() -> None:
    """Pose, deformation, particles and points are one: the points lie at the adjusted face's depths."""
    scene = Scene()
    for index in range(STARTING + 6):
        estimate = scene.step(index)
    person, track = scene.state.person, scene.state.track
    view, a = person.views[-1], person.views[-1].deformation - MODEL.deformation_mean
    assert view.stamp_ns == estimate.stamp_ns
    np.testing.assert_array_equal(estimate.position, view.pose.position)
    np.testing.assert_array_equal(estimate.quaternion, view.pose.quaternion)
    np.testing.assert_allclose(estimate.shape, view.deformation, atol=ROUNDING)
    assert track.pose is track.particles.pose is view.pose
    np.testing.assert_array_equal(track.particles.coefficients, a)
    depths = view.pose.points(person.shape.shapes(a))[:, 2]
    np.testing.assert_allclose(estimate.points[:, 2], depths, atol=ROUNDING)
    seen = project((CAMERA,), estimate.points).pixels[0]
    np.testing.assert_allclose(seen, view.pixels, atol=ROUNDING)


def test_the_reference_is_the_first_frame_as_the_start_adjusted_it() -> None:
    """Its images are of the first frame; how they are warped from then on is told by the adjusted pose."""
    begun = []

    initialise = MonoInitialiser.initialise

    def recorded(*arguments: object) -> object:
        begun.append(initialise(*arguments))
        return begun[-1]

    scene = Scene()
    with patch.object(MonoInitialiser, "initialise", recorded):
        for index in range(STARTING):
            scene.step(index)
    views, reference = begun[-1].views, scene.state.person.templates[0]
    assert [view.stamp_ns for view in views] == [index * FRAME_NS for index in range(STARTING)]
    np.testing.assert_array_equal(reference.facing, views[0].pose.facing)
    person = begun[-1].person
    shape = MODEL.of_person(person.identity, person.offsets).mean
    wanted = tangents(project((CAMERA,), views[0].pose.points(shape)), views[0].pose)
    np.testing.assert_array_equal(reference.tangents, wanted)
    pixels = views[0].pixels
    taken = take_templates(RigImages((CAMERA,), scene.frame(0).images), views[0].pose, shape, pixels[None])
    np.testing.assert_array_equal(reference.windows, taken.windows)


def test_a_step_leaves_the_state_as_it_is() -> None:
    scene = Scene()
    for index in range(STARTING + 5):
        before = scene.state
        saved = None if before is None else deepcopy(scene.tracker.codec.to_arrays(before))
        scene.step(index)
        if before is not None:
            assert_same(scene.tracker.codec.to_arrays(before), saved)


@pytest.mark.parametrize("at", [2, STARTING, STARTING + 4], ids=["collecting", "found", "following"])
def test_a_saved_state_goes_on_alike(at: int) -> None:
    scene, other = Scene(), Scene()
    for index in range(at):
        scene.step(index)
    other.state = other.tracker.codec.from_arrays(scene.tracker.codec.to_arrays(scene.state))
    other.rng.bit_generator.state = scene.rng.bit_generator.state
    for index in range(at, at + 5):
        assert_same_estimates(scene.step(index), other.step(index))


def test_equal_runs_give_equal_bits() -> None:
    first, second = Scene(), Scene()
    for index in range(STARTING + 5):
        assert_same_estimates(first.step(index), second.step(index))


def test_a_second_pass_begins_in_its_first_frame() -> None:
    scene = Scene()
    for index in range(25):
        scene.step(index)
    known = scene.tracker.learned(scene.state)
    second = Scene(known=known)
    found = [second.step(index) for index in range(25)]
    assert {e.status for e in found} == {Status.TRACKING}
    assert second.told.asked == 1, "the templates tell, not several detections"
    assert numbers_of(second, found[0])["adjusted_frames"] > 0
    assert_near_truth([scene.step(25), *found[1:]])  # of frame 0 only a few steps from a pixel aside


def test_a_second_pass_looks_for_the_face_until_it_comes() -> None:
    scene = Scene()
    for index in range(12):
        scene.step(index)
    second = Scene(known=scene.tracker.learned(scene.state), told=Told(there=False))
    assert [second.step(index, blank=True).status for index in range(4)] == [Status.LOST] * 4
    assert "4 frames searched" in second.tracker.not_found(second.state)
    second.told.there = True
    assert second.step(4).status is Status.TRACKING


def test_a_face_that_goes_is_lost_and_found_again() -> None:
    scene = Scene()
    before = [scene.step(index) for index in range(12)]
    scene.told.there = False
    gone = [scene.step(index, blank=True) for index in range(12, 18)]
    scene.told.there = True
    back = [scene.step(index) for index in range(18, 30)]
    assert {e.status for e in before} == {Status.TRACKING}
    assert {e.status for e in gone} == {Status.LOST} and {e.confidence for e in gone} == {0.0}
    np.testing.assert_array_equal(gone[-1].position, before[-1].position)
    assert back[0].status is Status.REINITIALISED
    assert {e.status for e in back[1:]} == {Status.TRACKING}
    assert_near_truth([before[0], *back[1:]])
    adjusted = [numbers_of(scene, e)["adjusted_frames"] for e in (before[-1], *gone)]
    assert adjusted == [12.0 - STARTING] * 7, "nothing is learnt of frames without a face"


def displaced(state: MonoState) -> MonoState:
    """The head where it is not, so that hardly a point looks like itself."""
    track = state.track
    pose = track.pose.moved(np.array([40.0, 25.0, 0.0, 0.0, 0.0, 0.0]))
    particles = track.particles.moved_to(pose, track.particles.coefficients)
    return replace(state, track=replace(track, pose=pose, particles=particles, templates=None))


@pytest.mark.parametrize("blurred", [False, True])
def test_a_head_that_jumps_is_followed_without_a_search(blurred: bool) -> None:
    """44 px aside within a frame, which no particle reaches; blurred it looks like no template."""
    scene, jump = Scene(), 44
    for index in range(STARTING + 6):
        scene.step(index)
    scene.told.there = False
    for index in range(STARTING + 6, STARTING + 9):
        (image,) = scene.frame(index).images
        moved = np.roll(image, jump, axis=1)
        moved = cv2.GaussianBlur(moved, (0, 0), 2.5) if blurred else moved
        there = Frame(index, index * FRAME_NS, (moved,))
        scene.state, found = scene.tracker.step(scene.state, there, scene.rng)
        true = pose_at(index)
        assert found.status is Status.TRACKING
        pixels, wanted = (
            project((CAMERA,), place[None]).pixels[0, 0] for place in (found.position, true.position)
        )
        np.testing.assert_allclose(pixels, wanted + np.array([jump, 0.0]), atol=4.0)
    assert scene.told.asked <= STARTING + 1, "compared once at most, as the blurred face looks hardly like it"


def test_a_head_that_jumps_and_turns_within_a_frame_is_followed_without_a_search() -> None:
    """By 75 px, 17 degrees of yaw and 11 of pitch: a shift alone does not lead there."""
    scene = Scene()
    for index in range(STARTING + 6):
        scene.step(index)
    scene.told.there = False
    for index in range(STARTING + 6, STARTING + 9):
        true = pose_at(index).moved(np.array([60.0, 10.0, 0.0, 0.2, 0.3, 0.0]))
        images = FACE.render((CAMERA,), true, SHAPE, noise=NOISE, seed=index)
        scene.state, found = scene.tracker.step(
            scene.state, Frame(index, index * FRAME_NS, images), scene.rng
        )
        assert found.status is Status.TRACKING
        assert angle_between(found.quaternion, true.quaternion) < JUMPED_RAD
    assert scene.told.asked == STARTING


def scored(method: Callable[..., FrameFit], *outcomes: tuple[float, np.ndarray]) -> Callable[..., FrameFit]:
    """A way to fit that comes to these scores and weights in turn, and to the last one from then on."""
    left = list(outcomes)

    def fit(*where: object) -> FrameFit:
        score, weights = left.pop(0) if len(left) > 1 else left[0]
        return replace(method(*where), score=score, weights=weights)

    return fit


def test_of_two_places_the_one_counts_in_which_more_of_the_face_is_seen() -> None:
    """Beyond the image no point contradicts: the score is the mean of those that are left."""
    scene, half = Scene(), np.repeat([0.65, 0.0], 5)
    for index in range(STARTING + 6):
        scene.step(index)
    scene.told.there, scene.state = False, replace(scene.state, trust=0.0)
    places = scored(PersonFitter.fit, (0.65, half), (0.6, np.full(10, 0.6)))
    with patch.object(PersonFitter, "fit", places):
        found = scene.step(STARTING + 6)
    assert numbers_of(scene, found)["score"] == 0.6


def test_a_face_that_dissolves_is_doubted_though_each_frame_looks_like_the_one_before() -> None:
    """Followed by what it looked like a moment ago it may be wrong already: that is no evidence for it."""
    scene = Scene()
    for index in range(STARTING + 6):
        scene.step(index)
    scene.told.there = False
    (face,) = scene.frame(STARTING + 5).images
    texture = cv2.GaussianBlur(np.random.default_rng(0).uniform(0.0, 255.0, face.shape), (0, 0), 3.0)
    texture = (texture - texture.mean()) / texture.std() * face.std() + face.mean()
    found = []
    for index, share in enumerate(np.minimum(np.arange(1, 17) / 12.0, 1.0), start=STARTING + 6):
        image = np.clip((1.0 - share) * face + share * texture, 0.0, 255.0).astype(np.uint8)
        scene.state, one = scene.tracker.step(
            scene.state, Frame(index, index * FRAME_NS, (image,)), scene.rng
        )
        found.append(one)
    assert found[7].status is Status.TRACKING and found[7].confidence > 0.9  # a third is still the face
    assert all(np.diff([one.confidence for one in found[8:]]) < 0.0)
    assert found[-1].status is Status.LOST


def test_a_track_that_looks_hardly_like_the_face_is_compared_with_a_detection() -> None:
    """It goes on from there in the same frame; but not in every frame is one looked for."""
    scene = Scene(config=PATIENT)
    found = [scene.step(index) for index in range(10)]
    scene.state = displaced(scene.state)
    found += [scene.step(10), scene.step(11)]
    assert [e.status for e in found[10:]] == [Status.TRACKING] * 2
    assert scene.told.asked == STARTING + 1
    assert_near_truth([found[0], found[-1]])
    scene.state = displaced(scene.state)
    assert scene.step(12).status is Status.LOST and scene.told.asked == STARTING + 1, "asked just now"


@pytest.mark.parametrize("frames, then", [(2, Status.TRACKING), (3, Status.REINITIALISED)])
def test_a_head_is_lost_after_as_many_frames_as_the_configuration_says(frames: int, then: Status) -> None:
    scene = Scene(config=PATIENT)
    for index in range(10):
        scene.step(index)
    scene.told.there = False
    gone = [scene.step(10 + index, blank=True) for index in range(frames)]
    scene.told.there = True
    assert {e.status for e in gone} == {Status.LOST}
    assert scene.step(10 + frames).status is then


def test_another_face_is_another_person_and_the_first_is_known_again() -> None:
    scene = Scene()
    first = [numbers_of(scene, scene.step(index))["person"] for index in range(12)]
    scene.face = textured_face(seed=7)
    other = [scene.step(index) for index in range(12, 75)]
    scene.face = FACE
    again = [scene.step(index) for index in range(75, 90)]
    assert set(first) == {0.0} and other[0].status is Status.LOST
    assert other[-1].status is again[-1].status is Status.TRACKING
    assert numbers_of(scene, other[-1])["person"] == 1.0 and numbers_of(scene, again[-1])["person"] == 0.0
    assert len(scene.state.people) == 2 and [who for _, who in scene.state.changes] == [1, 0]
    assert not scene.state.cut, "it was found since"
    said = scene.tracker.remarks(scene.state)
    assert "person 1" in said[0] and "person 0" in said[1]


def test_without_an_image_nothing_is_found() -> None:
    scene = Scene()
    for index in range(8):
        scene.step(index)
    missing = Frame(8, 8 * FRAME_NS, (None,))
    _, estimate = scene.tracker.step(scene.state, missing, scene.rng)
    assert estimate.status is Status.LOST


def test_before_it_is_found_a_head_is_lost() -> None:
    scene = Scene(told=Told(there=False))
    estimates = [scene.step(index, blank=True) for index in range(3)]
    assert {e.status for e in estimates} == {Status.LOST}
    np.testing.assert_array_equal(estimates[-1].position, UNSEEN.position)
    said = "3 frames searched, best score 0.30, mostly: no face"
    again = assert_lawful(scene.tracker.codec, scene.state)
    assert scene.tracker.not_found(scene.state) == scene.tracker.not_found(again) == said
    assert scene.tracker.learned(scene.state) == {}
    scene.told.there = True
    assert scene.step(3).status is Status.TRACKING


def test_clicked_points_begin_at_once() -> None:
    pixels = project((CAMERA,), pose_at(0).points(SHAPE)).pixels[0]
    scene = Scene(clicked=pixels)
    found = [scene.step(index) for index in range(20)]
    assert {e.status for e in found} == {Status.TRACKING} and scene.told.asked == 0
    assert numbers_of(scene, found[0])["person"] == 0.0 and np.isfinite(found[0].numbers[0])
    assert_near_truth(found)


def test_clicked_points_that_are_no_face_are_refused() -> None:
    pixels = project((CAMERA,), pose_at(0).points(SHAPE)).pixels[0]
    scene = Scene(clicked=pixels[[8, 5, 4, 1, 0, 3, 9, 2, 6, 7]])
    with pytest.raises(NothingFoundError, match="clicked points do not form a head"):
        scene.step(0)


def test_what_no_tracker_learned_is_refused() -> None:
    with pytest.raises(ResultError, match="model is incomplete or damaged"):
        Scene(known={"face.mean": MODEL.mean})
