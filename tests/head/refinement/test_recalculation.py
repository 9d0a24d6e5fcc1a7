"""The points' own places: no place in a search around them costs less."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from posetrack_cli.head.config import RefinementSettings, StereoRefinementSettings
from posetrack_cli.head.face.rig_images import RigImages, project
from posetrack_cli.head.face.templates import GRID, SIZE, normalise, sample_grid, take_templates
from posetrack_cli.head.refinement.evidence import ComparedFrame
from posetrack_cli.head.refinement.refine import (
    make_prior,
    recalculate,
    recalculate_points,
    refine_initial_depth,
)
from support.textured_face import FACING, SHAPE, stereo, textured_face

OFFSETS = np.random.default_rng(8).uniform(-1.2, 1.2, (10, 3))
"""Of the points from where the model has them, mm."""
SD = 3.0
AROUND = 0.25
"""Step of the search, mm: a pixel is 0.7 mm across, 6 mm in depth."""
UPRIGHT = np.eye(2)


def drawn(shape=SHAPE + OFFSETS):
    cameras = stereo()
    face = textured_face()
    templates = take_templates(RigImages(cameras, face.render(cameras, FACING, SHAPE)), FACING, SHAPE)
    images = face.render(cameras, FACING, shape, noise=3.0)
    return cameras, images, templates


def scattered(sd_mm, power, between_cameras, most):
    """Points found within ``sd_mm``; comparisons count by that power, and those between cameras so much."""
    cameras, images, templates = drawn()
    frame = ComparedFrame(RigImages(cameras, images), [templates], None, RefinementSettings())
    scene, _ = frame.scene(FACING, SHAPE)
    scene.targets.pair_weights[:] *= between_cameras
    scene = scene._replace(robustness=scene.robustness._replace(power=power))
    points, correlations, pixels = SHAPE.copy(), np.empty((2, 10)), np.empty((2, 10, 2))
    at = FACING.rotation, FACING.position
    recalculate_points(scene, *at, SHAPE, make_prior(np.full(10, sd_mm)), most, points, correlations, pixels)
    return scene, points, correlations, pixels


def found(settings, previous=False, start=SHAPE):
    cameras, images, templates = drawn()
    before = templates if previous else None
    scene, _ = ComparedFrame(RigImages(cameras, images), [templates], before, settings).scene(FACING, SHAPE)
    return scene, recalculate(scene, FACING, SHAPE, start, settings)


def grid_at(image, pixel):
    grid = np.empty((GRID, GRID))
    assert sample_grid(image, image.shape[1], image.shape[0], *pixel, UPRIGHT, grid)
    return grid


def neighbours(point_in_camera):
    steps = (-AROUND, 0.0, AROUND)
    return [
        point_in_camera + np.array(step) for step in product(steps, steps, (-4 * AROUND, 0.0, 4 * AROUND))
    ]


def search(cost, start):
    """The least cost on a grid about a start, walked to from neighbour to neighbour."""
    point_in_camera = start
    while True:
        best = min(neighbours(point_in_camera), key=cost)
        if cost(best) >= cost(point_in_camera):
            return point_in_camera
        point_in_camera = best


def joint_cost(scene, cameras, images, k, point_in_camera):
    """E_k + the prior, with constant belief, from the definitions."""
    total = 0.5 * 7.0 * np.log1p(np.sum((point_in_camera - SHAPE[k]) ** 2) / (4.0 * SD**2))
    projection = project(cameras, FACING.points(point_in_camera[None]))
    for c, image in enumerate(images):
        patch = np.empty(SIZE)
        normalise(grid_at(image, projection.pixels[c, 0]), patch)
        ncc = patch @ scene.targets.patches[0, c, k]
        total += scene.targets.weights[0, c, k] * scene.robustness.precision * (1.0 - ncc)
    return total


def test_no_place_around_costs_less():
    scene, shape, _, _ = scattered(SD, power=0.0, between_cameras=0.0, most=30)
    cameras, images, _ = drawn()
    for k in range(10):
        wanted = search(
            lambda point_in_camera, k=k: joint_cost(scene, cameras, images, k, point_in_camera), SHAPE[k]
        )
        away = np.abs(shape[k] - wanted)
        assert np.all(away <= [2 * AROUND, 2 * AROUND, 8 * AROUND]), (k, away)


def test_points_are_found_where_they_were_drawn():
    _, shape, correlations, pixels = scattered(10.0, power=1.0, between_cameras=1.0, most=15)
    away = np.abs(shape - SHAPE - OFFSETS)
    assert away[:, :2].max() < 0.3  # noise of 3 levels in 20
    assert away[4:6, 2].max() < 1.0
    assert correlations.min() > 0.95
    np.testing.assert_allclose(pixels, project(stereo(), FACING.points(shape)).pixels, atol=0.02)


def printed_cost(cameras, images, first, settings, k, point_in_camera):
    """E of (3.3)-(3.6) for one point; reference and frame before are the same images ``first``."""
    total = settings.epsilon * np.sum((point_in_camera - SHAPE[k]) ** 2)
    before = project(cameras, FACING.points(SHAPE)).pixels
    now = project(cameras, FACING.points(point_in_camera[None])).pixels
    for c, image in enumerate(images):
        difference = grid_at(image, now[c, 0]) - grid_at(first[c], before[c, k])
        total += (settings.rho + 1.0) * np.sum(difference[1:-1, 1:-1] ** 2)
    return total


@pytest.mark.parametrize("epsilon", [2000.0, 20.0])
def test_the_printed_one_minimises_the_printed_cost(epsilon):
    settings = RefinementSettings(recalculation="printed", epsilon=epsilon, recalculation_iterations=30)
    _, result = found(settings, previous=True)
    cameras, images, _ = drawn()
    first = textured_face().render(cameras, FACING, SHAPE)
    for k in (0, 4, 7, 9):
        wanted = search(
            lambda point_in_camera, k=k: printed_cost(cameras, images, first, settings, k, point_in_camera),
            SHAPE[k],
        )
        away = np.abs(result.shape[k] - wanted)
        assert np.all(away <= [2 * AROUND, 2 * AROUND, 8 * AROUND]), (k, away)


def test_printed_without_a_frame_before_compares_with_the_reference_only():
    settings = RefinementSettings(recalculation="printed", recalculation_iterations=30)
    doubled = settings.model_copy(update={"epsilon": (1.0 + settings.rho) * settings.epsilon})
    _, alone = found(settings)
    _, both = found(doubled, previous=True)  # (1 + rho) times the same comparison, and as much prior
    np.testing.assert_allclose(alone.shape, both.shape, atol=1e-6)


def test_a_shape_is_settled_at_the_depth_that_both_cameras_see():
    cameras = stereo()
    images = textured_face().render(cameras, FACING, SHAPE)
    points = FACING.points(SHAPE)
    wrong = points * (1.0 + np.linspace(-6.0, 6.0, 10)[:, None] / 700.0)  # along the reference's rays
    shape = (wrong - FACING.position) @ FACING.rotation
    settled = refine_initial_depth(RigImages(cameras, images), FACING, shape, StereoRefinementSettings())
    away = np.abs(settled - SHAPE)
    assert away[:, :2].max() < 0.3
    assert away[:, 2].max() < 1.0  # a sixth of a pixel; 6 mm before


def test_settling_with_one_image_changes_nothing():
    cameras = stereo()
    images = textured_face().render(cameras, FACING, SHAPE)
    settled = refine_initial_depth(
        RigImages(cameras, [images[0], None]), FACING, SHAPE, StereoRefinementSettings()
    )
    np.testing.assert_allclose(settled, SHAPE, atol=1e-6)
