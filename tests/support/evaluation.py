"""Evaluations made up for tests of what is made from them: tables, gates, reports."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.evaluation.association import Pairs
from posetrack_cli.evaluation.coverage import Coverage
from posetrack_cli.evaluation.evaluation import Curve, Evaluation, statistics
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.anatomy import ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS, make_anatomy
from posetrack_cli.hand.kinematics import joint_positions

FRAME_NS = 33_333_333


def hand_track(name: str, frames: int, error_mm: float, seed: int = 0) -> Track:
    """A hand that goes in a circle, opening and closing; ``error_mm`` is the sd of its position noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames) / 30.0
    circle = np.stack([50 * np.sin(t), 30 * np.cos(t), 650 + 40 * np.sin(t / 3)], axis=1)
    position = circle + error_mm * rng.standard_normal((frames, 3))
    turn = 0.5 * np.stack([np.sin(t / 2), np.sin(t / 3), np.sin(t / 5)], axis=1)
    quaternion = rotations.exponential(turn + 0.002 * error_mm * rng.standard_normal((frames, 3)))
    shape = np.repeat(0.6 - 0.5 * np.cos(t)[:, None], len(ANGLE_NAMES), axis=1)
    poses = np.hstack([position, quaternion, shape])
    wide = np.full((frames, 21), max(error_mm, 0.1) ** 2)
    return Track(
        name,
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
        twist=np.zeros((frames, 21)),
        pose_variance=wide,
        twist_variance=wide,
        points=joint_positions(make_anatomy(), poses),
        confidence=np.full(frames, 0.8),
        cost=np.full(frames, 5.0),
        effective_sample_size=np.full(frames, 100.0),
        milliseconds=np.full(frames, 30.0),
        evaluations=np.full(frames, 513.0),
        resampled=np.ones(frames, dtype=np.bool_),
    )


def hand_evaluation(name: str = "a", frames: int = 300, error_mm: float = 5.0, **changes: Any) -> Evaluation:
    """A hand's evaluation against truth, consistent in itself; ``changes`` replace attributes."""
    truth = hand_track("truth", frames, 0.0)
    track = hand_track(name, frames, error_mm, seed=sum(name.encode()))
    assert track.points is not None
    assert truth.points is not None
    errors = np.linalg.norm(track.points - truth.points, axis=2)
    largest = errors.max(axis=1)
    thresholds = np.arange(0.0, 101.0)
    share = (largest[:, None] < thresholds).mean(axis=0)
    rows = np.arange(frames, dtype=np.int64)
    values: dict[str, Any] = {
        "name": name,
        "path": Path(f"{name}.mcap"),
        "subject": "hand",
        "run": {"tracker": "hand", "seed": "1", "configuration": "{}", "renderer": "llvmpipe"},
        "coverage": Coverage(frames, frames, 0, 0, 0, 0, 0, True, frames),
        "metrics": {
            "coverage": 1.0,
            "joint_error_mm": statistics(errors),
            "joint_error_mm.index_tip": statistics(errors[:, JOINT_NAMES.index("index_tip")]),
            "largest_joint_error_mm": statistics(largest),
            "frames_within_20mm": float((largest < 20).mean()),
        },
        "absent": {"velocity_error_mm_s": "the truth has no velocity"},
        "series": {"joint_error_mm": errors.mean(axis=1), "largest_joint_error_mm": largest},
        "series_stamp_ns": track.stamp_ns,
        "curve": Curve(thresholds, share, share),
        "notes": (),
        "losses": (),
        "track": track,
        "truth": truth,
        "pairs": Pairs(rows, rows),
    }
    return Evaluation(**{**values, **changes})
