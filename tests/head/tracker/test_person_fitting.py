"""Which frames a person is learnt from, and what is kept of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.head.tracker.frame_tracker import FrameFit
from posetrack_cli.head.tracker.person import KnownPerson
from posetrack_cli.head.tracker.person_fitting import PersonFitter
from support.mono_scene import CAMERA, FEW, MODEL, Scene

FRAMES = 12


@pytest.fixture(scope="module")
def scene() -> Scene:
    made = Scene()
    for index in range(FRAMES):
        made.step(index)
    return made


@pytest.fixture
def followed(scene: Scene) -> FrameFit:
    """What the next frame says, before anything is learnt from it."""
    state = scene.state
    assert state is not None and state.following is not None
    follower = PersonFitter(FEW, CAMERA, MODEL)
    return follower.followed(state.person, state.following, scene.frame(FRAMES), np.random.default_rng(1))


def learnt(scene: Scene, followed: FrameFit, **settings: object) -> tuple[KnownPerson, FrameFit]:
    values = FEW.model_dump()
    for key, value in settings.items():
        table, name = key.split("__")
        values[table][name] = value
    follower = PersonFitter(type(FEW).model_validate(values), CAMERA, MODEL)
    state = scene.state
    assert state is not None
    return follower.learnt(state.person, state.following, scene.frame(FRAMES), followed)


def frames_of(scene: Scene) -> int:
    assert scene.state is not None
    return scene.state.person.adjusted_frames


def test_a_neutral_face_that_looks_at_the_camera_is_learnt_from(scene: Scene, followed: FrameFit) -> None:
    person, after = learnt(scene, followed)
    assert person.adjusted_frames == frames_of(scene) + 1
    assert np.any(after.following.pose.position != followed.following.pose.position)


def test_an_expression_is_not_taken_for_the_person(scene: Scene, followed: FrameFit) -> None:
    state = scene.state
    assert state is not None
    smile = np.zeros(MODEL.deformation_size)
    smile[1] = 2.0 * MODEL.deformation_deviations[1]
    moved_mm = float(np.linalg.norm(state.person.shape.basis @ smile))
    smiling = replace(followed, coefficients=smile)
    just_not, after = learnt(scene, smiling, adjustment__neutral_mm=0.99 * moved_mm)
    assert just_not.adjusted_frames == frames_of(scene)
    assert after is smiling  # pose and deformation stay those of the patches
    just, _ = learnt(scene, smiling, adjustment__neutral_mm=1.01 * moved_mm)
    assert just.adjusted_frames == frames_of(scene) + 1


@pytest.mark.parametrize(
    "gate", [{"adjustment__facing_deg": 0.01}, {"adjustment__score": 1.0}, {"adjustment__when": "start"}]
)
def test_other_frames_are_not_learnt_from(scene: Scene, followed: FrameFit, gate: dict[str, object]) -> None:
    person, after = learnt(scene, followed, **gate)
    assert person.adjusted_frames == frames_of(scene)
    assert after is followed


def test_a_keyframe_has_only_points_that_look_like_themselves(scene: Scene, followed: FrameFit) -> None:
    slid = followed.correlations.copy()
    slid[[4, 7]] = [0.3, np.nan]
    person, _ = learnt(
        scene, replace(followed, correlations=slid), refinement__keyframe_deg=1e-6, adjustment__when="start"
    )
    assert scene.state is not None
    assert len(person.sets) == len(scene.state.person.sets) + 1
    assert followed.following.previous is not None
    expected = followed.following.previous.seen.copy()
    expected[:, [4, 7]] = False
    np.testing.assert_array_equal(person.sets[-1].seen, expected)
    assert expected.any()
