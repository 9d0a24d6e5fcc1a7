"""Metrics of velocities against a truth that has one.

A truth may know the velocity of some frames or of some entries only, the rest is NaN: each metric is over the
frames that it has both sides of, and a note says when they are not all.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.metrics import pose_errors
from posetrack_cli.evaluation.metrics.measures import Matched, Measures, common_columns, shape_columns
from posetrack_cli.evaluation.track import Track

LINEAR_METRIC = "velocity_error_mm_s"
ANGULAR_METRIC = "angular_velocity_error_deg_s"
ANGLES_METRIC = "angle_velocity_error_deg_s"
LINEAR, ANGULAR, SHAPE = slice(0, 3), slice(3, 6), 6
"""Columns of a twist; the shape's begin at 6."""
NO_VELOCITY = "the truth has no velocity"


def velocity_metrics(measures: Measures, matched: Matched, *, angles: bool = False) -> None:
    """Add |v_est - v_true|, |R_est w_est - R_true w_true| and, of angles, |angle' - true angle'|.

    The angular velocities of both sides are in their own body's axes, so they are brought to camera axes
    before they are compared.

    Args:
        measures: where to.
        matched: the frames with a truth.
        angles: whether the shape entries are angles of joints.
    """
    if reason := velocity_lacks(matched):
        return measures.lack(reason, LINEAR_METRIC, ANGULAR_METRIC, *([ANGLES_METRIC] if angles else []))
    _linear(measures, matched)
    _angular(measures, matched)
    if angles:
        _angles(measures, matched)


def velocity_lacks(matched: Matched) -> str:
    """Why velocities cannot be compared at all; empty when they can."""
    if reason := matched.lacks("twist"):
        return reason
    if estimates_no_velocity(matched.estimate):
        return "the run estimates no velocity"
    return NO_VELOCITY if _moves_without_velocity(matched.truth) else ""


def estimates_no_velocity(track: Track) -> bool:
    """Return whether all velocities are exactly 0 and certain, as a filter without velocity writes them."""
    both = (track.twist, track.twist_variance)
    return len(track) > 0 and not any(array is not None and array.any() for array in both)


def _moves_without_velocity(truth: Track) -> bool:
    """Whether all velocities are exactly 0 though the pose changes, as a filter without velocity says."""
    moves = any(
        array is not None and (array != array[:1]).any() for array in (truth.position, truth.quaternion)
    )
    return moves and truth.twist is not None and not truth.twist.any()


def _linear(measures: Measures, matched: Matched) -> None:
    mine, theirs = matched.of_estimate("twist", LINEAR), matched.of_truth("twist", LINEAR)
    _add(measures, LINEAR_METRIC, pose_errors.distances(mine, theirs))


def _angular(measures: Measures, matched: Matched) -> None:
    if reason := matched.lacks("quaternion"):
        return measures.lack(reason, ANGULAR_METRIC)
    mine, theirs = matched.of_estimate("twist", ANGULAR), matched.of_truth("twist", ANGULAR)
    turns = matched.of_estimate("quaternion"), matched.of_truth("quaternion")
    errors = pose_errors.angular_velocity_errors_deg(mine, theirs, *turns)
    _add(measures, ANGULAR_METRIC, errors)


def _angles(measures: Measures, matched: Matched) -> None:
    common = common_columns(matched.estimate.shape_names, matched.truth.shape_names)
    if not common.names:
        return measures.lack("the truth has no finger angles", ANGLES_METRIC)
    mine, theirs = shape_columns(matched, "twist", common, SHAPE)
    errors = np.degrees(np.abs(mine - theirs))
    known = _add(measures, ANGLES_METRIC, errors)
    if known.any():
        measures.summarise_parts(ANGLES_METRIC, errors[known], common.names)


def _add(measures: Measures, address: str, errors: FloatArray) -> BoolArray:
    """Add the errors (M,) or (M, K) of the frames where they are known; return which (M,) these are."""
    known = known_frames(errors)
    if len(known) and not known.any():
        measures.lack(NO_VELOCITY, address)
        return known
    if not known.all():
        measures.notes.append(f"{address} is over the {int(known.sum())} of {len(known)} frames that have it")
    measures.add(address, errors, known)
    return known


def known_frames(errors: FloatArray) -> BoolArray:
    """Return in which frames (M,) all errors, (M,) or (M, K), are known, that is finite."""
    finite: BoolArray = np.isfinite(errors)
    known: BoolArray = np.logical_and.reduce(finite, axis=tuple(range(1, finite.ndim)))
    return known
