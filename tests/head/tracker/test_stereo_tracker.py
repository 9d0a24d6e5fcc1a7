"""The stereo tracker on a drawn face whose motion is known; where the face is found is told, not detected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.rotations import angle_between
from posetrack_cli.head.config import RunSettings
from posetrack_cli.head.initialisation.search import InitFailure
from posetrack_cli.head.subject import STEREO_TRACK
from posetrack_cli.head.tracker import stereo
from posetrack_cli.head.tracker.head_tracker import UNSEEN, HeadTracker
from posetrack_cli.head.tracker.stereo import StereoFace
from posetrack_cli.results.estimate import Estimate, Status
from support.codecs import assert_lawful
from support.mono_scene import map_skin_soon
from support.stereo_scene import CAMERAS, FEW, Scene, Told
from support.textured_face import SHAPE, pose_at, textured_face

POSITION_MM, ROTATION_RAD = 0.3, np.radians(0.3)
"""Far above that, which leaves room for the planes' edges, and far below a pixel: 0.7 mm."""


def errors(estimates: list[Estimate]) -> tuple[np.ndarray, np.ndarray]:
    """Distances, mm, and angles, rad, from the truth, less what the first frame was wrong by."""
    true = [pose_at(e.frame_index) for e in estimates]
    inverse = [t.rotation.T @ (e.position - t.position) for e, t in zip(estimates, true, strict=True)]
    turns = [angle_between(e.quaternion, t.quaternion) for e, t in zip(estimates, true, strict=True)]
    return np.linalg.norm(np.array(inverse) - inverse[0], axis=1), np.array(turns)


def test_a_moving_head_is_followed() -> None:
    scene = Scene()
    found = [scene.step(index) for index in range(45)]
    assert all(e.status is Status.TRACKING and e.confidence > 0.8 for e in found)
    distances, angles = errors(found)
    assert distances.max() < POSITION_MM and angles.max() < ROTATION_RAD
    assert scene.told.asked == 1, "once found, it is not searched for"


def test_a_camera_may_drop_out() -> None:
    scene = Scene()
    found = [scene.step(index, seen=(True, not 5 <= index < 10)) for index in range(15)]
    found += [scene.step(index, seen=(not index < 18, True)) for index in range(15, 20)]
    assert all(e.status is Status.TRACKING for e in found)
    distances, _ = errors(found)
    # one camera sees depth only in how the face grows: z errs by far more, but nothing is lost
    assert distances[10:15].max() < 1.0 and distances.max() < 10.0 * POSITION_MM


def test_a_face_that_goes_is_lost_and_found_again() -> None:
    scene = Scene()
    before = [scene.step(index) for index in range(10)]
    scene.told.there = False
    gone = [scene.step(index, blank=True) for index in range(10, 16)]
    scene.told.there = True
    back = [scene.step(index) for index in range(16, 30)]
    assert {e.status for e in before} == {Status.TRACKING}
    assert {e.status for e in gone} == {Status.LOST} and {e.confidence for e in gone} == {0.0}
    np.testing.assert_array_equal(gone[-1].position, before[-1].position)
    assert back[0].status is Status.REINITIALISED
    assert {e.status for e in back[1:]} == {Status.TRACKING}
    distances, angles = errors([before[0], *back])
    # it came back 4 mm from where it was last: the first frame's few steps need not have converged
    assert distances[1] < 2.0 and distances[2:].max() < POSITION_MM
    assert angles[1] < np.radians(1.0) and angles[2:].max() < ROTATION_RAD


def test_another_face_in_its_place_is_not_taken_for_it() -> None:
    scene = Scene()
    for index in range(10):
        scene.step(index)
    scene.face = textured_face(seed=7)
    others = [scene.step(index) for index in range(10, 20)]
    assert {e.status for e in others} == {Status.LOST}


def test_skin_takes_part_in_the_pose_of_a_second_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    """The map comes from the first pass and is not saved for other recordings; points stay where they are."""
    map_skin_soon(monkeypatch)
    twice = FEW.model_copy(update={"run": RunSettings(passes=2)})
    first = Scene(config=twice)
    for index in range(30):
        first.step(index)
    assert not [name for name in first.tracker.learned(first.state) if "skin" in name]
    known = first.tracker.learned(first.state, for_second_pass=True)
    second, plain = Scene(config=twice, known=known), Scene(known={**known, "skin_map.share": np.array(0.0)})
    found = [[scene.step(index) for index in range(30)] for scene in (second, plain)]
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one.points, other.points, atol=1e-9)
    moved = [angle_between(one.quaternion, other.quaternion) for one, other in zip(*found, strict=True)]
    assert 0.0 < np.max(moved) < ROTATION_RAD
    assert errors(found[0])[1].max() < ROTATION_RAD
    assert_lawful(second.tracker.codec, second.state)


