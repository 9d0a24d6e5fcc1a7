"""The person of another result: whom a measured shape makes, and what of a file is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import PosetrackError, ResultError, UsageError
from posetrack_cli.head.actions import MEAN_DISPLACEMENTS
from posetrack_cli.head.config import AdjustmentSettings, ModelSettings
from posetrack_cli.head.model_file import model_bytes
from posetrack_cli.head.multilinear.face_model import load_face_model
from posetrack_cli.head.subject import MONO_TRACK, STEREO_TRACK
from posetrack_cli.head.tracker.codecs import FOCAL_PX, people_codec
from posetrack_cli.head.tracker.face_learning import new_face
from posetrack_cli.head.tracker.given_person import GivenPerson, person_from_shape, read_person
from posetrack_cli.head.tracker.stereo import StereoCodecs, StereoState
from support.mono_cases import random_known, random_templates
from support.mono_scene import CAMERA

MODEL, SETTINGS = load_face_model(), AdjustmentSettings()


def neutral(identity: np.ndarray) -> np.ndarray:
    return MODEL.of_person(identity).mean - MEAN_DISPLACEMENTS


def written(path: Path, arrays: dict[str, np.ndarray], tracker: str = "head-mono") -> Path:
    path.write_bytes(model_bytes(arrays, [CAMERA], tracker))
    return path


def test_a_measured_shape_is_kept_whole() -> None:
    """Whatever it is, offsets take what no identity explains."""
    shape = neutral(MODEL.identity_mean) + np.random.default_rng(0).normal(0.0, 4.0, (10, 3))
    person = person_from_shape(shape, MODEL, SETTINGS)
    made = MODEL.of_person(person.identity, person.offsets).mean
    np.testing.assert_allclose(made - MEAN_DISPLACEMENTS, shape, atol=1e-9)


def test_the_identity_of_a_face_of_the_model_is_found() -> None:
    """Against a nearly flat prior; the usual one draws it to the mean, but not to the other side."""
    rng = np.random.default_rng(1)
    identity = MODEL.identity_mean + rng.normal(size=MODEL.identity_size) * MODEL.identity_deviations
    flat = SETTINGS.model_copy(update={"prior": 1e-4})
    found = person_from_shape(neutral(identity), MODEL, flat)
    wanted = MODEL.of_person(identity).mean
    beside = np.linalg.norm(MODEL.of_person(found.identity).mean - wanted, axis=1)
    mean = np.linalg.norm(MODEL.of_person(MODEL.identity_mean).mean - wanted, axis=1)
    assert beside.max() < 1.5 and beside.mean() < 0.5 * mean.mean()  # laid on the mean, it is turned a little
    usual = person_from_shape(neutral(identity), MODEL, SETTINGS)
    away = [(one - MODEL.identity_mean) / MODEL.identity_deviations for one in (usual.identity, identity)]
    assert float(away[0] @ away[1]) > 0.0


def test_the_first_person_of_one_camera_is_held(tmp_path: Path) -> None:
    people = people_codec(MODEL, SETTINGS)
    known = tuple(random_known(seed, MODEL) for seed in (3, 4))
    path = written(tmp_path / "face.npz", people.to_arrays(known) | {FOCAL_PX: np.array(900.0)})
    given = read_person(path, MODEL, SETTINGS)
    (person,) = people.from_arrays(given.learned)
    np.testing.assert_array_equal(person.person.identity, known[0].person.identity)
    np.testing.assert_array_equal(person.person.offsets, known[0].person.offsets)
    assert person.is_held and person.is_settled and not person.album.views and given.size == known[0].size
    assert given.learned[FOCAL_PX] == 900.0


def test_what_says_of_nobody_is_one_line(tmp_path: Path) -> None:
    people = people_codec(MODEL, SETTINGS)
    nobody = written(tmp_path / "nobody.npz", people.to_arrays(()) | {FOCAL_PX: np.array(900.0)})
    face = new_face(neutral(MODEL.identity_mean), ModelSettings())
    state = StereoState(face=face, templates=(random_templates(0),))
    stereo = written(tmp_path / "stereo.npz", StereoCodecs(1, ModelSettings()).to_model(state), "head-stereo")
    few = written(tmp_path / "few.npz", people.to_arrays((random_known(3, MODEL),)))
    other = written(tmp_path / "other.npz", {"people": np.array(1)})
    refused: list[tuple[Path, type[PosetrackError], str]] = [
        (tmp_path / "nowhere.mcap", UsageError, "no such model file"),
        (nobody, ResultError, "array 'people' is missing"),
        (stereo, UsageError, "expected the result of that run"),
        (few, ResultError, "array 'focal_px' is missing"),
        (other, ResultError, "model is incomplete or damaged"),
    ]
    for path, kind, expected in refused:
        with pytest.raises(kind, match=expected) as caught:
            read_person(path, MODEL, SETTINGS)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_whom_several_cameras_measured_has_the_frame_that_they_laid() -> None:
    """It errs as theirs does."""
    seen, measured = GivenPerson({}, None), GivenPerson({}, None, is_measured=True)
    assert (
        seen.systematic_sd is MONO_TRACK.systematic_sd
        and measured.systematic_sd is STEREO_TRACK.systematic_sd
    )
