"""Windows cut out of depth images: around a prediction, and around a hand that was detected."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.forearm import SEEN_MM
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.detection import Detection, detect
from posetrack_cli.hand.observe.observation import IGNORED, Observation
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.rendering.port import RenderingDevice, Window
from support.hand import KINECT
from support.hand_scene import HANDS, WALL_MM, Stage, relaxed

ANATOMY = HANDS["right"].anatomy
STEP = 4
PALM = np.array([40.0, -30.0, 700.0])
ARM = np.array([0.0, -1.0, 0.0])  # from the elbow, below, to the wrist


def observer(segment: bool = True) -> Observer:
    return Observer(HandConfig(), ANATOMY, KINECT, segment=segment)


def coarse(rows: FloatArray, columns: FloatArray) -> BoolArray:
    """A mask over every fourth pixel of the image: a disc of 45 mm about the palm."""
    x, y = ((columns - KINECT.cx) / KINECT.fx, (rows - KINECT.cy) / KINECT.fy)
    inside: BoolArray = np.hypot(PALM[2] * x - PALM[0], PALM[2] * y - PALM[1]) < 45.0
    return inside


def detection(wrist: FloatArray | None) -> Detection:
    window = Window(1, 2, STEP, KINECT.width // STEP, KINECT.height // STEP)
    mask = coarse(window.rows()[:, None], window.columns()[None])
    arm = None if wrist is None else ARM
    return Detection(window, mask, PALM, 45.0, wrist, arm, 60.0, 1.0, 0.0)


def limb() -> np.ndarray:
    """A plane at the palm's depth: disc and a broad arm below it, then wall; some pixels are not read."""
    depth = np.full((KINECT.height, KINECT.width), WALL_MM, dtype=np.float32)
    v, u = np.mgrid[: KINECT.height, : KINECT.width]
    depth[coarse(v, u)] = PALM[2]
    below = (PALM[2] * (v - KINECT.cy) / KINECT.fy > PALM[1]) & (
        np.abs(PALM[2] * (u - KINECT.cx) / KINECT.fx - PALM[0]) < 30
    )
    depth[below] = PALM[2]
    depth[::9] = 0.0
    return depth


def test_a_detected_hand_s_pixels_are_targets_and_its_forearm_says_nothing() -> None:
    wrist = PALM + np.array([0.0, 55.0, 0.0])
    depth = limb()
    found = observer().observe_detection(depth, detection(wrist))
    window = found.window
    rows, columns = window.rows()[:, None], window.columns()[None]
    tile = observer().sampler.sample(depth, window)
    middle = np.abs(coarse(rows, columns).astype(int))
    # the mask is known to its own step, and holes in it at its edge are not bridged: compare away from it
    edge = 2.0 * PALM[2] / KINECT.fx * STEP
    x, y = PALM[2] * (columns - KINECT.cx) / KINECT.fx, PALM[2] * (rows - KINECT.cy) / KINECT.fy
    radius = np.hypot(x - PALM[0], y - PALM[1])
    hand, read = radius < 45.0 - edge, tile > 0
    np.testing.assert_array_equal(found.image[hand & read], tile[hand & read])
    np.testing.assert_array_equal(found.image[~read], 0.0)
    assert found.target_pixels == np.count_nonzero(found.image > 0)
    assert abs(found.target_pixels - np.count_nonzero(middle & read)) < 0.15 * found.target_pixels
    beyond = (tile == PALM[2]) & (y > wrist[1] + 1.0) & (np.hypot(x - wrist[0], y - wrist[1]) < 155.0)
    assert beyond.sum() > 100
    np.testing.assert_array_equal(found.image[beyond], 0.0)
    wall = read & (radius > 45.0 + edge) & (tile == WALL_MM)
    np.testing.assert_array_equal(found.image[wall], -WALL_MM)
    before = (tile == PALM[2]) & (radius > 45.0 + edge) & (y < wrist[1] - 1.0)
    np.testing.assert_array_equal(found.image[before], -PALM[2])  # something else, not forearm


def test_without_a_forearm_all_that_is_no_hand_is_something_else() -> None:
    found = observer().observe_detection(limb(), detection(None))
    tile = observer().sampler.sample(limb(), found.window)
    np.testing.assert_array_equal(np.abs(found.image), tile)


def test_the_window_is_around_the_mask_and_as_large_as_around_a_pose() -> None:
    found = observer().observe_detection(limb(), detection(None)).window
    pixel = KINECT.pixels_from_points(PALM[None])[0][0]
    assert np.abs(found.centre - pixel).max() < STEP + found.step
    predicted = observer().observe(limb(), relaxed(z=float(PALM[2]))).window
    assert (found.width, found.step) == (predicted.width, predicted.step)


