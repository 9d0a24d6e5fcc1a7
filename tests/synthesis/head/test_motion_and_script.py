"""How a synthetic head moves and what its face does, as functions of time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.geometry import rotations
from posetrack_cli.head.face.points import BROWS, MOUTH
from posetrack_cli.synthesis.head.form import minimum_jerk, pulse, random_sway, skin_grid
from posetrack_cli.synthesis.head.frames import make_illumination
from posetrack_cli.synthesis.head.movement import (
    BEFORE_MM,
    FACING,
    STAY_S,
    TURN_RAD_S,
    make_movement,
    make_occluder,
)
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.person import (
    BOTH_WAYS,
    EXPRESSIONS,
    Identity,
    deforming_interval,
    make_person,
    make_script,
)

MINUTE = HeadSynthOptions(frames=1800)
seconds = np.arange(1800) / 30.0
ROUNDING = 1e-9


def test_a_sudden_turn_is_as_fast_as_said() -> None:
    movement = make_movement(replace(MINUTE, motion="turn"), np.random.default_rng(1))
    assert movement.turn_interval is not None
    start, end = movement.turn_interval
    assert start == pytest.approx(0.75 * MINUTE.duration_s)
    fine = np.linspace(start, end, 2000)
    speed = np.linalg.norm(movement.twists(fine)[:, 3:], axis=1)
    assert speed.max() == pytest.approx(TURN_RAD_S, rel=1e-3)
    assert np.degrees(TURN_RAD_S) == pytest.approx(200.0)
    elsewhere = seconds[(seconds < start - 1.0) | (seconds > end + 1.0)]
    assert np.linalg.norm(movement.twists(elsewhere)[:, 3:], axis=1).max() < np.radians(120.0)


@pytest.mark.parametrize("motion", ["natural", "turn"])
def test_velocity_is_the_poses_derivative(motion: str) -> None:
    """The trapezium rule over 1 ms steps: error h^2 / 12 times the third derivative, < 1e-5 rad a second."""
    movement = make_movement(replace(MINUTE, motion=motion), np.random.default_rng(2))
    times = np.arange(44.0, 48.0, 1e-3)
    poses, twists = movement.poses(times), movement.twists(times)
    way = np.cumsum(0.5e-3 * (twists[1:, :3] + twists[:-1, :3]), axis=0)
    np.testing.assert_allclose(poses[1:, :3] - poses[0, :3], way, atol=1e-3)
    turn = poses[0, 3:]
    for twist in 0.5e-3 * (twists[1:, 3:] + twists[:-1, 3:]):
        turn = rotations.multiply(turn, rotations.exponential(twist))
    assert abs(turn @ poses[-1, 3:]) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("motion", ["natural", "slight", "turn", "still"])
def test_a_recording_begins_at_rest_facing_the_camera(motion: str) -> None:
    options = replace(MINUTE, motion=motion, distance_mm=850.0)
    movement = make_movement(options, np.random.default_rng(3))
    first = movement.poses(np.zeros(1))[0]
    np.testing.assert_allclose(first, [0.0, 0.0, 850.0, *FACING], atol=ROUNDING)
    np.testing.assert_allclose(movement.twists(np.zeros(1))[0], 0.0, atol=0.05)
    moved = np.abs(movement.poses(seconds) - first).max()
    assert moved == 0.0 if motion == "still" else moved > (5.0 if motion == "slight" else 20.0)


def test_yaw_reaches_the_wide_range() -> None:
    """Sines of two frequencies add up to almost the sum of their amplitudes within five minutes."""
    movement = make_movement(replace(MINUTE, yaw_range=70.0), np.random.default_rng(3))
    facing = rotations.matrices_from_quaternions(movement.poses(np.arange(0.0, 300.0, 0.1))[:, 3:])[..., 2]
    yaw = np.degrees(np.arctan2(facing[:, 0], -facing[:, 2]))
    assert 60.0 < np.abs(yaw).max() <= 70.0 + ROUNDING


def test_a_roll_turns_every_pose_about_the_camera_axis() -> None:
    rolled, upright = (
        make_movement(replace(MINUTE, roll=roll), np.random.default_rng(3)).poses(seconds)
        for roll in (90.0, 0.0)
    )
    quarter = rotations.exponential(np.array([0.0, 0.0, np.pi / 2.0]))
    expected = rotations.canonical(rotations.multiply(quarter, upright[:, 3:]))
    np.testing.assert_allclose(rolled[:, 3:], expected, atol=ROUNDING)
    np.testing.assert_array_equal(rolled[:, :3], upright[:, :3])


def test_deformations_take_two_thirds_and_leave_a_neutral_beginning() -> None:
    script = make_script(MINUTE, np.random.default_rng(4))
    strengths = script.strengths(seconds)
    interval = deforming_interval(MINUTE)
    assert interval is not None
    start, end = interval
    assert (start, end) == pytest.approx((2.0, 2.0 / 3.0 * MINUTE.duration_s))
    deforming = [k for k, name in enumerate(EXPRESSIONS) if name != "blink"]
    outside = (seconds <= start) | (seconds >= end)
    np.testing.assert_allclose(strengths[outside][:, deforming], 0.0, atol=ROUNDING)
    assert (np.abs(strengths).max(axis=0) > 0.4).all()  # every expression occurs
    assert (strengths[~outside][:, deforming] != 0.0).any(axis=1).mean() > 0.6
    for k, name in enumerate(EXPRESSIONS):
        low = -1.0 if name in BOTH_WAYS else -ROUNDING
        assert low <= strengths[:, k].min() and strengths[:, k].max() <= 1.0 + ROUNDING
    assert strengths[seconds > end][:, EXPRESSIONS.index("blink")].max() > 0.5


def test_without_expressions_nothing_deforms() -> None:
    script = make_script(replace(MINUTE, expressions=False), np.random.default_rng(4))
    assert not script.strengths(seconds).any()


def test_the_two_motions_change_one_distance_each() -> None:
    """Width of the mouth, then from the brows to the mouth, each several times through a wide range."""
    options = HeadSynthOptions(frames=420, script="two-motions", motion="slight")
    script = make_script(options, np.random.default_rng(4))
    times = np.arange(options.frames) / options.fps
    interval = deforming_interval(options)
    assert interval is not None
    start, middle = interval[0], np.mean(interval)
    person = make_person(Identity(), skin_grid())
    shapes = np.array([person.shape(strengths) for strengths in script.strengths(times)])
    width = np.linalg.norm(shapes[:, 5] - shapes[:, 4], axis=1)
    length = np.linalg.norm(shapes[:, BROWS].mean(axis=1) - shapes[:, MOUTH].mean(axis=1), axis=1)
    neutral, wide, tall = times < start, (times > start) & (times < middle), times > middle
    assert start > 4.0 and np.ptp(width[neutral]) == np.ptp(length[neutral]) == 0.0
    # at strengths of 0.8: smile 2 x 7.5 and pucker 2 x 5 mm, jaw 10 and brows 4.5 + 2.6 mm
    assert np.ptp(width[wide]) > 0.8 * 25.0 and np.ptp(length[tall]) > 0.8 * 17.0
    for values in (width[wide], length[tall]):
        beyond = np.diff((values > np.quantile(values, 0.7)).astype(int))
        assert (beyond == 1).sum() >= 2
        rates = np.histogram((values - values.min()) / np.ptp(values), 5, (0.0, 1.0))[0]
        assert rates.min() >= 5  # frames to take the shapes of even rates from


def test_a_slight_motion_faces_the_camera() -> None:
    movement = make_movement(replace(MINUTE, motion="slight"), np.random.default_rng(3))
    poses = movement.poses(seconds)
    turned = 2.0 * np.degrees(np.arccos(np.clip(np.abs(poses[:, 3:] @ FACING), 0.0, 1.0)))
    assert 2.0 < turned.max() < 10.0
    assert 5.0 < np.linalg.norm(poses[:, :3] - movement.origin, axis=1).max() < 20.0


def test_an_object_covers_one_side_for_one_second() -> None:
    options = replace(MINUTE, occlusion=True)
    occluder = make_occluder(options, np.random.default_rng(5))
    assert occluder is not None
    assert make_occluder(MINUTE, np.random.default_rng(5)) is None
    head = np.array([10.0, 20.0, 700.0])
    aside = np.array([occluder.place(t, head)[0] - head[0] for t in seconds]) * occluder.side
    covering = aside < 60.0
    assert covering.sum() / 30.0 == pytest.approx(STAY_S, abs=0.35)
    assert (aside > 0.0).all() and aside[0] > 400.0 and aside[-1] > 400.0
    assert occluder.place(0.0, head)[2] == head[2] - BEFORE_MM


def test_light_drifts_slowly_and_switches_when_asked() -> None:
    rng = np.random.default_rng
    steady, slow, sudden = (
        make_illumination(replace(MINUTE, light=light), rng(6)) for light in ("steady", "slow", "sudden")
    )
    strengths = {
        name: np.array([light.at(t).strengths for t in seconds])
        for name, light in (("steady", steady), ("slow", slow), ("sudden", sudden))
    }
    assert np.ptp(strengths["steady"], axis=0).max() == 0.0
    steps = np.abs(np.diff(strengths["slow"], axis=0)).max()
    assert 0.0 < steps < 0.01 and np.ptp(strengths["slow"], axis=0).min() > 0.03
    jump = np.abs(strengths["sudden"] - strengths["slow"]).max(axis=1)
    middle = MINUTE.duration_s / 2.0
    assert jump[seconds < middle].max() == 0.0 and jump[seconds > middle + 0.1].min() > 0.1
    for light in (steady.at(1.0), sudden.at(40.0)):
        np.testing.assert_allclose(np.linalg.norm(light.directions, axis=1), 1.0)


def test_curves() -> None:
    s = np.linspace(0.0, 1.0, 1001)
    np.testing.assert_allclose(minimum_jerk(s) + minimum_jerk(1.0 - s), 1.0)
    assert np.gradient(minimum_jerk(s), s).max() == pytest.approx(1.875, rel=1e-4)
    held = pulse(np.array([0.0, 1.0, 1.5, 2.5, 3.0, 4.5, 9.0]), 1.0, 1.0, 1.0, 1.5)
    np.testing.assert_allclose(held, [0.0, 0.0, 0.5, 1.0, 1.0, 0.0, 0.0], atol=ROUNDING)
    sway = random_sway(np.array([2.0, 5.0]), (0.1, 0.3), np.random.default_rng(7))
    assert (np.abs(sway(np.linspace(0.0, 300.0, 20_000))).max(axis=0) <= [2.0, 5.0]).all()
