"""Score maps against one correlation per particle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.head.face.patches import PATCH
from posetrack_cli.head.particles.kernels import BEHIND, add_scores
from posetrack_cli.head.particles.scores import HALF, Box, boxes_around, score_map

WIDTH, HEIGHT = 96, 72
TOLERANCE = 1e-4
"""OpenCV correlates by float32 Fourier transforms."""


def picture(seed=0):
    return np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)


def template(seed=1):
    return np.random.default_rng(seed).normal(size=(PATCH, PATCH)).astype(np.float32)


def correlation(image, patch, column, row):
    """The normalised correlation with the corner at a column and a row, straight from its definition."""
    seen = image[row : row + PATCH, column : column + PATCH].astype(np.float64)
    a, b = seen - seen.mean(), patch.astype(np.float64) - patch.mean()
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


def looked_up(image, patch, box, u, v, between, weight=1.0):
    scores, left, top = score_map(image, patch, box)
    total = np.zeros(len(u))
    add_scores(scores, left, top, np.float32(u), np.float32(v), weight, between, total)
    return total


def box_of(u, v):
    return boxes_around(np.float32([u]), np.float32([v]), (HEIGHT, WIDTH))[0]


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
    patch = image[30 : 30 + PATCH, 41 : 41 + PATCH].astype(np.float32)
    u, v = np.array([41 + HALF]), np.array([30 + HALF])
    for between in (True, False):
        assert looked_up(image, patch, box_of(u, v), u, v, between) == pytest.approx([1.0], abs=TOLERANCE)


def test_brightness_and_contrast_do_not_matter():
    image, patch, (u, v) = picture() // 4, template(), particles()
    brighter = (2 * image + 40).astype(np.uint8)
    one = looked_up(image, patch, box_of(u, v), u, v, between=True)
    two = looked_up(brighter, 7.0 * patch - 3.0, box_of(u, v), u, v, between=True)
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


@pytest.mark.parametrize(
    "u, v", [(-30.0, 30.0), (150.0, 30.0), (30.0, -30.0), (30.0, 150.0), (BEHIND, BEHIND)]
)
def test_a_point_beside_the_image_has_no_box(u, v):
    assert box_of([u], [v]).is_empty


@given(st.lists(st.tuples(st.floats(-50, 150), st.floats(-50, 120)), min_size=1, max_size=20))
def test_the_box_holds_every_particle_that_is_on_the_image(places):
    u, v = np.float32(places).T
    box = box_of(u, v)
    for x, y in zip(u - HALF, v - HALF, strict=True):
        if 0.0 <= x <= WIDTH - PATCH and 0.0 <= y <= HEIGHT - PATCH:
            assert box.left <= x <= box.right and box.top <= y <= box.bottom
    if not box.is_empty:
        assert box.left >= 0 and box.top >= 0
        assert box.right <= WIDTH - PATCH and box.bottom <= HEIGHT - PATCH
        scores = score_map(picture(), template(), box).scores
        assert scores.shape == (box.bottom - box.top + 1, box.right - box.left + 1)


def test_a_large_box_is_cut_about_its_middle():
    u, v = np.float32([[20.0, 70.0]]), np.float32([[20.0, 22.0]])
    (box,) = boxes_around(u, v, (HEIGHT, WIDTH), largest=11)
    assert box.right - box.left + 1 == 11
    assert abs((box.left + box.right) / 2.0 + HALF - 45.0) <= 1.0
    assert (box.top, box.bottom) == (12, 15)


def test_boxes_grow_within_the_image_and_know_what_they_hold():
    box = Box(1, 10, 20, HEIGHT - PATCH)
    grown = box.grown(2, (HEIGHT, WIDTH))
    assert grown == Box(0, 8, 22, HEIGHT - PATCH)
    assert grown.holds(box) and not box.holds(grown) and box.holds(box)
