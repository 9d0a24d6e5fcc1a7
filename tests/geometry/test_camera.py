"""Cameras: projection and its inverse, the mirrored image against OpenCV, intrinsics that cannot be."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.errors import PosetrackError
from posetrack_cli.geometry.camera import Camera

CAMERA = Camera(512, 424, 365.0, 367.0, 250.25, 211.5)
ROUNDING_PX = 1e-9
"""Pixels below 1e5 carry 1e-11 of rounding; a few operations on them."""

COEFFICIENTS = {
    4: (0.09, -0.25, 0.011, -0.023),
    5: (0.09, -0.25, 0.011, -0.023, 0.07),
    8: (0.3, 0.1, 0.011, -0.023, 0.02, 0.4, 0.1, 0.01),
    12: (0.3, 0.1, 0.011, -0.023, 0.02, 0.4, 0.1, 0.01, 0.013, -0.02, -0.017, 0.03),
    14: (0.3, 0.1, 0.011, -0.023, 0.02, 0.4, 0.1, 0.01, 0.013, -0.02, -0.017, 0.03, 0.05, -0.08),
}


def distorted_pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    """OpenCV's own projection, with distortion: (N, 3) -> (N, 2)."""
    coefficients, zero = np.array(camera.distortion), np.zeros(3)
    if camera.distortion_model == "equidistant":
        pixels, _ = cv2.fisheye.projectPoints(points[:, None], zero, zero, camera.matrix, coefficients)
    else:
        pixels, _ = cv2.projectPoints(points, zero, zero, camera.matrix, coefficients)
    return pixels.reshape(-1, 2)


def some_points() -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.column_stack([rng.uniform(-200, 200, (40, 2)), rng.uniform(500, 900, 40)])


@settings(deadline=None, max_examples=50)
@given(
    arrays(np.float64, (3, 4, 2), elements=st.floats(-1e3, 1e3)),
    arrays(np.float64, (3, 4), elements=st.floats(1.0, 1e4)),
)
def test_projection_undoes_back_projection(pixels: np.ndarray, depth: np.ndarray) -> None:
    points = CAMERA.points_from_pixels(pixels, depth)
    np.testing.assert_array_equal(points[..., 2], depth)
    back, valid = CAMERA.pixels_from_points(points)
    assert valid.all()
    np.testing.assert_allclose(back, pixels, atol=ROUNDING_PX)


def test_projection_is_opencv_s() -> None:
    points = some_points()
    np.testing.assert_allclose(
        CAMERA.pixels_from_points(points)[0],
        cv2.projectPoints(points, np.zeros(3), np.zeros(3), CAMERA.matrix, None)[0][:, 0],
        atol=ROUNDING_PX,
    )


def test_points_behind_or_in_the_sensor_are_not_valid_and_stay_finite() -> None:
    points = np.array([[1.0, 2.0, -3.0], [1.0, 2.0, 0.0], [1.0, 2.0, 3.0]])
    pixels, valid = CAMERA.pixels_from_points(points)
    assert valid.tolist() == [False, False, True]
    assert np.isfinite(pixels).all()


def test_one_depth_for_many_pixels() -> None:
    points = CAMERA.points_from_pixels(np.zeros((2, 5, 2)), np.array(700.0))
    assert points.shape == (2, 5, 3)
    assert (points[..., 2] == 700.0).all()


@pytest.mark.parametrize("count", [0, *COEFFICIENTS])
def test_the_mirrored_camera_sees_the_mirrored_scene_in_the_flipped_image(count: int) -> None:
    model = "plumb_bob" if count <= 5 else "rational_polynomial"
    camera = Camera(512, 424, 365.0, 367.0, 250.25, 211.5, COEFFICIENTS.get(count, ()), model)
    check_mirrored(camera)


def test_the_mirrored_fisheye() -> None:
    check_mirrored(Camera(512, 424, 365.0, 367.0, 250.25, 211.5, (0.1, -0.2, 0.03, 0.01), "equidistant"))


def check_mirrored(camera: Camera) -> None:
    points = some_points()
    flipped = distorted_pixels(camera, points)
    flipped[:, 0] = camera.width - 1 - flipped[:, 0]
    mirrored = camera.mirrored()
    np.testing.assert_allclose(distorted_pixels(mirrored, points * [-1, 1, 1]), flipped, atol=1e-7)
    again = mirrored.mirrored()
    np.testing.assert_allclose(distorted_pixels(again, points), distorted_pixels(camera, points), atol=1e-7)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fx": 0.0}, "fx 0.0"),
        ({"fy": -1.0}, "fy -1.0"),
        ({"cx": np.nan}, "cx nan"),
        ({"cy": np.inf}, "cy inf"),
        ({"cx": 1e300}, "intrinsics"),
        ({"fy": 1e-300}, "intrinsics"),
        ({"distortion": (np.nan, 0.0, 0.0, 0.0)}, "intrinsics"),
        ({"width": 0}, "invalid image size, found 0x424"),
        ({"height": -3}, "512x-3"),
        ({"distortion": (0.1, 0.2)}, "plumb_bob with 2 coefficients"),
        ({"distortion": (0.1,) * 5, "distortion_model": "rational_polynomial"}, "with 5 coefficients"),
        ({"distortion": (0.1,) * 4, "distortion_model": "thin"}, "thin with 4"),
    ],
)
def test_a_camera_that_cannot_be_is_refused_by_name(changes: dict[str, object], message: str) -> None:
    values = {"width": 512, "height": 424, "fx": 365.0, "fy": 365.0, "cx": 255.5, "cy": 211.5} | changes
    with pytest.raises(PosetrackError) as caught:
        Camera(**values, name="kinect")
    assert str(caught.value).startswith("kinect: ")
    assert message in str(caught.value)


def test_zero_coefficients_are_no_distortion() -> None:
    assert not Camera(512, 424, 365.0, 365.0, 255.5, 211.5, (0.0,) * 5).is_distorted
    assert Camera(512, 424, 365.0, 365.0, 255.5, 211.5, (0.0, 0.0, 0.0, 1e-3)).is_distorted
