"""Metrics of a head against truth: the thesis's x, y, z, roll, pitch, yaw (tables 4.1-4.3) and its points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.metrics import pose_errors
from posetrack_cli.evaluation.metrics.covariance_metrics import POSE_AXES, covariance_metrics
from posetrack_cli.evaluation.metrics.measures import Matched, Measures, common_columns
from posetrack_cli.evaluation.metrics.velocity_metrics import velocity_metrics
from posetrack_cli.geometry.rigid import in_object

HEAD_POSE = ("x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg")
"""Columns of the thesis's tables 4.1-4.3, each as mean and standard deviation."""
STATE_PARTS = ("position", "rotation", *POSE_AXES)
"""Parts of the state that the covariance metrics tell apart; deformations are left out.

Their axes belong to the model, and a truth's is another.
"""
_POSITION, _ROTATION = (*HEAD_POSE[:3], "position_mm"), (*HEAD_POSE[3:], "rotation_deg")


def head_metrics(measures: Measures, matched: Matched, missed: int = 0) -> None:
    """Add every metric of a head over the M frames with a truth; lost ones count like all others."""
    _position(measures, matched)
    _rotation(measures, matched)
    _points(measures, matched)
    velocity_metrics(measures, matched)
    covariance_metrics(measures, matched, STATE_PARTS)


def _position(measures: Measures, matched: Matched) -> None:
    """|x|, |y|, |z| of t_est - t_true in camera axes, and its length."""
    if reason := matched.lacks("position"):
        return measures.lack(reason, *_POSITION)
    mine, theirs = matched.of_estimate("position"), matched.of_truth("position")
    for column, name in enumerate(HEAD_POSE[:3]):
        measures.add(name, np.abs(mine[:, column] - theirs[:, column]))
    measures.add("position_mm", pose_errors.distances(mine, theirs))


def _rotation(measures: Measures, matched: Matched) -> None:
    """Absolute differences of roll, pitch and yaw (``geometry.euler``), and the angle of q_est^-1 q_true."""
    if reason := matched.lacks("quaternion"):
        return measures.lack(reason, *_ROTATION)
    mine, theirs = matched.of_estimate("quaternion"), matched.of_truth("quaternion")
    errors = pose_errors.euler_errors_deg(mine, theirs)
    for column, name in enumerate(HEAD_POSE[3:]):
        measures.add(name, errors[:, column])
    measures.add("rotation_deg", pose_errors.rotation_errors_deg(mine, theirs))


def _points(measures: Measures, matched: Matched) -> None:
    """Distances of points in head coordinates, m = R^T (p - t), each side by its own pose (figure 4.11).

    The pose's error is so kept out: what remains is the error of the shape.
    """
    points = common_columns(matched.estimate.point_names, matched.truth.point_names)
    reason = matched.lacks("points", "position", "quaternion")
    if reason := reason or ("" if points.names else "the truth has other points"):
        return measures.lack(reason, "point_error_mm")
    if points.lacking:
        measures.notes.append(f"point errors without {', '.join(points.lacking)}: the truth has none")
    pairs = (
        (_in_head(matched.of_estimate, mine), _in_head(matched.of_truth, theirs))
        for mine, theirs in zip(points.estimate, points.truth, strict=True)
    )
    errors = pose_errors.distances_by_point(pairs, len(matched))
    measures.add_parts("point_error_mm", errors, points.names)


def _in_head(side: Callable[..., FloatArray], point: int) -> FloatArray:
    """A point (M, 3) in head coordinates, of the estimate or of the truth."""
    return in_object(side("points", point), side("position"), side("quaternion"))
