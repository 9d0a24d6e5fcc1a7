"""A start from a few frames: pose and person, and when there is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.head.adjustment.adjuster import Adjuster
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.initialisation.clicked import read_clicked
from posetrack_cli.head.initialisation.mono import MonoInitialisation, MonoInitialiser, _implausible, face_at
from posetrack_cli.head.initialisation.search import NO_FACE, InitFailure
from posetrack_cli.head.multilinear.face_model import load_face_model
from support.initialisation_scenes import BENT, PLAIN, Says, head, pixels_of

MODEL = load_face_model(None)
MEAN = MODEL.of_person(MODEL.identity_mean).mean
CONFIG = HeadMonoConfig()
MEAN_PERSON = CONFIG.model_copy(update={"adjustment": CONFIG.adjustment.model_copy(update={"when": "never"})})
HEADS = [head(2.0 * i, 4.0 * i - 8.0, 15.0 - 6.0 * i, 10.0 * i, -5.0 * i, 650.0 + 10.0 * i) for i in range(5)]


def detected(shape=MEAN, camera=PLAIN, heads=HEADS, noise=0.0):
    rng = np.random.default_rng(0)
    return [
        face_at(pixels_of(one, camera, shape) + noise * rng.standard_normal((10, 2)), i, camera)
        for i, one in enumerate(heads)
    ]


def initialise(faces, camera, model, config):
    return MonoInitialiser(config, Adjuster(model, camera, config.adjustment), Says(())).initialise(faces)


def errors(start, heads=HEADS):
    """(n, 6) mm and degrees."""
    differences = np.array([one.difference(view.pose) for one, view in zip(heads, start.views, strict=True)])
    return np.column_stack([differences[:, :3], np.rad2deg(differences[:, 3:])])


@pytest.mark.parametrize("camera", [PLAIN, BENT], ids=lambda camera: camera.name)
@pytest.mark.parametrize("config", [CONFIG, MEAN_PERSON], ids=["adjusted", "mean"])
@pytest.mark.parametrize("count", [1, 5])
def test_the_mean_person_is_found_where_it_is(camera, config, count):
    """Nothing is to be adjusted: every prior is at its mean, so the poses are exact."""
    start = initialise(detected(camera=camera, heads=HEADS[:count]), camera, MODEL, config)
    assert isinstance(start, MonoInitialisation)
    np.testing.assert_allclose(errors(start, HEADS[:count]), 0.0, atol=0.02)
    np.testing.assert_allclose(start.person.identity, MODEL.identity_mean, atol=1e-3)
    assert start.residual < 1e-4
    assert [view.stamp_ns for view in start.views] == list(range(count))


def test_another_person_is_found_better_than_the_mean_one_would_be():
    rng = np.random.default_rng(5)
    better = []
    for _ in range(6):
        identity = MODEL.identity_mean + MODEL.identity_deviations * rng.uniform(
            -1.5, 1.5, MODEL.identity_size
        )
        shape = MODEL.of_person(identity).mean
        adjusted, mean = (
            initialise(detected(shape, noise=0.5), PLAIN, MODEL, one) for one in (CONFIG, MEAN_PERSON)
        )
        assert isinstance(adjusted, MonoInitialisation)
        assert isinstance(mean, MonoInitialisation)
        assert np.abs(errors(adjusted))[:, 3:].max() < 10.0
        assert adjusted.residual < mean.residual
        better.append(np.abs(errors(adjusted)).mean(axis=0) < np.abs(errors(mean)).mean(axis=0))
    assert np.mean(better) > 0.5


def test_first_pixels_and_score_are_those_detected():
    faces = detected(noise=0.5)
    start = initialise(faces, PLAIN, MODEL, CONFIG)
    assert isinstance(start, MonoInitialisation)
    np.testing.assert_array_equal(start.pixels, faces[0].pixels)
    assert start.score == 1.0


def test_detected_points_count_less_than_tracked_ones():
    start = initialise(detected(), PLAIN, MODEL, CONFIG)
    assert isinstance(start, MonoInitialisation)
    np.testing.assert_allclose(start.views[0].weights, CONFIG.start.pixel_sd**-2)


def test_without_frames_there_is_no_face():
    assert initialise([], PLAIN, MODEL, CONFIG) == InitFailure(NO_FACE)


def reason(faces, config=CONFIG):
    failure = initialise(faces, PLAIN, MODEL, config)
    assert isinstance(failure, InitFailure)
    assert failure.score == 1.0
    return failure.reason


def test_points_in_disorder_are_no_face():
    """Constant offsets could explain them; an average face cannot."""
    order = np.random.default_rng(1).permutation(10)
    faces = [face_at(pixels_of(one)[order], i, PLAIN) for i, one in enumerate(HEADS)]
    assert "points deviate from a face by" in reason(faces) or "looks away" in reason(faces)


def test_an_adjusted_face_off_its_points_is_none():
    assert _implausible(HEADS, 0.11) == ""
    assert _implausible(HEADS, 0.13) == "points deviate from a face by 0.13 eye distances"


def test_left_exchanged_with_right_looks_away():
    """As from a person who clicks the left of the image first: the face would be seen through its back."""
    exchanged = [3, 2, 1, 0, 5, 4, 7, 6, 9, 8]
    faces = [face_at(pixels_of(one)[exchanged], i, PLAIN) for i, one in enumerate(HEADS)]
    assert "looks away" in reason(faces) or "eye distances" in reason(faces)


def test_a_face_too_far_to_be_one_is_none():
    heads = [head(x=one.position[0], z=9000.0) for one in HEADS]
    assert reason(detected(heads=heads)) == "face at an implausible distance of 9 m"


@pytest.mark.parametrize("squeezed", [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1e-9, 1e-9]])
def test_points_in_one_place_or_on_a_line_are_no_face(squeezed):
    pixels = np.array([320.0, 240.0]) + squeezed * (pixels_of(head()) - [320.0, 240.0])
    assert reason([face_at(pixels, 0, PLAIN)])


def test_one_clicked_frame_begins_a_head(tmp_path: Path):
    from posetrack_cli.head.face.points import POINT_NAMES

    truth = HEADS[1]
    rows = [
        f"plain,{name},{x},{y}"
        for name, (x, y) in zip(POINT_NAMES, pixels_of(truth, shape=MEAN), strict=True)
    ]
    file = tmp_path / "clicked.csv"
    file.write_text("\n".join(["camera,point,x,y", *rows]))
    (pixels,) = read_clicked(file, [PLAIN])
    start = initialise([face_at(pixels, 0, PLAIN)], PLAIN, MODEL, CONFIG)
    assert isinstance(start, MonoInitialisation)
    np.testing.assert_allclose(errors(start, [truth]), 0.0, atol=0.02)
