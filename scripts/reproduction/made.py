"""What posetrack's commands make once: kept while the same code would make the same of the same arguments."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from posetrack_cli.build import source_digest
from posetrack_cli.cli.main import run as posetrack
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, PosetrackError
from posetrack_cli.head.face.points import MEAN_SHAPE, SHAPE_SD

DRAWING = (
    "synthesis/*.py",
    "synthesis/head/*.py",
    "head/face/pose.py",
    "geometry/camera.py",
    "geometry/distortion.py",
    "geometry/kernels.py",
    "geometry/rigid.py",
    "geometry/rotations.py",
    "rendering/port.py",
    "rendering/gl/device.py",
    "rendering/gl/textured.py",
    "rendering/gl/shaders/textured.*",
)
"""What a synthetic head's images and truth come from, beside the average face."""


def command(*arguments: str) -> None:
    """Run ``posetrack`` in this process.

    Raises:
        PosetrackError: it failed.
    """
    code = posetrack(list(arguments))
    if code not in (EXIT_DONE, EXIT_DATA_LOST):
        raise PosetrackError(f"posetrack {' '.join(arguments[:3])} ended with exit code {code}")


def is_made(path: Path, facts: Mapping[str, object]) -> bool:
    """Whether a file is there that was made of these facts."""
    stamp = stamp_path(path)
    return path.exists() and stamp.exists() and stamp.read_text("utf-8") == _text(facts)


def mark_made(path: Path, facts: Mapping[str, object]) -> None:
    """Keep beside a file what it was made of."""
    stamp_path(path).write_text(_text(facts), encoding="utf-8")


def stamp_path(path: Path) -> Path:
    """Return the name of the file that tells what a file was made of."""
    return path.with_name(f"{path.name}.made.json")


def drawing_digest() -> str:
    """SHA-256 over the sources that synthetic heads are drawn by, and the average face."""
    face = json.dumps([MEAN_SHAPE.tolist(), SHAPE_SD.tolist()])
    return hashlib.sha256(f"{source_digest(DRAWING)}{face}".encode()).hexdigest()


def _text(facts: Mapping[str, object]) -> str:
    return json.dumps(facts, indent=1) + "\n"
