"""The head that is drawn: its points lie on the skin, it deforms as a face does, and people differ."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import EYES, MEAN_SHAPE, MIRRORED, SHAPE_SD
from posetrack_cli.rendering.mesh import closest_points
from posetrack_cli.synthesis.head.form import MOUTH_X, grid_normals, skin_grid
from posetrack_cli.synthesis.head.person import (
    EXPRESSIONS,
    Identity,
    Person,
    identity_of_seed,
    make_person,
    random_points,
)

GRID = skin_grid()
SOLVED = 1e-9
"""mm; a 10 x 10 system of condition 1e4 in float64."""
FACET_MM = 0.35
"""A facet of 1.6 mm over the sharpest bend, of radius 2 mm: 1.6^2 / (8 * 2) = 0.16 mm, both ways."""


def strengths(**values: float) -> FloatArray:
    return np.array([values.get(name, 0.0) for name in EXPRESSIONS])


@pytest.fixture(scope="module")
def average() -> Person:
    return make_person(Identity(), GRID)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_ten_points_lie_on_the_skin(seed: int) -> None:
    person = make_person(identity_of_seed(seed), GRID)
    for name in (None, "smile_left", "jaw_open", "mouth_sideways", "pucker", "brows_up"):
        e = strengths(**({} if name is None else {name: 0.8}))
        points = person.shape(e)
        corners = person.skin(e).reshape(-1, 3)[GRID.triangles]
        triangle, shares = closest_points(points, corners)
        nearest = np.einsum("pk,pkc->pc", shares, corners[triangle])
        away = np.linalg.norm(nearest - points, axis=1)
        np.testing.assert_allclose(away, 0.0, atol=FACET_MM, err_msg=str(name))


def test_the_neutral_points_are_those_of_the_identity() -> None:
    identity = identity_of_seed(7)
    person = make_person(identity, GRID)
    np.testing.assert_allclose(person.points, identity.points, atol=SOLVED)
    np.testing.assert_allclose(person.points[EYES].mean(axis=0), 0.0, atol=SOLVED)
    np.testing.assert_array_equal(person.shape(strengths()), person.points)


@pytest.mark.parametrize(
    ("name", "points", "size_mm"),
    [
        ("jaw_open", (4, 5), 17.5),
        ("smile_right", (4,), 15.6),
        ("smile_left", (5,), 15.6),
        ("mouth_sideways", (4,), 18.0),
        ("pucker", (4, 5), 11.0),
        ("brows_up", (8, 9), 4.5),
    ],
)
def test_expressions_are_as_large_as_was_measured(
    average: Person, name: str, points: tuple[int, ...], size_mm: float
) -> None:
    """Sizes at full strength of the method's document, here to a tenth."""
    moved = np.linalg.norm(average.points_moved[EXPRESSIONS.index(name)], axis=1)
    np.testing.assert_allclose(moved[list(points)], size_mm, rtol=0.1)


def test_eye_corners_hardly_move(average: Person) -> None:
    """2.6 mm was the most that was measured."""
    assert np.linalg.norm(average.points_moved[:, EYES], axis=-1).max() < 2.6


def test_left_and_right_smile_are_mirror_images(average: Person) -> None:
    right, left = (average.points_moved[EXPRESSIONS.index(f"smile_{side}")] for side in ("right", "left"))
    np.testing.assert_allclose(right, left[list(MIRRORED)] * [-1.0, 1.0, 1.0], atol=SOLVED)


def lip_gap(person: Person, e: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance of the lips' edges along the front, and the average head's x there."""
    upper = int(np.flatnonzero(GRID.inside)[0]) - 1
    lower = int(np.flatnonzero(GRID.inside)[-1]) + 1
    front = GRID.places[upper, :, 2] > 0.0
    skin = person.skin(e)
    gap = np.linalg.norm(skin[upper, front] - skin[lower, front], axis=-1)
    return gap, GRID.places[upper, front, 0]


def test_the_mouth_is_closed_until_the_jaw_opens_and_never_torn(average: Person) -> None:
    closed, x = lip_gap(average, strengths())
    np.testing.assert_allclose(closed, 0.0, atol=SOLVED)
    opened, _ = lip_gap(average, strengths(jaw_open=1.0))
    assert opened[np.argmin(np.abs(x))] > 8.0
    np.testing.assert_allclose(opened[np.abs(x) >= MOUTH_X - SOLVED], 0.0, atol=SOLVED)
    assert (opened[np.abs(x) < 0.9 * MOUTH_X] > 0.0).all()


def test_the_skin_faces_outwards(average: Person) -> None:
    normals = grid_normals(average.neutral)
    outwards = average.neutral - np.array([0.0, 0.0, -80.0])
    outwards[..., 1] = 0.0
    rows = ~GRID.inside & (GRID.places[:, 0, 1] < 60.0)
    facing = np.sum(normals * outwards, axis=-1)[rows]
    assert (facing > 0.0).mean() > 0.97  # not below the nose and beside its wings


def test_people_differ_as_was_measured() -> None:
    """The whole deviation; a sample's sd with 10 free directions and 300 faces has sd 1 / sqrt(6000)."""
    rng = np.random.default_rng(0)
    faces = np.array([random_points(rng) for _ in range(300)])
    spread = np.sqrt(((faces - faces.mean(axis=0)) ** 2).sum(axis=(1, 2)).mean())
    assert spread == pytest.approx(np.sqrt((SHAPE_SD**2).sum()), rel=0.15)
    np.testing.assert_allclose(faces.mean(axis=0), MEAN_SHAPE, atol=5.0 * 3.3 / np.sqrt(300.0))


def test_faces_are_nearly_symmetric() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        face = random_points(rng)
        mirrored = face[list(MIRRORED)] * [-1.0, 1.0, 1.0]
        assert np.abs(face - mirrored).max() < 3.0 < np.abs(face[:5] - face[5:]).max()


def test_a_person_is_of_the_seed() -> None:
    one, same, other = identity_of_seed(5), identity_of_seed(5), identity_of_seed(6)
    np.testing.assert_array_equal(one.points, same.points)
    assert (one.looks, one.relief) == (same.looks, same.relief)
    assert one.looks != other.looks and (one.points != other.points).all()
