"""Parts of images: where their pixels and their points go."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.evaluation.viewing.drawing import (
    LEAST_ROWS,
    Viewport,
    around_points,
    largest_viewport,
    moved_to,
)
from posetrack_cli.geometry.camera import Camera
from support.viewing import KINECT, open_hand, shown_pose

viewports = st.builds(
    Viewport,
    left=st.integers(0, 200),
    top=st.integers(0, 200),
    width=st.integers(8, 300),
    height=st.integers(8, 200),
    scale=st.sampled_from([0.5, 1.0, 2.0, 3.0, 2.5]),
)


@given(viewport=viewports, where=st.tuples(st.floats(0, 0.999), st.floats(0, 0.999)))
def test_a_pixel_and_the_point_it_sees_go_to_the_same_place(
    viewport: Viewport, where: tuple[float, float]
) -> None:
    """The image says at each pixel which it is; the point behind a pixel must fall where it is shown."""
    columns, rows = np.meshgrid(np.arange(KINECT.width), np.arange(KINECT.height))
    pixel = np.floor([viewport.left + where[0] * viewport.width, viewport.top + where[1] * viewport.height])
    point = KINECT.points_from_pixels(pixel, np.array(650.0))
    (x, y), _ = viewport.camera(KINECT).pixels_from_points(point)
    assert -0.5 <= x <= viewport.size[0] - 0.5 and -0.5 <= y <= viewport.size[1] - 0.5
    at = min(round(float(y)), viewport.size[1] - 1), min(round(float(x)), viewport.size[0] - 1)
    shown = [viewport.cut(image.astype(np.float32))[at] for image in (columns, rows)]
    # a picture pixel spans 1 / scale image pixels, and nearest may take either neighbour of an edge
    np.testing.assert_allclose(shown, pixel, atol=max(1.0, 1.0 / viewport.scale))


def test_an_enlarged_pixel_is_a_block_centred_on_its_point() -> None:
    viewport = Viewport(100, 50, 40, 30, 4.0)
    image = np.zeros((KINECT.height, KINECT.width), np.float32)
    image[60, 110] = 1.0
    rows, columns = np.nonzero(viewport.cut(image))
    point = KINECT.points_from_pixels(np.array([110.0, 60.0]), np.array(500.0))
    (x, y), _ = viewport.camera(KINECT).pixels_from_points(point)
    assert (len(rows), rows.mean(), columns.mean()) == (16, pytest.approx(y), pytest.approx(x))


def test_the_whole_image_at_scale_one_is_the_image() -> None:
    viewport = Viewport.whole(KINECT)
    image = np.arange(KINECT.height * KINECT.width, dtype=np.float32).reshape(KINECT.height, -1)
    np.testing.assert_array_equal(viewport.cut(image), image)
    assert viewport.camera(KINECT) == KINECT


def test_a_distorted_camera_is_seen_through_a_pinhole() -> None:
    lens = Camera(512, 424, 365.0, 365.0, 255.5, 211.5, (0.1, -0.2, 0.0, 0.0, 0.05))
    assert not Viewport.whole(lens, 2.0).camera(lens).is_distorted


def test_around_points_lies_in_the_image_and_shows_them_all() -> None:
    for centre in ([0.0, 0.0, 650.0], [300.0, -250.0, 600.0], [-2000.0, 0.0, 500.0]):
        shown = shown_pose(open_hand(centre))
        viewport = around_points(shown.points, KINECT)
        assert viewport.left >= 0 and viewport.top >= 0 and viewport.width >= 1 and viewport.height >= 1
        assert viewport.left + viewport.width <= 512 and viewport.top + viewport.height <= 424
        pixels, _ = KINECT.pixels_from_points(shown.points)
        inside = (pixels >= 0).all(axis=1) & (pixels < [512, 424]).all(axis=1)
        low = [viewport.left, viewport.top]
        high = [viewport.left + viewport.width, viewport.top + viewport.height]
        assert ((pixels[inside] >= low) & (pixels[inside] <= high)).all()


def test_small_parts_are_enlarged_by_whole_numbers_unless_a_scale_is_given() -> None:
    shown = shown_pose(open_hand())
    usual = around_points(shown.points, KINECT).scaled(None)
    assert usual.scale == int(usual.scale) and LEAST_ROWS <= usual.size[1] < 2 * LEAST_ROWS
    assert around_points(shown.points, KINECT).scaled(0.5).scale == 0.5
    assert Viewport.whole(KINECT).scaled(None).scale == 1.0


def test_points_behind_the_camera_or_none_show_everything() -> None:
    behind = np.array([[0.0, 0.0, -100.0]])
    for points in (behind, np.empty((0, 21, 3))):
        assert around_points(points, KINECT) == Viewport.whole(KINECT)
    assert largest_viewport(np.empty((0, 21, 3)), KINECT) == Viewport.whole(KINECT)


def test_a_moved_viewport_keeps_its_size_and_stays_in_the_image() -> None:
    near, far = (shown_pose(open_hand([0.0, 0.0, z])).points for z in (500.0, 900.0))
    common = largest_viewport(np.stack([far, near]), KINECT)
    assert (common.width, common.height) == (lambda v: (v.width, v.height))(around_points(near, KINECT))
    for x in (-900.0, 0.0, 900.0):
        placed = moved_to(common, shown_pose(open_hand([x, 0.0, 900.0])).points, KINECT)
        assert (placed.width, placed.height) == (common.width, common.height)
        assert 0 <= placed.left <= 512 - placed.width and 0 <= placed.top <= 424 - placed.height
    middle = moved_to(common, far, KINECT)
    pixels, _ = KINECT.pixels_from_points(far)
    centre = 0.5 * (pixels.min(axis=0) + pixels.max(axis=0))
    assert abs(middle.left + 0.5 * middle.width - centre[0]) <= 1.0
