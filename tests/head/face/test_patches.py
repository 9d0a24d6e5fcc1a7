"""Patches: OpenCV's samples and correlation, and derivatives against differences."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posetrack_cli.head.face.templates import (
    CENTRE,
    GRID,
    LEAST_CONTRAST,
    SIZE,
    differentiate,
    normalise,
    product,
    sample_grid,
)

WARP = np.array([[1.2, 0.3], [-0.2, 0.8]])
UPRIGHT = np.eye(2)


@pytest.fixture(scope="module")
def image():
    noise = np.random.default_rng(1).uniform(0.0, 255.0, (80, 100))
    return cv2.GaussianBlur(noise, (0, 0), 2.0).astype(np.uint8)


def patch_at(image, u, v, warp=UPRIGHT):
    grid, patch = np.empty((GRID, GRID)), np.empty(SIZE)
    assert sample_grid(image, image.shape[1], image.shape[0], u, v, warp, grid)
    return grid, patch, normalise(grid, patch)


def test_samples_are_bilinear(image):
    u, v = 41.3, 37.8
    steps = np.arange(GRID) - CENTRE
    across, down = np.meshgrid(steps, steps)
    x = (u + WARP[0, 0] * across + WARP[0, 1] * down).astype(np.float32)
    y = (v + WARP[1, 0] * across + WARP[1, 1] * down).astype(np.float32)
    wanted = cv2.remap(image.astype(np.float32), x, y, cv2.INTER_LINEAR)
    grid, _, _ = patch_at(image, u, v, WARP)
    np.testing.assert_allclose(grid, wanted, atol=1.0)  # OpenCV rounds places to 1/32 px: 20 levels/px / 32


def test_scalar_product_is_opencvs_correlation(image):
    _, p, _ = patch_at(image, 40.5, 30.5)
    _, q, _ = patch_at(image, 42.5, 33.5)
    both = image[23:39, 33:49], image[26:42, 35:51]
    exact = np.corrcoef(*(part.astype(float).ravel() for part in both))[0, 1]
    assert product(p, q) == pytest.approx(exact, abs=1e-12)
    # OpenCV subtracts sums of squares, up to 256 * 255^2 = 1.7e7, which float32 holds to 1. So its result is
    # good to a few times 1 / (256 variances), here 4e-5; how good depends on the processor.
    assert np.std(both) > 10.0
    assert cv2.matchTemplate(*both, cv2.TM_CCOEFF_NORMED).item() == pytest.approx(exact, abs=2e-4)


def test_brightness_and_contrast_change_nothing(image):
    grid, patch, norm = patch_at(image, 50.2, 40.7)
    other = np.empty(SIZE)
    assert normalise(0.4 * grid + 31.0, other) == pytest.approx(0.4 * norm)
    np.testing.assert_allclose(other, patch, atol=1e-12)
    assert patch.sum() == pytest.approx(0.0, abs=1e-12)
    assert patch @ patch == pytest.approx(1.0)


def test_a_patch_without_contrast_shows_nothing():
    grid, patch = np.full((GRID, GRID), 100.0), np.ones(SIZE)
    grid[::2] += LEAST_CONTRAST  # standard deviation half of that
    assert normalise(grid, patch) == 0.0
    assert not patch.any()


@pytest.mark.parametrize("warp", [UPRIGHT, WARP], ids=["upright", "warped"])
def test_gradient_is_the_difference_of_patches(warp):
    y, x = np.mgrid[0:80, 0:100].astype(float)
    waves = 100.0 + 40.0 * np.sin(x / 7.0 + 0.3) + 30.0 * np.cos(y / 8.0 - x / 20.0)
    grid, patch, norm = patch_at(waves, 40.0, 35.0, warp)
    gradient = np.empty((2, SIZE))
    differentiate(grid, patch, norm, gradient)
    for axis in range(2):
        step = warp[:, axis]  # one pixel of the patch in pixels of the image
        ahead = patch_at(waves, 40.0 + 0.5 * step[0], 35.0 + 0.5 * step[1], warp)[1]
        behind = patch_at(waves, 40.0 - 0.5 * step[0], 35.0 - 0.5 * step[1], warp)[1]
        # third order, (1.2 / 7)^2 / 6 = 0.5 %; bilinear interpolation bends at every pixel, (1 / 7)^2 / 8;
        # the projection leaves a third of the slopes
        assert np.linalg.norm(gradient[axis] - (ahead - behind)) < 0.05 * np.linalg.norm(gradient[axis])


@pytest.mark.parametrize(
    "u, v", [(CENTRE - 0.01, 40.0), (100 - 1 - CENTRE + 0.01, 40.0), (50.0, 80 - CENTRE)]
)
def test_a_patch_that_leaves_the_image_is_none(image, u, v):
    grid = np.full((GRID, GRID), -1.0)
    assert not sample_grid(image, 100, 80, u, v, UPRIGHT, grid)
    assert np.all(grid == -1.0)


def test_a_patch_may_touch_the_edge(image):
    grid = np.empty((GRID, GRID))
    assert sample_grid(image, 100, 80, CENTRE, CENTRE, UPRIGHT, grid)
    np.testing.assert_array_equal(grid, image[:GRID, :GRID])
