"""Points of one image found in another, on a rendered surface whose depth is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posetrack_cli.head.face.rig_images import CameraImage
from posetrack_cli.head.initialisation.matching import match_points
from posetrack_cli.head.initialisation.stereo import MATCHED_POINTS
from support.rig import LEFT, right_camera

DEPTH = 700.0
PLACES = np.array([[x, y] for y in (180.0, 230.0, 280.0) for x in (270.0, 320.0, 370.0)] + [[300.0, 200.0]])
PIXELS_PER_MM = LEFT.fx / DEPTH


def texture(seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(0, 255, (480, 640)).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2.5), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def views_of_a_plane(toe_in: float, slant: float) -> tuple[CameraImage, CameraImage]:
    """A textured plane as both cameras see it: z = DEPTH + slant x in the left camera's axes."""
    left, right = CameraImage(LEFT, texture(4)), right_camera(toe_in)
    normal = np.array([-slant, 0.0, 1.0]) / DEPTH  # normal . p = 1 on the plane
    transform = np.array(right.camera_T_reference)
    homography = (
        right.matrix @ (transform[:, :3] + np.outer(transform[:, 3], normal)) @ np.linalg.inv(LEFT.matrix)
    )
    return left, CameraImage(right, cv2.warpPerspective(left.image, homography, (640, 480)))


def plane_depths(slant: float) -> np.ndarray:
    return DEPTH / (1.0 - slant * (PLACES[:, 0] - LEFT.cx) / LEFT.fx)


@pytest.mark.parametrize("toe_in", [0.0, 0.17])
@pytest.mark.parametrize(("slant", "tolerance_px"), [(0.0, 0.25), (0.4, 0.5)])
def test_points_are_found_where_the_surface_projects_them(
    toe_in: float, slant: float, tolerance_px: float
) -> None:
    left, right = views_of_a_plane(toe_in, slant)
    expected, _ = right.pixels_of(left.points_at(PLACES, plane_depths(slant)))
    matches = match_points(left, right, PLACES, np.zeros(len(PLACES)), PIXELS_PER_MM)
    # Peaks are refined to a fraction of a pixel; a patch is compared as if it faced the camera.
    np.testing.assert_allclose(matches.pixels, expected, atol=tolerance_px)
    assert matches.correlations.min() > 0.8
    assert matches.returns_px.max() < 1.5


def test_points_of_another_scene_do_not_come_back() -> None:
    left, right = views_of_a_plane(0.17, 0.0)
    other = CameraImage(right.camera, texture(99))
    matches = match_points(left, other, PLACES, np.zeros(len(PLACES)), PIXELS_PER_MM)
    good = (matches.correlations > 0.5) & (matches.returns_px < 4.0 * PIXELS_PER_MM)
    assert good.sum() < MATCHED_POINTS


def test_points_that_the_other_camera_cannot_see_have_no_correlation() -> None:
    left, right = views_of_a_plane(-1.2, 0.0)
    matches = match_points(left, right, PLACES, np.zeros(len(PLACES)), PIXELS_PER_MM)
    np.testing.assert_array_equal(matches.correlations, 0.0)
