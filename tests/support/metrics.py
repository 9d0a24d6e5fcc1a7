"""Random tracks of hands and heads, and their metrics, for tests of what is measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import settings

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.association import Pairs
from posetrack_cli.evaluation.evaluation import Curve, Statistics
from posetrack_cli.evaluation.metrics.hand_metrics import hand_metrics
from posetrack_cli.evaluation.metrics.head_metrics import head_metrics
from posetrack_cli.evaluation.metrics.measures import Matched, Measures
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.anatomy import ANGLE_LIMITS, ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS, make_anatomy
from posetrack_cli.hand.kinematics import joint_positions

HEAD_POINTS = ("left_eye_inner", "left_mouth_corner", "right_nostril", "right_brow_inner")
FRAME_NS = 33_333_333
NOTHING = "nothing to compare"
relaxed = settings(deadline=None, max_examples=60)


def random_quaternions(rng: np.random.Generator, frames: int) -> FloatArray:
    return rotations.canonical(rng.standard_normal((frames, 4)))


def random_hand(frames: int, seed: int = 0) -> Track:
    """A hand anywhere, turned any way, at any angles; its velocity is random too."""
    rng = np.random.default_rng(seed)
    position = np.array([0.0, 0.0, 600.0]) + 100.0 * rng.standard_normal((frames, 3))
    quaternion = random_quaternions(rng, frames)
    shape = rng.uniform(*ANGLE_LIMITS.T, (frames, len(ANGLE_NAMES)))
    return Track(
        "random",
        "hand",
        ANGLE_NAMES,
        JOINT_NAMES,
        JOINT_PARENTS,
        stamp_ns=np.arange(frames, dtype=np.int64) * FRAME_NS,
        lost=np.zeros(frames, dtype=np.bool_),
        reinitialised=np.zeros(frames, dtype=np.bool_),
        position=position,
        quaternion=quaternion,
        shape=shape,
        twist=rng.standard_normal((frames, 21)),
        pose_variance=rng.uniform(0.5, 2.0, (frames, 21)),
        twist_variance=rng.uniform(0.5, 2.0, (frames, 21)),
        points=joint_positions(make_anatomy(), np.hstack([position, quaternion, shape])),
    )


def random_head(frames: int, seed: int = 0) -> Track:
    """A head anywhere, turned any way, whose points are anywhere around it."""
    rng = np.random.default_rng(seed)
    position = np.array([0.0, 0.0, 700.0]) + 50.0 * rng.standard_normal((frames, 3))
    quaternion = random_quaternions(rng, frames)
    in_head = 40.0 * rng.standard_normal((frames, len(HEAD_POINTS), 3))
    return Track(
        "random",
        "head",
        ("b1", "b2"),
        HEAD_POINTS,
        (-1,) * len(HEAD_POINTS),
        stamp_ns=np.arange(frames, dtype=np.int64) * FRAME_NS,
        lost=np.zeros(frames, dtype=np.bool_),
        reinitialised=np.zeros(frames, dtype=np.bool_),
        position=position,
        quaternion=quaternion,
        shape=rng.standard_normal((frames, 2)),
        twist=rng.standard_normal((frames, 8)),
        pose_variance=rng.uniform(0.5, 2.0, (frames, 8)),
        twist_variance=rng.uniform(0.5, 2.0, (frames, 8)),
        points=rotations.rotate(quaternion[:, None], in_head) + position[:, None],
    )


def moved(track: Track, q: FloatArray, t: FloatArray) -> Track:
    """The track seen from another camera: every point p at R p + t."""
    assert track.position is not None
    assert track.quaternion is not None
    assert track.points is not None
    return replace(
        track,
        position=rotations.rotate(q, track.position) + t,
        quaternion=rotations.canonical(rotations.multiply(q, track.quaternion)),
        points=rotations.rotate(q, track.points) + t,
    )


def all_pairs(frames: int) -> Pairs:
    rows = np.arange(frames, dtype=np.int64)
    return Pairs(rows, rows)


def measure(
    estimate: Track, truth: Track, pairs: Pairs | None = None, missed: int = 0
) -> tuple[Measures, Curve | None]:
    """All metrics of the subject over these pairs, by default of rows of the same number."""
    measures = Measures(NOTHING)
    matched = Matched(estimate, truth, all_pairs(len(estimate)) if pairs is None else pairs)
    if estimate.subject == "head":
        head_metrics(measures, matched)
        return measures, None
    return measures, hand_metrics(measures, matched, missed)


def figures(measures: Measures, address: str) -> Statistics:
    value = measures.metrics[address]
    assert isinstance(value, Statistics), address
    return value


def number(measures: Measures, address: str) -> float:
    value = measures.metrics[address]
    assert isinstance(value, float), address
    return value
