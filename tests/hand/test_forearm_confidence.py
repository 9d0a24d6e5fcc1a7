"""How sure a forearm is: by the area of it that readings explain, and that little of it says little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.evaluation.viewing.drawing import Canvas, Shown
from posetrack_cli.evaluation.viewing.hand_drawing import LABEL_COLOURS, HandDrawer
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.likelihood import RenderedCosts
from posetrack_cli.hand.fit.local_fits import FOREARM_CONFIDENCE
from posetrack_cli.hand.fit.skeleton import INNER_NUMBERS, inner_numbers, inner_of
from posetrack_cli.hand.model.forearm import (
    LEAST_CONFIDENCE,
    NEAR_MM,
    forearm_confidence,
    forearm_window,
    transforms_with_forearm,
)
from posetrack_cli.hand.model.hand import average_hand
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.hand.observe.segmentation import Label
from posetrack_cli.hand.start import NUMBER_NAMES, forearm_confidence_of
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.port import RenderingDevice, Window
from support.fitting import RIGHT
from support.hand import KINECT, random_poses
from support.hand_scene import WALL_MM, relaxed, tracker

CONFIG = HandConfig()
DOWN = np.array([0.1, 0.97, 0.2]) / np.linalg.norm([0.1, 0.97, 0.2])
POSE = relaxed(x=20.0, z=600.0)
FRAME_NS = 33_333_333


def with_arm(direction: FloatArray) -> FloatArray:
    """Inner numbers (6,) of a forearm as wide as the wrist lets expect."""
    return np.concatenate([direction / np.linalg.norm(direction), np.zeros(3)])


def drawn(device: RenderingDevice, inner: FloatArray) -> Float32Array:
    """What a perfect sensor sees of a hand and its forearm before a wall, mm."""
    renderer = device.depth_renderer(RIGHT.smooth_with_arm, (KINECT.width, KINECT.height), 1)
    bones = transforms_with_forearm(RIGHT.anatomy, POSE[None], inner)
    depth = renderer.depth(bones, KINECT, Window.whole(KINECT))[0]
    return np.where(depth > 0, depth, np.float32(WALL_MM))


def confidence(device: RenderingDevice, depth: Float32Array, inner: FloatArray) -> float:
    """That of a forearm in a depth image, whose camera is as high as the image."""
    camera = replace(KINECT, height=depth.shape[0])
    scorer = RenderedCosts(device, RIGHT, camera, CONFIG.observation, 1)
    observer = Observer(CONFIG, RIGHT.anatomy, camera, segment=True)
    return observer.forearm_confidence(depth, *scorer.forearm(POSE, inner))


# What it is


def test_it_is_the_share_of_the_drawn_area_that_readings_explain() -> None:
    """Twelve pixels of 10 mm x 10 mm each: five explained, two behind, one before, four without a reading."""
    arm = np.full((3, 4), 600.0, np.float32)
    readings = arm + np.array([[0, NEAR_MM, -NEAR_MM, 3], [-3, NEAR_MM + 1, 500, -NEAR_MM - 1], [0] * 4])
    readings[2] = 0.0
    span, inside = np.full((3, 4), 10.0), np.ones((3, 4), dtype=bool)
    found = forearm_confidence(arm, readings, inside, span, 0.2)
    assert found == pytest.approx(500.0 / (500.0 + 300.0 + 0.2 * 400.0 + 300.0))
    # what is outside the image, or hidden by the hand, does not count
    inside[1] = False
    arm[2] = 0.0
    assert forearm_confidence(arm, readings, inside, span, 0.2) == pytest.approx(400.0 / 700.0)
    assert forearm_confidence(arm, readings, np.zeros_like(inside), span, 0.2) == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_the_window_shows_all_of_the_forearm(seed: int) -> None:
    """Of a camera that looks at most of it from far enough: each of its points falls into the tile."""
    rng = np.random.default_rng(seed)
    (pose,) = random_poses(1, seed)
    inner, tile = with_arm(rng.standard_normal(3) * [1.0, 1.0, 0.5]), 64
    wrist = joint_positions(RIGHT.anatomy, pose[None])[0, 0]
    window = forearm_window(wrist, inner[:3], RIGHT.anatomy.scale, KINECT, tile)
    mesh, bones = RIGHT.smooth_with_arm, transforms_with_forearm(RIGHT.anatomy, pose[None], inner)
    arm = mesh.posed(bones.astype(np.float64))[0][len(RIGHT.smooth.vertices) :]
    a, b, c, d = window.tile_projection(KINECT)
    across, down = a * arm[:, 0] / arm[:, 2] + b, c * arm[:, 1] / arm[:, 2] + d
    assert min(across.min(), down.min()) > 0.0 and max(across.max(), down.max()) < tile
    assert window.step <= np.ceil(2.0 * max(np.ptp(across), np.ptp(down)) * window.step / tile)


# What it says of images


def test_a_forearm_that_is_seen_where_it_is_drawn_is_sure(device: RenderingDevice) -> None:
    inner = with_arm(DOWN)
    assert confidence(device, drawn(device, inner), inner) > 0.9


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)], ids=["in depth", "in the image"])
@pytest.mark.parametrize("turned_deg", [-35.0, 35.0])
def test_one_that_is_drawn_elsewhere_is_not(
    device: RenderingDevice, axis: tuple[float, float, float], turned_deg: float
) -> None:
    """The arm of CVAR's P4, frame 2: drawn beside the one that is seen, before a table."""
    turn = rotations.exponential(np.deg2rad(turned_deg) * np.array(axis))
    inner = with_arm(rotations.rotate(turn, DOWN))
    assert confidence(device, drawn(device, with_arm(DOWN)), inner) < LEAST_CONFIDENCE