def test_a_mask_at_the_image_s_edge_is_cut_like_the_image() -> None:
    """Its window reaches over the edge, where nothing is read."""
    window = Window(0, 0, STEP, KINECT.width // STEP, KINECT.height // STEP)
    mask = np.zeros((window.height, window.width), dtype=bool)
    mask[:10, :10] = True
    palm = KINECT.points_from_pixels(np.array([16.0, 16.0]), np.asarray(600.0))
    depth = np.full((KINECT.height, KINECT.width), 600.0, dtype=np.float32)
    found = observer().observe_detection(
        depth, Detection(window, mask, palm, 30.0, None, None, 60.0, 1.0, 0.0)
    )
    outside = (found.window.rows()[:, None] < 0) | (found.window.columns()[None] < 0)
    assert outside.any()
    np.testing.assert_array_equal(found.image[outside], 0.0)
    assert found.target_pixels == pytest.approx((10 * STEP / found.window.step) ** 2, rel=0.15)


def test_a_prediction_s_window_holds_the_hand_and_all_readings_if_nothing_is_segmented(
    device: RenderingDevice,
) -> None:
    pose = relaxed()
    depth = Stage(device, HANDS["right"]).depth(pose)
    hand, everything = (observer(segment).observe(depth, pose) for segment in (True, False))
    drawn = observer().sampler.sample(depth, hand.window) < WALL_MM
    assert np.count_nonzero((hand.image > 0) ^ drawn) < 0.05 * drawn.sum()
    assert everything.target_pixels == everything.image.size
    pixels, _ = KINECT.pixels_from_points(joint_positions(ANATOMY, pose[None])[0])
    columns, rows = hand.window.columns(), hand.window.rows()
    assert (pixels.min(axis=0) > [columns[0], rows[0]]).all()
    assert (pixels.max(axis=0) < [columns[-1], rows[-1]]).all()


def test_a_detection_s_window_agrees_with_the_one_around_its_pose(device: RenderingDevice) -> None:
    pose = relaxed(-60.0, 10.0, 800.0)
    depth = Stage(device, HANDS["right"]).depth(pose)
    (found,) = detect(depth, KINECT, HandConfig().detection)
    seen = observer().observe_detection(depth, found)
    drawn = observer().sampler.sample(depth, seen.window) < WALL_MM
    assert np.count_nonzero((seen.image > 0) & drawn) > 0.8 * drawn.sum()
    assert not ((seen.image > 0) & ~drawn).any()


def test_a_detected_forearm_is_a_target_near_the_wrist_where_it_is_explained() -> None:
    """Up to ``SEEN_MM`` behind the wrist; beyond, nothing of the limb counts."""
    wrist, depth = PALM + np.array([0.0, 55.0, 0.0]), limb()
    with_arm = Observer(HandConfig(), ANATOMY, KINECT, segment=True, with_arm=True)
    found = with_arm.observe_detection(depth, detection(wrist))
    window = found.window
    tile = with_arm.sampler.sample(depth, window)
    x = PALM[2] * (window.columns()[None] - KINECT.cx) / KINECT.fx - wrist[0]
    y = PALM[2] * (window.rows()[:, None] - KINECT.cy) / KINECT.fy - wrist[1]
    arm = (tile == PALM[2]) & (np.abs(x) < 25.0)
    near, far = (arm & (y > low) & (y < high) for low, high in ((2.0, SEEN_MM - 2.0), (SEEN_MM + 2.0, 140.0)))
    assert near.sum() > 100
    np.testing.assert_array_equal(found.image[near], PALM[2])
    np.testing.assert_array_equal(found.image[far], IGNORED)
    np.testing.assert_allclose(found.inner, [0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    cut = observer().observe_detection(depth, detection(wrist))
    hand = cut.image > 0
    np.testing.assert_array_equal(found.image[hand], cut.image[hand])
    assert found.target_pixels == np.count_nonzero(found.image > 0) > cut.target_pixels


def test_fingers_count_before_the_wrist_alone() -> None:
    """Three strips 12 mm wide are thin, a disc of 45 mm is not; on the forearm's side they are no fingers."""
    window = Window(0, 0, 2, 64, 64)
    image = np.full((64, 64), -2000.0, dtype=np.float32)
    apart = 2.0 * 600.0 / KINECT.fx
    strips = np.zeros((64, 64), dtype=bool)
    for column in (20, 30, 40):
        strips[2:20, column : column + round(12.0 / apart)] = True
    rows, columns = np.mgrid[:64, :64]
    image[strips | (np.hypot(rows - 34, columns - 32) * apart < 45.0)] = 600.0
    wrist = KINECT.points_from_pixels(np.array([64.0, 100.0]), np.asarray(600.0))
    targets = int(np.count_nonzero(image > 0))
    area = np.count_nonzero(strips & (image > 0)) * apart**2
    up, down = np.array([0.0, -1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0, 0.0])
    fingers = [
        observer().fingers_mm2(Observation(window, image, targets, arm, wrist))
        for arm in (down, up, 0.0 * up)
    ]
    assert 0.7 * area < fingers[0] < 1.3 * area  # of a strip's end some is the disc's
    assert fingers[1] < 0.25 * area  # the disc's rim
    assert fingers[2] == pytest.approx(fingers[0] + fingers[1], rel=0.1)  # without a forearm all counts
    assert observer().fingers_mm2(Observation(window, np.zeros_like(image), 0)) == 0.0
