"""False colours and shading."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.evaluation.viewing.drawing import DepthRange, false_colour, lit, shaded

DEPTHS = DepthRange(500.0, 1000.0)


def colour_of(depth: float) -> tuple[int, int, int]:
    blue, green, red = false_colour(np.full((1, 1), depth, np.float32), DEPTHS)[0, 0].tolist()
    return blue, green, red


def test_near_is_red_far_is_blue_no_reading_is_black() -> None:
    blue, green, red = colour_of(540.0)
    assert red > 2 * green and red > 2 * blue
    blue, green, red = colour_of(930.0)
    assert blue > 2 * red and blue > green
    assert colour_of(0.0) == (0, 0, 0)
    assert colour_of(750.0)[1] > 150, "green between"


def test_what_lies_beyond_the_range_has_the_colour_of_its_end() -> None:
    assert colour_of(100.0) == colour_of(500.0) != colour_of(600.0)
    assert colour_of(8000.0) == colour_of(1000.0) != (0, 0, 0)


def test_the_range_leaves_out_outliers_and_what_is_no_depth() -> None:
    z = np.concatenate([np.full(1000, 650.0), [5000.0, np.nan, -20.0]])
    depths = DepthRange.of_points(z)
    assert 500 < depths.near < 650 < depths.far < 1100
    usual = DepthRange.of_points(np.array([np.nan]))
    assert 0 < usual.near < usual.far


def test_light_comes_from_the_upper_left() -> None:
    """Depth that grows downwards or to the right turns the surface away from the light."""
    rows, columns = np.mgrid[0:9, 0:9].astype(np.float32)
    plain, down, right = (lit(600.0 + slope, 1.0)[4, 4] for slope in (0 * rows, rows, columns))
    up, left = (lit(600.0 - slope, 1.0)[4, 4] for slope in (rows, columns))
    assert down < plain < up and right < plain < left


def test_light_does_not_depend_on_how_finely_a_surface_is_sampled() -> None:
    coarse = lit(600.0 + np.mgrid[0:9, 0:9][0].astype(np.float32), 1.0)[4, 4]
    fine = lit(600.0 + 0.25 * np.mgrid[0:9, 0:9][0].astype(np.float32), 0.25)[4, 4]
    assert coarse == pytest.approx(fine)


def test_shading_scales_a_colour() -> None:
    light = np.array([[0.5, 1.0]])
    np.testing.assert_array_equal(shaded(np.array([100, 200, 50]), light), [[[50, 100, 25], [100, 200, 50]]])