def wrist_row() -> int:
    wrist = joint_positions(RIGHT.anatomy, POSE[None])[0, 0]
    return int(np.rint(KINECT.pixels_from_points(wrist[None])[0][0, 1]))


def test_one_that_is_not_seen_is_not_sure(device: RenderingDevice) -> None:
    """Cut off by the image's edge at the wrist, hidden by something in front of it, or without a reading."""
    inner, row = with_arm(DOWN), wrist_row()
    depth = drawn(device, inner)
    for hidden in (0.0, 400.0):
        changed = depth.copy()
        changed[row:] = hidden
        assert confidence(device, changed, inner) < 0.2
    assert confidence(device, depth[:row], inner) < 0.2
    assert confidence(device, depth[: row + 60], inner) > 0.8  # of which a part is seen


# Where it is stated, and what for


def test_a_tracker_states_it(device: RenderingDevice) -> None:
    """In a frame that shows a forearm; in one without readings there is none."""
    assert NUMBER_NAMES[: len(INNER_NUMBERS)] == INNER_NUMBERS and NUMBER_NAMES[-1] == FOREARM_CONFIDENCE
    config = HandConfig.model_validate({"filter": {"particles": 64}})
    following, rng = tracker(device, average_hand(), config), np.random.default_rng(0)
    depth = drawn(device, with_arm(DOWN))
    state = following.start(POSE, FRAME_NS, rng)
    state, estimate = following.step(state, Frame(1, 2 * FRAME_NS, (depth,)), rng)
    assert inner_of(estimate.numbers)[:3] @ DOWN > np.cos(np.deg2rad(15.0))
    assert 0.7 < forearm_confidence_of(estimate.numbers) < 1.0
    unseen = np.zeros_like(depth)
    _, estimate = following.step(state, Frame(2, 3 * FRAME_NS, (unseen,)), rng)
    assert np.isnan(forearm_confidence_of(estimate.numbers))


def numbers(confidence: float) -> FloatArray:
    signs = np.zeros(len(NUMBER_NAMES) - len(INNER_NUMBERS) - 1)
    return np.concatenate([inner_numbers(with_arm(DOWN)), signs, [confidence]])


@pytest.mark.parametrize(
    ("numbers", "is_drawn"),
    [
        (numbers(LEAST_CONFIDENCE), True),
        (numbers(LEAST_CONFIDENCE - 0.01), False),
        (numbers(0.9)[:-1], True),
        (numbers(0.1)[: len(INNER_NUMBERS)], True),
    ],
    ids=["sure", "doubtful", "of before", "of long before"],
)
@pytest.mark.parametrize("outline", [False, True])
def test_pictures_show_no_forearm_that_is_doubtful(
    device: RenderingDevice, numbers: FloatArray, is_drawn: bool, outline: bool
) -> None:
    shown = Shown(POSE[:3], POSE[3:7], POSE[7:], numbers=numbers)
    canvas = Canvas(np.zeros((KINECT.height, KINECT.width, 3), np.uint8), KINECT)
    drawer = HandDrawer(device, RIGHT)
    (drawer.outline if outline else drawer.draw)(canvas, shown, (200, 200, 200))
    orange = (canvas.picture == LABEL_COLOURS[Label.FOREARM]).all(axis=2)
    assert (np.count_nonzero(orange) > 50) == is_drawn
