"""Metrics of a hand against truth."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.alignment import tracked_pairs
from posetrack_cli.evaluation.evaluation import Count, Curve
from posetrack_cli.evaluation.metrics import pose_errors
from posetrack_cli.evaluation.metrics.covariance_metrics import POSE_AXES, covariance_metrics
from posetrack_cli.evaluation.metrics.measures import (
    Common,
    Matched,
    Measures,
    common_columns,
    rows_of,
    shape_columns,
)
from posetrack_cli.evaluation.metrics.velocity_metrics import velocity_metrics
from posetrack_cli.geometry.rotations import conjugate, rotate
from posetrack_cli.hand.anatomy import ANGLE_NAMES, FINGERS, JOINT_NAMES

WITHIN_MM = (10, 20, 30, 40, 50, 80)
"""Thresholds D of the metrics ``frames_within_<D>mm`` and ``frames_mean_within_<D>mm``."""
BIAS = "joint_bias_mm"
COMPONENTS = tuple(f"joint_bias_{axis}_mm" for axis in "xyz")
BIAS_METRICS = (BIAS, *COMPONENTS)


CURVE_MM: FloatArray = np.arange(0.0, 101.0)
"""Thresholds of the curve, mm."""
OTHER_JOINTS = "the truth has other joints"
_WRIST = JOINT_NAMES[0]
_WITHIN = tuple(f"frames_within_{threshold}mm" for threshold in WITHIN_MM)
_MEAN_WITHIN = tuple(f"frames_mean_within_{threshold}mm" for threshold in WITHIN_MM)
STATE_PARTS = ("position", "rotation", "angles", *POSE_AXES, *ANGLE_NAMES)
"""Parts of the state that the covariance metrics tell apart, down to its single entries."""
_JOINT_METRICS = (
    "joint_error_mm",
    "joint_error_tracked_mm",
    "finger_error_mm",
    "fingertip_error_mm",
    "largest_joint_error_mm",
)


def joint_bias(measures: Measures, matched: Matched, joints: Common) -> None:
    """Add the mean error vector of each joint in the palm's axes, over the frames that are not lost.

    With R_i the estimated rotation of the hand: b_j = mean_i R_i^T (p_ij - p_true,ij), mm, estimate minus
    truth. Of a right hand x points to the thumb, y to the wrist, z out of the back of the hand. The whole's
    length is the mean of |b_j| over the joints, its components are those of the mean of b_j.
    """
    if matched.estimate.quaternion is None:
        return measures.lack("the result has no rotation", *BIAS_METRICS)
    if not len(matched):
        return measures.lack(measures.nothing, *BIAS_METRICS)
    biases = _biases(matched, joints)
    _add(measures, BIAS, np.linalg.norm(biases, axis=1), joints.names)
    for component, values in zip(COMPONENTS, biases.T, strict=True):
        _add(measures, component, values, joints.names)


def _biases(matched: Matched, joints: Common) -> FloatArray:
    """(P, 3), one joint at a time: a long track's points are most of its memory."""
    track, truth = matched.estimate, matched.truth
    rows, true_rows = tracked_pairs(track, matched.pairs)
    assert track.quaternion is not None and track.points is not None and truth.points is not None
    back = conjugate(track.quaternion[rows])
    return np.array(
        [
            rotate(back, track.points[rows, mine] - truth.points[true_rows, theirs]).mean(axis=0)
            for mine, theirs in zip(joints.estimate, joints.truth, strict=True)
        ]
    )


def _add(measures: Measures, address: str, values: FloatArray, names: tuple[str, ...]) -> None:
    measures.metrics[address] = float(values.mean())
    measures.metrics |= {f"{address}.{name}": float(v) for name, v in zip(names, values, strict=True)}


def hand_metrics(measures: Measures, matched: Matched, missed: int) -> Curve | None:
    """Add every metric of a hand; return the curve if there are joints to compare.

    The error of a joint is the Euclidean distance |p_est - p_true|, mm. ``joint_error_mm`` summarises it
    over frames and joints, ``largest_joint_error_mm`` the largest of each frame. Joints are matched by name.

    Args:
        measures: where to.
        matched: the M frames with a truth; lost ones count like all others.
        missed: truths that the result has no estimate for.
    """
    curve = _joints(measures, matched, missed)
    _wrist(measures, matched)
    _angles(measures, matched)
    velocity_metrics(measures, matched, angles=True)
    covariance_metrics(measures, matched, STATE_PARTS)
    return curve


