"""The thesis's recalculation in the image: it ends where the printed cost is least."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from posetrack_cli.head.config import RefinementSettings
from posetrack_cli.head.face.rig_images import RigImages, project
from posetrack_cli.head.face.templates import GRID, SIZE, normalise, sample_grid, take_templates
from posetrack_cli.head.refinement.evidence import ComparedFrame
from posetrack_cli.head.refinement.refine import PrintedConstants, recalculate_2d_as_printed
from support.textured_face import FACING, SHAPE, stereo, textured_face

CAMERAS = stereo(1)
FACE = textured_face()
FIRST = FACE.render(CAMERAS, FACING, SHAPE)
EXPECTED = project(CAMERAS, FACING.points(SHAPE)).pixels[0]
OFFSETS_MM = np.random.default_rng(8).uniform(-1.2, 1.2, (10, 3))
SETTINGS = RefinementSettings(recalculation="printed")
MANY = 40
# Bilinear intensities have kinks at every pixel, across which differences of samples are no derivative.
KINKS_PX = 0.12


def recalculated(images, printed, previous=None, start=EXPECTED, expected=EXPECTED, iterations=MANY):
    templates = take_templates(RigImages(CAMERAS, FIRST), FACING, SHAPE)
    frame = ComparedFrame(RigImages(CAMERAS, images), [templates], previous, SETTINGS)
    scene, _ = frame.scene(FACING, SHAPE)
    pixels, correlations = start.copy(), np.empty(len(start))
    recalculate_2d_as_printed(scene, expected, printed, iterations, pixels, correlations)
    return scene, pixels, correlations


def region(image, pixel):
    grid = np.empty((GRID, GRID))
    assert sample_grid(image, image.shape[1], image.shape[0], *pixel, np.eye(2), grid)
    return grid


def cost(printed, image, before, k, point_in_camera):
    """E of (4.42)-(4.44) of one point, from the definition."""
    now = region(image, point_in_camera)[1:-1, 1:-1]
    to_first = now - region(FIRST[0], EXPECTED[k])[1:-1, 1:-1]
    to_before = now - region(before, EXPECTED[k])[1:-1, 1:-1]
    regions = printed.rho * np.sum(to_before**2) + np.sum(to_first**2)
    return regions + printed.epsilon * np.sum((point_in_camera - EXPECTED[k]) ** 2)


@pytest.mark.parametrize("epsilon", [4000.0, 40.0])
def test_no_place_nearby_costs_less(epsilon):
    """A simplex search from where it ended finds nothing better but for the kinks."""
    printed = PrintedConstants(4.0, epsilon)
    images = FACE.render(CAMERAS, FACING, SHAPE + OFFSETS_MM)
    before = FACE.render(CAMERAS, FACING, SHAPE, gain=0.95)
    previous = take_templates(RigImages(CAMERAS, before), FACING, SHAPE)
    _, pixels, _ = recalculated(images, printed, previous)
    for k in range(10):
        best = minimize(
            lambda point_in_camera, k=k: cost(printed, images[0], before[0], k, point_in_camera),
            pixels[k],
            method="Nelder-Mead",
            options={"initial_simplex": pixels[k] + np.array([[0.5, 0.0], [-0.3, 0.4], [-0.3, -0.4]])},
        )
        assert np.hypot(*(best.x - pixels[k])) < KINKS_PX, (k, best.x, pixels[k])


def test_an_image_that_moved_is_found_where_it_moved_to():
    """By whole pixels, so that the regions are equal and only their places differ."""
    shift = np.array([2.0, -1.0])
    moved = [np.roll(FIRST[0], (-1, 2), axis=(0, 1))]
    _, pixels, correlations = recalculated(moved, PrintedConstants(4.0, 1e-3))
    np.testing.assert_allclose(pixels - EXPECTED, np.broadcast_to(shift, (10, 2)), atol=0.02)
    # Templates are as those of the tracker, sampled at the true place: equal but for interpolation.
    assert correlations.min() > 0.99


def test_without_noise_and_movement_nothing_moves():
    previous = take_templates(RigImages(CAMERAS, FIRST), FACING, SHAPE)
    _, pixels, correlations = recalculated(FIRST, PrintedConstants(4.0, 4000.0), previous)
    np.testing.assert_allclose(pixels, EXPECTED, atol=1e-9)
    np.testing.assert_allclose(correlations, 1.0, atol=1e-9)


def test_a_strong_prior_keeps_points_where_the_filter_has_them():
    expected = EXPECTED + np.array([1.5, -0.5])
    _, pixels, _ = recalculated(FIRST, PrintedConstants(4.0, 1e9), start=EXPECTED, expected=expected)
    np.testing.assert_allclose(pixels, expected, atol=1e-2)


def test_the_step_is_that_of_the_normal_equations_mended():
    """One step against D and d written out with matrices; the print's factor 2 would weigh E_M half."""
    printed = PrintedConstants(4.0, 4000.0)
    images = FACE.render(CAMERAS, FACING, SHAPE + OFFSETS_MM)
    previous = take_templates(RigImages(CAMERAS, FIRST), FACING, SHAPE)
    expected = EXPECTED + np.array([0.4, 0.3])
    _, pixels, _ = recalculated(images, printed, previous, expected=expected, iterations=1)
    for k in range(10):
        grid, first = region(images[0], EXPECTED[k]), region(FIRST[0], EXPECTED[k])
        slopes = [grid[1:-1, 2:] - grid[1:-1, :-2], grid[2:, 1:-1] - grid[:-2, 1:-1]]
        K = 0.5 * np.stack([slope.ravel() for slope in slopes], axis=1)
        difference = (grid - first)[1:-1, 1:-1].ravel()
        D = (printed.rho + 1.0) * K.T @ K + printed.epsilon * np.eye(2)
        d = (printed.rho + 1.0) * K.T @ difference + printed.epsilon * (EXPECTED[k] - expected[k])
        np.testing.assert_allclose(pixels[k] - EXPECTED[k], -np.linalg.solve(D, d), atol=1e-9)


def test_correlations_are_those_of_the_templates():
    images = FACE.render(CAMERAS, FACING, SHAPE + OFFSETS_MM, noise=3.0)
    scene, pixels, correlations = recalculated(images, PrintedConstants(4.0, 4000.0))
    for k in range(10):
        patch = np.empty(SIZE)
        normalise(region(images[0], pixels[k]), patch)
        assert correlations[k] == pytest.approx(patch @ scene.targets.patches[0, 0, k], abs=1e-9)


def test_a_point_outside_the_image_stays_and_has_no_correlation():
    start = EXPECTED.copy()
    start[3] = [-40.0, 10.0]
    _, pixels, correlations = recalculated(FIRST, PrintedConstants(4.0, 4000.0), start=start)
    np.testing.assert_array_equal(pixels[3], start[3])
    np.testing.assert_array_equal(np.isnan(correlations), np.arange(10) == 3)
