"""Widths across an arm, and the shift between two courses of them."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.hand.observe.arm import BIN_MM, best_shift, extents, slice_areas

HAND = np.r_[np.zeros(15), np.repeat(45.0, 10), np.repeat(80.0, 12), np.repeat(60.0, 3), np.zeros(10)]
LAST = 40


def with_arm(shift: int) -> np.ndarray:
    """The hand moved by whole slices, and a forearm of another width behind it."""
    moved = np.roll(HAND, shift)
    moved[LAST + shift :] = 75.0
    return moved


def test_the_area_of_a_slice_over_its_length_is_the_width() -> None:
    # a strip 30 mm wide from 3 to 23 mm, of 0.5 mm pixels
    along = np.tile(3.25 + 0.5 * np.arange(40), 60)
    widths = slice_areas(along, np.full(along.size, 0.25), np.full(along.size, 0.5), -4.0, 10)
    np.testing.assert_allclose(widths, 30.0 * np.array([0, 0.25, 1, 1, 1, 1, 0.75, 0, 0, 0]))
    np.testing.assert_allclose(widths.sum() * BIN_MM, 30.0 * 20.0)


def test_a_pixel_is_shared_by_the_slices_that_it_covers() -> None:
    """From 1 to 11 mm: three quarters of the first slice, the second, three quarters of the third."""
    widths = slice_areas(np.array([6.0]), np.array([50.0]), np.array([10.0]), 0.0, 5)
    np.testing.assert_allclose(widths, [3.75, 5.0, 3.75, 0.0, 0.0])


def test_what_lies_beyond_the_slices_is_not_counted() -> None:
    widths = slice_areas(np.array([-1.0, 8.0, 500.0]), np.full(3, 12.0), np.full(3, 4.0), 0.0, 2)
    np.testing.assert_allclose(widths, [12.0 / 4.0 * 0.25, 12.0 / 4.0 * 0.5])
    assert not slice_areas(np.empty(0), np.empty(0), np.empty(0), 0.0, 3).any()


@given(st.floats(2.0, 6.0), st.floats(0.0, 6.28), st.floats(0.0, 1.0), st.floats(0.0, 0.9))
def test_a_bar_is_equally_wide_whatever_the_pixels_and_its_direction(
    apart: float, angle: float, first: float, slant: float
) -> None:
    """Rows of pixels, 2 to 6 mm apart, fall into slices of 4 mm in turn one or two, or none."""
    width = 60.0
    axis = np.array([np.cos(angle) * np.cos(slant), np.sin(angle) * np.cos(slant), np.sin(slant)])
    steps = apart * (np.arange(-160, 161) + first)
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    across = y * np.cos(angle) - x * np.sin(angle)
    along = (x * np.cos(angle) + y * np.sin(angle)) / np.cos(slant)
    seen = along[np.abs(across) < 0.5 * width]
    widths = slice_areas(
        seen, np.full(seen.size, apart**2), extents(np.full(seen.size, apart), axis), -80.0, 40
    )
    expected = width * np.cos(slant)  # seen from the front a slice of the slanted bar is cos(slant) as long
    # each of the two rims is off by up to half a pixel on the whole, and has a pixel more or less in a slice
    assert abs(widths.mean() - expected) <= apart + 1e-9
    assert np.abs(widths - expected).max() < apart + 2.0 * apart**2 / BIN_MM


def test_an_arm_that_points_at_the_camera_has_slices_too() -> None:
    reach = extents(np.array([3.0]), np.array([0.0, 0.0, 1.0]))
    assert 3.0 < reach[0] < 10.0


@given(st.integers(-8, 8))
def test_the_shift_is_found_whatever_the_forearm_is(shift: int) -> None:
    found = best_shift(with_arm(shift), HAND, LAST, most=10, stiffness=1e-6)
    assert abs(found - shift) < 0.5  # the parabola's part


def test_a_stiff_prior_keeps_the_wrist_where_it_is_expected() -> None:
    assert abs(best_shift(with_arm(6), HAND, LAST, most=10, stiffness=1e4)) < 0.5
    between = best_shift(with_arm(6), HAND, LAST, most=10, stiffness=20.0)
    assert 0.0 < between <= 6.5


def test_nothing_observed_leaves_the_wrist_to_the_prior() -> None:
    assert best_shift(np.zeros_like(HAND), np.zeros_like(HAND), LAST, most=10, stiffness=1.0) == 0.0
