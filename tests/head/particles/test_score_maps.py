"""Score maps against one correlation per particle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.head.face.templates import PATCH
from posetrack_cli.head.particles.score_maps import (
    BEHIND,
    HALF,
    LARGEST_BOX,
    ScoreMaps,
    add_all_scores,
    add_scores,
    correlate,
    write_box,
)

WIDTH, HEIGHT = 96, 72
TOLERANCE = 2e-6
"""256 products of float32 numbers, added up: some ten roundings of 6e-8 of numbers below 4."""


def picture(seed=0):
    return np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)


def normalised(patch):
    away = patch - patch.mean()
    return (away / np.linalg.norm(away)).astype(np.float32)


def template(seed=1):
    return normalised(np.random.default_rng(seed).normal(size=(PATCH, PATCH)))


def correlation(image, patch, column, row):
    """The normalised correlation with the corner at a column and a row, straight from its definition."""
    seen = image[row : row + PATCH, column : column + PATCH].astype(np.float64)
    a, b = seen - seen.mean(), patch.astype(np.float64) - patch.mean()
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


def map_of(image, patch, box):
    scores = np.full((box[3] - box[2] + 1, box[1] - box[0] + 1), np.nan, np.float32)
    correlate(image, patch, box, scores)
    return scores


def looked_up(image, patch, box, u, v, between, weight=1.0):
    total = np.zeros(len(u))
    add_scores(map_of(image, patch, box), box, np.float32(u), np.float32(v), weight, between, total)
    return total


def box_of(u, v, largest=LARGEST_BOX):
    box = np.zeros(4, np.int64)
    write_box(np.float32(u), np.float32(v), WIDTH, HEIGHT, largest, box)
    return box


def is_empty(box):
    left, right, top, bottom = box
    return right < left or bottom < top


def particles(count=300, seed=2):
    rng = np.random.default_rng(seed)
    return rng.uniform(20.0, 60.0, count), rng.uniform(18.0, 50.0, count)


def test_the_nearest_score_is_one_correlation_per_particle():
    image, patch, (u, v) = picture(), template(), particles()
    found = looked_up(image, patch, box_of(u, v), u, v, between=False)
    corners = np.floor(np.stack([u, v]) - HALF + 0.5).astype(int).T
    expected = [correlation(image, patch, *corner) for corner in corners]
    assert found == pytest.approx(expected, abs=TOLERANCE)


def test_between_scores_are_interpolated_from_four_correlations():
    image, patch, (u, v) = picture(), template(), particles()
    found = looked_up(image, patch, box_of(u, v), u, v, between=True)
    expected = []
    for x, y in zip(np.float32(u) - HALF, np.float32(v) - HALF, strict=True):
        column, row = int(x), int(y)
        s, t = x - column, y - row
        a, b = (correlation(image, patch, column + i, row) for i in (0, 1))
        c, d = (correlation(image, patch, column + i, row + 1) for i in (0, 1))
        expected.append((1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * c + s * d))
    assert found == pytest.approx(expected, abs=TOLERANCE)


def test_a_template_correlates_by_one_with_where_it_was_taken():
    image = picture()
    patch = normalised(image[30 : 30 + PATCH, 41 : 41 + PATCH])
    u, v = np.array([41 + HALF]), np.array([30 + HALF])
    for between in (True, False):
        assert looked_up(image, patch, box_of(u, v), u, v, between) == pytest.approx([1.0], abs=TOLERANCE)


def test_brightness_and_contrast_do_not_matter():
    image, patch, (u, v) = picture() // 4, template(), particles()
    brighter = (2 * image + 40).astype(np.uint8)
    one = looked_up(image, patch, box_of(u, v), u, v, between=True)
    two = looked_up(brighter, patch, box_of(u, v), u, v, between=True)
    assert two == pytest.approx(one, abs=TOLERANCE)


def test_without_contrast_nothing_correlates():
    flat = np.full((HEIGHT, WIDTH), 77, np.uint8)
    u, v = particles()
    assert np.all(looked_up(flat, template(), box_of(u, v), u, v, between=True) == 0.0)


def test_outside_the_image_nothing_is_added():
    """Templates must lie in the image as a whole: corners up to WIDTH - PATCH."""
    image, patch = picture(), template()
    last_u, last_v = WIDTH - PATCH + HALF, HEIGHT - PATCH + HALF
    u = np.array([HALF, HALF - 0.6, last_u, last_u + 0.6, BEHIND, 40.0])
    v = np.array([HALF, 30.0, last_v, 30.0, BEHIND, last_v + 0.6])
    for between in (True, False):
        found = looked_up(image, patch, box_of(u, v), u, v, between)
        inside = [correlation(image, patch, 0, 0), correlation(image, patch, WIDTH - PATCH, HEIGHT - PATCH)]
        expected = [inside[0], 0.0, inside[1], 0.0, 0.0, 0.0]
        assert found == pytest.approx(expected, abs=TOLERANCE)


def test_weights_add_up():
    image, patch, (u, v) = picture(), template(), particles()
    one = looked_up(image, patch, box_of(u, v), u, v, between=True)
    assert looked_up(image, patch, box_of(u, v), u, v, True, weight=0.3) == pytest.approx(0.3 * one)


def test_of_a_bright_corner_of_a_wide_box_nothing_is_lost():
    """Contrast of two grey levels, 200 above most of what the box holds."""
    image = np.full((HEIGHT, WIDTH), 20, np.uint8)
    image[:PATCH, :PATCH] = 220 + 2 * np.random.default_rng(5).integers(-1, 2, (PATCH, PATCH))
    patch = template()
    scores = map_of(image, patch, np.array([0, WIDTH - PATCH, 0, HEIGHT - PATCH]))
    # products of 200 x 256 x 1/16 and roundings of 6e-8 over a contrast of 26
    assert scores[0, 0] == pytest.approx(correlation(image, patch, 0, 0), abs=1e-5)


@pytest.mark.parametrize("levels, shown", [(1, False), (2, True)])
def test_less_contrast_than_a_camera_has_noise_is_none(levels, shown):
    image = np.full((HEIGHT, WIDTH), 90, np.uint8)
    image[:, ::2] += levels
    assert np.any(map_of(image, template(), np.array([3, 9, 4, 8]))) == shown


@pytest.mark.parametrize(
    "u, v", [(-30.0, 30.0), (150.0, 30.0), (30.0, -30.0), (30.0, 150.0), (BEHIND, BEHIND)]
)
def test_a_point_beside_the_image_has_no_box(u, v):
    assert is_empty(box_of([u], [v]))


@given(st.lists(st.tuples(st.floats(-50, 150), st.floats(-50, 120)), min_size=1, max_size=20))
def test_the_box_holds_every_particle_that_is_on_the_image(places):
    u, v = np.float32(places).T
    box = box_of(u, v)
    left, right, top, bottom = box
    for x, y in zip(u - HALF, v - HALF, strict=True):
        if 0.0 <= x <= WIDTH - PATCH and 0.0 <= y <= HEIGHT - PATCH:
            assert left <= x <= right and top <= y <= bottom
    if not is_empty(box):
        assert left >= 0 and top >= 0
        assert right <= WIDTH - PATCH and bottom <= HEIGHT - PATCH
        assert np.all(np.isfinite(map_of(picture(), template(), box)))


@given(st.lists(st.sampled_from([np.nan, np.inf, -np.inf, 20.0, 33.5, 47.0]), min_size=1, max_size=9))
def test_a_pixel_that_is_none_has_no_place(columns):
    """A lens beyond its range maps points to infinity, and to what is no number."""
    u, v = np.float32(columns), np.full(len(columns), 30.0, np.float32)
    pixels = u[~np.isnan(u)]
    assert is_empty(box_of(u, v)) if pixels.size == 0 else np.all(box_of(u, v) == box_of(pixels, v))
    total, maps = np.zeros(len(columns)), ScoreMaps.of(1)
    add_all_scores(picture(), template()[None], np.ones(1), u[None], v[None], True, *maps, total)
    assert np.all((total == 0.0) | np.isfinite(u))


def test_a_large_box_is_cut_about_its_middle():
    left, right, top, bottom = box_of([20.0, 70.0], [20.0, 22.0], largest=11)
    assert right - left + 1 == 11
    assert abs((left + right) / 2.0 + HALF - 45.0) <= 1.0
    assert (top, bottom) == (12, 15)


clouds = st.tuples(st.floats(-20.0, 110.0), st.floats(-20.0, 90.0), st.floats(0.0, 15.0))


def added(maps, clouds_now, between, weights, image=None):
    """What is added to particles of three points about these places, and how many maps that took."""
    rng = np.random.default_rng(11)
    u, v = (np.float32([rng.normal(cloud[i], cloud[2], 40) for cloud in clouds_now]) for i in (0, 1))
    total, patches = np.zeros(40), np.stack([template(seed) for seed in range(len(clouds_now))])
    made = add_all_scores(
        picture() if image is None else image, patches, weights, u, v, between, *maps, total
    )
    each = np.zeros(40)
    for k, patch in enumerate(patches):
        box = box_of(u[k], v[k])
        if weights[k] > 0.0 and not is_empty(box):
            each += looked_up(picture(), patch, box, u[k], v[k], between, weights[k])
    return total, each, made


@given(
    st.lists(clouds, min_size=3, max_size=3),
    st.lists(clouds, min_size=3, max_size=3),
    st.booleans(),
    st.sampled_from([(1.0, 0.4, 0.7), (0.0, 1.0, 0.2)]),
)
def test_all_points_score_as_each_alone_whatever_maps_are_there(first, second, between, weights):
    """A map has a margin, serves again where it holds all particles, and is made anew where it does not."""
    maps = ScoreMaps.of(3)
    for clouds_now in (first, second, second):
        total, each, made = added(maps, clouds_now, between, np.array(weights))
        assert total == pytest.approx(each, abs=1e-5)  # at a box's edge the places to interpolate differ
    assert made == 0


def test_another_image_gets_other_maps():
    maps, places = ScoreMaps.of(1), [(40.0, 40.0, 2.0)]
    _, _, first = added(maps, places, True, np.ones(1))
    maps.clear()
    total, each, again = added(maps, places, True, np.ones(1), image=picture(7))
    assert first == again == 1
    assert not np.allclose(total, each)  # those are of the first picture
