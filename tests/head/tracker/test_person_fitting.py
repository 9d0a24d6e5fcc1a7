"""Which frames a person is learnt from, and what is kept of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.head.adjustment.adjuster import Adjuster
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.tracker.frame_tracker import FrameFit, SeededFrame
from posetrack_cli.head.tracker.person import KnownPerson, PersonFitter
from support.mono_scene import CAMERA, FEW, MODEL, Scene

FRAMES = 12


def fitter_of(config: HeadMonoConfig) -> PersonFitter:
    return PersonFitter(config, Adjuster(MODEL, CAMERA, config.adjustment))


@pytest.fixture(scope="module")
def scene() -> Scene:
    made = Scene()
    for index in range(FRAMES):
        made.step(index)
    return made


@pytest.fixture
def fit(scene: Scene) -> FrameFit:
    """What the next frame says, before anything is learnt from it."""
    state = scene.state
    assert state is not None and state.track is not None
    frame = SeededFrame(scene.frame(FRAMES), np.random.default_rng(1))
    return fitter_of(FEW).fit(state.person, state.track, frame)


def updated(scene: Scene, fit: FrameFit, **settings: object) -> tuple[KnownPerson, FrameFit]:
    values = FEW.model_dump()
    for key, value in settings.items():
        table, name = key.split("__")
        values[table][name] = value
    state = scene.state
    assert state is not None
    frame = SeededFrame(scene.frame(FRAMES), np.random.default_rng(1))
    fitter = fitter_of(type(FEW).model_validate(values))
    return fitter.update_person(state.person, state.track, frame, fit)


def frames_of(scene: Scene) -> int:
    assert scene.state is not None
    return scene.state.person.adjusted_frames


def test_a_neutral_face_that_looks_at_the_camera_is_learnt_from(scene: Scene, fit: FrameFit) -> None:
    person, after = updated(scene, fit)
    assert person.adjusted_frames == frames_of(scene) + 1
    assert np.any(after.track.pose.position != fit.track.pose.position)


def test_an_expression_is_not_taken_for_the_person(scene: Scene, fit: FrameFit) -> None:
    state = scene.state
    assert state is not None
    smile = np.zeros(MODEL.deformation_size)
    smile[1] = 2.0 * MODEL.deformation_deviations[1]
    moved_mm = float(np.linalg.norm(state.person.shape.basis @ smile))
    smiling = replace(fit, coefficients=smile)
    just_not, after = updated(scene, smiling, adjustment__neutral_mm=0.99 * moved_mm)
    assert just_not.adjusted_frames == frames_of(scene)
    assert after is smiling  # pose and deformation stay those of the patches
    just, _ = updated(scene, smiling, adjustment__neutral_mm=1.01 * moved_mm)
    assert just.adjusted_frames == frames_of(scene) + 1


@pytest.mark.parametrize(
    "gate", [{"adjustment__facing_deg": 0.01}, {"adjustment__score": 1.0}, {"adjustment__when": "start"}]
)
def test_other_frames_are_not_learnt_from(scene: Scene, fit: FrameFit, gate: dict[str, object]) -> None:
    person, after = updated(scene, fit, **gate)
    assert person.adjusted_frames == frames_of(scene)
    assert after is fit


@pytest.mark.parametrize("shut", [{"facing_deg": 0.01}, {"score": 1.0}])
@pytest.mark.parametrize("recalculation", ["joint", "printed"])
def test_as_printed_points_are_recalculated_in_frames_that_are_learnt_from_alone(
    scene: Scene, recalculation: str, shut: dict[str, float]
) -> None:
    """4.4.3: in others they are where the model has them; the pose, found before, is the same."""
    state, values = scene.state, FEW.model_dump()
    assert state is not None and state.track is not None
    values["refinement"]["recalculation"] = recalculation
    frame = scene.frame(FRAMES)

    def fitted(**adjustment: object) -> FrameFit:
        changed = values | {"adjustment": values["adjustment"] | adjustment}
        fitter = fitter_of(HeadMonoConfig.model_validate(changed))
        assert state is not None and state.track is not None
        return fitter.fit(state.person, state.track, SeededFrame(frame, np.random.default_rng(1)))

    always, opened = fitted(**shut), fitted(gates_points=True)
    model = state.person.shape.shapes(always.coefficients)
    assert np.abs(always.track.shape - model).max() > 0.01  # mm: points were found off the model
    np.testing.assert_array_equal(opened.track.shape, always.track.shape)
    gated = fitted(gates_points=True, **shut)
    np.testing.assert_array_equal(gated.track.shape, model)
    np.testing.assert_array_equal(gated.track.pose.position, always.track.pose.position)
    seen = project((CAMERA,), gated.track.pose.points(model)).pixels
    np.testing.assert_allclose(gated.pixels, seen, atol=1e-9)


def test_a_keyframe_has_only_points_that_look_like_themselves(scene: Scene, fit: FrameFit) -> None:
    slid = fit.correlations.copy()
    slid[[4, 7]] = [0.3, np.nan]
    person, _ = updated(
        scene, replace(fit, correlations=slid), refinement__keyframe_deg=1e-6, adjustment__when="start"
    )
    assert scene.state is not None
    assert len(person.templates) == len(scene.state.person.templates) + 1
    assert fit.track.templates is not None
    expected = fit.track.templates.seen.copy()
    expected[:, [4, 7]] = False
    np.testing.assert_array_equal(person.templates[-1].seen, expected)
    assert expected.any()
