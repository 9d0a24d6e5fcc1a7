"""Subjects, and files of truth about them, for tests of where truth comes from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.model.anatomy import ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.writer import ResultWriter
from support.tracks import random_quaternions

CAMERA = Camera(512, 424, 365.0, 365.0, 255.5, 211.5, name="camera")
HAND = Subject("hand", "camera", ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)
HEAD = Subject("head", "camera", ("b1", "b2"), ("eye", "nose", "mouth"), (-1, -1, -1))
FRAME_NS = 33_333_333


def estimates(
    subject: Subject, frames: int, *, seed: int = 0, lost: Sequence[int] = (), velocity: bool = True
) -> list[Estimate]:
    """Random estimates at 30 Hz from 0; every number tells its place."""
    rng = np.random.default_rng(seed)
    k, p = len(subject.shape_names), len(subject.point_names)
    quaternions = random_quaternions(rng, frames)
    return [
        Estimate(
            frame_index=i,
            stamp_ns=i * FRAME_NS,
            status=Status.LOST if i in lost else Status.TRACKING,
            confidence=0.5,
            position=100.0 * rng.standard_normal(3),
            quaternion=quaternions[i],
            shape=rng.standard_normal(k),
            pose_rate=rng.standard_normal(7 + k) if velocity else None,
            twist=rng.standard_normal(6 + k) if velocity else None,
            pose_variance=rng.uniform(1.0, 2.0, 6 + k),
            twist_variance=rng.uniform(1.0, 2.0, 6 + k) if velocity else None,
            points=100.0 * rng.standard_normal((p, 3)),
            effective_sample_size=100.0 + i,
            resampled=bool(i % 2),
            cost=None if i % 3 else 4.0 + i,
        )
        for i in range(frames)
    ]


def write_result(
    path: Path, subject: Subject, own: Iterable[Estimate], truth: Iterable[TruthMessage] = ()
) -> Path:
    """Write a finished result."""
    with ResultWriter(path, subject, CAMERA, {"tracker": subject.name}) as writer:
        for message in truth:
            writer.add_truth(message)
        for one in own:
            writer.write(one)
        writer.finish({})
    return path


def write_csv(path: Path, columns: dict[str, Any], comments: Sequence[str] = ()) -> Path:
    """Write columns so that reading gives the same bits."""
    lines = [f"# {comment}" for comment in comments]
    lines.append(",".join(columns))
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines += [",".join(repr(cell) for cell in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def pose_columns(own: Sequence[Estimate]) -> dict[str, Any]:
    """Stamps and poses as a CSV names them."""
    position = np.array([one.position for one in own])
    quaternion = np.array([one.quaternion for one in own])
    columns: dict[str, Any] = {"stamp_ns": [one.stamp_ns for one in own]}
    columns |= {f"{axis}_mm": position[:, i] for i, axis in enumerate("xyz")}
    return columns | {f"q{axis}": quaternion[:, i] for i, axis in enumerate("xyzw")}


def point_columns(subject: Subject, points: np.ndarray) -> dict[str, Any]:
    """Points (N, P, 3) as a CSV names them."""
    return {
        f"{name}_{axis}_mm": points[:, i, j]
        for i, name in enumerate(subject.point_names)
        for j, axis in enumerate("xyz")
    }
