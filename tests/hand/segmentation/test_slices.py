"""Widths across an arm, and the shift between two courses of them."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.hand.segmentation.slices import BIN_MM, best_shift, slice_areas

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
    widths = slice_areas(along, np.full(along.size, 0.25), -4.0, 10)
    np.testing.assert_allclose(widths, 30.0 * np.array([0, 0.25, 1, 1, 1, 1, 0.75, 0, 0, 0]))
    np.testing.assert_allclose(widths.sum() * BIN_MM, 30.0 * 20.0)


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
