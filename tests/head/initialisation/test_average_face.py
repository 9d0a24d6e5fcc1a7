"""An average face laid on measured points."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.head.face.points import FEATURES
from posetrack_cli.head.face.rig_images import CameraImage
from posetrack_cli.head.initialisation.average_face import (
    MeasuredFace,
    face_deviation,
    swapped_order,
)
from support.rig import LEFT, face_pixels, right_camera, turned_head

EVERY = np.ones(10, bool)
VIEW = CameraImage(LEFT, np.zeros((480, 640), np.uint8))


@pytest.mark.parametrize("size", [0.8, 1.0, 1.25])
def test_an_average_face_of_any_size_deviates_in_nothing(size: float) -> None:
    points = turned_head().points(size * FEATURES)
    assert MeasuredFace(points, EVERY).size == pytest.approx(size)
    np.testing.assert_allclose(MeasuredFace(points, EVERY).deviations, 0.0, atol=1e-9)


def test_points_matched_with_something_else_are_taken_away_and_no_others() -> None:
    rng = np.random.default_rng(5)
    points = turned_head().points(FEATURES + rng.normal(0.0, 1.0, FEATURES.shape))
    points[[2, 8]] += [[0.0, 0.0, 45.0], [5.0, 0.0, -60.0]]
    kept = MeasuredFace(points, EVERY).without_outliers().known
    np.testing.assert_array_equal(np.flatnonzero(~kept), [2, 8])


def test_never_more_than_two_are_taken_away() -> None:
    points = np.random.default_rng(1).normal(0.0, 300.0, (10, 3))
    assert MeasuredFace(points, EVERY).without_outliers().known.sum() == 8


def test_an_unknown_point_gets_the_depth_of_an_average_face_on_its_ray() -> None:
    truth = turned_head().points(1.1 * FEATURES)
    pixels, _ = VIEW.pixels_of(truth)
    known = EVERY.copy()
    known[[1, 7]] = False
    broken = np.where(known[:, None], truth, 0.0)
    np.testing.assert_allclose(MeasuredFace(broken, known).completed(VIEW, pixels), truth, atol=1e-6)


# Images that belong to other cameras than they are said to


# What a detector is off by in each image, pixels.
NOISE_PX = 1.5


@pytest.mark.parametrize("toe_in", [0.0, 0.17], ids=["parallel", "converging"])
@pytest.mark.parametrize("seed", range(5))
def test_exchanged_images_are_noticed_and_right_ones_are_not(toe_in: float, seed: int) -> None:
    cameras = (LEFT, right_camera(toe_in))
    rng = np.random.default_rng(seed)
    pose = turned_head(rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2))
    faces = face_pixels(cameras, pose)
    faces += rng.normal(0.0, NOISE_PX, faces.shape)
    assert swapped_order(cameras, faces) == ()
    assert swapped_order(cameras, faces[::-1]) == (1, 0)


def test_converging_cameras_see_a_hollow_face_when_exchanged() -> None:
    cameras = (LEFT, right_camera(0.17))
    faces = face_pixels(cameras, turned_head(0.0, 0.0))
    assert face_deviation(cameras, faces) < 1e-6
    assert face_deviation(cameras, faces[::-1]) > 1.5


def test_without_a_face_in_every_image_nothing_is_said() -> None:
    cameras = (LEFT, right_camera(0.17))
    faces = face_pixels(cameras, turned_head())[::-1].copy()
    faces[1] = np.nan
    assert swapped_order(cameras, faces) == ()
