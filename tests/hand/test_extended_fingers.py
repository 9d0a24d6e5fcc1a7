"""Fingers that stand out of a drawn hand, and the hands that they tell of."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.model.kinematics import (
    joint_positions,
    joint_set_distance,
    mean_joint_distances,
    mirrored_poses,
)
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.policy import NEAR_MM
from posetrack_cli.hand.search import Acquisition, extended_fingers, poses_from_fingers
from posetrack_cli.rendering.port import RenderingDevice
from support.hand import KINECT, random_poses
from support.hand_scene import HANDS, Stage, acquisition, relaxed, turned_about_its_length

TIP_MM = 12.0
"""A tip is the mean of what is seen of the finger's last 8 mm, on pixels of 4 mm, from the side."""
LAID_MM = 15.0
"""Mean joint error of a hand that is laid on fingers as if they were straight; fits make it less than 5."""
TIPS = [4 + 4 * f for f in range(5)]
SIDES = ["right", "left"]
CLOSED = (1.3, 1.5)


@pytest.fixture(scope="module", params=SIDES)
def side(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def stage(device: RenderingDevice, side: str) -> Stage:
    return Stage(device, HANDS[side])


@pytest.fixture(scope="module")
def finder(device: RenderingDevice, side: str) -> Acquisition:
    return acquisition(HANDS[side])


def spread_hand(side: str, about_view: float = 0.0, closed: tuple[int, ...] = ()) -> FloatArray:
    """An open hand (22,) that is turned in the image, with some of its fingers closed."""
    pose = relaxed()
    turn = rotations.exponential(np.array([0.0, 0.0, about_view]))
    pose[3:7] = rotations.canonical(rotations.multiply(turn, pose[3:7]))
    pose[7:] = 0.1
    pose[9] = 0.3
    pose[[11, 14, 17, 20]] = 0.2, 0.05, -0.1, -0.25
    for finger in closed:
        pose[[7 + 3 * finger, 9 + 3 * finger]] = CLOSED
    return pose if side == "right" else mirrored_poses(pose[None])[0]


def seen(finder: Acquisition, stage: Stage, pose: FloatArray) -> Observation:
    """What is observed of a hand at a pose, about a prediction that is turned and closed otherwise."""
    expected = turned_about_its_length(pose, -0.6 if stage.hand.anatomy.is_left else 0.6)
    expected[[10, 13, 16, 19]] = 0.8
    return finder.observer.observe(stage.depth(pose), expected)


@pytest.mark.parametrize("about_view", [0.0, 0.9, -1.2, 2.4, np.pi])
def test_an_open_hand_shows_its_five_fingers_in_their_order(
    finder: Acquisition, stage: Stage, side: str, about_view: float
) -> None:
    pose = spread_hand(side, about_view)
    fingers = extended_fingers(seen(finder, stage, pose), 1.0, KINECT)
    tips = joint_positions(stage.hand.anatomy, pose[None])[0, TIPS]
    apart = np.linalg.norm(np.array([finger.tip for finger in fingers])[:, None] - tips, axis=2)
    assert apart.shape == (5, 5)
    assert apart.min(axis=1).max() < TIP_MM
    order = apart.argmin(axis=1).tolist()
    steps = {(after - before) % 5 for before, after in pairwise(order)}
    assert steps in ({1}, {4})  # around the palm, one way or the other


@pytest.mark.parametrize("turned", [0.0, np.pi], ids=["palm", "back"])
@pytest.mark.parametrize("closed", [(), (4,), (3, 4), (1,)], ids=["five", "four", "three", "no index"])
def test_one_of_the_hands_that_fingers_tell_of_is_the_drawn_one(
    finder: Acquisition, stage: Stage, side: str, turned: float, closed: tuple[int, ...]
) -> None:
    pose = turned_about_its_length(spread_hand(side, 0.5, closed), turned)
    observation = seen(finder, stage, pose)
    hands = poses_from_fingers(observation, stage.hand.anatomy, KINECT)
    assert min(stage.error(hand, pose) for hand in hands) < LAID_MM
    starts = finder.starts_from_fingers(observation)
    assert len(starts) == 2
    assert min(stage.error(start, pose) for start in starts) < LAID_MM


def test_a_fist_tells_of_no_hand(finder: Acquisition, stage: Stage, side: str) -> None:
    pose = spread_hand(side, 0.0, (1, 2, 3, 4))
    assert poses_from_fingers(seen(finder, stage, pose), stage.hand.anatomy, KINECT).shape == (0, 22)
    assert finder.starts_from_fingers(seen(finder, stage, pose)).shape == (0, 22)


def test_a_hand_that_turned_by_a_right_angle_is_fitted_from_its_fingers(
    finder: Acquisition, stage: Stage, side: str
) -> None:
    """As a quick turn in the image: the prediction has each finger on the next one, and stays there."""
    pose, expected = spread_hand(side, 1.5), spread_hand(side, 0.0)
    there, here = joint_positions(stage.hand.anatomy, np.stack([pose, expected]))[:, [5, 17]].mean(axis=1)
    expected[:3] += there - here
    depth = stage.depth(pose)
    observation = finder.observer.observe(depth, expected)
    none = np.empty((0, 22))

    def fitted(told: FloatArray) -> float:
        rng = np.random.default_rng(1)
        fits = finder.local_fitter.fit(observation, expected, none, 1 / 30, rng, extra=told)
        return stage.error(fits.modes.poses[0], pose)

    assert fitted(finder.starts_from_fingers(observation)) < 5.0
    assert fitted(none) > 20.0


def test_two_hands_of_the_same_joints_are_in_one_place(side: str) -> None:
    anatomy, rng = HANDS[side].anatomy, np.random.default_rng(3)
    first, second = random_poses(20, rng), random_poses(20, rng)
    for one, other in zip(first, second, strict=True):
        apart = joint_set_distance(anatomy, one, other)
        assert joint_set_distance(anatomy, one, one) == 0.0
        assert apart == joint_set_distance(anatomy, other, one)
        assert apart <= mean_joint_distances(anatomy, one, other[None])[0] + 1e-9


def test_another_finger_that_points_and_a_half_open_hand_pulled_back_are_in_one_place(side: str) -> None:
    """Both explain the pixels of a pointing hand, 30 to 60 mm off joint by joint."""
    anatomy = HANDS[side].anatomy
    pointing = spread_hand(side, 0.0, (2, 3, 4))
    pulled_back = spread_hand(side)
    pulled_back[[10, 13, 16, 19]], pulled_back[[12, 15, 18, 21]] = -0.2, (0.4, 0.7, 0.7, 0.5)
    back = rotations.rotate(pointing[3:7], np.array([0.0, 1.0, 0.0]))
    pulled_back[:3] = pointing[:3] + 50.0 * back
    middle = spread_hand(side, 0.0, (1, 3, 4))
    for other in (pulled_back, middle):
        apart = mean_joint_distances(anatomy, pointing, other[None])[0]
        assert joint_set_distance(anatomy, pointing, other) < 0.75 * apart
        assert joint_set_distance(anatomy, pointing, other) < NEAR_MM
    elbow = pointing.copy()
    elbow[:3] += 250.0 * back
    assert joint_set_distance(anatomy, pointing, elbow) > 3.0 * NEAR_MM
