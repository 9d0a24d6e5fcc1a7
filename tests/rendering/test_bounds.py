"""Boxes around posed meshes: nothing that is drawn may lie outside, and they must spare something."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.model.hand import hand_mesh, inside_limits
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.hand.start import rest_pose
from posetrack_cli.rendering.gl.device import NEAR_MM, BoneSpheres
from posetrack_cli.rendering.port import RenderingDevice, Window
from posetrack_cli.tracking.velocity import BodySpace

CAMERA = Camera(512, 424, 365.0, 365.0, 255.5, 211.5)
TILE = 48


def random_poses(centre: tuple[float, float, float], spread_mm: float, count: int = 64) -> np.ndarray:
    rng = np.random.default_rng(5)
    start = np.tile(rest_pose(make_anatomy(), np.array(centre)), (count, 1))
    sd = np.concatenate([np.full(3, spread_mm), np.full(3, 1.5), np.full(15, 0.8)])
    return inside_limits(BodySpace().retract(start, sd * rng.standard_normal((count, 21))))


def pixel_box(drawn: np.ndarray) -> tuple[int, int, int, int]:
    rows, columns = np.nonzero(drawn)
    return columns.min(), rows.min(), columns.max() + 1, rows.max() + 1


@pytest.mark.parametrize(
    ("centre", "spread_mm"),
    [((0.0, 0.0, 650.0), 15.0), ((60.0, -80.0, 650.0), 60.0), ((0.0, 0.0, 130.0), 60.0)],
    ids=["in the tile", "half out of it", "through the near plane"],
)
def test_everything_drawn_lies_in_its_box(
    device: RenderingDevice, centre: tuple[float, float, float], spread_mm: float
) -> None:
    mesh, poses = hand_mesh(make_anatomy()), random_poses(centre, spread_mm)
    transforms = skinning_transforms(make_anatomy(), poses)
    window = Window.around(np.array([CAMERA.cx, CAMERA.cy]), TILE, 3)
    drawn = device.depth_renderer(mesh, (TILE, TILE), len(poses)).depth(transforms, CAMERA, window) > 0
    projection = window.tile_projection(CAMERA)
    boxes = BoneSpheres(mesh).tile_boxes(transforms, projection, (TILE, TILE), NEAR_MM)
    assert drawn.any(axis=(1, 2)).sum() > 10  # enough that the comparison means something
    for image, (left, top, right, bottom) in zip(drawn, boxes, strict=True):
        if image.any():
            first_column, first_row, past_column, past_row = pixel_box(image)
            assert left <= first_column and top <= first_row
            assert right >= past_column and bottom >= past_row


def test_boxes_spare_a_third_of_the_window_of_an_open_hand() -> None:
    """Hand 180 mm long and 130 broad with its thumb, window 256 mm: a third of it is all there is to cover;
    spheres round that up, but not to the double."""
    anatomy = make_anatomy()
    pose = rest_pose(anatomy, np.array([0.0, 0.0, 650.0]))
    window = Window.around(np.array([CAMERA.cx, CAMERA.cy]), TILE, 3)
    boxes = BoneSpheres(hand_mesh(anatomy)).tile_boxes(
        skinning_transforms(anatomy, pose[None]), window.tile_projection(CAMERA), (TILE, TILE), NEAR_MM
    )
    left, top, right, bottom = boxes[0]
    assert (right - left) * (bottom - top) < 2.0 / 3.0 * TILE**2
