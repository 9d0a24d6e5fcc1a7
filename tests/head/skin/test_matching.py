"""Places found again in another crop, and the crops in which they are looked for."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.geometry.rotations import angle_between, exponential
from posetrack_cli.head.skin.matching import (
    ALIKE_DEG,
    FAR_PX,
    GREY,
    HEIGHT,
    SEEN_DEG,
    WIDTH,
    WINDOW,
    track_points,
    views_for,
)

FOUND_PX = 0.05
"""The search ends with a step below .02 px, and each was less than half of the one before. Rounding to grey
levels, .3 each, adds .3 / (8 a pixel sqrt(225)) = .003 px."""
CHANCE = 0.15
"""Of places that are not there: one in ten has something like it near, which leads back to it by chance."""
WAVES, TEXTURE = 60, "another texture"
GRID = np.stack(np.meshgrid(np.arange(30.0, 150.0, 12.0), np.arange(30.0, 180.0, 12.0)), axis=-1).reshape(
    -1, 2
)


@cache
def waves() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Waves of 6 to 30 pixels in all directions, their phases and strengths."""
    rng = np.random.default_rng(0)
    lengths, directions = rng.uniform(6.0, 30.0, WAVES), rng.uniform(0.0, np.pi, WAVES)
    along = 2 * np.pi / lengths[:, None] * np.column_stack([np.cos(directions), np.sin(directions)])
    return along, rng.uniform(0.0, 2 * np.pi, WAVES), rng.uniform(3.0, 6.0, WAVES)


def textured(shift: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """The sum of the waves, moved by so many pixels, exactly but for grey levels."""
    along, phases, strengths = waves()
    columns, rows = np.meshgrid(np.arange(WIDTH) - shift[0], np.arange(HEIGHT) - shift[1])
    values = np.full(columns.shape, GREY)
    for (a, b), phase, strength in zip(along, phases, strengths, strict=True):
        values += strength * np.cos(a * columns + b * rows + phase)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.37, -0.61), (2.25, 1.4), (-3.8, 2.6)])
def test_what_was_moved_is_found_to_a_part_of_a_pixel(shift: tuple[float, float]) -> None:
    """Without a word of where it went."""
    places, found = track_points(textured(), GRID, textured(shift), GRID)
    assert found.mean() > 0.95  # a window that looks like a line may slip
    np.testing.assert_allclose(places[found], GRID[found] + shift, atol=FOUND_PX)


def test_what_went_far_is_found_where_it_is_expected() -> None:
    shift = (24.3, -17.8)
    second = textured(shift)
    inside = GRID[(GRID[:, 1] > 50.0) & (GRID[:, 0] < 120.0)]
    places, found = track_points(textured(), inside, second, inside + np.array([25.0, -19.0]))
    assert found.mean() > 0.95
    np.testing.assert_allclose(places[found], inside[found] + shift, atol=FOUND_PX)


@pytest.mark.parametrize("shift", [(13.0, 0.0), (24.3, -17.8)])
def test_nothing_is_found_far_from_where_it_is_expected(shift: tuple[float, float]) -> None:
    """What is found is something else, if by chance; never the place itself."""
    places, found = track_points(textured(), GRID, textured(shift), GRID)
    assert np.all(np.linalg.norm(places[found] - GRID[found], axis=1) < FAR_PX)
    assert found.mean() < CHANCE


def test_places_on_an_even_area_are_not_found() -> None:
    """A window that reaches into the texture has something to hold on to."""
    first, second = textured(), textured((0.5, 0.5))
    first[60:120, 60:120] = second[60:120, 60:120] = int(GREY)
    _, found = track_points(first, GRID, second, GRID)
    away = np.abs(GRID - 90.0).max(axis=1)  # from its middle
    on_it = away < 30 - WINDOW[0]
    assert on_it.sum() >= 4 and not found[on_it].any()
    assert found[away > 30 + WINDOW[0]].mean() > 0.95


@pytest.mark.parametrize("by", ["an even hand", TEXTURE])
def test_places_that_are_covered_are_not_found(by: str) -> None:
    first, second = textured(), textured((0.5, 0.5))
    second[60:150] = cv2.flip(second, 1)[60:150] if by == TEXTURE else int(GREY)
    _, found = track_points(first, GRID, second, GRID)
    covered = (GRID[:, 1] > 60 + WINDOW[1]) & (GRID[:, 1] < 150 - WINDOW[1])
    assert covered.sum() >= 20 and found[covered].mean() < (CHANCE if by == TEXTURE else 0.02)
    reached = (GRID[:, 1] > 60 - WINDOW[1]) & (GRID[:, 1] < 150 + WINDOW[1])
    assert found[~reached].mean() > 0.95


def test_places_outside_the_crops_are_not_found() -> None:
    outside = np.array([[-50.0, 40.0], [40.0, 1e6], [-1e9, -1e9]])
    _, found = track_points(textured(), outside, textured(), outside)
    assert not found.any()
    _, found = track_points(textured(), GRID[:3], textured(), outside)
    assert not found.any()


@st.composite
def choices(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, int]:
    """A pose, views with their times, some unknown, and how many are asked for."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, 30))
    quaternions = exponential(np.radians(draw(st.floats(1.0, 25.0))) * rng.normal(size=(count, 3)))
    away = np.abs(rng.integers(-20, 20, count)).astype(float)
    away[rng.uniform(size=count) < draw(st.sampled_from([0.0, 0.2, 1.0]))] = np.inf
    near, alike = draw(st.integers(0, 6)), draw(st.integers(0, 6))
    return exponential(0.1 * rng.normal(size=3)), away, quaternions, near, alike


@given(choices())
def test_views_are_near_in_time_or_turned_alike_and_each_is_named_once(
    choice: tuple[np.ndarray, np.ndarray, np.ndarray, int, int],
) -> None:
    """As they would be chosen one by one."""
    quaternion, away, quaternions, near, alike = choice
    chosen = views_for(quaternion, away, quaternions, near, alike)
    turned = np.degrees(angle_between(quaternions, quaternion))
    assert len(set(chosen)) == len(chosen) <= near + alike
    assert np.all(np.isfinite(away[chosen]))
    known = [index for index in range(len(away)) if np.isfinite(away[index])]
    by_time = sorted(known, key=lambda index: away[index])[:near]
    seen = [index for index in by_time if turned[index] < SEEN_DEG]
    rest = sorted((index for index in known if index not in seen), key=lambda index: turned[index])
    assert chosen == seen + [index for index in rest if turned[index] < ALIKE_DEG][:alike]


def test_a_view_near_in_time_may_be_turned_more_than_any_other() -> None:
    turns = np.radians([0.0, 25.0, 26.0, 31.0])
    quaternions = exponential(turns[:, None] * [[0.0, 1.0, 0.0]])
    assert ALIKE_DEG < 25.0 < 26.0 < SEEN_DEG < 31.0
    away = np.array([np.inf, 1.0, 3.0, 2.0])
    assert views_for(quaternions[0], away, quaternions, 4, 4) == [1, 2]
    assert views_for(quaternions[0], away, quaternions, 1, 4) == [1]
    assert views_for(quaternions[0], np.zeros(4), quaternions, 0, 4) == [0]
