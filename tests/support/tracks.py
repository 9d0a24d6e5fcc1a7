"""Tracks of hands and heads that are made up: smooth ones with a known error, and random ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.model.anatomy import (
    ANGLE_LIMITS,
    ANGLE_NAMES,
    JOINT_NAMES,
    JOINT_PARENTS,
    make_anatomy,
)
from posetrack_cli.hand.model.kinematics import joint_positions

HEAD_POINTS = ("left_eye_inner", "left_mouth_corner", "right_nostril", "right_brow_inner")
FRAME_NS = 33_333_333


def _never_lost(frames: int) -> dict[str, Any]:
    """What a track says of its frames that are one like the other."""
    return {
        "stamp_ns": np.arange(frames, dtype=np.int64) * FRAME_NS,
        "lost": np.zeros(frames, dtype=np.bool_),
        "reinitialised": np.zeros(frames, dtype=np.bool_),
    }


def _hand(name: str, position: FloatArray, quaternion: FloatArray, shape: FloatArray, **more: Any) -> Track:
    """A right hand of average size, with the joints that its poses have."""
    return Track(
        name,
        "hand",
        ANGLE_NAMES,
        JOINT_NAMES,
        JOINT_PARENTS,
        **_never_lost(len(position)),
        position=position,
        quaternion=quaternion,
        shape=shape,
        points=joint_positions(make_anatomy(), np.hstack([position, quaternion, shape])),
        **more,
    )


def hand_track(name: str, frames: int, error_mm: float, seed: int = 0) -> Track:
    """A hand that goes in a circle, opening and closing; ``error_mm`` is the sd of its position noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames) / 30.0
    circle = np.stack([50 * np.sin(t), 30 * np.cos(t), 650 + 40 * np.sin(t / 3)], axis=1)
    position = circle + error_mm * rng.standard_normal((frames, 3))
    turn = 0.5 * np.stack([np.sin(t / 2), np.sin(t / 3), np.sin(t / 5)], axis=1)
    wide = np.full((frames, 21), max(error_mm, 0.1) ** 2)
    return _hand(
        name,
        position,
        rotations.exponential(turn + 0.002 * error_mm * rng.standard_normal((frames, 3))),
        np.repeat(0.6 - 0.5 * np.cos(t)[:, None], len(ANGLE_NAMES), axis=1),
        twist=np.zeros((frames, 21)),
        pose_variance=wide,
        twist_variance=wide,
        confidence=np.full(frames, 0.8),
        cost=np.full(frames, 5.0),
        effective_sample_size=np.full(frames, 100.0),
        milliseconds=np.full(frames, 30.0),
        evaluations=np.full(frames, 513.0),
        resampled=np.ones(frames, dtype=np.bool_),
    )


def random_quaternions(rng: np.random.Generator, frames: int) -> FloatArray:
    return rotations.canonical(rng.standard_normal((frames, 4)))


def random_hand(frames: int, seed: int = 0) -> Track:
    """A hand anywhere, turned any way, at any angles; its velocity is random too."""
    rng = np.random.default_rng(seed)
    return _hand(
        "random",
        np.array([0.0, 0.0, 600.0]) + 100.0 * rng.standard_normal((frames, 3)),
        random_quaternions(rng, frames),
        rng.uniform(*ANGLE_LIMITS.T, (frames, len(ANGLE_NAMES))),
        twist=rng.standard_normal((frames, 21)),
        pose_variance=rng.uniform(0.5, 2.0, (frames, 21)),
        twist_variance=rng.uniform(0.5, 2.0, (frames, 21)),
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
        **_never_lost(frames),
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
