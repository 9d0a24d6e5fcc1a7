from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from posetrack_cli.geometry.rotations import angle_between, exponential
from posetrack_cli.hand.model.anatomy import ANGLES, JOINT_NAMES, TANGENT_SIZE, make_anatomy
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.synthesis.hand.frames import CAMERA
from posetrack_cli.synthesis.hand.motion import (
    Motion,
    Region,
    WalkNoise,
    difference,
    folded,
    make_motion,
    natural_motion,
    pose_walk,
    reflected,
    start_pose,
    velocity_walk,
    walk_region,
)
from posetrack_cli.synthesis.hand.options import SynthOptions
from posetrack_cli.synthesis.hand.shapes import SHAPES, coupled, inside_limits, minimum_jerk

FRAME_S = 1.0 / 30.0
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
FAR_REGION = Region(np.full(3, -1e9), np.full(3, 1e9), np.pi)
TAIL = 1e-6  # chance that a right sampler fails one chi-square test; the seeds are fixed


def seconds(count: int) -> np.ndarray:
    return np.arange(count) * FRAME_S


def motion(kind: str, seed: int, count: int = 300, **options: object) -> Motion:
    made = SynthOptions(motion=kind, **options)  # type: ignore[arg-type]
    return make_motion(made, seconds(count), np.random.default_rng(seed))


@pytest.mark.parametrize("kind", ["A", "B", "C"])
@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_every_motion_keeps_the_joint_limits(kind: str, speed: float) -> None:
    for seed in range(8):
        assert inside_limits(motion(kind, seed, speed=speed).poses[:, ANGLES]).all()


@pytest.mark.parametrize("kind", ["A", "B"])
def test_walks_stay_in_box_and_cone(kind: str) -> None:
    region = walk_region(1.0)
    for seed in range(8):
        poses = motion(kind, seed, speed=3.0).poses
        assert (poses[:, :3] >= region.low).all() and (poses[:, :3] <= region.high).all()
        assert (angle_between(poses[:, 3:7], IDENTITY) <= region.cone + 1e-12).all()


@pytest.mark.parametrize("kind", ["A", "B", "C"])
@pytest.mark.parametrize(("scale", "side"), [(0.5, "right"), (1.0, "left"), (1.5, "right")])
def test_the_whole_hand_stays_in_the_image(kind: str, scale: float, side: str) -> None:
    for seed in range(3):
        poses = motion(kind, seed, scale=scale, side=side, speed=2.0).poses
        pixels, before = CAMERA.pixels_from_points(joint_positions(make_anatomy(side, scale), poses))
        assert before.all()
        assert (pixels >= 0.0).all() and (pixels <= [CAMERA.width - 1, CAMERA.height - 1]).all()


def middle_pose() -> np.ndarray:
    """A pose whose angles are far from their limits."""
    pose = start_pose(1.0)
    pose[ANGLES] = np.deg2rad([10.0, 35.0, 0.0, *np.tile([35.0, 0.0, 50.0], 4)])
    return pose


def assert_density(squares: np.ndarray, sd: np.ndarray, count: int) -> None:
    """Sums of ``count`` squared increments of a frame are chi-square around sd^2 dt."""
    statistic = squares / (sd**2 * FRAME_S)
    assert (statistic > chi2.ppf(TAIL, count)).all() and (statistic < chi2.isf(TAIL, count)).all()


def test_increments_of_a_have_the_density_of_eq_66() -> None:
    sd = 0.2 * WalkNoise().walk.vector()
    squares, count = np.zeros(TANGENT_SIZE), 0
    for seed in range(60):  # short slow walks: no limit is reached
        poses = pose_walk(middle_pose(), seconds(5), sd, FAR_REGION, np.random.default_rng(seed))
        squares += (difference(poses[:-1], poses[1:]) ** 2).sum(axis=0)
        count += 4
    assert_density(squares, sd, count)


