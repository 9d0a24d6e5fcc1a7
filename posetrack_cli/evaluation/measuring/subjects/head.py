"""Metrics of heads: pose, face points, annotated landmarks."""

from __future__ import annotations

from posetrack_cli.evaluation.measuring.face_metrics import FACE_METRICS, eye_metrics
from posetrack_cli.evaluation.measuring.head_metrics import (
    HEAD_POSE,
    STATE_PARTS,
    head_metrics,
    landmark_metrics,
)
from posetrack_cli.evaluation.measuring.measures import Matched, Measures, Metric
from posetrack_cli.evaluation.measuring.subjects.kind import SubjectKind
from posetrack_cli.head.actions import ACTION_NAMES
from posetrack_cli.head.dense.numbers import MEASURED_SHARES
from posetrack_cli.head.subject import RIGHT_DEG, RIGHT_MM
from posetrack_cli.results.reader import Result

FAR_DEG = 10.0
_METRICS = (
    Metric("x_mm", "mm", "Absolute error of the head's position along x, right.", spoken="x error"),
    Metric("y_mm", "mm", "Absolute error of the head's position along y, down.", spoken="y error"),
    Metric("z_mm", "mm", "Absolute error of the head's position along z, the depth.", spoken="z error"),
    Metric("roll_deg", "deg", "Absolute error of the head's roll, about z.", spoken="roll error"),
    Metric("pitch_deg", "deg", "Absolute error of the head's pitch, about x.", spoken="pitch error"),
    Metric("yaw_deg", "deg", "Absolute error of the head's yaw, about y.", spoken="yaw error"),
    Metric(
        "position_mm",
        "mm",
        "Distance between the estimated and the true origin of the head.",
        spoken="position error",
    ),
    Metric(
        "rotation_deg",
        "deg",
        "Angle of the rotation between estimated and true head orientation, 0 to 180.",
        spoken="rotation error",
    ),
    Metric(
        "point_error_mm",
        "mm",
        "Distance between estimated and true feature point in head coordinates, each transformed by its own "
        "pose.",
        "point",
    ),
    Metric(
        "landmark_error_px",
        "px",
        "Image distance between projected and annotated feature point; includes a constant offset, as "
        "annotators define nostrils and brows differently.",
        "point",
    ),
    Metric(
        "landmark_nme",
        "%",
        "Normalised mean error: mean landmark error of a frame in percent of the distance between the "
        "annotated outer eye corners.",
        spoken="normalised mean landmark error",
    ),
    *FACE_METRICS,
)


def _face(measures: Measures, result: Result, matched: Matched) -> None:
    landmark_metrics(measures, matched, result.camera)
    eye_metrics(measures, matched)


HEAD = SubjectKind(
    name="head",
    body="Head",
    metrics=_METRICS,
    measure=head_metrics,
    parts={"state": STATE_PARTS},
    point_part="point",
    shape_part="",
    point_metric="point_error_mm",
    key_figures=(
        "coverage",
        *(f"{name}.mean" for name in (*HEAD_POSE, "position_mm", "rotation_deg", "point_error_mm")),
    ),
    studied_figures=(
        "velocity_error_mm_s.mean",
        "angular_velocity_error_deg_s.mean",
        "inside_90",
        "jitter_mm.mean",
        "ms_per_frame.median",
    ),
    lead=("position_mm", "rotation_deg"),
    readings=("position_mm", "rotation_deg", "point_error_mm"),
    worst_by=("point_error_mm", "position_mm", "landmark_error_px"),
    right={"rotation_deg": RIGHT_DEG, "point_error_mm": RIGHT_MM},
    far={"rotation_deg": FAR_DEG},
    measure_of_result=_face,
    expressions=(*(name for name in ACTION_NAMES if not name.endswith("_sd")), *MEASURED_SHARES),
)
