"""Epipolar geometry: points of space fulfil it, OpenCV agrees, exchanged images are found out."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posetrack_cli.geometry.camera import Camera, in_camera_axes, pixels_from_points
from posetrack_cli.geometry.rigid import CameraPair, better_order, order_fit, sampson_distance

ROUNDING_PX = 1e-8


def placed(camera: Camera, rotation_deg: tuple[float, float, float], t: tuple[float, float, float]) -> Camera:
    matrix = Rotation.from_euler("xyz", rotation_deg, degrees=True).as_matrix()
    rows = tuple(tuple(map(float, row)) for row in np.column_stack([matrix, t]))
    return replace(camera, camera_T_reference=rows)


LENS = (-0.21, 0.08, 0.0012, -0.0017, 0.02)
PLAIN = Camera(640, 480, 900.0, 905.0, 322.5, 238.0, name="left")
LEFT = replace(PLAIN, distortion=LENS)
RIGHT = placed(replace(LEFT, fx=880.0, fy=884.0, name="right"), (1.0, -9.0, 0.5), (-118.0, 2.0, 20.0))
PARALLEL = placed(replace(PLAIN, name="right"), (0.0, 0.0, 0.0), (-120.0, 0.0, 0.0))


def head_points(count: int = 40) -> np.ndarray:
    rng = np.random.default_rng(3)
    return rng.uniform((-80, -90, 620), (80, 90, 780), (count, 3))


def seen(cameras: list[Camera], points: np.ndarray) -> np.ndarray:
    return np.stack([pixels_from_points(camera, in_camera_axes(camera, points))[0] for camera in cameras])


def test_relative_transform_goes_from_first_to_second() -> None:
    third = placed(LEFT, (3.0, 12.0, -2.0), (90.0, -4.0, 10.0))
    rotation, t = CameraPair(RIGHT, third).transform
    points = head_points()
    np.testing.assert_allclose(
        in_camera_axes(RIGHT, points) @ rotation.T + t, in_camera_axes(third, points), atol=1e-9
    )


def test_every_point_lies_on_the_epipolar_line_that_opencv_draws() -> None:
    cameras = [replace(LEFT, distortion=()), replace(RIGHT, distortion=())]
    first, second = seen(cameras, head_points())
    lines = cv2.computeCorrespondEpilines(first[:, None], 1, CameraPair(*cameras).fundamental)[:, 0]
    np.testing.assert_allclose(np.sum(lines[:, :2] * second, axis=-1) + lines[:, 2], 0.0, atol=ROUNDING_PX)


def test_distortion_is_undone_before_the_epipolar_error() -> None:
    first, second = seen([LEFT, RIGHT], head_points())
    np.testing.assert_allclose(CameraPair(LEFT, RIGHT).epipolar_errors(first, second), 0.0, atol=ROUNDING_PX)
    straight = sampson_distance(CameraPair(LEFT, RIGHT).fundamental, first, second)
    assert straight.max() > 0.1, "as if there were no distortion: an error"


def test_sampson_distance_is_opencv_s() -> None:
    cameras = [replace(LEFT, distortion=()), replace(RIGHT, distortion=())]
    first, second = seen(cameras, head_points(8))
    second = second + np.random.default_rng(4).normal(0, 2, second.shape)
    fundamental = CameraPair(*cameras).fundamental
    expected = [
        cv2.sampsonDistance(np.append(a, 1.0), np.append(b, 1.0), fundamental) ** 0.5
        for a, b in zip(first, second, strict=True)
    ]
    np.testing.assert_allclose(sampson_distance(fundamental, first, second), expected, rtol=1e-9)


def test_sampson_distance_is_to_first_order_the_distance_to_the_nearest_true_pair() -> None:
    cameras = [replace(LEFT, distortion=()), replace(RIGHT, distortion=())]
    first, second = seen(cameras, head_points(20))
    second = second + np.array([0.0, 0.5])
    fundamental = CameraPair(*cameras).fundamental
    moved = cv2.correctMatches(fundamental, first[None], second[None])
    exact = np.sqrt(np.sum((moved[0][0] - first) ** 2 + (moved[1][0] - second) ** 2, axis=-1))
    np.testing.assert_allclose(sampson_distance(fundamental, first, second), exact, rtol=1e-3)


def test_rays_meet_in_front_of_both_cameras_or_not() -> None:
    first, second = seen([LEFT, RIGHT], head_points())
    assert CameraPair(LEFT, RIGHT).in_front(first, second).all()
    a, b = seen([PLAIN, PARALLEL], head_points())
    assert CameraPair(PLAIN, PARALLEL).in_front(a, b).all()
    assert not CameraPair(PLAIN, PARALLEL).in_front(b, a).any(), "with images exchanged depth is negative"


@pytest.mark.parametrize("cameras", [[LEFT, RIGHT], [PLAIN, PARALLEL]], ids=["toed in", "parallel"])
@pytest.mark.parametrize("noise_px", [0.0, 1.0])
def test_exchanged_images_are_found_out(cameras: list[Camera], noise_px: float) -> None:
    pixels = seen(cameras, head_points(10))
    pixels += np.random.default_rng(5).normal(0.0, noise_px, pixels.shape)
    pixels[0, 3] = np.nan  # a point that was not found
    assert better_order(cameras, pixels) is None
    found = better_order(cameras, pixels[::-1])
    assert found is not None
    assert found.order == (1, 0)
    assert found.error_px == order_fit(cameras, pixels, (0, 1)).error_px


def test_points_that_fit_no_order_are_not_called_exchanged() -> None:
    pixels = np.random.default_rng(6).uniform(100, 400, (2, 10, 2))
    assert better_order([LEFT, RIGHT], pixels) is None
    nothing = np.full((2, 10, 2), np.nan)
    assert better_order([LEFT, RIGHT], nothing) is None
    assert order_fit([LEFT, RIGHT], nothing, (0, 1)).error_px == np.inf


@pytest.mark.parametrize("recorded", [(0, 1, 2), (0, 2, 1), (1, 2, 0), (2, 1, 0)])
def test_of_three_cameras_the_order_is_found(recorded: tuple[int, ...]) -> None:
    third = replace(placed(LEFT, (0.0, 9.0, 0.0), (110.0, 0.0, 15.0)), name="far left")
    cameras = [LEFT, RIGHT, third]
    pixels = seen(cameras, head_points(10))[list(recorded)]
    found = better_order(cameras, pixels)
    assert (found.order if found else (0, 1, 2)) == tuple(np.argsort(recorded))
