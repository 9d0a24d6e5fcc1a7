"""Random people who move their faces, and results as a tracker that makes no error would write them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.face.points import POINT_NAMES, HeadPose
from posetrack_cli.head.multilinear.build import mirrored
from posetrack_cli.head.subject import StereoDiagnostics, head_subject
from posetrack_cli.head.tracker.frame_tracker import NO_SIGNS
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.results.writer import ResultWriter
from posetrack_cli.synthesis.head.person import random_points

CAMERA = Camera(640, 480, 700.0, 700.0, 319.5, 239.5, name="left")
ROW = {name: row for row, name in enumerate(POINT_NAMES)}
Alter = Callable[[int, np.ndarray], np.ndarray]


def moved(**right: Sequence[float]) -> np.ndarray:
    """A symmetric displacement (K, 3) by what the points of the right half do, mm."""
    shape = np.zeros((len(POINT_NAMES), 3))
    for name, by in right.items():
        shape[ROW[f"right_{name}"]] = by
    return shape + mirrored(shape)


WIDE = moved(mouth_corner=(-7.0, 4.0, -8.0))
NARROW = moved(mouth_corner=(5.0, 1.0, 9.0))
LONG = moved(mouth_corner=(2.0, -13.0, -11.0), brow_inner=(-0.4, 4.5, -0.3), nostril=(0.0, -1.5, 0.0))
SHORT = moved(mouth_corner=(0.0, 3.0, 1.0), brow_inner=(2.0, -2.5, 1.0))


def motions() -> np.ndarray:
    """Ten actions (A, K, 3): the mouth grows wide from narrow, the face long from short."""
    strengths = np.linspace(-1.0, 1.0, 5)[:, None, None]
    up, down = np.maximum(strengths, 0.0), np.maximum(-strengths, 0.0)
    return np.concatenate([up * WIDE + down * NARROW, up * LONG + down * SHORT])


def people(count: int, seed: int = 0) -> np.ndarray:
    """Neutral faces (count, K, 3), mm."""
    rng = np.random.default_rng(seed)
    return np.stack([random_points(rng) for _ in range(count)])


def acting(neutral: np.ndarray) -> np.ndarray:
    """Faces (S, K, 3) in all actions (S, A, K, 3); wider faces move more."""
    width = np.linalg.norm(neutral[:, 3] - neutral[:, 0], axis=-1) / 89.0
    return neutral[:, None] + width[:, None, None, None] * motions()


def performance(neutral: np.ndarray, frames: int = 400) -> np.ndarray:
    """One face (K, 3) at rest for a quarter of the frames (frames, K, 3), then in each motion, to and fro."""
    times = np.linspace(0.0, 1.0, frames)
    sideways = np.where((times > 0.25) & (times < 0.6), np.sin(4.0 * np.pi * (times - 0.25) / 0.35), 0.0)
    along = np.where(times >= 0.65, np.sin(4.0 * np.pi * (times - 0.65) / 0.35), 0.0)
    up, down = (np.maximum(sign * np.stack([sideways, along]), 0.0) for sign in (1.0, -1.0))
    moves = np.einsum("mt,mki->tki", up, np.stack([WIDE, LONG]))
    moves += np.einsum("mt,mki->tki", down, np.stack([NARROW, SHORT]))
    return neutral + moves


def write_stereo_result(
    path: Path,
    shapes: np.ndarray,
    *,
    lost: Sequence[int] = (),
    weights: np.ndarray | None = None,
    tracker: str = "head-stereo",
) -> Path:
    """A result of shapes (N, K, 3) of a head that turns about, with the weights (N, K) of the points."""
    subject = head_subject(CAMERA.name, 0)
    with ResultWriter(path, subject, CAMERA, {"tracker": tracker, "configuration": "{}"}) as writer:
        for index, shape in enumerate(shapes):
            known = np.ones(len(POINT_NAMES)) if weights is None else weights[index]
            status = Status.LOST if index in lost else Status.TRACKING
            writer.write(_estimate(index, status, shape, known))
        writer.finish({})
    return path


def _estimate(index: int, status: Status, shape: np.ndarray, weights: np.ndarray) -> Estimate:
    turn = np.array([0.1, 0.3, 0.05]) * np.sin(0.1 * index)
    pose = HeadPose(np.array([0.0, 0.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0]))
    pose = pose.moved(np.concatenate([[5.0 * np.cos(0.1 * index), 2.0, 0.0], turn]))
    return Estimate(
        frame_index=index,
        stamp_ns=index * 33_333_333,
        status=status,
        confidence=0.9,
        position=pose.position,
        quaternion=pose.quaternion,
        shape=np.zeros(0),
        pose_rate=None,
        twist=None,
        pose_variance=None,
        twist_variance=None,
        points=pose.points(shape),
        effective_sample_size=None,
        resampled=False,
        numbers=np.concatenate([StereoDiagnostics(np.zeros(0), weights=weights).numbers(0), NO_SIGNS]),
    )