def test_a_saved_state_goes_on_alike() -> None:
    scene, other = Scene(), Scene()
    for index in range(8):
        scene.step(index)
    other.state = other.tracker.codec.from_arrays(scene.tracker.codec.to_arrays(scene.state))
    other.rng.bit_generator.state = scene.rng.bit_generator.state
    for index in range(8, 12):
        first, second = scene.step(index), other.step(index)
        np.testing.assert_array_equal(first.position, second.position)
        np.testing.assert_array_equal(first.points, second.points)
        np.testing.assert_array_equal(first.pose_variance, second.pose_variance)


def test_a_result_states_what_the_whole_track_is_wrong_by_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a head's frame sits in it no frame tells; velocities do not know of it."""
    scenes = Scene(), Scene()
    for index in range(3):
        stated = scenes[0].step(index)
        with monkeypatch.context() as patch:
            patch.setattr(stereo, "STEREO_TRACK", replace(STEREO_TRACK, systematic_sd=np.zeros(6)))
            particles = scenes[1].step(index)
    more = stated.pose_variance - particles.pose_variance
    np.testing.assert_allclose(more[:3], np.square([2.6, 2.3, 3.3]), rtol=1e-9)
    np.testing.assert_allclose(np.degrees(np.sqrt(more[3:6])), [2.3, 1.8, 1.4])
    np.testing.assert_array_equal(more[6:], 0.0)
    np.testing.assert_array_equal(stated.twist_variance, particles.twist_variance)


def test_a_search_is_saved_too() -> None:
    scene = Scene(told=Told(there=False))
    for index in range(3):
        scene.step(index, blank=True)
    again = assert_lawful(scene.tracker.codec, scene.state)
    said = "3 frames searched, best score 0.30, mostly: no face"
    assert scene.tracker.not_found(scene.state) == scene.tracker.not_found(again) == said


def test_before_it_is_found_a_head_is_lost() -> None:
    scene = Scene(told=Told(there=False))
    estimate = scene.step(0, blank=True)
    assert estimate.status is Status.LOST and estimate.confidence == 0.0
    np.testing.assert_array_equal(estimate.position, UNSEEN.position)
    scene.told.there = True
    assert scene.step(1).status is Status.TRACKING
    assert scene.tracker.not_found(scene.state) == ""


def test_what_was_learned_begins_another_run() -> None:
    scene = Scene()
    for index in range(20):
        scene.step(index)
    known = scene.tracker.learned(scene.state)
    second = Scene()
    second.tracker = HeadTracker(StereoFace(FEW, CAMERAS, second.told, known))
    estimates = [second.step(index) for index in range(10)]
    assert {e.status for e in estimates} == {Status.TRACKING}
    np.testing.assert_array_equal(scene.state.face.model.mean, known["face.mean"])
    # told 1 mm beside the face, it is where the templates say: as the first run was after a while
    distances, angles = errors([scene.step(20), *estimates])
    assert distances.max() < 2.0 * POSITION_MM and angles.max() < ROTATION_RAD


def test_a_head_that_is_found_confirms_the_order_of_the_cameras() -> None:
    scene = Scene(told=Told(there=False, failure=InitFailure("points do not fit", 0.9, (1, 0))))
    scene.step(0)
    scene.told.there = True
    assert scene.step(1).status is Status.TRACKING
    assert scene.state.search.order == () and scene.tracker.remarks(scene.state) == ()


def test_exchanged_images_are_refused() -> None:
    scene = Scene(told=Told(there=False, failure=InitFailure("points do not fit", 0.9, (1, 0))))
    scene.step(0)
    scene.step(1)
    with pytest.raises(RecordingError, match="camera1, camera0"):
        scene.step(2)


def test_a_head_that_jumps_is_followed_by_its_whole_face() -> None:
    """By 40 px between two frames, farther than a patch reaches, in the images of both cameras."""
    scene = Scene()
    for index in range(6):
        scene.step(index)
    scene.told.there = False
    there = pose_at(6).moved(np.array([60.0, 15.0, 0.0, 0.0, 0.1, 0.0]))
    images = scene.face.render(tuple(CAMERAS), there, SHAPE, noise=2.0)
    scene.state, found = scene.tracker.step(scene.state, replace(scene.frame(6), images=images), scene.rng)
    assert scene.told.asked == 1 and found.points is not None
    np.testing.assert_allclose(found.points, there.points(SHAPE), atol=2.0)
