"""Lens distortion against OpenCV in every model, its derivatives against differences, its inverse."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.geometry.camera import (
    Camera,
    distort,
    distortion_jacobian,
    in_camera_axes,
    largest_radius,
    normalised_from_pixels,
    pixels_and_jacobian,
    pixels_from_normalised,
    pixels_from_points,
    undistort,
    undistorted_pixels,
)

ROUNDING_PX = 1e-8
"""A few dozen roundings of pixels below 1e4."""
STEP = 1e-6
"""Of central differences: its square times third derivatives of order 1, and rounding 1e-16 / 1e-6."""
DIFFERENCE = 1e-8

DISTORTIONS: dict[str, tuple[str, tuple[float, ...]]] = {
    "none": ("plumb_bob", ()),
    "four": ("plumb_bob", (0.09, -0.25, 0.011, -0.023)),
    "five": ("plumb_bob", (-0.28, 0.09, 0.0011, -0.0023, -0.012)),
    "eight": ("rational_polynomial", (0.3, 0.1, 0.011, -0.023, 0.02, 0.4, 0.1, 0.01)),
    "twelve": (
        "rational_polynomial",
        (0.3, 0.1, 0.011, -0.023, 0.02, 0.4, 0.1, 0.01, 0.013, -0.02, -0.017, 0.03),
    ),
    "fourteen": (
        "rational_polynomial",
        (0.3, 0.1, 0.011, -0.023, 0.02, 0.4, 0.1, 0.01, 0.013, -0.02, -0.017, 0.03, 0.05, -0.08),
    ),
    "inverse": ("inverse_brown_conrady", (0.12, -0.11, 0.004, 0.006, 0.03)),
    "fisheye": ("equidistant", (0.1, -0.02, 0.003, 0.001)),
}


@pytest.fixture(params=DISTORTIONS)
def camera(request: pytest.FixtureRequest) -> Camera:
    model, coefficients = DISTORTIONS[request.param]
    return Camera(640, 480, 900.0, 905.0, 322.5, 238.0, coefficients, model)


def some_points() -> np.ndarray:
    """Points up to 19 degrees off the axis, one of them on it."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-200, 200, (60, 2)), rng.uniform(700, 900, 60)])
    points[0, :2] = 0.0
    return points


def opencv_pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    coefficients, zero = np.array(camera.distortion), np.zeros(3)
    if camera.distortion_model == "inverse_brown_conrady":
        # OpenCV's undistortion of this lens is its distortion of the inverse one, and the other way round
        criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-15)
        rays = points[:, None, :2] / points[:, None, 2:]
        ideal = cv2.undistortPointsIter(rays, np.eye(3), coefficients, np.eye(3), np.eye(3), criteria)[:, 0]
        return ideal * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    if camera.distortion_model == "equidistant":
        return cv2.fisheye.projectPoints(points[:, None], zero, zero, camera.matrix, coefficients)[0][:, 0]
    return cv2.projectPoints(points, zero, zero, camera.matrix, coefficients)[0][:, 0]


def test_projection_is_opencv_s(camera: Camera) -> None:
    points = some_points()
    pixels, valid = pixels_from_points(camera, points)
    assert valid.all()
    np.testing.assert_allclose(pixels, opencv_pixels(camera, points), atol=ROUNDING_PX)


def test_pixels_go_back_to_their_rays(camera: Camera) -> None:
    points = some_points().reshape(3, 20, 3)
    rays = points[..., :2] / points[..., 2:]
    pixels, _ = pixels_from_points(camera, points)
    np.testing.assert_allclose(normalised_from_pixels(camera, pixels), rays, atol=1e-11)
    ideal, _ = camera.pixels_from_points(points)
    np.testing.assert_allclose(undistorted_pixels(camera, pixels), ideal, atol=ROUNDING_PX)


@settings(deadline=None, max_examples=50)
@given(st.floats(-0.4, 0.4), st.floats(-0.1, 0.3), st.floats(-0.01, 0.01), st.floats(-0.02, 0.02))
def test_any_ordinary_lens_is_undone(k1: float, k2: float, p1: float, p2: float) -> None:
    camera = Camera(640, 480, 900.0, 905.0, 322.5, 238.0, (k1, k2, p1, p2))
    rays = some_points()[:, :2] / 800.0
    back = normalised_from_pixels(camera, pixels_from_normalised(camera, rays))
    np.testing.assert_allclose(back, rays, atol=1e-10)


