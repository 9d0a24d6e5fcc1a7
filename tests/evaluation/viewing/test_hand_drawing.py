"""Hands drawn by the renderer: where their skin falls, and which hand a run record describes."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.evaluation.viewing.drawing import Canvas, Shown, Viewport, around_points
from posetrack_cli.evaluation.viewing.hand_drawing import HandDrawer
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.model.anatomy import JOINT_NAMES, make_anatomy
from posetrack_cli.hand.model.hand import average_hand
from posetrack_cli.hand.model.kinematics import mirrored_poses
from posetrack_cli.rendering.port import RenderingDevice
from support.viewing import KINECT, open_hand, shown_pose

SKIN = (150, 200, 235)
GREEN = (0, 255, 0)


def painted(
    device: RenderingDevice,
    shown: Shown,
    *,
    camera: Camera = KINECT,
    side: str = "right",
    outline: bool = False,
) -> np.ndarray:
    picture = np.zeros((camera.height, camera.width, 3), np.uint8)
    drawer = HandDrawer(device, average_hand(side))
    (drawer.outline if outline else drawer.draw)(Canvas(picture, camera), shown, GREEN if outline else SKIN)
    return picture


@pytest.mark.parametrize("centre", [(0.0, 0.0, 650.0), (120.0, -60.0, 500.0)])
def test_the_drawn_hand_covers_its_joints(
    device: RenderingDevice, centre: tuple[float, float, float]
) -> None:
    shown = shown_pose(open_hand(centre))
    assert shown.points is not None
    picture = painted(device, shown)
    pixels, _ = KINECT.pixels_from_points(shown.points)
    for name, (x, y) in zip(JOINT_NAMES, np.rint(pixels).astype(int), strict=True):
        if not name.endswith("_tip"):  # a tip is a point of the skin's edge
            assert picture[y, x].any(), name
    assert not picture[:, : int(pixels[:, 0].min()) - 30].any()


def test_an_enlarged_part_shows_the_same_hand(device: RenderingDevice) -> None:
    """Every pixel of the picture at scale one is a block of the enlarged one, but for the hand's edge."""
    shown = shown_pose(open_hand())
    viewport = around_points(shown.points, KINECT).scaled(3.0)
    plain = painted(device, shown).any(axis=2).astype(np.uint8)
    fine = painted(device, shown, camera=viewport.camera(KINECT)).any(axis=2)
    agree = (viewport.cut(plain) > 0) == fine
    edge = 3.0 * 4 * np.sqrt(plain.sum())  # pixels of an outline are of the order of the root of its area
    assert (~agree).sum() < 3.0 * edge


def test_a_left_hand_is_the_mirror_image_of_a_right_one(device: RenderingDevice) -> None:
    pose = open_hand((60.0, 20.0, 600.0))
    right = painted(device, shown_pose(pose)).any(axis=2)
    left_pose = mirrored_poses(pose[None])[0]
    left = painted(device, shown_pose(left_pose, make_anatomy("left")), side="left").any(axis=2)
    # 255.5 is the middle of 512 columns: a mirrored scene gives a mirrored image but for rounding at edges
    assert (left != right[:, ::-1]).sum() < 0.01 * right.sum()
    assert (left != right).sum() > 0.5 * right.sum()


def test_an_outline_leaves_the_inside_as_it_was(device: RenderingDevice) -> None:
    shown = shown_pose(open_hand())
    filled, line = painted(device, shown).any(axis=2), painted(device, shown, outline=True)
    on_line = line.any(axis=2)
    assert (on_line <= filled).all() and 0 < on_line.sum() < 0.25 * filled.sum()
    assert (line[on_line] == GREEN).all()


def test_without_a_pose_the_skeleton_stands_in(device: RenderingDevice) -> None:
    shown = shown_pose(open_hand())
    joints_only = Shown(points=shown.points)
    for outline in (False, True):
        picture = painted(device, joints_only, outline=outline)
        assert 0 < picture.any(axis=2).sum() < 0.5 * painted(device, shown).any(axis=2).sum()
    assert not painted(device, Shown()).any()


@pytest.mark.parametrize("position", [(0.0, 0.0, -600.0), (5000.0, 0.0, 600.0)])
def test_a_hand_outside_the_image_is_not_drawn(
    device: RenderingDevice, position: tuple[float, float, float]
) -> None:
    assert not painted(device, shown_pose(open_hand(position))).any()


def test_pictures_of_changing_size(device: RenderingDevice) -> None:
    drawer = HandDrawer(device, average_hand())
    shown = shown_pose(open_hand())
    for scale in (1.0, 0.5, 2.0):
        camera = Viewport.whole(KINECT, scale).camera(KINECT)
        depth = drawer.depth(camera, shown)
        assert depth is not None and depth.shape == (camera.height, camera.width)
        assert abs(depth[depth > 0].mean() - 650.0) < 30.0
