"""The thumb's inner angles: found in images, written, and used by all that draws a result."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.evaluation.viewing.drawing import Shown
from posetrack_cli.evaluation.viewing.hand_drawing import HandDrawer
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.fitter import HandFitter, PosePrior
from posetrack_cli.hand.fit.gauss_newton import STIFF_THUMB, ThumbPrior
from posetrack_cli.hand.fit.skeleton import (
    NO_INNER,
    NO_THUMB,
    RELAXED_INNER,
    THUMB,
    inner_numbers,
    inner_of,
    thumbs_of,
)
from posetrack_cli.hand.model.anatomy import JOINT_NAMES
from posetrack_cli.hand.model.kinematics import joint_positions, mirrored_poses, skinning_transforms
from posetrack_cli.hand.run import make_tracker
from posetrack_cli.hand.start import NUMBER_NAMES
from posetrack_cli.hand.tracker import THUMB_MEMORY
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.port import RenderingDevice, Window
from support.fitting import HANDS, TILE_PX, observed
from support.hand import KINECT, random_poses
from support.hand_scene import WALL_MM, relaxed

FREE = 1.0 / np.square(np.repeat([60.0, 0.8, 0.7], [3, 3, 15]))
"""(21,) a prior that holds next to nothing."""
LOOSE = ThumbPrior(1.0 / np.square(np.array([0.7, 0.7])), rests=True)
"""The same of the thumb's inner angles."""
BENT, ASIDE = np.array([0.4, 0.0]), np.array([0.0, 0.35])
THUMBS = pytest.mark.parametrize("thumb", [BENT, ASIDE, -ASIDE], ids=["bent", "aside", "inwards"])
FRAME_NS = 33_333_333
FEW = HandConfig.model_validate({"filter": {"particles": 64}})
each_hand = pytest.mark.parametrize("name", list(HANDS))


def with_thumb(thumb: FloatArray) -> FloatArray:
    inner = NO_INNER.copy()
    inner[THUMB] = thumb
    return inner


def shown_thumb(name: str) -> FloatArray:
    """A hand (22,) whose thumb is seen well, not mirrored: a left hand shows its palm like a right one."""
    pose = relaxed(x=20.0, z=600.0)
    pose[7:10] = -0.1, 0.3, 0.3
    return pose if name == "right" else mirrored_poses(pose[None])[0]


def depth_of(device: RenderingDevice, pose: FloatArray, thumb: FloatArray) -> Float32Array:
    """What a perfect sensor sees of the right hand before a wall (424, 512), mm."""
    hand = HANDS["right"]
    renderer = device.depth_renderer(hand.smooth, (KINECT.width, KINECT.height), 1)
    transforms = skinning_transforms(hand.anatomy, pose[None], thumb)
    drawn = renderer.depth(transforms, KINECT, Window.whole(KINECT))[0]
    return np.where(drawn > 0, drawn, np.float32(WALL_MM))


@each_hand
@THUMBS
def test_a_thumb_that_no_pose_has_is_found(name: str, thumb: FloatArray) -> None:
    """With its inner angles, and so with its tip where it is, if they are held as loosely as all others."""
    hand, truth = HANDS[name], shown_thumb(name)
    fitter = HandFitter(hand, KINECT, TILE_PX, thumb=LOOSE)
    tile = fitter.tile(observed(hand, fitter, truth, inner=with_thumb(thumb)))
    found = fitter.descend(tile, truth[None], [PosePrior(truth, FREE)], 20)[0]
    np.testing.assert_allclose(found.inner[THUMB], thumb, atol=np.deg2rad(8.0))
    true = joint_positions(hand.anatomy, truth[None], thumb)[0]
    joints = joint_positions(hand.anatomy, found.pose[None], found.inner[THUMB])[0]
    still = joint_positions(hand.anatomy, truth[None])[0]
    assert np.linalg.norm(still[4] - true[4]) > 6.0
    assert np.linalg.norm(joints[2:5] - true[2:5], axis=1).max() < 2.5


def test_a_stiff_thumb_keeps_what_is_expected_of_it() -> None:
    """A hand whose side and size are in question has no inner angles; its fits are those of 22 numbers."""
    hand, truth = HANDS["right"], shown_thumb("right")
    fitter = HandFitter(hand, KINECT, TILE_PX, thumb=STIFF_THUMB)
    tile = fitter.tile(observed(hand, fitter, truth, inner=with_thumb(ASIDE)))
    found = fitter.descend(tile, truth[None], [PosePrior(truth, FREE)], 20)[0]
    np.testing.assert_allclose(found.inner[THUMB], 0.0, atol=1e-5)
    free = HandFitter(hand, KINECT, TILE_PX).descend(tile, truth[None], [PosePrior(truth, FREE)], 20)[0]
    assert free.cost[0] < 0.8 * found.cost[0]


def test_what_a_thumb_differs_by_from_a_relaxed_one_is_expected_of_the_next_frame_in_part(
    device: RenderingDevice,
) -> None:
    """It stays where nothing is seen; the estimate then has what is expected."""
    hand, truth = HANDS["right"], shown_thumb("right")
    tracker, rng = make_tracker(FEW, hand, KINECT, device), np.random.default_rng(0)
    state = tracker.start(truth, FRAME_NS, rng)
    np.testing.assert_array_equal(state.expected, RELAXED_INNER)
    seen = depth_of(device, truth, ASIDE)
    state, estimate = tracker.step(state, Frame(1, 2 * FRAME_NS, (seen,)), rng)
    found, at_rest = inner_of(estimate.numbers)[THUMB], RELAXED_INNER[THUMB]
    np.testing.assert_allclose(state.expected[THUMB], at_rest + THUMB_MEMORY * (found - at_rest))
    assert np.abs(state.expected[THUMB]).max() > 0.1
    after, estimate = tracker.step(state, Frame(2, 3 * FRAME_NS, (np.zeros_like(seen),)), rng)
    np.testing.assert_array_equal(after.expected, state.expected)
    np.testing.assert_array_equal(inner_of(estimate.numbers)[THUMB], state.expected[THUMB])


