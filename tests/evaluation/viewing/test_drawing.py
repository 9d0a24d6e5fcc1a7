"""Points, bones and axes: where they are drawn, checked by projecting them."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.evaluation.viewing.drawing import (
    AXIS_COLOURS,
    AXIS_MM,
    Canvas,
    Shown,
    SkeletonDrawer,
)
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.model.anatomy import JOINT_PARENTS
from support.viewing import KINECT, open_hand, shown_pose

WHITE = (255, 255, 255)


def drawn(shown: Shown, drawer: SkeletonDrawer) -> np.ndarray:
    picture = np.zeros((KINECT.height, KINECT.width, 3), np.uint8)
    drawer.draw(Canvas(picture, KINECT), shown, WHITE)
    return picture


def pixel(point: np.ndarray) -> tuple[int, int]:
    """Row and column of a point, mm."""
    (x, y), _ = KINECT.pixels_from_points(point)
    return round(float(y)), round(float(x))


def test_points_and_the_middles_of_bones_are_covered() -> None:
    shown = shown_pose(open_hand())
    assert shown.points is not None
    picture = drawn(shown, SkeletonDrawer(JOINT_PARENTS, axes=False))
    for child, parent in enumerate(JOINT_PARENTS):
        assert picture[pixel(shown.points[child])].tolist() == [255, 255, 255]
        if parent >= 0:
            row, column = pixel(0.5 * (shown.points[child] + shown.points[parent]))
            assert (
                picture[row - 1 : row + 2, column - 1 : column + 2].max() > 120
            )  # of two pixels each has a half
    far = picture[:, : pixel(shown.points.min(axis=0))[1] - 20]
    assert not far.any(), "nothing is drawn elsewhere"


def test_axes_are_red_green_blue_and_point_where_the_pose_turns_them() -> None:
    quaternion = rotations.exponential(np.array([0.0, 0.0, 0.5]))
    origin = np.array([0.0, 0.0, 600.0])
    picture = drawn(Shown(position=origin, quaternion=quaternion), SkeletonDrawer())
    matrix = rotations.matrices_from_quaternions(quaternion)
    for axis in (0, 1):  # z runs away from the camera, nearly a point here
        at = pixel(origin + 0.7 * AXIS_MM * matrix[:, axis])
        assert picture[at].tolist() == list(AXIS_COLOURS[axis])
        assert not picture[pixel(origin - 0.7 * AXIS_MM * matrix[:, axis])].any()


def test_a_head_is_drawn_by_the_same_points_and_axes() -> None:
    """Ten points without bones, and a pose: what a head's result holds."""
    points = np.array([0.0, 0.0, 700.0]) + 40.0 * np.random.default_rng(1).standard_normal((10, 3))
    shown = Shown(np.array([0.0, 0.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(4), points)
    picture = drawn(shown, SkeletonDrawer((-1,) * 10, axes=False))
    assert all(picture[pixel(point)].all() for point in points)
    assert drawn(shown, SkeletonDrawer((-1,) * 10)).any(axis=2).sum() > picture.any(axis=2).sum()


@pytest.mark.parametrize(
    "points",
    [
        [[0.0, 0.0, -500.0], [10.0, 0.0, -500.0]],  # behind the camera
        [[9000.0, 0.0, 500.0], [9500.0, 0.0, 500.0]],  # beside the image
    ],
)
def test_what_is_not_in_the_image_is_not_drawn(points: list[list[float]]) -> None:
    assert not drawn(Shown(points=np.array(points)), SkeletonDrawer((-1, 0))).any()


def test_a_bone_that_reaches_behind_the_camera_is_left_out_and_no_number_overflows() -> None:
    points = np.array([[0.0, 0.0, 500.0], [10.0, 0.0, -500.0], [1e9, -1e9, 2.0]])
    picture = drawn(Shown(points=points), SkeletonDrawer((-1, 0, -1)))
    assert picture[pixel(points[0])].all()
    assert picture.any(axis=2).sum() < 50, "a dot only"


def test_what_is_not_known_is_not_drawn() -> None:
    assert not drawn(Shown(), SkeletonDrawer(JOINT_PARENTS)).any()
    assert not drawn(Shown(position=np.array([0.0, 0.0, 600.0])), SkeletonDrawer()).any()


# Text below pictures
