"""Joint velocities against central differences: a hand whose motion is known, and what cannot be told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.measuring.evaluation import Statistics
from posetrack_cli.evaluation.measuring.hand_metrics import (
    ERROR,
    INTERVALS,
    central_differences,
    joints_by_pose,
)
from posetrack_cli.evaluation.measuring.measures import Matched, Measures
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.hand.model.anatomy import JOINT_NAMES, make_anatomy
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.tracking.velocity import BodySpace
from support.metrics import NOTHING, all_pairs, number
from support.tracks import hand_track

FRAMES = 400
NS_PER_FRAME = 5_000_000
RATE = np.concatenate([[30.0, -80.0, 20.0], [0.8, -0.5, 0.3], np.full(15, 0.6)])


def moving(noise: float = 0.0, stated: float = 1.0) -> tuple[Track, Track]:
    """Estimates of a hand that moves with ``RATE``, whose velocities err by a share ``noise`` of it.

    The true hand swings slowly about that motion's poses, as angles may not grow for two seconds.
    """
    rng = np.random.default_rng(2)
    stamps = np.arange(FRAMES) * NS_PER_FRAME
    phase = 2.0 * np.pi * stamps * 1e-9
    start = np.zeros(22)
    start[2], start[6], start[7:] = 600.0, 1.0, 0.3
    poses = BodySpace().retract(np.repeat(start[None], FRAMES, axis=0), 0.15 * np.sin(phase)[:, None] * RATE)
    # About a fixed axis, from one start: the rate stays RATE times the swing's.
    twist = 0.15 * 2.0 * np.pi * np.cos(phase)[:, None] * RATE
    sd = noise * np.abs(RATE)
    own = hand(poses, stamps, twist + rng.normal(size=twist.shape) * sd, np.tile(stated * sd**2, (FRAMES, 1)))
    return own, hand(poses, stamps, None, None)


def hand(
    poses: FloatArray, stamps: np.ndarray, twist: FloatArray | None, variance: FloatArray | None
) -> Track:
    return replace(
        hand_track("hand", len(poses), 0.0),
        stamp_ns=stamps,
        position=poses[:, :3],
        quaternion=poses[:, 3:7],
        shape=poses[:, 7:],
        points=joint_positions(make_anatomy(), poses),
        pose_variance=np.ones((len(poses), 21)),
        twist=twist,
        twist_variance=variance,
    )


def measured(estimate: Track, truth: Track) -> Measures:
    measures = Measures(NOTHING)
    joints_by_pose(measures, Matched(estimate, truth, all_pairs(len(estimate))), make_anatomy)
    return measures


def test_the_velocities_of_a_known_motion_are_right() -> None:
    measures = measured(*moving())
    # A central difference of a sine errs by (2 pi dt)^2 / 6 of it: 1.6e-4 of up to 250 mm/s.
    error = measures.metrics[ERROR]
    assert isinstance(error, Statistics) and error.max < 0.1
    assert measures.series[ERROR].shape == (FRAMES,)
    assert np.isnan(measures.series[ERROR][[0, -1]]).all() and np.isfinite(measures.series[ERROR][1:-1]).all()


@pytest.mark.parametrize("percent", [50, 90])
def test_true_velocities_lie_inside_as_often_as_stated(percent: int) -> None:
    honest, timid = (measured(*moving(0.1, stated)) for stated in (1.0, 0.09))
    name = f"joint_velocity_inside_{percent}"
    # 398 frames of 21 independent errors: the standard deviation of a joint's share is below 0.026.
    for address in (name, *(f"{name}.{joint}" for joint in JOINT_NAMES)):
        assert number(honest, address) == pytest.approx(percent / 100, abs=0.08)
    assert number(timid, name) < number(honest, name) - 0.2


def test_a_missing_frame_of_the_truth_has_no_difference_across_more() -> None:
    truth = moving()[1]
    assert truth.points is not None
    kept = np.delete(np.arange(FRAMES), [50, 100, 101])
    sparse = replace(truth, stamp_ns=truth.stamp_ns[kept], points=truth.points[kept])
    velocities = central_differences(sparse, np.arange(len(sparse)), NS_PER_FRAME)
    unknown = kept[np.isnan(velocities).any(axis=(1, 2))]
    # Across 50 the neighbours are three frames apart, across 100 and 101 four.
    assert unknown.tolist() == [0, 99, 102, FRAMES - 1]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"twist": None}, "the run does not estimate velocities"),
        ({"twist_variance": None}, "the run does not estimate velocities"),
        ({"quaternion": None}, "the result has no pose with covariance"),
    ],
)
def test_what_is_lacking_is_said(change: dict[str, None], reason: str) -> None:
    estimate, truth = moving()
    measures = measured(replace(estimate, **change), truth)  # type: ignore[arg-type]
    assert {measures.absent[name] for name in (ERROR, *INTERVALS)} == {reason}


def test_two_frames_have_no_velocity() -> None:
    estimate, truth = moving()
    short = [
        replace(track, **{name: getattr(track, name)[:2] for name in vars(track) if _is_long(track, name)})
        for track in (estimate, truth)
    ]
    assert measured(*short).absent[ERROR] == "the ground truth has no velocity"


def _is_long(track: Track, name: str) -> bool:
    values = getattr(track, name)
    return isinstance(values, np.ndarray) and len(values) == FRAMES


def test_frames_without_an_estimated_velocity_are_left_out() -> None:
    estimate, truth = moving()
    assert estimate.twist is not None and estimate.twist_variance is not None
    gone = estimate.twist.copy()
    gone[7] = np.nan
    measures = measured(replace(estimate, twist=gone), truth)
    error = measures.metrics[ERROR]
    assert isinstance(error, Statistics) and error.max < 0.1


def test_aligned_poses_have_no_velocities_of_joints() -> None:
    estimate, truth = moving()
    assert estimate.position is not None
    moved = replace(estimate, position=estimate.position + 20.0)
    assert measured(moved, truth).absent[ERROR] == "not available after alignment of the poses"
