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
    caption,
)
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.anatomy import JOINT_PARENTS
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


WORDS = ["frame 12", "0.400 s", "tracking", "confidence 0.75"]


def written(picture: np.ndarray) -> np.ndarray:
    """Which columns have writing."""
    return (picture.max(axis=2) > 100).any(axis=0)


def test_pictures_of_one_width_are_equally_high() -> None:
    few, many = caption([(["a"], WHITE)], 300), caption([(WORDS * 3, WHITE)], 300)
    assert few.shape == many.shape == (18, 300, 3)
    assert caption([(WORDS, WHITE), (WORDS, WHITE)], 300).shape == (36, 300, 3)


def test_long_lines_shrink_until_they_fit() -> None:
    wide, narrow = caption([(WORDS, WHITE)], 800), caption([(WORDS, WHITE)], 290)
    length = np.flatnonzero(written(wide)).max()
    assert 290 < length < 500
    assert np.flatnonzero(written(narrow)).max() < 290, "nothing touches the edge"


def test_colours_are_those_asked_for_line_by_line() -> None:
    picture = caption([(["one"], (255, 0, 0)), (["two"], (0, 0, 255))], 200).astype(int)
    first, second = picture[:18].max(axis=(0, 1)), picture[18:].max(axis=(0, 1))
    assert first[0] > 200 and first[2] < 100 and second[2] > 200 and second[0] < 100


def test_letters_that_the_font_lacks() -> None:
    np.testing.assert_array_equal(caption([(["résumé"], WHITE)], 200), caption([(["resume"], WHITE)], 200))
    np.testing.assert_array_equal(caption([(["手"], WHITE)], 200), caption([(["?"], WHITE)], 200))


def test_no_words_are_no_writing() -> None:
    assert not written(caption([([], WHITE)], 100)).any()
