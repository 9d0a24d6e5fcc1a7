"""The surface of a face between its ten points, and the corners that are chosen on it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st
from scipy.spatial.distance import cdist, pdist

from posetrack_cli.head.face.points import EYES, MEAN_SHAPE, MOUTH
from posetrack_cli.head.multilinear.face_model import load_face_model
from posetrack_cli.head.skin import matching
from posetrack_cli.head.skin.matching import (
    BORDER_PX,
    GREY,
    HEIGHT,
    LIDS_MM,
    LIPS_MM,
    MIDDLE,
    MOST_STEPS,
    PX_PER_MM,
    STEP_MM,
    WIDTH,
    Surface,
    surface_of,
)

BESIDE_MM = 4.0
"""The nearest place of the grid is STEP / sqrt(2) away, over which a nose or cheek rises by as much: 1.4 mm;
the rest is what smoothing leaves of points that do not fit each other, a few mm."""
REACH_PX = np.sqrt(2.0) * 3.0
"""How far a corner lies from the nearest place: two pixels of the mask about it, and one that it is cut by,
in both axes."""
MODEL = load_face_model()
FACE = surface_of(MEAN_SHAPE)
DISTANCE_PX = 11.0


def textured(seed: int) -> np.ndarray:
    """A crop full of corners."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH)), (0, 0), 1.5)
    return np.clip(GREY + 40.0 * noise / noise.std(), 0.0, 255.0).astype(np.uint8)


def places_of(face: Surface, scale: float = PX_PER_MM) -> np.ndarray:
    """Where a crop has a face that looks straight ahead from far away."""
    return (face.points[:, :2] - MIDDLE[:2]) * [scale, -scale] + [WIDTH / 2, HEIGHT / 2]


@pytest.fixture
def whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """With lids and lips, which a surface leaves out, so that there is something at all ten points."""
    monkeypatch.setattr(matching, "LIDS_MM", (0.0, 0.0))
    monkeypatch.setattr(matching, "LIPS_MM", (0.0, 0.0))


@pytest.mark.parametrize("person", range(6))
@pytest.mark.usefixtures("whole")
def test_it_passes_near_the_ten_points(person: int) -> None:
    """Of people as different as the model knows them."""
    wish = np.random.default_rng(person).normal(size=MODEL.identity_size) * (person > 0)
    shape = MODEL.of_person(MODEL.identity_mean + wish * MODEL.identity_deviations).mean
    points = surface_of(shape).points
    nearest = points[np.argmin(cdist(shape[:, :2], points[:, :2]), axis=1)]
    assert np.abs(nearest[:, :2] - shape[:, :2]).max() <= STEP_MM  # also at its rim
    assert np.abs(nearest[:, 2] - shape[:, 2]).max() < BESIDE_MM


@given(st.floats(0.6, 1.6))
@examples(max_examples=10)
def test_no_point_lies_on_lids_or_lips(size: float) -> None:
    """Boxes as large as the face, about the middles of both eyes and the mouth."""
    shape = size * MEAN_SHAPE
    points = surface_of(shape).points
    eyes = shape[EYES]
    for moving, half in ((eyes[:2], LIDS_MM), (eyes[2:], LIDS_MM), (shape[MOUTH], LIPS_MM)):
        away = np.abs(points[:, :2] - moving[:, :2].mean(axis=0))
        assert not np.any(np.all(away < size * np.array(half), axis=1))
    assert len(points) > 500, "the rest of the face is there"


@pytest.mark.parametrize("size", [10.0, 1e3, 1e7, -1e7])
def test_a_face_of_any_size_takes_no_more_memory(size: float) -> None:
    """As a file may say that a face is."""
    assert 0 < len(surface_of(size * MEAN_SHAPE).points) <= (MOST_STEPS + 1) ** 2


def test_its_points_lie_on_a_grid_within_the_face() -> None:
    apart = pdist(FACE.points[:, :2])
    assert apart.min() == pytest.approx(STEP_MM)
    reach = np.abs(np.vstack([MEAN_SHAPE, matching.ANCHORS])[:, :2]).max(axis=0)
    assert np.all(np.abs(FACE.points[:, :2]) <= reach)


@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.floats(3.0, 30.0))
@examples(max_examples=15)
def test_corners_are_few_apart_and_where_the_face_is(seed: int, count: int, distance: float) -> None:
    crop, places = textured(seed), places_of(FACE)
    chosen = FACE.corners(crop, places, count, distance)
    assert 1 <= len(chosen) <= count and len(set(chosen)) == len(chosen)
    there = places[chosen]
    assert np.all(there >= BORDER_PX) and np.all(there < np.array([WIDTH, HEIGHT]) - BORDER_PX)
    if len(chosen) > 1:
        assert pdist(there).min() >= distance - 2 * REACH_PX


def test_corners_are_where_the_crop_has_some() -> None:
    """On an even crop with one bright square: at its four corners."""
    crop = np.full((HEIGHT, WIDTH), int(GREY), np.uint8)
    crop[120:150, 60:90] = 250
    square = np.array([[60, 120], [89, 120], [60, 149], [89, 149]])
    there = places_of(FACE)[FACE.corners(crop, places_of(FACE), 10, DISTANCE_PX)]
    away = cdist(there, square)
    assert len(there) == 4 and set(np.argmin(away, axis=1)) == {0, 1, 2, 3}
    # the square's corner is a corner for every block that holds it, so at up to half a block from it
    assert away.min(axis=1).max() < REACH_PX + np.sqrt(2.0) * matching.BLOCK / 2


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_an_even_crop_has_none(grey: int) -> None:
    crop = np.full((HEIGHT, WIDTH), grey, np.uint8)
    assert FACE.corners(crop, places_of(FACE), 40, DISTANCE_PX) == []


@pytest.mark.parametrize("aside", [[1e3, 0.0], [0.0, -1e3], [1e12, 1e12]])
def test_a_face_outside_the_crop_has_none(aside: list[float]) -> None:
    assert FACE.corners(textured(0), places_of(FACE) + aside, 40, DISTANCE_PX) == []


def test_places_at_the_border_are_left_out() -> None:
    """A face so large that it fills the crop."""
    places = places_of(FACE, 3 * PX_PER_MM)
    there = places[FACE.corners(textured(1), places, 40, DISTANCE_PX)]
    assert len(there) and np.all(there >= BORDER_PX)
    assert np.all(there < np.array([WIDTH, HEIGHT]) - BORDER_PX)
