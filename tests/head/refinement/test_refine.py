"""The calls that a tracker makes: with one camera, the printed recalculation moves points in the image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.geometry.camera import pixels_from_points
from posetrack_cli.head.actions import displacement
from posetrack_cli.head.config import RefinementSettings
from posetrack_cli.head.face.points import rigid_model
from posetrack_cli.head.face.rig_images import RigImages, project
from posetrack_cli.head.face.templates import take_templates
from posetrack_cli.head.refinement.evidence import ComparedFrame
from posetrack_cli.head.refinement.refine import (
    PrintedConstants,
    recalculate,
    recalculate_2d_as_printed,
    refine,
)
from support.textured_face import FACING, SHAPE, stereo, textured_face

(CAMERA,) = stereo(1)
BENT = replace(CAMERA, distortion=(-0.2, 0.05, 0.001, -0.001, 0.0))
TURNED = FACING.moved(np.array([5.0, -3.0, 20.0, 0.1, -0.25, 0.15]))
"""So that camera axes are not the head's."""
OFFSETS_MM = np.random.default_rng(8).uniform(-1.2, 1.2, (10, 3))
SETTINGS = RefinementSettings(recalculation="printed", recalculation_iterations=20)
ROUNDING = 1e-9
BENDING_PX = 0.01
"""Lenses are linearised about the model's points: over 2 of 500 px, distortion's second order is 1e-5."""


def drawn(camera, shape):
    """A frame whose points lie off the model's, and the templates of one where they did not."""
    face = textured_face()
    templates = take_templates(RigImages([camera], face.render([camera], TURNED, SHAPE)), TURNED, SHAPE)
    images = face.render([camera], TURNED, shape, noise=2.0)
    frame = ComparedFrame(RigImages([camera], images), [templates], templates, SETTINGS)
    scene, _ = frame.scene(TURNED, SHAPE)
    return scene


def found(camera=CAMERA, start=SHAPE, settings=SETTINGS):
    scene = drawn(camera, SHAPE + OFFSETS_MM)
    return scene, recalculate(scene, TURNED, SHAPE, start, settings)


@pytest.mark.parametrize("camera, error", [(CAMERA, ROUNDING), (BENT, BENDING_PX)], ids=["no lens", "lens"])
def test_points_lie_at_the_models_depths_where_they_are_seen(camera, error):
    _, result = found(camera)
    points = TURNED.points(result.shape)
    np.testing.assert_allclose(points[:, 2], TURNED.points(SHAPE)[:, 2], atol=ROUNDING)
    pixels, _ = pixels_from_points(camera, points)
    np.testing.assert_allclose(pixels, result.pixels[0], atol=error)


def test_points_are_moved_in_the_image_from_where_they_were_before():
    """The call is the kernel's, from the pixels of M' of the frame before, with the prior at M's."""
    settings = SETTINGS.model_copy(update={"recalculation_iterations": 1})
    start = SHAPE + 0.5 * OFFSETS_MM[::-1]
    scene, result = found(start=start, settings=settings)
    pixels, expected = (project((CAMERA,), TURNED.points(shape)).pixels[0] for shape in (start, SHAPE))
    correlations = np.empty(10)
    printed = PrintedConstants(settings.rho, settings.epsilon)
    recalculate_2d_as_printed(scene, expected, printed, 1, pixels, correlations)
    np.testing.assert_allclose(result.pixels[0], pixels, atol=ROUNDING)
    np.testing.assert_allclose(result.correlations[0], correlations, atol=ROUNDING)
    assert result.pixels.shape == (1, 10, 2) and result.correlations.shape == (1, 10)


def test_points_are_found_where_they_were_drawn_but_for_their_depth():
    """In one patch noise of 2 levels leaves 0.02 px; planes that bend away beside each other some tenths."""
    free = SETTINGS.model_copy(update={"epsilon": 20.0})
    _, result = found(settings=free)
    drawn_at = project((CAMERA,), TURNED.points(SHAPE + OFFSETS_MM)).pixels[0]
    before = project((CAMERA,), TURNED.points(SHAPE)).pixels[0]
    away = np.linalg.norm(result.pixels[0] - drawn_at, axis=1)
    assert away.max() < 0.3 < 0.5 < np.median(np.linalg.norm(before - drawn_at, axis=1))
    assert result.correlations.min() > 0.95


def test_the_start_is_left_as_it_is():
    start = SHAPE.copy()
    found(start=start)
    np.testing.assert_array_equal(start, SHAPE)


STRENGTH, TURNED_DEG = 0.2, 0.2
"""Of the action, and what remains of up to 1 deg: the prior of strengths keeps a tenth of the motion."""


@pytest.mark.parametrize("action", ["brows_up", "jaw_open", "mouth_wide", "mouth_left"])
def test_expressions_do_not_turn_a_rigid_head(action):
    """A face whose model knows no deformation moves."""
    cameras, face = stereo(2), textured_face()
    templates = take_templates(RigImages(cameras, face.render(cameras, TURNED, SHAPE)), TURNED, SHAPE)
    moved = SHAPE + STRENGTH * displacement(action)
    images = RigImages(cameras, face.render(cameras, TURNED, moved, noise=2.0))
    turned_deg = []
    for expressions in (False, True):
        settings = RefinementSettings(expressions=expressions)
        frame = ComparedFrame(images, [templates], templates, settings)
        refined = refine(frame, rigid_model(SHAPE), TURNED, np.zeros(0))
        assert refined.coefficients.shape == (0,)
        turned_deg.append(np.degrees(np.linalg.norm(TURNED.difference(refined.pose)[3:])))
    assert turned_deg[1] < TURNED_DEG and turned_deg[1] < 0.5 * turned_deg[0]
