"""What the tests of HTML reports share."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posetrack_cli.evaluation.measuring.evaluation import Evaluation, statistics
from posetrack_cli.evaluation.reading.tracks import Coverage, Pairs, Track
from posetrack_cli.evaluation.viewing.pictures import Picture
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.rotations import FACING

PNG = cv2.imencode(".png", np.full((4, 8), 128, dtype=np.uint8))[1].tobytes()
HEAD_POINTS = tuple(f"point_{i}" for i in range(10))


def picture(frame_index: int = 1, stamp_ns: int = 33_333_333) -> Picture:
    return Picture(PNG, frame_index, stamp_ns, f"frame {frame_index}, joint error 8.0 mm")


def head_track(name: str, frames: int, error_mm: float) -> Track:
    """A head that turns from side to side and nods, with ten points."""
    rng = np.random.default_rng(3)
    t = np.arange(frames) / 30.0
    position = np.stack([20 * np.sin(t), 10 * np.cos(t), np.full(frames, 800.0)], axis=1)
    position = position + error_mm * rng.standard_normal((frames, 3))
    turn = np.stack([0.2 * np.sin(2 * t), 0.5 * np.sin(t), np.zeros(frames)], axis=1)
    quaternion = rotations.canonical(rotations.multiply(rotations.exponential(turn), np.array(FACING)))
    model = rng.uniform(-50.0, 50.0, (10, 3)) * [1.0, 1.0, 0.3]
    return Track(
        name,
        "head",
        ("a1", "a2"),
        HEAD_POINTS,
        (),
        stamp_ns=np.arange(frames, dtype=np.int64) * 33_333_333,
        lost=np.zeros(frames, dtype=np.bool_),
        reinitialised=np.zeros(frames, dtype=np.bool_),
        position=position,
        quaternion=quaternion,
        shape=np.stack([np.sin(t), np.cos(t)], axis=1),
        pose_variance=np.full((frames, 8), 1e-4),
        points=position[:, None] + rotations.rotate(quaternion[:, None], model),
    )


def head_evaluation(frames: int = 100, **changes: Any) -> Evaluation:
    """A head against its truth."""
    track, truth = head_track("a", frames, 2.0), head_track("truth", frames, 0.0)
    assert track.position is not None
    assert truth.position is not None
    errors = np.linalg.norm(track.position - truth.position, axis=1)
    rows = np.arange(frames, dtype=np.int64)
    values: dict[str, Any] = {
        "name": "a",
        "path": Path("a.mcap"),
        "subject": "head",
        "run": {},
        "coverage": Coverage(frames, frames, 0, 0, 0, 0, 0, True, frames),
        "metrics": {"coverage": 1.0, "position_mm": statistics(errors)},
        "absent": {},
        "series": {"position_mm": errors, "rotation_deg": np.zeros(frames)},
        "series_stamp_ns": track.stamp_ns,
        "curve": None,
        "notes": (),
        "losses": (),
        "track": track,
        "truth": truth,
        "pairs": Pairs(rows, rows),
    }
    return Evaluation(**{**values, **changes})


NASTY = "</script><img src=x onerror=alert(1)>&\"' ü 手 \u202e"


def shortened(evaluation: Evaluation, frames: int) -> Evaluation:
    """The first frames of an evaluation."""

    def cut(track: Track) -> Track:
        arrays = {k: v[:frames] for k, v in vars(track).items() if isinstance(v, np.ndarray)}
        return dataclasses.replace(track, **arrays)

    rows = np.arange(frames, dtype=np.int64)
    assert evaluation.truth is not None
    return dataclasses.replace(
        evaluation,
        coverage=Coverage(frames, frames, 0, 0, 0, 0, 0, True, frames),
        series={name: values[:frames] for name, values in evaluation.series.items()},
        series_stamp_ns=evaluation.series_stamp_ns[:frames],
        track=cut(evaluation.track),
        truth=cut(evaluation.truth),
        pairs=Pairs(rows, rows),
    )


def without_truth(evaluation: Evaluation) -> Evaluation:
    frames = len(evaluation.track)
    return dataclasses.replace(
        evaluation,
        coverage=Coverage(frames, frames, 0, 0, frames, 0, 0, False, 0),
        metrics={"coverage": 1.0},
        absent={"joint_error_mm": "no truth"},
        series={},
        series_stamp_ns=evaluation.series_stamp_ns[:0],
        curve=None,
        truth=None,
        pairs=None,
        judged=None,
    )
