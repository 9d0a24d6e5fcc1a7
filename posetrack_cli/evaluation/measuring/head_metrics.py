"""Head metrics: pose and points against ground truth, and landmarks against image annotations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.measuring import pose_metrics
from posetrack_cli.evaluation.measuring.measures import Matched, Measures, common_columns
from posetrack_cli.evaluation.measuring.pose_metrics import (
    POSE_AXES,
    covariance_metrics,
    distances,
    velocity_metrics,
)
from posetrack_cli.geometry.camera import Camera, pixels_from_points
from posetrack_cli.geometry.rigid import in_object
from posetrack_cli.head.subject import OUTER_EYES

HEAD_POSE = ("x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg")
"""Columns of tables 4.1-4.3 of the thesis, each reported as mean and standard deviation."""
# Deformations are left out, as their axes are those of the face model, which the ground truth does not share.
STATE_PARTS = ("position", "rotation", *POSE_AXES)
"""Parts of the state that covariance metrics are reported for."""
_POSITION, _ROTATION = (*HEAD_POSE[:3], "position_mm"), (*HEAD_POSE[3:], "rotation_deg")


def head_metrics(measures: Measures, matched: Matched, missed: int = 0) -> None:
    """Add all head metrics over the M frames with ground truth, including lost ones."""
    _position(measures, matched)
    _rotation(measures, matched)
    _points(measures, matched)
    velocity_metrics(measures, matched)
    covariance_metrics(measures, matched, STATE_PARTS)


def _position(measures: Measures, matched: Matched) -> None:
    """Add |x|, |y|, |z| of t_est - t_true in camera axes, and its norm."""
    if reason := matched.lacks("position"):
        return measures.lack(reason, *_POSITION)
    mine, theirs = matched.of_estimate("position"), matched.of_truth("position")
    for column, name in enumerate(HEAD_POSE[:3]):
        measures.add(name, np.abs(mine[:, column] - theirs[:, column]))
    measures.add("position_mm", pose_metrics.distances(mine, theirs))


def _rotation(measures: Measures, matched: Matched) -> None:
    """Add absolute differences of roll, pitch and yaw (``geometry.rotations``), and the angle of
    q_est^-1 q_true."""
    if reason := matched.lacks("quaternion"):
        return measures.lack(reason, *_ROTATION)
    mine, theirs = matched.of_estimate("quaternion"), matched.of_truth("quaternion")
    errors = pose_metrics.euler_errors_deg(mine, theirs)
    for column, name in enumerate(HEAD_POSE[3:]):
        measures.add(name, errors[:, column])
    measures.add("rotation_deg", pose_metrics.rotation_errors_deg(mine, theirs))


def _points(measures: Measures, matched: Matched) -> None:
    """Add distances of points in head coordinates, m = R^T (p - t), each side by its own pose (figure 4.11).

    This leaves out the pose error; the remaining error is that of the shape.
    """
    points = common_columns(matched.estimate.point_names, matched.truth.point_names)
    reason = matched.lacks("points", "position", "quaternion")
    if reason := reason or ("" if points.names else "the ground truth has other points"):
        return measures.lack(reason, "point_error_mm")
    if points.lacking:
        measures.notes.append(
            f"point errors without {', '.join(points.lacking)}: missing in the ground truth"
        )
    pairs = (
        (_in_head(matched.of_estimate, mine), _in_head(matched.of_truth, theirs))
        for mine, theirs in zip(points.estimate, points.truth, strict=True)
    )
    errors = pose_metrics.distances_by_point(pairs, len(matched))
    measures.add_parts("point_error_mm", errors, points.names)


def _in_head(side: Callable[..., FloatArray], point: int) -> FloatArray:
    """Return a point (M, 3) of the estimate or the ground truth in head coordinates."""
    return in_object(side("points", point), side("position"), side("quaternion"))


# Landmarks annotated in images


ERROR, NORMALISED = "landmark_error_px", "landmark_nme"


def landmark_metrics(measures: Measures, matched: Matched, camera: Callable[[], Camera]) -> None:
    """Add the distances between projected and annotated points, px, and normalised by the eye distance, %.

    Args:
        measures: collector.
        matched: the frames with ground truth.
        camera: returns the camera of the estimates, with lens distortion; called only if needed.
    """
    estimate, truth = matched.estimate, matched.truth
    if truth.pixels is None:
        return measures.lack("the ground truth has no image points", ERROR, NORMALISED)
    points = common_columns(estimate.point_names, truth.point_names)
    if estimate.points is None or not points.names:
        return measures.lack("the result has other points", ERROR, NORMALISED)
    projected, visible = pixels_from_points(camera(), matched.of_estimate("points")[:, points.estimate])
    pixels = matched.of_truth("pixels")
    errors = distances(projected, pixels[:, points.truth])
    # Projections of points behind the camera are meaningless, so such frames are left out.
    known: BoolArray = np.logical_and.reduce(visible, axis=1)
    if not known.all():
        measures.notes.append(
            f"landmark errors without {(~known).sum()} frames with points outside the field of view"
        )
    measures.add(ERROR, errors, known)
    measures.summarise_parts(ERROR, errors[known], points.names)
    right, left = (pixels[:, truth.point_names.index(name)] for name in OUTER_EYES)
    measures.add(NORMALISED, 100.0 * np.mean(errors, axis=1) / distances(right, left), known)
