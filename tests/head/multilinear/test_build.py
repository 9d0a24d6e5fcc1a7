"""The separated model: what it keeps of the people it was built from, and of others."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import least_squares

from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_COUNT
from posetrack_cli.head.multilinear.build import (
    BuiltModel,
    add_deformation,
    build_model,
    mirrored,
    possible_ranks,
    symmetric_halves,
)
from posetrack_cli.head.multilinear.face_model import FaceModel, load_face_model
from support.face_people import acting, motions, people

ROUNDING_MM = 1e-9
"""Of sums of some thousand products of millimetres."""
OUTSIDE_MM = 1.5
"""How near the model comes to people whom it was not built from, root mean square."""
SHAPES = arrays(np.float64, (POINT_COUNT, 3), elements=st.floats(-100.0, 100.0))


@pytest.fixture(scope="module")
def built() -> BuiltModel:
    return build_model(acting(people(40)))


def rms(differences: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(differences**2, axis=-1))))


@given(SHAPES)
def test_halves_are_symmetric_and_keep_their_half(shape: np.ndarray) -> None:
    halves = symmetric_halves(shape)
    np.testing.assert_array_equal(mirrored(halves), halves)
    for half, side in zip(halves, (MEAN_SHAPE[:, 0] < 0.0, MEAN_SHAPE[:, 0] > 0.0), strict=True):
        np.testing.assert_array_equal(half[side], shape[side])


def test_an_added_deformation_grows_with_the_person_and_changes_nothing_else(built: BuiltModel) -> None:
    moved = np.random.default_rng(0).normal(size=(POINT_COUNT, 3))
    sizes = 1.0 + 0.1 * np.random.default_rng(1).normal(size=len(built.identities))
    wider = add_deformation(built, moved, sizes, 0.5)
    np.testing.assert_allclose(wider.approximations(), built.approximations(), atol=ROUNDING_MM)
    some = np.append(built.deformations[3], 0.7)
    shown = wider.model.shapes(wider.identities, some) - built.model.shapes(built.identities, some[:-1])
    grows = built.identities @ np.linalg.lstsq(built.identities, sizes)[0]
    np.testing.assert_allclose(shown, 0.7 * grows[:, None, None] * moved, atol=ROUNDING_MM)
    assert wider.model.deformation_mean[-1] == 0.0 and wider.model.deformation_deviations[-1] == 0.5


@given(SHAPES)
def test_a_mirror_twice_is_none(shape: np.ndarray) -> None:
    np.testing.assert_array_equal(mirrored(mirrored(shape)), shape)


def test_an_asymmetric_person_gives_two_symmetric_samples() -> None:
    shapes = acting(people(3))
    shapes[1, :, 4] += [-3.0, 2.0, 0.0]  # the right corner of the mouth
    built = build_model(shapes, 6, 5)
    assert built.samples.shape == (6, *shapes.shape[1:])
    right, left = built.samples[1], built.samples[1 + 3]
    np.testing.assert_allclose(mirrored(right), right, atol=ROUNDING_MM)
    assert np.all(left[:, 5, 0] - left[:, 4, 0] < right[:, 5, 0] - right[:, 4, 0] - 2.0)


def test_every_face_of_the_model_is_symmetric(built: BuiltModel) -> None:
    rng, model = np.random.default_rng(0), built.model
    identities = model.identity_mean + 3.0 * model.identity_deviations * rng.standard_normal((20, 10))
    deformations = model.deformation_mean + 3.0 * model.deformation_deviations * rng.standard_normal((20, 5))
    shapes = model.shapes(identities, deformations)
    np.testing.assert_allclose(mirrored(shapes), shapes, atol=ROUNDING_MM)


def test_with_all_parameters_it_is_exact() -> None:
    shapes = acting(people(4))
    built = build_model(shapes, *possible_ranks(shapes))
    np.testing.assert_allclose(built.approximations(), built.samples, atol=ROUNDING_MM)


def test_ranks_are_those_of_what_varies() -> None:
    """Four neutral faces that differ in both halves, and two motions of two directions each and a rest."""
    shapes = acting(people(4))
    assert possible_ranks(shapes) == (8, 5)
    symmetric = symmetric_halves(shapes)[0]
    assert possible_ranks(symmetric)[0] == 4


def test_the_parameters_of_the_samples_have_the_stated_distribution(built: BuiltModel) -> None:
    for rows, mean, deviations in (
        (built.identities, built.model.identity_mean, built.model.identity_deviations),
        (built.deformations, built.model.deformation_mean, built.model.deformation_deviations),
    ):
        np.testing.assert_allclose(rows.mean(axis=0), mean, atol=1e-12)
        covariance = np.cov(rows.T, bias=True)
        floor = 1e-6  # of variances: the least deviation is 1e-4 of a mean square below 1
        np.testing.assert_allclose(covariance, np.diag(deviations**2), atol=floor)
        assert np.all(deviations > 0.0)


def test_people_outside_are_described_nearly_as_well(built: BuiltModel) -> None:
    strangers = symmetric_halves(acting(people(15, seed=1)))[0]
    errors = np.array([fitted(built.model, shapes) - shapes for shapes in strangers])
    assert rms(errors) <= OUTSIDE_MM
    assert rms(errors) <= 3.0 * rms(built.approximations() - built.samples)


def test_the_shipped_model_describes_strangers_whom_other_statistics_draw() -> None:
    """Neutral faces by ``SHAPE_SD`` alone, without the covariance that the model was built with.

    The model's points are what a tracker sees, theirs are landmarks: both are taken about their means.
    """
    model = load_face_model()
    strangers = symmetric_halves(acting(people(15, seed=2)))[0]
    strangers = strangers - strangers.mean(axis=(0, 1)) + model.mean
    assert rms(np.array([fitted(model, shapes) - shapes for shapes in strangers])) <= OUTSIDE_MM


def fitted(model: FaceModel, shapes: np.ndarray) -> np.ndarray:
    """The model's nearest faces (A, K, 3) to those of one person in all actions, by general least squares."""
    count = model.identity_size
    start = np.concatenate([np.zeros(count), np.zeros(len(shapes) * model.deformation_size)])

    def faces(whitened: np.ndarray) -> np.ndarray:
        s = model.identity_mean + model.identity_deviations * whitened[:count]
        rest = whitened[count:].reshape(len(shapes), -1)
        return model.shapes(s, model.deformation_mean + model.deformation_deviations * rest)

    def residuals(whitened: np.ndarray) -> np.ndarray:
        return np.concatenate([(faces(whitened) - shapes).ravel(), 0.1 * whitened])  # mm against a weak prior

    return faces(least_squares(residuals, start).x)


def test_identity_and_deformation_are_apart(built: BuiltModel) -> None:
    """Who smiles differently wide smiles all the same: along a the faces move as the actions do."""
    deformations = built.deformations
    mean = np.einsum("kisa,s->kia", built.model.core, built.model.identity_mean)
    moves = np.einsum("kia,ta->tki", mean, deformations - deformations.mean(axis=0))
    expected = motions() - motions().mean(axis=0)
    assert rms(moves - expected) <= 0.05 * rms(
        expected
    )  # faces are as wide as the mean one but for a per cent
