"""Regions of the face: crops at a pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.geometry.camera import Camera, pixels_wherever
from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.dense.regions import (
    LEFT_EYE,
    MOUTH_REGION,
    REGIONS,
    RIGHT_EYE,
    crop,
    image_from_crop,
    mapped,
)
from posetrack_cli.head.face.points import HeadPose

CAMERA = Camera(640, 480, 900.0, 900.0, 319.5, 239.5)
POSE = HeadPose(
    np.array([20.0, -15.0, 800.0]), head_quaternion_from_roll_pitch_yaw(np.array([0.2, -0.1, 0.4]))
)


@pytest.mark.parametrize("region", REGIONS, ids=lambda region: region.name)
def test_homography_projects_the_regions_plane(region):
    homography = image_from_crop(region, POSE, CAMERA)
    pixels = np.array([[3.0, 7.0], [30.5, 21.25], [50.0, 44.0]])

    seen = pixels_wherever(CAMERA, POSE.points(region.head_from_crop(pixels)))

    # getPerspectiveTransform rounds its input to float32: 640 px have an error of 4e-5
    np.testing.assert_allclose(mapped(homography, pixels), seen, atol=1e-3)


def test_eyes_are_mirror_images():
    pixels = np.array([[3.0, 7.0], [30.5, 21.25]])

    right, left = RIGHT_EYE.head_from_crop(pixels), LEFT_EYE.head_from_crop(pixels)

    np.testing.assert_allclose(left, right * (-1.0, 1.0, 1.0))


@pytest.mark.parametrize("size", [1, 4])
def test_crop_of_a_ramp_keeps_grey_levels(size):
    camera = replace(CAMERA, width=640 * size, height=480 * size, fx=900.0 * size, fy=900.0 * size)
    camera = replace(camera, cx=(320 * size) - 0.5, cy=(240 * size) - 0.5)
    image = np.repeat(np.linspace(0, 255, camera.width)[None], camera.height, axis=0).astype(np.uint8)
    homography = image_from_crop(MOUTH_REGION, POSE, camera)

    found = crop(image, homography, MOUTH_REGION)

    y, x = np.mgrid[: MOUTH_REGION.height, : MOUTH_REGION.width].astype(float)
    expected = mapped(homography, np.stack([x, y], axis=-1))[..., 0] / (camera.width - 1) * 255
    # grey levels are rounded down in the image, and rounded in the crop
    assert np.abs(found - expected).max() <= 1.6


def test_region_behind_the_camera():
    assert image_from_crop(MOUTH_REGION, replace(POSE, position=np.array([0.0, 0.0, -50.0])), CAMERA) is None
