"""Poses of the Biwi Kinect head pose data as truth: a folder of ``frame_NNNNN_pose.txt``.

A file has the head's rotation, row by row, and its centre in mm, in the axes of the data's camera. Which
camera that is, and where its head's origin lies, the data do not state next to the files: ``--align rigid``
removes both constants.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.errors import PosetrackError, TruthError
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry.rigid import rotation_from_rows
from posetrack_cli.geometry.rotations import canonical, quaternions_from_matrices
from posetrack_cli.head.subject import HEAD
from posetrack_cli.recording.datasets.biwi import SENSOR
from posetrack_cli.recording.datasets.layout import nominal_stamps, numbered, numbers_of

POSE_FILE = re.compile(r"frame_([0-9]{1,9})_pose\.txt")
NUMBERS = 12
"""In a file: the rotation's rows, and the centre."""


def holds_poses(folder: Path) -> bool:
    """Return whether a folder has files of poses."""
    try:
        return any(POSE_FILE.fullmatch(file.name) for file in folder.iterdir())
    except OSError:
        return False


def load_biwi_poses(folder: Path, run: Mapping[str, str]) -> Track:
    """Read the poses of a sequence, with the stamps that its images have.

    Args:
        folder: of the sequence.
        run: record of the result that is measured, whose frame rate counts.

    Raises:
        TruthError: a file cannot be used.
    """
    try:
        files = numbered(folder, POSE_FILE)
        if len(files) > limits.KEYPOINT_SETS:
            raise TruthError("too many poses", where=folder, found=len(files), expected=limits.KEYPOINT_SETS)
        fps = run.get("input.fps")
        stamps, _, _ = nominal_stamps(files, float(fps) if fps else None, SENSOR)
        values = [_numbers(file) for file in files.values()]
        rotations = [rotation_from_rows(v[:9], str(f)) for v, f in zip(values, files.values(), strict=True)]
    except TruthError:
        raise
    except (PosetrackError, ValueError) as error:
        raise TruthError(str(error)) from error
    return Track(
        folder.name,
        HEAD,
        shape_names=(),
        point_names=(),
        point_parents=(),
        stamp_ns=np.array(stamps),
        position=np.array([v[9:] for v in values]),
        quaternion=canonical(quaternions_from_matrices(np.array(rotations))),
    )


def _numbers(file: Path) -> list[float]:
    values = numbers_of(file)
    if len(values) != NUMBERS or not np.isfinite(values).all() or np.abs(values).max() > limits.LENGTH_MM:
        expected = "a rotation of nine numbers and a centre of three, mm"
        raise TruthError("is not a pose", where=file, found=f"{len(values)} numbers", expected=expected)
    return values
