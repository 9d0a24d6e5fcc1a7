"""What is taken from a result: the frames that count, and shapes at even rates of either motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.head.face.points import EYES, POINT_NAMES
from posetrack_cli.head.multilinear.learning import (
    RATES,
    ObservedFace,
    examples_of,
    learn_model,
    neutral_of,
    read_face,
)
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.writer import ResultWriter
from support.face_people import CAMERA, LONG, NARROW, SHORT, WIDE, people, performance, write_stereo_result

READ_MM = 1e-3
"""Estimates are written with this many decimals at least."""
RATE_MM = 1.2
"""A rate is met to an eighth, and the ends are percentiles: of movements of 20 mm at most, and medians."""


@pytest.fixture
def neutral() -> np.ndarray:
    return people(1)[0]


def observed(shapes: np.ndarray) -> ObservedFace:
    return ObservedFace(Path("r.mcap"), len(shapes), shapes)


def distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b, axis=-1).max())


def test_shapes_are_read_in_the_heads_frame(neutral: np.ndarray, tmp_path: Path) -> None:
    shapes = performance(neutral, 60)
    face = read_face(write_stereo_result(tmp_path / "r.mcap", shapes + np.array([1.0, -2.0, 3.0])))
    assert face.frames == 60
    np.testing.assert_allclose(face.shapes, shapes, atol=READ_MM)  # about the eye corners again
    np.testing.assert_allclose(face.shapes[:, EYES].mean(axis=1), 0.0, atol=READ_MM)


def test_lost_hidden_and_one_sided_frames_do_not_count(neutral: np.ndarray, tmp_path: Path) -> None:
    shapes = np.repeat(neutral[None], 60, axis=0)
    shapes[5:8, POINT_NAMES.index("left_mouth_corner")] += [8.0, 10.0, -9.0]
    weights = np.ones((60, len(POINT_NAMES)))
    weights[10, 2] = 0.0
    weights[11] = np.nan  # not known is no reason
    path = write_stereo_result(tmp_path / "r.mcap", shapes, lost=[0, 1], weights=weights)
    face = read_face(path)
    assert face.frames == 60 and len(face.shapes) == 60 - 3 - 1 - 2
    np.testing.assert_allclose(face.shapes, np.repeat(neutral[None], 54, axis=0), atol=READ_MM)


def test_too_few_frames_are_refused(neutral: np.ndarray, tmp_path: Path) -> None:
    path = write_stereo_result(tmp_path / "r.mcap", np.repeat(neutral[None], 35, axis=0), lost=range(20))
    with pytest.raises(ResultError, match="too few frames show the whole face, found 15 of 35"):
        read_face(path)


def test_other_trackers_are_refused(neutral: np.ndarray, tmp_path: Path) -> None:
    path = write_stereo_result(tmp_path / "r.mcap", performance(neutral, 40), tracker="head-mono")
    with pytest.raises(
        UsageError, match="found a result of 'head-mono', expected a result of posetrack head stereo"
    ):
        read_face(path)


def test_hands_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "hand.mcap"
    with ResultWriter(path, Subject("hand", "left", (), (), ()), CAMERA, {"tracker": "hand"}) as writer:
        writer.finish({})
    with pytest.raises(
        UsageError, match="cannot learn a face model from this result, found a result of 'hand'"
    ):
        read_face(path)


def test_rest_is_where_a_face_is_most_often() -> None:
    rng = np.random.default_rng(0)
    distances = np.concatenate([50.0 + 0.1 * rng.standard_normal(60), np.linspace(50.0, 70.0, 40)])
    assert neutral_of(rng.permutation(distances)) == pytest.approx(50.0, abs=0.1)


def test_rates_of_both_motions_are_found(neutral: np.ndarray) -> None:
    sideways, along = examples_of(observed(performance(neutral)))
    for motion, low, high in ((sideways, NARROW, WIDE), (along, SHORT, LONG)):
        assert np.all(motion.counts > 5)
        assert distance(motion.shapes[0], neutral + low) < RATE_MM
        assert distance(motion.shapes[-1], neutral + high) < RATE_MM


def test_shapes_change_evenly_with_the_rate(neutral: np.ndarray) -> None:
    """Also where the distance is narrow at one end and wide at the other: l is linear in r by definition."""
    for motion in examples_of(observed(performance(neutral))):
        lengths = motion.lowest + RATES * (motion.highest - motion.lowest)
        right, left = motion.shapes[:, 4], motion.shapes[:, 5]
        width = np.linalg.norm(left - right, axis=-1)
        down = np.linalg.norm(motion.shapes[:, 8:].mean(axis=1) - motion.shapes[:, 4:6].mean(axis=1), axis=-1)
        found = width if np.ptp(width) > np.ptp(down) else down
        # a rate stands for the frames up to an eighth to either side
        np.testing.assert_allclose(found, lengths, atol=0.125 * np.ptp(lengths))


def test_outliers_and_noise_hardly_matter(neutral: np.ndarray) -> None:
    shapes = performance(neutral, 600)
    clean = examples_of(observed(shapes))
    rng = np.random.default_rng(3)
    noisy = shapes + 0.3 * rng.standard_normal(shapes.shape)
    noisy[rng.choice(600, 6, replace=False), 4:6, 1] -= 40.0
    for one, other in zip(clean, examples_of(observed(noisy)), strict=True):
        assert distance(one.shapes, other.shapes) < RATE_MM


def test_rates_that_were_not_seen_are_interpolated(neutral: np.ndarray) -> None:
    shapes = performance(neutral)
    width = np.linalg.norm(shapes[:, 5] - shapes[:, 4], axis=-1)
    rest, most = np.median(width), width.max()
    gap = (width > rest + 0.1 * (most - rest)) & (width < rest + 0.8 * (most - rest))
    whole, without = (examples_of(observed(some))[0] for some in (shapes, shapes[~gap]))
    assert without.counts[3] == 0 < whole.counts[3]
    assert distance(whole.shapes[3], without.shapes[3]) < RATE_MM


@pytest.mark.parametrize(
    ("at_rest", "name"),
    [(slice(250, None), "whole face up and down"), (slice(0, 250), "mouth sideways")],
)
def test_too_little_of_a_motion_is_said(neutral: np.ndarray, at_rest: slice, name: str) -> None:
    shapes = performance(neutral)
    shapes[at_rest] = neutral
    with pytest.raises(ResultError, match=f"r.mcap: too little of the motion '{name}'"):
        examples_of(observed(shapes))


def test_one_person_is_too_few(neutral: np.ndarray) -> None:
    with pytest.raises(UsageError, match="too few people, found 1"):
        learn_model([observed(performance(neutral))], 10, 5)


def test_learned_faces_are_those_that_were_seen() -> None:
    neutrals = people(6)
    learned = learn_model([observed(performance(one)) for one in neutrals], 10, 5)
    errors = learned.built.approximations() - learned.built.samples
    assert float(np.sqrt(np.mean(np.sum(errors**2, axis=-1)))) < 1.0
    assert learned.possible[0] == 12 and learned.possible[1] <= 10