def test_a_fisheye_is_undone_far_off_the_axis() -> None:
    model, coefficients = DISTORTIONS["fisheye"]
    camera = Camera(640, 480, 300.0, 300.0, 322.5, 238.0, coefficients, model)
    rays = np.tan(np.radians([[0.0, 0.0], [0.0, 60.0], [75.0, 0.0]]))
    back = normalised_from_pixels(camera, pixels_from_normalised(camera, rays))
    np.testing.assert_allclose(back, rays, atol=1e-9)


def test_derivatives_of_the_lens(camera: Camera) -> None:
    x, y = (some_points()[:, :2] / 800.0).T
    found = distortion_jacobian(camera, x, y)
    ahead, behind = np.array(distort(camera, x + STEP, y)), np.array(distort(camera, x - STEP, y))
    by_x = (ahead - behind) / (2 * STEP)
    ahead, behind = np.array(distort(camera, x, y + STEP)), np.array(distort(camera, x, y - STEP))
    by_y = (ahead - behind) / (2 * STEP)
    for got, expected in zip(found, (by_x[0], by_y[0], by_x[1], by_y[1]), strict=True):
        np.testing.assert_allclose(got, expected, atol=DIFFERENCE)


def test_derivatives_of_the_projection(camera: Camera) -> None:
    points = some_points()
    pixels, jacobian = pixels_and_jacobian(camera, points)
    np.testing.assert_allclose(pixels, pixels_from_points(camera, points)[0], atol=ROUNDING_PX)
    assert jacobian.shape == (60, 2, 3)
    for axis in range(3):
        step = np.eye(3)[axis] * 1e-3  # mm; third derivatives are some 1e-5 px/mm^3
        ahead, behind = (
            pixels_from_points(camera, points + step)[0],
            pixels_from_points(camera, points - step)[0],
        )
        np.testing.assert_allclose(jacobian[..., axis], (ahead - behind) / 2e-3, atol=1e-7)


def test_single_precision_stays_single(camera: Camera) -> None:
    x = np.linspace(-0.2, 0.2, 9, dtype=np.float32)
    for values in (*distort(camera, x, x), *distortion_jacobian(camera, x, x), *undistort(camera, x, x)):
        assert values.dtype == np.float32
    single, double = distort(camera, x, x), distort(camera, x.astype(float), x.astype(float))
    np.testing.assert_allclose(single, double, atol=16 * np.finfo(np.float32).eps)


def test_points_that_a_polynomial_folds_back_into_the_image_are_not_valid() -> None:
    camera = Camera(640, 480, 900.0, 900.0, 320.0, 240.0, (-0.3, 0.0, 0.0, 0.0))
    limit = largest_radius(camera)
    assert limit == pytest.approx(1 / np.sqrt(0.9), abs=2e-3), "d(r - .3 r^3)/dr = 0"
    folded = np.array([[1.8, 0.0, 1.0]])
    pixels, valid = pixels_from_points(camera, folded)
    assert 0 < pixels[0, 0] < camera.width, "it would be seen"
    assert not valid.any()
    assert pixels_from_points(camera, np.array([[0.9 * limit, 0.0, 1.0]]))[1].all()
    assert largest_radius(Camera(640, 480, 900.0, 900.0, 320.0, 240.0)) == np.inf


def test_points_behind_the_camera_are_not_valid_and_stay_finite(camera: Camera) -> None:
    pixels, valid = pixels_from_points(camera, np.array([[1.0, 2.0, -3.0], [1.0, 2.0, 0.0], [0.1, 0.2, 3.0]]))
    assert valid.tolist() == [False, False, True]
    assert np.isfinite(pixels).all()


def test_points_of_the_reference_in_another_camera_s_axes() -> None:
    turned = ((0.0, -1.0, 0.0, 5.0), (1.0, 0.0, 0.0, -7.0), (0.0, 0.0, 1.0, 11.0))
    camera = Camera(640, 480, 900.0, 900.0, 320.0, 240.0, camera_T_reference=turned)
    moved = in_camera_axes(camera, np.array([[1.0, 2.0, 3.0]]))
    np.testing.assert_array_equal(moved, [[-2.0 + 5.0, 1.0 - 7.0, 3.0 + 11.0]])
