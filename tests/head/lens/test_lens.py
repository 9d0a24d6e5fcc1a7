"""Errors of poses caused by an estimated lens."""

from __future__ import annotations

import math

import numpy as np
import pytest

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rotations import exponential, multiply
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.lens.lens import GAIN, EstimatedLens

FACING = np.array([1.0, 0.0, 0.0, 0.0])  # x y z w: looks at the camera
CAMERA = Camera(640, 480, 1000.0, 1000.0, 319.5, 239.5)


def lens(focal_sd: float = 0.1, centre_sd_px: float = 0.0) -> EstimatedLens:
    return EstimatedLens(CAMERA, focal_sd, np.full(2, centre_sd_px), np.zeros(2), np.zeros(2))


def test_distance_is_proportional_to_the_focal_length() -> None:
    ahead = HeadPose(np.array([0.0, 0.0, 700.0]), FACING)
    np.testing.assert_allclose(np.sqrt(lens().variance(ahead)), [0.0, 0.0, 70.0, 0.0, 0.0, 0.0], atol=1e-9)


def test_a_face_at_the_side_turns_with_the_direction_of_its_ray() -> None:
    """With a focal length 10 % longer, a ray of 0.2 is one of 0.2 / 1.1."""
    aside = HeadPose(np.array([140.0, 0.0, 700.0]), FACING)
    about_y = math.sqrt(lens().variance(aside)[4])
    assert about_y == pytest.approx(math.atan(0.2) - math.atan(0.2 / 1.1), rel=0.15)


def test_a_principal_point_turns_the_head_and_moves_it() -> None:
    ahead = HeadPose(np.array([0.0, 0.0, 700.0]), FACING)
    sd = np.sqrt(lens(0.0, 20.0).variance(ahead))
    np.testing.assert_allclose(sd, [14.0, 14.0, 0.0, 0.02, 0.02, 0.0], atol=1e-9)


def test_confidence_falls_with_the_distance_from_the_usual_direction() -> None:
    usual = HeadPose(np.array([0.0, 0.0, 700.0]), FACING)
    turned = multiply(exponential(np.array([0.0, 0.6, 0.0])), FACING)
    aside = HeadPose(np.array([200.0, 0.0, 700.0]), turned)
    assert lens(0.4).share_right(usual) == pytest.approx(1.0)
    sd = math.degrees(0.4 * (200.0 / 700.0 + 0.6 * GAIN))
    # two-sided normal probability of 3 degrees
    assert lens(0.4).share_right(aside) == pytest.approx(math.erf(3.0 / sd / math.sqrt(2.0)), rel=0.02)
    assert lens(0.05).share_right(aside) > 0.99


def test_confidence_counts_a_turned_camera_only_for_a_turned_head() -> None:
    """Turning the camera by 6 degrees and the head by 0.6 rad in either order differs by 6 deg times 0.6."""
    px = 1000.0 * math.radians(6.0)
    usual, turned = (multiply(exponential(np.array([0.0, angle, 0.0])), FACING) for angle in (0.0, 0.6))
    shares = [lens(0.0, px).share_right(HeadPose(np.array([0.0, 0.0, 700.0]), q)) for q in (usual, turned)]
    assert shares[0] == pytest.approx(1.0)
    sd = math.sqrt(2.0) * 6.0 * 0.6  # both coordinates of the principal point
    assert shares[1] == pytest.approx(math.erf(3.0 / sd / math.sqrt(2.0)), rel=0.01)