def _joints(measures: Measures, matched: Matched, missed: int) -> Curve | None:
    joints = common_columns(matched.estimate.point_names, matched.truth.point_names)
    reason = matched.lacks("points") or ("" if joints.names else OTHER_JOINTS)
    if reason:
        measures.lack(reason, *_JOINT_METRICS, *_WITHIN, *_MEAN_WITHIN, *BIAS_METRICS)
        return None
    if joints.lacking:
        total = len(joints.names) + len(joints.lacking)
        lacking = ", ".join(joints.lacking)
        measures.notes.append(
            f"joint errors over {len(joints.names)} of {total} joints: the truth has no {lacking}"
        )
    errors = joint_errors(matched, joints)
    measures.add_parts("joint_error_mm", errors, joints.names)
    _tracked(measures, matched, errors)
    _fingers(measures, errors, joints.names)
    joint_bias(measures, matched, joints)
    return _largest(measures, errors, missed)


def joint_errors(matched: Matched, joints: Common) -> FloatArray:
    """Return the distances (M, P) between estimated and true joints, mm."""
    pairs = (
        (matched.of_estimate("points", mine), matched.of_truth("points", theirs))
        for mine, theirs in zip(joints.estimate, joints.truth, strict=True)
    )
    return pose_errors.distances_by_point(pairs, len(matched))


def _tracked(measures: Measures, matched: Matched, errors: FloatArray) -> None:
    """Joint errors where the track is not lost; a result that does not say is taken as not lost."""
    lost = matched.estimate.lost
    kept = errors if lost is None else errors[~rows_of(lost, matched.pairs.estimate)]
    nothing = "every frame with truth is lost" if len(matched) else ""
    measures.summarise("joint_error_tracked_mm", kept, nothing)


def _fingers(measures: Measures, errors: FloatArray, names: tuple[str, ...]) -> None:
    """Joint errors of the fingers together, of each finger, and of the fingertips."""
    columns = {
        finger: [i for i, name in enumerate(names) if name.startswith(f"{finger}_")] for finger in FINGERS
    }
    of_fingers = [i for own in columns.values() for i in own]
    tips = [i for i in of_fingers if names[i].endswith("_tip")]
    for address, own in (("finger_error_mm", of_fingers), ("fingertip_error_mm", tips)):
        if own:
            measures.add(address, errors[:, own])
        else:
            measures.lack(OTHER_JOINTS, address)
    for finger, own in columns.items():
        measures.summarise(f"finger_error_mm.{finger}", errors[:, own], "" if own else OTHER_JOINTS)


def _largest(measures: Measures, errors: FloatArray, missed: int) -> Curve | None:
    """The largest error of each frame, and the curve: share of frames due that stay below D.

    Due are the frames with a truth: those matched and those that the result missed, which count as not
    below. An estimate without truth cannot be judged and is not among them; coverage counts it.
    """
    largest, mean = errors.max(axis=1), errors.mean(axis=1)
    measures.add("largest_joint_error_mm", largest)
    due = len(errors) + missed
    if not due:
        measures.lack(measures.nothing, *_WITHIN, *_MEAN_WITHIN)
        return None
    for names, values in ((_WITHIN, largest), (_MEAN_WITHIN, mean)):
        shares = pose_errors.share_below(values, np.array(WITHIN_MM), due)
        measures.metrics |= {name: float(share) for name, share in zip(names, shares, strict=True)}
        measures.counts |= {
            name: Count(round(float(share) * due), due) for name, share in zip(names, shares, strict=True)
        }
    return Curve(CURVE_MM, *(pose_errors.share_below(values, CURVE_MM, due) for values in (largest, mean)))


def _wrist(measures: Measures, matched: Matched) -> None:
    """Position and rotation of the wrist, which is the origin of hand coordinates.

    A truth of joints alone has its wrist among them.
    """
    reason = matched.lacks("position")
    joints = common_columns(matched.estimate.point_names, matched.truth.point_names)
    if not reason:
        measures.add(
            "wrist_position_mm",
            pose_errors.distances(matched.of_estimate("position"), matched.of_truth("position")),
        )
    elif _WRIST in joints.names and not matched.lacks("points"):
        at = joints.names.index(_WRIST)
        only = Common((_WRIST,), (joints.estimate[at],), (joints.truth[at],), ())
        measures.add("wrist_position_mm", joint_errors(matched, only)[:, 0])
    else:
        measures.lack(reason, "wrist_position_mm")
    if reason := matched.lacks("quaternion"):
        measures.lack(reason, "wrist_rotation_deg")
    else:
        measures.add(
            "wrist_rotation_deg",
            pose_errors.rotation_errors_deg(
                matched.of_estimate("quaternion"), matched.of_truth("quaternion")
            ),
        )


def _angles(measures: Measures, matched: Matched) -> None:
    """Absolute errors |angle_est - angle_true|; joint limits keep angles far from a full turn."""
    common = common_columns(matched.estimate.shape_names, matched.truth.shape_names)
    if reason := matched.lacks("shape") or ("" if common.names else "the truth has other finger angles"):
        return measures.lack(reason, "angle_error_deg")
    mine, theirs = shape_columns(matched, "shape", common)
    measures.add_parts("angle_error_deg", np.degrees(np.abs(mine - theirs)), common.names)