def test_b_is_eq_67_where_nothing_is_reflected() -> None:
    noise = WalkNoise()
    pose_sd, velocity_sd = 0.1 * noise.pose.vector(), 0.1 * noise.velocity.vector()
    pose_squares, velocity_squares, count = np.zeros(TANGENT_SIZE), np.zeros(TANGENT_SIZE), 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        poses, twists = velocity_walk(middle_pose(), seconds(5), pose_sd, velocity_sd, FAR_REGION, rng)
        residual = difference(poses[:-1], poses[1:]) - FRAME_S * twists[:-1]
        pose_squares += (residual**2).sum(axis=0)
        velocity_squares += (np.diff(twists, axis=0) ** 2).sum(axis=0)
        count += 4
    assert_density(pose_squares, pose_sd, count)
    assert_density(velocity_squares, velocity_sd, count)


def test_walk_of_two_steps_has_the_variance_of_one_twice_as_long() -> None:
    start, sd = middle_pose(), np.full(TANGENT_SIZE, 1e-3)
    ends = []
    for instants in ([0.0, 0.1, 0.2], [0.0, 0.2]):
        walks = [
            pose_walk(start, np.array(instants), sd, FAR_REGION, np.random.default_rng(k)) for k in range(300)
        ]
        last = np.array([walk[-1] for walk in walks])
        ends.append(difference(np.broadcast_to(start, last.shape), last).var())
    tolerance = 5.0 * np.sqrt(2.0 * 2.0 / (300 * TANGENT_SIZE))  # five sd of a ratio of two variances
    assert abs(ends[0] / ends[1] - 1.0) < tolerance


def test_reflection_reverses_the_velocity_only_where_the_pose_left() -> None:
    region = walk_region(1.0)
    pose = middle_pose()
    pose[0] = region.high[0] + 5.0
    pose[3:7] = exponential(np.array([0.0, 0.0, region.cone + 0.1]))
    pose[9] = 1.0  # thumb abduction beyond its limit
    twist = np.ones(TANGENT_SIZE)
    inside, back = reflected(pose, twist, region)
    assert inside[0] == pytest.approx(region.high[0] - 5.0)
    assert angle_between(inside[3:7], IDENTITY) == pytest.approx(region.cone - 0.1)
    assert np.flatnonzero(back < 0.0).tolist() == [0, 5, 8]
    assert np.abs(back) == pytest.approx(1.0)


def test_folding_reaches_across_several_borders() -> None:
    values, sign = folded(np.array([-0.25, 0.5, 1.25, 2.25, -1.5]), np.array(0.0), np.array(1.0))
    assert values == pytest.approx([0.25, 0.5, 0.75, 0.25, 0.5])
    assert sign.tolist() == [-1.0, 1.0, -1.0, 1.0, 1.0]


@pytest.mark.parametrize("speed", [1.0, 2.0])
def test_velocity_of_c_is_the_derivative_of_its_pose(speed: float) -> None:
    fine = np.arange(4000) * 5e-4
    made = make_motion(SynthOptions(motion="C", speed=speed), fine, np.random.default_rng(3))
    assert made.twists is not None
    step = difference(made.poses[:-1], made.poses[1:]) / 5e-4
    middle = 0.5 * (made.twists[:-1] + made.twists[1:])
    # the trapezoid's error is step^2 / 12 times the jerk, see DIFFERENCE_S
    most = 5e-4**2 / 12.0 * speed**3
    assert np.abs(step - middle)[:, :3].max() < most * 3e5
    assert np.abs(step - middle)[:, 3:].max() < most * 2e5


def test_velocity_of_b_is_its_state_and_a_has_none() -> None:
    assert motion("A", 0).twists is None
    twists = motion("B", 0).twists
    assert twists is not None and not twists[0].any() and twists[1:].any(axis=1).all()


def test_c_starts_with_an_open_hand_before_the_sensor() -> None:
    for seed in range(20):
        pose = motion("C", seed, 2).poses[0]
        joints = joint_positions(make_anatomy(), pose[None])[0]
        palm = joints[[JOINT_NAMES.index(name) for name in ("wrist", "index_mcp", "little_mcp")]].mean(axis=0)
        assert np.hypot(*palm[:2]) < 15.0
        assert abs(palm[2] - 650.0) < 15.0
        assert angle_between(pose[3:7], IDENTITY) < np.deg2rad(5.0)
        assert np.abs(pose[ANGLES] - SHAPES["open"]).max() < np.deg2rad(4.0)


