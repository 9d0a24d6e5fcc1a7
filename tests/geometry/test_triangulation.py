"""Triangulation: exact where pixels are, OpenCV's two-view answer, the best one for noise, missing views."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from posetrack_cli.geometry.camera import Camera, in_camera_axes, pixels_from_points
from posetrack_cli.geometry.rigid import CameraPair, reprojection_errors, triangulate

EXACT_MM = 1e-7
"""Pixels to 1e-10 px at 700 mm and a baseline of 120 mm: 1e-10 * 700^2 / (900 * 120)."""
LENS = (-0.21, 0.08, 0.0012, -0.0017, 0.02)


def camera(turn_deg: float, t: tuple[float, float, float], lens: tuple[float, ...] = LENS) -> Camera:
    matrix = Rotation.from_euler("y", turn_deg, degrees=True).as_matrix()
    rows = tuple(tuple(map(float, row)) for row in np.column_stack([matrix, t]))
    return Camera(640, 480, 900.0, 905.0, 322.5, 238.0, lens, camera_T_reference=rows)


CAMERAS = [camera(0, (0, 0, 0)), camera(-9, (-118, 2, 20)), camera(8, (110, -3, 15))]


def head_points(shape: tuple[int, ...] = (30,)) -> np.ndarray:
    return np.random.default_rng(3).uniform((-80, -90, 620), (80, 90, 780), (*shape, 3))


def seen(cameras: list[Camera], points: np.ndarray) -> np.ndarray:
    return np.stack([pixels_from_points(own, in_camera_axes(own, points))[0] for own in cameras])


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("refine", [False, True])
def test_exact_pixels_give_the_points(count: int, refine: bool) -> None:
    points = head_points((5, 6))
    found, valid = triangulate(CAMERAS[:count], seen(CAMERAS[:count], points), refine=refine)
    assert valid.shape == (5, 6)
    assert valid.all()
    np.testing.assert_allclose(found, points, atol=EXACT_MM)


def test_two_views_against_opencv() -> None:
    pair = [replace(own, distortion=()) for own in CAMERAS[:2]]
    pixels = seen(pair, head_points()) + np.random.default_rng(4).normal(0, 0.3, (2, 30, 2))
    matrices = [own.matrix @ np.array(own.camera_T_reference) for own in pair]
    # OpenCV's optimal correction, then its linear method, is the two-view maximum likelihood solution
    fundamental = CameraPair(*pair).fundamental
    corrected = cv2.correctMatches(fundamental, pixels[0][None], pixels[1][None])
    homogeneous = cv2.triangulatePoints(*matrices, corrected[0][0].T, corrected[1][0].T)
    expected = (homogeneous[:3] / homogeneous[3]).T
    np.testing.assert_allclose(triangulate(pair, pixels)[0], expected, atol=1e-4)


def test_noisy_pixels_give_the_least_squares_point() -> None:
    points = head_points((6,))
    pixels = seen(CAMERAS, points) + np.random.default_rng(5).normal(0, 2.0, (3, 6, 2))
    found, _ = triangulate(CAMERAS, pixels)
    for index, point in enumerate(points):

        def residuals(p: np.ndarray, index: int = index) -> np.ndarray:
            return (seen(CAMERAS, p[None])[:, 0] - pixels[:, index]).ravel()

        best = least_squares(residuals, point, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
        np.testing.assert_allclose(found[index], best, atol=1e-4)


def test_refinement_lowers_the_reprojection_error() -> None:
    pixels = seen(CAMERAS, head_points()) + np.random.default_rng(5).normal(0, 2.0, (3, 30, 2))
    squares = [
        np.sum(
            reprojection_errors(CAMERAS, triangulate(CAMERAS, pixels, refine=refine)[0], pixels) ** 2, axis=0
        )
        for refine in (False, True)
    ]
    assert (squares[1] <= squares[0] + 1e-9).all()
    assert squares[1].sum() < squares[0].sum()


def test_views_that_are_missing_do_not_count() -> None:
    points = head_points((4,))
    pixels = seen(CAMERAS, points)
    pixels[2, 0] = np.nan  # seen by two
    pixels[1:, 1] = np.nan  # seen by one
    pixels[0, 2] += 500.0  # wrong, and said not to be seen
    mask = np.ones((3, 4), bool)
    mask[0, 2] = False
    found, valid = triangulate(CAMERAS, pixels, mask)
    assert valid.tolist() == [True, False, True, True]
    np.testing.assert_allclose(found[valid], points[valid], atol=EXACT_MM)
    assert (found[1] == 0.0).all()


def test_rays_that_are_parallel_or_meet_behind_give_no_point() -> None:
    pair = [camera(0, (0, 0, 0), ()), camera(0, (-120, 0, 0), ())]
    same = np.array([[[300.0, 200.0], [300.0, 200.0]], [[300.0, 200.0], [350.0, 200.0]]])
    found, valid = triangulate(pair, same)
    assert valid.tolist() == [False, False]
    assert (found == 0.0).all()


def test_reprojection_error_is_infinite_behind_the_camera() -> None:
    points = np.array([[0.0, 0.0, 700.0], [0.0, 0.0, -700.0]])
    errors = reprojection_errors(CAMERAS, points, np.full((3, 2, 2), 300.0))
    assert np.isfinite(errors[:, 0]).all()
    assert np.isinf(errors[:, 1]).all()
    assert errors[0, 0] == pytest.approx(np.hypot(22.5, 62.0))
