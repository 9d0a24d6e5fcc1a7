"""Projection through several lenses: OpenCV's pixels, and derivatives against differences."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posetrack_cli.head.face.points import MEAN_SHAPE
from posetrack_cli.head.face.rig_images import project
from support.textured_face import FACING, turned_camera

LENSES = {
    "none": {},
    "plumb_bob": {"distortion": (-0.25, 0.1, 0.002, -0.003, 0.02)},
    "equidistant": {"distortion": (0.05, -0.02, 0.01, 0.003), "distortion_model": "equidistant"},
}
POINTS = FACING.points(MEAN_SHAPE)


@pytest.mark.parametrize("lens", ["none", "plumb_bob"])
def test_pixels_are_opencvs(lens):
    camera = turned_camera("right", 120.0, **LENSES[lens])
    transform = np.array(camera.camera_T_reference)
    rotation, _ = cv2.Rodrigues(transform[:, :3])
    wanted, _ = cv2.projectPoints(
        POINTS, rotation, transform[:, 3], camera.matrix, np.array(camera.distortion or [0.0] * 4)
    )
    np.testing.assert_allclose(project([camera], POINTS).pixels[0], wanted[:, 0], atol=1e-8)


@pytest.mark.parametrize("lens", LENSES)
def test_jacobians_are_differences(lens):
    camera, h = turned_camera("right", 120.0, **LENSES[lens]), 1e-3
    found = project([camera], POINTS).jacobians[0]
    for axis in range(3):
        step = h * np.eye(3)[axis]
        ahead, behind = (project([camera], POINTS + sign * step).pixels[0] for sign in (1, -1))
        np.testing.assert_allclose(found[:, :, axis], (ahead - behind) / (2 * h), atol=1e-7)


@pytest.mark.parametrize("lens", LENSES)
def test_a_lens_is_exact_about_its_points_and_nearly_so_around_them(lens):
    camera = turned_camera("left", 0.0, **LENSES[lens])
    lenses = project([camera], POINTS).lenses[0]
    nearby = POINTS + np.array([2.0, -2.0, 5.0])
    for points, tolerance in ((POINTS, 1e-9), (nearby, 0.05)):  # second order: 3 px, some 1e-3 per px^2
        x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
        bent = np.einsum("kij,jk->ki", lenses, np.stack([x, y, np.ones_like(x)]))
        pixels = bent * [camera.fx, camera.fy] + [camera.cx, camera.cy]
        np.testing.assert_allclose(pixels, project([camera], points).pixels[0], atol=tolerance)


def test_rays_go_to_the_camera():
    camera = turned_camera("right", 120.0)
    to_camera = np.array([120.0, 0.0, 0.0]) - POINTS
    wanted = to_camera / np.linalg.norm(to_camera, axis=1, keepdims=True)
    np.testing.assert_allclose(project([camera], POINTS).rays[0], wanted, atol=1e-12)


def test_points_behind_a_camera_are_told():
    points = np.array([[0.0, 0.0, 500.0], [0.0, 0.0, -500.0]])
    found = project([turned_camera("left", 0.0)], points)
    assert found.in_front.tolist() == [[True, False]]
    assert np.all(np.isfinite(found.pixels))