def test_seeds_give_different_scripts_and_one_seed_the_same() -> None:
    first, again, other = (motion("C", seed).poses for seed in (1, 1, 2))
    assert (first == again).all()
    assert np.abs(first[-1] - other[-1]).max() > 1.0


def test_c_moves_about_as_much_as_real_hands_do() -> None:
    anatomy, palm, turn, pip = make_anatomy(), [], [], []
    for seed in range(10):
        poses = motion("C", seed).poses
        palm.append(np.linalg.norm(np.diff(joint_positions(anatomy, poses)[:, 9], axis=0), axis=1))
        tangent = difference(poses[:-1], poses[1:])
        turn.append(np.rad2deg(np.linalg.norm(tangent[:, 3:6], axis=1)))
        pip.append(np.rad2deg(np.abs(tangent[:, [11, 14, 17, 20]]).ravel()))
    # hand.md, median and p90: palm 4 and 12 mm, 3 and 18 deg, PIP 3 and 17 deg; within a factor of two
    assert 2.0 < np.median(np.concatenate(palm)) < 8.0
    assert 6.0 < np.percentile(np.concatenate(palm), 90) < 24.0
    assert 1.5 < np.median(np.concatenate(turn)) < 6.0
    assert 9.0 < np.percentile(np.concatenate(turn), 90) < 36.0
    assert 8.5 < np.percentile(np.concatenate(pip), 90) < 34.0


def test_c_is_slower_with_a_lower_speed() -> None:
    slow, fast = motion("C", 5, 200, speed=0.5).poses, motion("C", 5, 100, speed=1.0).poses
    assert slow[::2] == pytest.approx(fast, abs=1e-9)


def test_bent_fingers_do_not_spread() -> None:
    angles = np.deg2rad(np.tile([10.0, 10.0, 10.0], (3, 5)))
    angles[0, 3::3], angles[1, 3::3], angles[2, 3::3] = 0.0, np.deg2rad(20.0), np.deg2rad(45.0)
    spread = coupled(angles)[:, [4, 7, 10, 13]]
    assert spread[0] == pytest.approx(np.deg2rad(10.0))
    assert ((spread[1] > 0.0) & (spread[1] < spread[0])).all()
    assert not spread[2].any()


def test_fingers_do_not_run_through_each_other() -> None:
    """The nearest two finger axes come, next to never, is less than half of what the skins need."""
    anatomy = make_anatomy()
    along = np.linspace(0.0, 1.0, 5)[:, None]
    nearest = []
    for seed in range(4):
        joints = joint_positions(anatomy, motion("C", seed, 600).poses[::3])
        tips = [joints[:, 3 + 4 * f, None] + along * (joints[:, 4 + 4 * f] - joints[:, 3 + 4 * f])[:, None]
                for f in range(5)]  # fmt: skip
        for f in range(5):
            for g in range(f):
                gap = np.linalg.norm(tips[f][:, :, None] - tips[g][:, None], axis=-1).min(axis=(1, 2))
                nearest.append(gap / (anatomy.radii[f, 3] + anatomy.radii[g, 3]))
    assert (np.concatenate(nearest) < 0.5).mean() < 0.005


def test_left_motion_is_the_mirror_image() -> None:
    for kind in ("B", "C"):
        right, left = motion(kind, 4), motion(kind, 4, side="left")
        assert right.twists is not None and left.twists is not None
        joints = [
            joint_positions(make_anatomy(side), m.poses) for side, m in (("right", right), ("left", left))
        ]
        assert joints[0] * [-1.0, 1.0, 1.0] == pytest.approx(joints[1], abs=1e-9)
    script, h = natural_motion(10.0, 1.0, np.random.default_rng(4)), 1e-5
    around = Motion(script.poses(np.array([2.0 - h, 2.0 + h])), None).mirrored().poses
    velocity = difference(around[:1], around[1:])[0] / (2.0 * h)
    assert left.twists[60] == pytest.approx(velocity, abs=1e-3)


def test_minimum_jerk_rests_at_both_ends() -> None:
    x = np.array([-1.0, 0.0, 0.5, 1.0, 2.0])
    assert minimum_jerk(x) == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0])
    h = 1e-4
    assert minimum_jerk(np.array([h]))[0] < 11.0 * h**3
