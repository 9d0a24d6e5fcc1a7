"""Many hands in one draw: each tile is what the hand alone gives, and the device's sums are numpy's."""

from __future__ import annotations

import moderngl
import numpy as np
import pytest

from posetrack_cli.errors import RenderingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.model.hand import hand_mesh
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.hand.start import scattered_poses
from posetrack_cli.rendering.gl import device as tiled
from posetrack_cli.rendering.gl.device import TiledDepthRenderer
from posetrack_cli.rendering.port import Comparison, RenderingDevice, TileSums, Window, sums_in_numpy
from support.rendering import CAMERA, STILL, moved, moved_a_subpixel, rigid, sphere

KINECT = Camera(512, 424, 365.0, 365.0, 255.5, 211.5)
MIDDLE = np.array([255.5, 211.5])
COUNT, SIZE = 512, 32
SUMS_RELATIVE = 1e-4
"""Float32 sums of a thousand terms below c_max, and depth 50 / (50 / z) with two roundings: 1e-5."""
COVERAGE_SHARE = 1e-3
DEPTH_MM, OTHER_SHARE = 0.1, 1e-4
"""Pixels on the edge between two triangles may show the other one, where skin lies behind skin by little:
2e-5 of all where corners are rounded to 1 / 256 of a pixel (an NVIDIA H100)."""


@pytest.fixture(scope="module")
def hands() -> np.ndarray:
    return skinning_transforms(
        make_anatomy(), scattered_poses(make_anatomy(), COUNT, np.random.default_rng(2))
    )


def window() -> Window:
    return Window.around(MIDDLE, SIZE, 4)


def renderer(device: RenderingDevice, most: int = COUNT) -> TiledDepthRenderer:
    return device.depth_renderer(hand_mesh(make_anatomy()), (SIZE, SIZE), most)


def observed_image(depth: np.ndarray) -> np.ndarray:
    """An image with target, other and missing readings in it."""
    rng = np.random.default_rng(8)
    image = np.where(depth > 0, depth + rng.normal(0.0, 15.0, depth.shape), -900.0)
    kind = rng.random(depth.shape)
    image = np.where(kind < 0.2, -image, image)
    return np.where(kind > 0.8, 0.0, image).astype(np.float32)


