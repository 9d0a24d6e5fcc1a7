"""The trajectory that a result holds."""

from __future__ import annotations

from typing import Any

import numpy as np

from posetrack_cli.evaluation.association import check_stamps
from posetrack_cli.evaluation.track import Track
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.estimate import Status, Subject
from posetrack_cli.results.fields import FIELD_NAMES
from posetrack_cli.results.reader import Result
from posetrack_cli.results.tracks import FILTERED

MOTION_FIELDS = ("stamp_ns", "status", "position", "quaternion", "shape", "twist", "points")
"""What a truth is made from, of the fields of an Estimate."""
_TRACK_FIELDS = tuple(name for name in FIELD_NAMES if name != "pose_rate")  # twist says the same


def track_of_result(result: Result, name: str, which: str = FILTERED) -> Track:
    """Return the estimates of one of a result's tracks, lost ones included.

    Args:
        result: finished or not; what of it cannot be read is in ``result.losses`` afterwards.
        name: what tables and errors call it.
        which: ``filtered`` or ``smoothed``.

    Raises:
        ResultError: nothing can be read, the stamps do not increase strictly, or there is no such track.
    """
    columns = result.columns(result.topic_of_track(which), _TRACK_FIELDS)
    status = columns["status"]
    return Track(
        **_motion(columns, name, result.subject),
        lost=status == Status.LOST.value,
        reinitialised=status == Status.REINITIALISED.value,
        pose_variance=_known(columns["pose_variance"]),
        twist_variance=_known(columns["twist_variance"]),
        confidence=columns["confidence"],
        cost=columns["cost"],
        effective_sample_size=_known(columns["effective_sample_size"]),
        milliseconds=columns["milliseconds"],
        evaluations=_known(columns["evaluations"]),
        resampled=columns["resampled"],
        frame_index=columns["frame_index"],
    )


def truth_of_columns(columns: Columns, name: str, subject: Subject) -> Track:
    """Return the trajectory of estimates that are taken for the truth.

    It has no status, variances and particles of its own. Estimates that are lost are no truth and are left
    out: frames without a truth count as unmatched.

    Args:
        columns: of ``MOTION_FIELDS``.
        name: what tables and errors call it.
        subject: whose shape entries and points they are.

    Raises:
        ResultError: the stamps do not increase strictly.
    """
    known = columns["status"] != Status.LOST.value
    if not known.all():
        columns = {key: column[known] for key, column in columns.items()}
        name = f"{name} without its {int((~known).sum())} lost frames"
    return Track(**_motion(columns, name, subject))


def _motion(columns: Columns, name: str, subject: Subject) -> dict[str, Any]:
    """Return what estimate and truth have in common."""
    check_stamps(columns["stamp_ns"], name)
    return {
        "name": name,
        "subject": subject.name,
        "shape_names": subject.shape_names,
        "point_names": subject.point_names,
        "point_parents": subject.point_parents,
        "stamp_ns": columns["stamp_ns"],
        "position": columns["position"],
        "quaternion": columns["quaternion"],
        "shape": columns["shape"],
        "twist": _known(columns["twist"]),
        "points": columns["points"] if subject.point_names else None,
    }


def _known(column: np.ndarray[Any, Any]) -> np.ndarray[Any, Any] | None:
    """Return the column, or None if no message had it."""
    return None if len(column) and np.isnan(column).all() else column