def test_a_left_hand_is_a_right_one_in_a_mirror() -> None:
    rng = np.random.default_rng(1)
    for pose in random_poses(10, 5):
        thumb = 0.3 * rng.standard_normal(2)
        right = joint_positions(HANDS["right"].anatomy, pose[None], thumb)
        left = joint_positions(HANDS["left"].anatomy, mirrored_poses(pose[None]), thumb)
        np.testing.assert_allclose(left * [-1.0, 1.0, 1.0], right, atol=1e-9)


def test_each_angle_moves_what_lies_beyond_its_joint() -> None:
    anatomy, pose = HANDS["right"].anatomy, relaxed()[None]
    before = joint_positions(anatomy, pose)[0]
    bent, aside = (joint_positions(anatomy, pose, thumb)[0] for thumb in (BENT, ASIDE))
    assert {JOINT_NAMES[k] for k in np.flatnonzero(np.any(bent != before, axis=1))} == {"thumb_tip"}
    assert {JOINT_NAMES[k] for k in np.flatnonzero(np.any(aside != before, axis=1))} == {
        "thumb_ip",
        "thumb_tip",
    }
    one = np.concatenate([joint_positions(anatomy, pose, thumb) for thumb in (BENT, ASIDE)])
    both = joint_positions(anatomy, np.repeat(pose, 2, axis=0), np.stack([BENT, ASIDE]))
    np.testing.assert_allclose(both, one, atol=1e-9)


def test_inner_numbers_are_read_as_they_are_written() -> None:
    inner = np.array([0.6, -0.8, 0.0, 0.1, 0.3, -0.2])
    np.testing.assert_allclose(inner_of(inner_numbers(inner)), inner)
    alone = with_thumb(BENT)
    assert np.isnan(inner_numbers(alone)[:4]).all()
    np.testing.assert_array_equal(inner_of(inner_numbers(alone)), alone)
    older = inner_numbers(inner)[:4]
    np.testing.assert_allclose(inner_of(older), [*inner[:4], 0.0, 0.0])
    for unknown in (None, np.empty(0), np.full(6, np.nan)):
        np.testing.assert_array_equal(inner_of(unknown), NO_INNER)
    np.testing.assert_array_equal(thumbs_of(None, 3), np.zeros((3, 2)))
    np.testing.assert_array_equal(thumbs_of(np.ones((3, 4)), 3), np.zeros((3, 2)))


def test_a_tracker_states_the_thumb_that_it_sees(device: RenderingDevice) -> None:
    """Its joints are those of pose and inner angles together."""
    hand, truth = HANDS["right"], shown_thumb("right")
    depth = depth_of(device, truth, ASIDE)
    tracker, rng = make_tracker(FEW, hand, KINECT, device), np.random.default_rng(0)
    state = tracker.start(truth, FRAME_NS, rng)
    for k in range(1, 5):
        state, estimate = tracker.step(state, Frame(k, k * FRAME_NS + FRAME_NS, (depth,)), rng)
    assert estimate.numbers is not None and len(estimate.numbers) == len(NUMBER_NAMES)
    thumb = inner_of(estimate.numbers)[THUMB]
    np.testing.assert_allclose(thumb, ASIDE, atol=np.deg2rad(8.0))
    pose = np.concatenate([estimate.position, estimate.quaternion, estimate.shape])
    np.testing.assert_array_equal(estimate.points, joint_positions(hand.anatomy, pose[None], thumb)[0])
    true = joint_positions(hand.anatomy, truth[None], ASIDE)[0]
    assert np.linalg.norm(estimate.points[4] - true[4]) < 4.0


def test_what_is_shown_has_its_thumb(device: RenderingDevice) -> None:
    """The silhouette that ``view`` draws is that of the inner angles; an older result has none."""
    hand, pose = HANDS["right"], shown_thumb("right")
    drawer = HandDrawer(device, hand)
    parts = {"position": pose[:3], "quaternion": pose[3:7], "shape": pose[7:]}
    depths = {}
    for name, numbers in (
        ("none", None),
        ("older", inner_numbers(NO_INNER)[:4]),
        ("zero", inner_numbers(NO_INNER)),
        ("aside", inner_numbers(with_thumb(ASIDE))),
    ):
        depths[name] = drawer.depth(KINECT, Shown(**parts, numbers=numbers))
        assert depths[name] is not None
    np.testing.assert_array_equal(depths["older"], depths["none"])
    np.testing.assert_array_equal(depths["zero"], depths["none"])
    last = joint_positions(hand.anatomy, pose[None], ASIDE)[0, 3:5].mean(axis=0)
    column, row = np.rint(KINECT.pixels_from_points(last[None])[0][0]).astype(int)
    assert depths["aside"][row, column] > 0
    assert np.count_nonzero((depths["aside"] > 0) != (depths["none"] > 0)) > 50


def test_nothing_expected_is_the_paper_s_thumb() -> None:
    """Without inner angles kinematics are those of 22 numbers."""
    anatomy, poses = HANDS["right"].anatomy, random_poses(5, 2)
    np.testing.assert_array_equal(
        skinning_transforms(anatomy, poses, NO_THUMB), skinning_transforms(anatomy, poses)
    )