def check_sums(found: TileSums, expected: TileSums) -> None:
    for name in ("both", "rendered_only", "unread"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    np.testing.assert_allclose(found.error, expected.error, rtol=SUMS_RELATIVE, atol=1e-3)
    assert found.observed == expected.observed


def test_each_of_512_tiles_is_the_hand_drawn_alone(device: RenderingDevice, hands: np.ndarray) -> None:
    together = renderer(device).depth(hands, KINECT, window())
    single = renderer(device, 1)
    assert single.capacity == 1
    alone = np.concatenate([single.depth(hands[k : k + 1], KINECT, window()) for k in range(COUNT)])
    assert together.shape == (COUNT, SIZE, SIZE)
    different = (together > 0) != (alone > 0)
    assert different.mean() <= COVERAGE_SHARE
    apart = (np.abs(together - alone) > DEPTH_MM + moved_a_subpixel(alone))[~different]
    assert apart.mean() < OTHER_SHARE
    assert (together > 0).sum(axis=(1, 2)).min() > 100  # there is something to compare in every tile


@pytest.mark.parametrize("pixels", [5 * SIZE * SIZE, SIZE * SIZE, 1])
def test_an_atlas_too_small_for_all_is_drawn_in_passes(
    device: RenderingDevice, hands: np.ndarray, monkeypatch: pytest.MonkeyPatch, pixels: int
) -> None:
    some = hands[:23]
    at_once = renderer(device, 23)
    monkeypatch.setattr(tiled, "ATLAS_PIXELS", pixels)
    small = renderer(device, 23)
    assert small.capacity < 23 <= at_once.capacity
    expected = at_once.depth(some, KINECT, window())
    np.testing.assert_allclose(small.depth(some, KINECT, window()), expected, atol=DEPTH_MM)
    image = observed_image(expected[0])
    found = small.sums(some, KINECT, window(), Comparison(image, 40.0))
    check_sums(found, sums_in_numpy(small.depth(some, KINECT, window()), Comparison(image, 40.0)))


@pytest.mark.parametrize("clamp", [10.0, 40.0])
def test_sums_on_the_device_are_those_in_numpy(
    device: RenderingDevice, hands: np.ndarray, clamp: float
) -> None:
    drawing = renderer(device, 100)
    depth = drawing.depth(hands[:100], KINECT, window())
    image = observed_image(depth[3])
    expected = sums_in_numpy(depth, Comparison(image, clamp))
    for sums in (expected.both, expected.rendered_only, expected.unread, expected.error):
        assert sums.min() > 0  # all four sums have something in them
    assert expected.both[0] * clamp > expected.error[0]  # and the clamp does not hold everywhere
    check_sums(drawing.sums(hands[:100], KINECT, window(), Comparison(image, clamp)), expected)


def test_depths_that_agree_are_counted_alike_on_the_device(
    device: RenderingDevice, hands: np.ndarray
) -> None:
    drawing = renderer(device, 100)
    depth = drawing.depth(hands[:100], KINECT, window())
    image = observed_image(depth[3])
    expected = sums_in_numpy(depth, Comparison(image, 40.0, match_mm=10.0)).matched
    found = drawing.sums(hands[:100], KINECT, window(), Comparison(image, 40.0, match_mm=10.0))
    np.testing.assert_allclose(found.matched, expected, atol=2.0)  # a difference of 10 mm but for rounding
    assert expected.min() > 0 and (found.matched < found.both).all()
    pixels = (zip(one.flat, image.flat, strict=True) for one in depth[:3])
    by_loop = [sum(d > 0 and y > 0 and abs(d - y) < 10.0 for d, y in pairs) for pairs in pixels]
    assert expected[:3].tolist() == by_loop
    assert not drawing.sums(hands[:100], KINECT, window(), Comparison(image, 40.0)).matched.any()


def test_sums_in_numpy_against_a_loop_over_pixels() -> None:
    rng = np.random.default_rng(0)
    depth = rng.choice([0.0, 500.0, 520.0], (3, 4, 5)).astype(np.float32)
    image = rng.choice([0.0, -900.0, 505.0, 600.0], (4, 5)).astype(np.float32)
    found = sums_in_numpy(depth, Comparison(image, 40.0))
    for n in range(3):
        error = both = other = unread = 0.0
        for d, y in zip(depth[n].ravel(), image.ravel(), strict=True):
            if d > 0 and y > 0:
                error, both = error + min(abs(d - y), 40.0), both + 1
            elif d > 0:
                other, unread = other + (y < 0), unread + (y == 0)
        row = (found.error[n], found.both[n], found.rendered_only[n], found.unread[n])
        assert row == (error, both, other, unread)
    assert found.observed == (image > 0).sum()


def test_tiles_that_are_not_square(device: RenderingDevice) -> None:
    ball = sphere(50.0, 4)
    wide = device.depth_renderer(ball, (40, 13), 7)
    seen = Window(5, 11, 1, 40, 13)
    depth = wide.depth(moved(*[(8.0 * k - 20.0, 0.0, 400.0) for k in range(7)]), CAMERA, seen)
    whole = device.depth_renderer(ball, (64, 48), 7)
    full = whole.depth(moved(*[(8.0 * k - 20.0, 0.0, 400.0) for k in range(7)]), CAMERA, Window.whole(CAMERA))
    part = full[:, 11:24, 5:45]
    assert (part > 0).any()
    assert ((depth > 0) != (part > 0)).sum() <= 2  # a ray along the silhouette
    both = (depth > 0) & (part > 0)
    np.testing.assert_allclose(depth[both], part[both], atol=DEPTH_MM)
    image = observed_image(depth[3])
    expected = sums_in_numpy(depth, Comparison(image, 40.0))
    offsets = moved(*[(8.0 * k - 20.0, 0.0, 400.0) for k in range(7)])
    check_sums(wide.sums(offsets, CAMERA, seen, Comparison(image, 40.0)), expected)


@pytest.mark.parametrize(
    "offset",
    [
        (90.0, 0.0, 400.0),
        (-90.0, 0.0, 400.0),
        (0.0, 65.0, 400.0),
        (0.0, -65.0, 400.0),
        (0.0, 0.0, 60.0),  # partly behind the sensor, larger than the tile
    ],
)
def test_nothing_leaks_into_neighbouring_tiles(
    device: RenderingDevice, offset: tuple[float, float, float]
) -> None:
    # the middle one of nine tiles is drawn half outside, the others are far behind the sensor: empty
    away = (0.0, 0.0, -1e4)
    offsets = moved(*[offset if k == 4 else away for k in range(9)])
    square = Camera(48, 48, 90.0, 90.0, 23.5, 23.5)
    drawing = device.depth_renderer(sphere(50.0, 3), (48, 48), 9)
    assert drawing.grid[0] > 2  # there are tiles on all sides
    assert drawing.grid[1] > 2
    depth = drawing.depth(offsets, square, Window.whole(square))
    if offset[2] > 100.0:
        assert 0 < (depth[4] > 0).sum() < depth[4].size
    assert not np.delete(depth, 4, axis=0).any()


def test_a_tile_larger_than_any_texture_is_refused(device: RenderingDevice) -> None:
    with pytest.raises(RenderingError, match="tile is too large for this GL, found"):
        device.depth_renderer(sphere(50.0, 1), (1 << 20, 16), 1)


def test_a_thousand_flat_tiles_are_drawn_alike(device: RenderingDevice) -> None:
    drawing = device.depth_renderer(sphere(50.0, 1), (1000, 1), 1000)
    seen = Window(-468, 24, 1, 1000, 1)
    depth = drawing.depth(np.tile(moved((0, 0, 400)), (1000, 1, 1, 1)), CAMERA, seen)
    assert (depth[0] > 0).any()
    np.testing.assert_allclose(depth, np.broadcast_to(depth[0], depth.shape), atol=DEPTH_MM)


@pytest.mark.parametrize("tile", [(512, 64), (1000, 1), (64, 512)])
def test_a_single_long_tile(device: RenderingDevice, tile: tuple[int, int]) -> None:
    drawing = device.depth_renderer(sphere(50.0, 1), tile, 1)
    assert drawing.grid == (1, 1)
    centre = Window.around(np.array([CAMERA.cx, CAMERA.cy]), 1, 1)
    seen = Window(centre.left - tile[0] // 2, centre.top - tile[1] // 2, 1, *tile)
    assert drawing.depth(moved((0, 0, 400)), CAMERA, seen)[0, tile[1] // 2, tile[0] // 2] > 0


def test_drawing_twice_gives_the_same_bytes(device: RenderingDevice, hands: np.ndarray) -> None:
    drawing = renderer(device, 64)
    image = observed_image(drawing.depth(hands[:1], KINECT, window())[0])
    first = drawing.sums(hands[:64], KINECT, window(), Comparison(image, 40.0))
    drawing.depth(hands[64:70], KINECT, window())  # fewer tiles, other poses in between
    second = drawing.sums(hands[:64], KINECT, window(), Comparison(image, 40.0))
    np.testing.assert_array_equal(first.error, second.error)
    np.testing.assert_array_equal(first.both, second.both)


def test_still_is_the_identity() -> None:
    mesh = rigid(np.eye(3), np.array([[0, 1, 2]]))
    np.testing.assert_array_equal(mesh.posed(STILL[None, None])[0], np.eye(3))


def test_what_the_device_refuses_is_one_line(
    device: RenderingDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a GPU without free memory does."""

    def refuse(self: TiledDepthRenderer) -> None:
        raise moderngl.Error("the framebuffer is not complete\n(UNSUPPORTED)")

    monkeypatch.setattr(TiledDepthRenderer, "_make_targets", refuse)
    with pytest.raises(RenderingError, match=r"not complete \(UNSUPPORTED\); free GPU memory"):
        device.depth_renderer(sphere(10.0, 0), (SIZE, SIZE))
