"""Images that belong to other cameras than they are said to."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.head.initialisation.average_face import exchanged_order, face_deviation
from support.rig import LEFT, face_pixels, right_camera, turned_head

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
    assert exchanged_order(cameras, faces) == ()
    assert exchanged_order(cameras, faces[::-1]) == (1, 0)


def test_converging_cameras_see_a_hollow_face_when_exchanged() -> None:
    cameras = (LEFT, right_camera(0.17))
    faces = face_pixels(cameras, turned_head(0.0, 0.0))
    assert face_deviation(cameras, faces) < 1e-6
    assert face_deviation(cameras, faces[::-1]) > 1.5


def test_without_a_face_in_every_image_nothing_is_said() -> None:
    cameras = (LEFT, right_camera(0.17))
    faces = face_pixels(cameras, turned_head())[::-1].copy()
    faces[1] = np.nan
    assert exchanged_order(cameras, faces) == ()
