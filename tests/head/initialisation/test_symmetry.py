"""Slopes of the segments between left and right points: what changes them and what does not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.head.face.points import FEATURES
from posetrack_cli.head.initialisation.mono import LEFT, RIGHT, slope_deviation
from support.initialisation_scenes import BENT, PLAIN, head, pixels_of

turns = st.floats(-35.0, 35.0)


@given(turns, turns, turns)
def test_no_turn_of_a_symmetric_face_changes_slopes_but_by_perspective(roll, pitch, yaw):
    """From 50 m away perspective is 1 / 70 of what it is from 0.7 m."""
    pixels = 70.0 * pixels_of(head(roll, pitch, yaw, z=50_000.0))
    assert np.rad2deg(slope_deviation(pixels, PLAIN)) < 0.1


@given(turns)
def test_roll_alone_changes_nothing_at_all(roll):
    assert slope_deviation(pixels_of(head(roll)), PLAIN) < 1e-9


def test_perspective_turns_them_less_than_a_detection_may():
    """At 70 cm, 30 degrees aside and 20 down; the threshold is 4 degrees."""
    pixels = pixels_of(head(0.0, 20.0, 30.0))
    assert np.rad2deg(slope_deviation(pixels, PLAIN)) < 2.5


@given(st.sampled_from(range(10)), st.floats(-20.0, 20.0).filter(lambda shift: abs(shift) > 1.0))
def test_a_point_that_is_shifted_up_or_down_raises_it(point, shift):
    pixels = pixels_of(head())
    pixels[point, 1] += shift
    assert slope_deviation(pixels, PLAIN) > np.deg2rad(0.2)


def test_it_is_a_weighted_standard_deviation_of_slopes():
    """Small slopes by hand: dy / dx of each segment, weights their lengths squared."""
    pixels = pixels_of(head())
    rises = np.array([1.0, -0.5, 0.3, 0.2, -0.4])
    pixels[list(LEFT), 1] += rises
    runs = (pixels[list(LEFT)] - pixels[list(RIGHT)])[:, 0]
    weights = runs**2 / np.sum(runs**2)
    slopes = rises / runs
    expected = np.sqrt(np.sum(weights * (slopes - np.sum(weights * slopes)) ** 2))
    assert slope_deviation(pixels, PLAIN) == pytest.approx(expected, rel=1e-2)  # angles for tangents


def test_the_lens_that_bends_segments_is_taken_off():
    pixels = pixels_of(head(x=180.0, y=120.0), BENT)
    assert slope_deviation(pixels, BENT) < 1e-6
    assert slope_deviation(pixels, PLAIN) > np.deg2rad(0.3)


def test_every_point_is_left_or_right_of_another():
    assert sorted(LEFT + RIGHT) == list(range(10))
    assert np.all(FEATURES[list(LEFT), 0] > 0.0)  # x is to the subject's left
    np.testing.assert_allclose(FEATURES[list(RIGHT), 1:], FEATURES[list(LEFT), 1:])
