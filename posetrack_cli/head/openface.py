"""Export of a head track as CSV of OpenFace's FeatureExtraction (Baltrusaitis et al. 2018).

Columns are those of OpenFace for pose and landmarks, with the ten of its 68 landmarks that are tracked.
``frame`` counts from 1. Camera axes are ours: x right, y down, z forward. ``pose_R`` are angles of
R = Rx Ry Rz, rad, all 0 for a head that looks along -z at the camera; positive for a head that lowers its
face (Rx), turns to its own right (Ry), tilts to its own left shoulder (Rz). ``pose_T`` is the mean of the
eye corners, mm, whereas OpenFace's origin is the mean of 68 landmarks, some 40 mm lower. Landmarks are in
px of the reference camera's image, and in mm. ``success`` is 0, and pose and landmarks are empty, where the
head is lost.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.geometry.rotations import FACING, matrices_from_quaternions, multiply
from posetrack_cli.head.face.points import POINT_NAMES
from posetrack_cli.head.landmarks.faces import IBUG_68
from posetrack_cli.results.derived import is_tracked, pixels
from posetrack_cli.results.export.source import ExportSource
from posetrack_cli.tables import csv_of
from posetrack_cli.units import NS_PER_S

FIELDS = ("frame_index", "stamp_ns", "status", "confidence", "position", "quaternion", "points")
_LEADING = ("frame", "face_id", "timestamp", "confidence", "success")
_POSE = tuple(f"pose_{kind}{axis}" for kind in "TR" for axis in "xyz")


def openface_text(source: ExportSource) -> Iterator[str]:
    """Yield the CSV of a head track, header first.

    Raises:
        UsageError: it is not a head.
        ResultError: the result has no calibration, or see ``ExportSource.blocks``.
    """
    subject, cameras = source.result.subject, source.result.image_cameras
    if subject.point_names != POINT_NAMES:
        what = f"openface requires a result of posetrack head mono or stereo, not of a {subject.name}"
        raise UsageError(what, where=source.result.path)
    if not cameras:
        raise ResultError("has no camera calibration", where=source.result.path)
    order = np.argsort(IBUG_68)
    blocks = source.begun_blocks(FIELDS)
    yield csv_of([[*_LEADING, *_POSE, *(f"{axis}_{IBUG_68[k]}" for axis in "xyXYZ" for k in order)]])
    first_ns: int | None = None
    for block in blocks:
        tracked, stamps = is_tracked(block), block["stamp_ns"].tolist()
        first_ns = stamps[0] if first_ns is None and stamps else first_ns
        placed = [pixels(block, cameras[0]), block["points"]]
        landmarks = np.concatenate([values[:, order].swapaxes(1, 2) for values in placed], axis=1)
        numbers = [block["position"], euler_xyz(block["quaternion"]), landmarks.reshape(len(stamps), 50)]
        values = np.where(tracked[:, None], np.hstack(numbers), np.nan).tolist()
        yield csv_of(
            [
                *(frame + 1, 0, (stamp - (first_ns or 0)) / NS_PER_S, confidence, int(success)),
                *(None if value != value else value for value in row),
            ]
            for frame, stamp, confidence, success, row in zip(
                block["frame_index"].tolist(),
                stamps,
                block["confidence"].tolist(),
                tracked,
                values,
                strict=True,
            )
        )


def euler_xyz(quaternions: FloatArray) -> FloatArray:
    """Return OpenFace's angles (N, 3), rad, of rotations of heads (N, 4): R = Rx Ry Rz after half a turn."""
    R = matrices_from_quaternions(multiply(quaternions, np.array(FACING)))
    about_x = np.arctan2(-R[:, 1, 2], R[:, 2, 2])
    about_y = np.arcsin(np.clip(R[:, 0, 2], -1.0, 1.0))
    return np.stack([about_x, about_y, np.arctan2(-R[:, 0, 1], R[:, 0, 0])], axis=1)
