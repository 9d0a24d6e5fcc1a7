"""The strongest place of a map near where it is expected."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.head.detection.points import find_peak


def bump(x: float, y: float, height: float = 1.0) -> np.ndarray:
    rows, columns = np.mgrid[0:40, 0:50]
    return height * np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / 3.0**2)


def test_a_peak_is_found_to_a_fraction_of_a_pixel() -> None:
    place, value = find_peak(bump(20.3, 15.6).astype(np.float32), np.array([22.0, 15.0]), (3.0, 3.0))
    # A parabola through three samples of a Gaussian of sd 3 is off by less than 0.02 pixels.
    np.testing.assert_allclose(place, [20.3, 15.6], atol=0.02)
    assert value == pytest.approx(1.0, abs=0.05)


def test_of_two_peaks_the_nearer_one_is_taken_though_the_other_is_a_little_stronger() -> None:
    two = (bump(15.0, 20.0) + bump(31.0, 20.0, 1.2)).astype(np.float32)
    place, _ = find_peak(two, np.array([17.0, 20.0]), (5.0, 5.0))
    np.testing.assert_allclose(place, [15.0, 20.0], atol=0.1)


@pytest.mark.parametrize("expected", [(-30.0, 10.0), (10.0, 200.0)])
def test_outside_the_map_the_expected_place_is_returned_with_no_response(
    expected: tuple[float, float],
) -> None:
    place, value = find_peak(bump(20.0, 20.0).astype(np.float32), np.array(expected), (3.0, 3.0))
    np.testing.assert_array_equal(place, expected)
    assert value == 0.0
