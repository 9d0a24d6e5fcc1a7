"""Metrics of velocities against a truth that has one."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation import pose_errors
from posetrack_cli.evaluation.measures import Matched, Measures, common_columns
from posetrack_cli.evaluation.track import Track

LINEAR, ANGULAR, ANGLES = "velocity_error_mm_s", "angular_velocity_error_deg_s", "angle_velocity_error_deg_s"


def velocity_metrics(measures: Measures, matched: Matched) -> None:
    """Add |v_est - v_true|, |R_est w_est - R_true w_true| and of a hand |angle' - true angle'|.

    The angular velocities of both sides are in their own body's axes, so they are brought to camera axes
    before they are compared. Frames without a velocity on either side are left out, and a note says so.
    """
    reason = velocity_lacks(matched)
    if reason:
        return measures.lack(reason, LINEAR, ANGULAR, ANGLES)
    known = frames_with_velocity(matched)
    if not known.all():
        measures.notes.append(
            f"velocity errors over the {int(known.sum())} of {len(known)} frames with a velocity"
        )
    measures.add(LINEAR, _linear(matched), known)
    if reason := matched.lacks("quaternion"):
        measures.lack(reason, ANGULAR)
    else:
        measures.add(ANGULAR, _angular(matched), known)
    _add_angles(measures, matched, known)


def velocity_lacks(matched: Matched) -> str:
    """Why velocities cannot be compared; empty when they can."""
    if reason := matched.lacks("twist"):
        return reason
    if estimates_no_velocity(matched.estimate):
        return "the run estimates no velocity"
    return "" if frames_with_velocity(matched).any() or not len(matched) else "the truth has no velocity"


def estimates_no_velocity(track: Track) -> bool:
    """Whether all velocities are exactly 0 and certain, as a filter without velocity writes them."""
    both = (track.twist, track.twist_variance)
    return len(track) > 0 and not any(array is not None and array.any() for array in both)


def frames_with_velocity(matched: Matched) -> BoolArray:
    """Which matched frames (M,) have a velocity on both sides; elsewhere it is NaN."""
    finite = (
        np.isfinite(side).all(axis=1) for side in (matched.of_estimate("twist"), matched.of_truth("twist"))
    )
    known: BoolArray = np.logical_and(*finite)
    return known


def _linear(matched: Matched) -> FloatArray:
    linear = slice(0, 3)
    return pose_errors.distances(matched.of_estimate("twist", linear), matched.of_truth("twist", linear))


def _angular(matched: Matched) -> FloatArray:
    angular = slice(3, 6)
    return pose_errors.angular_velocity_errors_deg(
        matched.of_estimate("twist", angular),
        matched.of_truth("twist", angular),
        matched.of_estimate("quaternion"),
        matched.of_truth("quaternion"),
    )


def _add_angles(measures: Measures, matched: Matched, known: BoolArray) -> None:
    if matched.estimate.subject != "hand":
        return
    common = common_columns(matched.estimate.shape_names, matched.truth.shape_names)
    if not common.names:
        return measures.lack("the truth has no finger angles", ANGLES)
    mine = matched.of_estimate("twist", slice(6, None))[:, common.estimate]
    theirs = matched.of_truth("twist", slice(6, None))[:, common.truth]
    errors = np.degrees(np.abs(mine - theirs))
    measures.add_parts(ANGLES, errors, common.names, known)
