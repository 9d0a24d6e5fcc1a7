"""Patches of standard size, cut from an image."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.head.detection.responses import MIDDLE, PIXELS_PER_MM, cut_patch


def spot(x: float, y: float) -> np.ndarray:
    rows, columns = np.mgrid[0:480, 0:640]
    return np.rint(200 * np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / 4.0**2)).astype(np.uint8)


@pytest.mark.parametrize(("pixels_per_mm", "roll"), [(1.4, 0.0), (0.6, 0.3), (3.0, -0.2)])
def test_a_spot_lies_where_the_transform_says(pixels_per_mm: float, roll: float) -> None:
    eyes = np.array([300.0, 200.0])
    along = pixels_per_mm * 20.0 * np.array([np.cos(roll), np.sin(roll)])  # 20 mm along the line of the eyes
    patch = cut_patch(spot(*(eyes + along)), eyes, pixels_per_mm, roll)
    row, column = np.unravel_index(int(np.argmax(patch.grey)), patch.grey.shape)
    expected = MIDDLE + np.array([20.0 * PIXELS_PER_MM, 0.0])
    np.testing.assert_allclose([column, row], expected, atol=1.0)
    np.testing.assert_allclose(patch.from_image(eyes + along), expected, atol=1e-9)


def test_pixels_go_to_the_patch_and_back() -> None:
    patch = cut_patch(spot(10, 10), np.array([100.0, 90.0]), 0.8, 0.25)
    pixels = np.random.default_rng(0).uniform(0, 400, (7, 2))
    np.testing.assert_allclose(patch.to_image(patch.from_image(pixels)), pixels, atol=1e-9)
    assert patch.roll == pytest.approx(0.25)
    assert patch.scale == pytest.approx(PIXELS_PER_MM / 0.8)
