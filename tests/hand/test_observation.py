"""What is looked at: pixels sampled one by one, and the window about the hand."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import ObservationSettings
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.observation import PixelSampler, everything, window_around
from posetrack_cli.rendering.port import Window
from support.hand import KINECT, REST

ANATOMY = make_anatomy()
windows = st.builds(
    Window,
    st.integers(-40, 90),
    st.integers(-40, 70),
    st.integers(1, 4),
    st.integers(1, 20),
    st.integers(1, 20),
)


@settings(deadline=None)
@given(windows)
def test_sampling_takes_single_pixels_and_zero_outside(window: Window) -> None:
    camera = Camera(64, 48, 90.0, 90.0, 31.5, 23.5)
    depth = (1.0 + np.arange(48 * 64)).reshape(48, 64).astype(np.float32)
    tile = PixelSampler(camera).sample(depth, window)
    for j in range(window.height):
        for i in range(window.width):
            u, v = window.left + i * window.step, window.top + j * window.step
            assert tile[j, i] == (depth[v, u] if 0 <= u < 64 and 0 <= v < 48 else 0.0)


DISTORTED = {
    "plumb_bob": Camera(512, 424, 365.0, 365.0, 255.5, 211.5, (0.09, -0.27, 0.004, -0.003, 0.1)),
    "fisheye": Camera(512, 424, 365.0, 365.0, 255.5, 211.5, (0.1, -0.05, 0.02, 0.01), "equidistant"),
}


@pytest.mark.parametrize("name", DISTORTED)
def test_a_distorted_image_is_looked_up_where_the_ray_arrives(name: str) -> None:
    # what each stored pixel shows: the plane z = 1000 + 400 x/z + 300 y/z along its ray, by OpenCV's inverse
    camera = DISTORTED[name]
    stored = np.stack(np.meshgrid(np.arange(512.0), np.arange(424.0)), axis=-1).reshape(-1, 1, 2)
    undistort = cv2.fisheye.undistortPoints if name == "fisheye" else cv2.undistortPoints
    rays = undistort(stored, camera.matrix, np.array(camera.distortion)).reshape(424, 512, 2)
    depth = (1000.0 + rays @ [400.0, 300.0]).astype(np.float32)
    window = Window(40, 30, 8, 54, 45)
    tile = PixelSampler(camera).sample(depth, window)
    u, v = np.meshgrid(window.columns(), window.rows())
    expected = 1000.0 + 400.0 * (u - camera.cx) / camera.fx + 300.0 * (v - camera.cy) / camera.fy
    # the nearest pixel is at most half a pixel off in both directions, stretched by 1.3 at most
    half_pixel_mm = 0.5 * 1.3 * (400.0 + 300.0) / 365.0
    seen = tile > 0
    assert seen.mean() > 0.9
    assert np.abs(tile - expected)[seen].max() < half_pixel_mm
    undistorted = PixelSampler(Camera(512, 424, 365.0, 365.0, 255.5, 211.5)).sample(depth, window)
    assert np.abs(undistorted - expected)[seen].max() > 4 * half_pixel_mm  # the distortion is there


def test_pixels_that_no_ray_reaches_are_zero() -> None:
    pincushion = Camera(64, 48, 60.0, 60.0, 31.5, 23.5, (0.4, 0.0, 0.0, 0.0))
    tile = PixelSampler(pincushion).sample(np.ones((48, 64), np.float32), Window.whole(pincushion))
    assert tile[24, 32] == 1.0
    assert tile[0, 0] == tile[-1, -1] == 0.0


@pytest.mark.parametrize(
    ("model", "distortion"),
    [("plumb_bob", (1e5, 1e6, 1e5, -1e5, 1e6)), ("equidistant", (1e6, -1e6, 1e6, -1e6))],
)
def test_a_distortion_that_leads_nowhere_reads_nothing_there(
    model: str, distortion: tuple[float, ...]
) -> None:
    """Warnings are errors in the tests: none about numbers that are no pixels."""
    camera = Camera(64, 48, 90.0, 90.0, 31.5, 23.5, distortion, model)
    tile = PixelSampler(camera).sample(np.ones((48, 64), np.float32), Window.whole(camera))
    assert set(np.unique(tile)) <= {0.0, 1.0} and not tile[0].any()


def joints_at(x: float, y: float, z: float) -> np.ndarray:
    joints = joint_positions(ANATOMY, REST[None])[0]
    return joints - joints.mean(axis=0) + [x, y, z]


@pytest.mark.parametrize("centre", [(0.0, 0.0, 650.0), (120.0, -80.0, 500.0), (-300.0, 200.0, 900.0)])
def test_the_window_spans_the_hand_at_its_depth(centre: tuple[float, float, float]) -> None:
    settings_ = ObservationSettings(tile_px=64, window_mm=240.0)
    window = window_around(joints_at(*centre), KINECT, settings_)
    flat = np.column_stack([joints_at(*centre)[:, :2], np.full(21, centre[2])])
    pixels, _ = KINECT.pixels_from_points(flat)
    assert np.abs(window.centre - 0.5 * (pixels.min(axis=0) + pixels.max(axis=0))).max() <= 0.5 + 1e-9
    assert (window.width, window.height) == (64, 64)
    size_px = 240.0 * 365.0 / centre[2]
    assert 0.8 * size_px <= window.step * 64 < 0.8 * size_px + 64  # the least whole step


def test_the_window_spans_all_of_a_hand_that_is_larger_or_nearer_than_its_settings_expect() -> None:
    joints = 1.3 * joints_at(0.0, 0.0, 300.0) * [1.0, 1.0, 1.0 / 1.3]
    window = window_around(joints, KINECT, ObservationSettings(tile_px=64, window_mm=150.0))
    pixels, _ = KINECT.pixels_from_points(np.column_stack([joints[:, :2], np.full(21, 300.0)]))
    assert (pixels.min(axis=0) > [window.left, window.top]).all()
    assert (pixels.max(axis=0) < [window.columns()[-1], window.rows()[-1]]).all()


def test_the_paper_s_window_is_128_pixels_at_any_depth() -> None:
    for z in (400.0, 650.0, 2000.0):
        window = window_around(joints_at(0, 0, z), KINECT, ObservationSettings(window_px=128, tile_px=64))
        assert (window.step, window.width) == (2, 64)
    window = window_around(joints_at(0, 0, 650.0), KINECT, ObservationSettings(window_px=128, tile_px=128))
    assert (window.step, window.width) == (1, 128)


@pytest.mark.parametrize("centre", [(0.0, 0.0, -300.0), (1e6, -1e6, 100.0), (0.0, 0.0, 0.0)])
def test_a_prediction_gone_astray_still_gives_a_window(centre: tuple[float, float, float]) -> None:
    window = window_around(joints_at(*centre), KINECT, ObservationSettings())
    tile = PixelSampler(KINECT).sample(np.ones((424, 512), np.float32), window)
    assert tile.shape == (64, 64)
    assert np.abs(window.centre).max() <= 4 * 512 + 1  # indices stay small, whatever the prediction


def test_a_prediction_in_the_sensor_itself() -> None:
    assert window_around(np.zeros((21, 3)), KINECT, ObservationSettings()).width == 64


def test_the_paper_s_observation_is_every_reading() -> None:
    tile = np.array([[0.0, 500.0], [900.0, 0.0]], dtype=np.float32)
    observation = everything(tile, Window(0, 0, 1, 2, 2))
    np.testing.assert_array_equal(observation.image, tile)
    assert observation.target_pixels == 2
