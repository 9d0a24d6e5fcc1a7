"""Hand metrics: errors, covariance consistency and velocities of joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import PosetrackError
from posetrack_cli.evaluation.measuring import pose_metrics
from posetrack_cli.evaluation.measuring.evaluation import Count, Curve
from posetrack_cli.evaluation.measuring.measures import (
    Common,
    Matched,
    Measures,
    absolute_deg,
    common_columns,
    rows_of,
    shape_difference,
)
from posetrack_cli.evaluation.measuring.pose_metrics import (
    NO_VELOCITY,
    POSE_AXES,
    covariance_metrics,
    estimates_no_velocity,
    known_frames,
    velocity_metrics,
)
from posetrack_cli.evaluation.reading.alignment import tracked_pairs
from posetrack_cli.evaluation.reading.tracks import Track, usual_interval
from posetrack_cli.geometry.rotations import conjugate, rotate
from posetrack_cli.hand.fit.skeleton import thumbs_of
from posetrack_cli.hand.model.anatomy import ANGLE_NAMES, FINGERS, JOINT_NAMES, HandAnatomy
from posetrack_cli.hand.model.kinematics import joint_jacobian
from posetrack_cli.units import NS_PER_S

WITHIN_MM = (10, 20, 30, 40, 50, 80)
"""Thresholds D of the metrics ``frames_within_<D>mm`` and ``frames_mean_within_<D>mm``."""
BIAS = "joint_bias_mm"
COMPONENTS = tuple(f"joint_bias_{axis}_mm" for axis in "xyz")
BIAS_METRICS = (BIAS, *COMPONENTS)


CURVE_MM: FloatArray = np.arange(0.0, 101.0)
"""Thresholds of ``Curve``, mm."""
OTHER_JOINTS = "the ground truth has other joints"
_WRIST = JOINT_NAMES[0]
_WITHIN = tuple(f"frames_within_{threshold}mm" for threshold in WITHIN_MM)
_MEAN_WITHIN = tuple(f"frames_mean_within_{threshold}mm" for threshold in WITHIN_MM)
STATE_PARTS = ("position", "rotation", "angles", *POSE_AXES, *ANGLE_NAMES)
"""Parts of the state that covariance metrics are reported for: blocks and single entries."""
_JOINT_METRICS = (
    "joint_error_mm",
    "joint_error_tracked_mm",
    "finger_error_mm",
    "fingertip_error_mm",
    "largest_joint_error_mm",
)


def joint_bias(measures: Measures, matched: Matched, joints: Common) -> None:
    """Add the mean error vector of each joint in palm axes, over the tracked frames.

    With R_i the estimated rotation of the hand: b_j = mean_i R_i^T (p_ij - p_true,ij), mm. For a right hand,
    x points to the thumb, y to the wrist, z out of the back of the hand. The value of the whole hand is the
    mean of |b_j| over the joints; its components are those of the mean of b_j.
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
    """Return b_j (P, 3), one joint at a time, as the points dominate the memory of a long track."""
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
    """Add all hand metrics; return the error curve if there are joints to compare.

    The error of a joint is the Euclidean distance |p_est - p_true|, mm. ``joint_error_mm`` summarises it
    over frames and joints, ``largest_joint_error_mm`` the maximum of each frame. Joints are matched by name.

    Args:
        measures: collector.
        matched: the M frames with ground truth, including lost ones.
        missed: number of ground-truth frames without an estimate.
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
            f"joint errors over {len(joints.names)} of {total} joints: the ground truth has no {lacking}"
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
    return pose_metrics.distances_by_point(pairs, len(matched))


def _tracked(measures: Measures, matched: Matched, errors: FloatArray) -> None:
    """Add joint errors over the frames that are not lost; without a status, all frames count as tracked."""
    lost = matched.estimate.lost
    tracked = None if lost is None else ~rows_of(lost, matched.pairs.estimate)
    nothing = "all frames with ground truth are lost" if len(matched) else ""
    measures.summarise("joint_error_tracked_mm", errors, nothing, tracked)


def _fingers(measures: Measures, errors: FloatArray, names: tuple[str, ...]) -> None:
    """Add joint errors of all fingers, of each finger, and of the fingertips."""
    columns = {
        finger: [i for i, name in enumerate(names) if name.startswith(f"{finger}_")] for finger in FINGERS
    }
    of_fingers = [i for own in columns.values() for i in own]
    tips = [i for i in of_fingers if names[i].endswith("_tip")]
    for address, own in (("finger_error_mm", of_fingers), ("fingertip_error_mm", tips)):
        if own:
            measures.add(address, rows_of(errors.T, np.array(own)).T)
        else:
            measures.lack(OTHER_JOINTS, address)
    for finger, own in columns.items():
        measures.summarise(f"finger_error_mm.{finger}", errors[:, own], "" if own else OTHER_JOINTS)


def _largest(measures: Measures, errors: FloatArray, missed: int) -> Curve | None:
    """Add the largest error of each frame, and return the share of expected frames below each threshold D.

    Expected are the frames with ground truth, matched or missed; missed frames count as above D. Estimates
    without ground truth are left out here and counted by the coverage metrics.
    """
    largest, mean = errors.max(axis=1), errors.mean(axis=1)
    measures.add("largest_joint_error_mm", largest)
    due = len(errors) + missed
    if not due:
        measures.lack(measures.nothing, *_WITHIN, *_MEAN_WITHIN)
        return None
    for names, values in ((_WITHIN, largest), (_MEAN_WITHIN, mean)):
        shares = pose_metrics.share_below(values, np.array(WITHIN_MM), due)
        measures.metrics |= {name: float(share) for name, share in zip(names, shares, strict=True)}
        measures.counts |= {
            name: Count(round(float(share) * due), due)  # the share is a quotient of integers
            for name, share in zip(names, shares, strict=True)
        }
    return Curve(CURVE_MM, *(pose_metrics.share_below(values, CURVE_MM, due) for values in (largest, mean)))


def _wrist(measures: Measures, matched: Matched) -> None:
    """Add position and rotation errors of the wrist, the origin of hand coordinates.

    Ground truth without poses provides the position as its wrist joint.
    """
    reason = matched.lacks("position")
    joints = common_columns(matched.estimate.point_names, matched.truth.point_names)
    if not reason:
        measures.add(
            "wrist_position_mm",
            pose_metrics.distances(matched.of_estimate("position"), matched.of_truth("position")),
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
            pose_metrics.rotation_errors_deg(
                matched.of_estimate("quaternion"), matched.of_truth("quaternion")
            ),
        )


def _angles(measures: Measures, matched: Matched) -> None:
    """Add absolute errors |angle_est - angle_true|."""
    common = common_columns(matched.estimate.shape_names, matched.truth.shape_names)
    missing = "" if common.names else "the ground truth has other finger angles"
    if reason := matched.lacks("shape") or missing:
        return measures.lack(reason, "angle_error_deg")
    # No wrap-around: joint limits keep the angles far from a full turn.
    errors = absolute_deg(shape_difference(matched, "shape", common))
    measures.add_parts("angle_error_deg", errors, common.names)


# Covariance consistency of joints.
#
# Results store variances of the pose entries, not of joints. With J the derivative of a joint's coordinates
# with respect to the tangent vector and P the stored diagonal covariance, to first order::
#
#     var = diag(J diag(P) J^T) = sum_k J_k^2 P_kk
#
# For the wrist, the origin of the pose, this is the stored variance. For other joints it ignores correlations
# between the entries, which are not stored. With ground truth of joints only, these are the only intervals.


METRICS = {f"joint_{name}": half_width for name, half_width in pose_metrics.INTERVALS.items()}
BLOCK_FRAMES = 128
"""Number of frames per block, as the Jacobians of a long track need many times its memory."""


def joints_by_pose(measures: Measures, matched: Matched, anatomy: Callable[[], HandAnatomy]) -> None:
    """Add the metrics of ``JointIntervals`` and ``JointVelocities``, or why there are none.

    Args:
        measures: collector.
        matched: the frames with ground truth.
        anatomy: returns the anatomy of the tracked hand, or raises PosetrackError; called only if needed.
    """
    joints = common_columns(matched.estimate.point_names, matched.truth.point_names)
    lacking = hand_lacks(matched, joints) or ("" if len(matched) else measures.nothing)
    wanted: list[JointIntervals | JointVelocities] = []
    for kind, names in ((JointIntervals, METRICS), (JointVelocities, (ERROR, *INTERVALS))):
        if reason := lacking or kind.lacks(matched):
            measures.lack(reason, *names)
        else:
            wanted.append(kind(matched, joints))
    if not wanted:
        return
    try:
        of_hand = anatomy()
    except PosetrackError as error:
        for one in wanted:
            measures.lack(f"unknown hand anatomy: {error}", *one.names)
        return
    with np.errstate(all="ignore"):  # poses of untrusted results can overflow the derivatives
        for first in range(0, len(matched), BLOCK_FRAMES):
            rows = slice(first, first + BLOCK_FRAMES)
            jacobian = _jacobian(of_hand, matched.estimate, matched.pairs.estimate[rows])
            for one in wanted:
                one.add(rows, jacobian)
    for one in wanted:
        one.finish(measures)


def _jacobian(anatomy: HandAnatomy, track: Track, rows: IntArray) -> FloatArray:
    """Return the derivatives J (n, 21, 3, 21) of the joints in some rows of a track."""
    assert track.position is not None and track.quaternion is not None and track.shape is not None
    poses = np.hstack([track.position[rows], track.quaternion[rows], track.shape[rows]])
    thumbs = thumbs_of(None if track.numbers is None else track.numbers[rows], len(rows))
    return joint_jacobian(anatomy, poses, thumbs)


def propagated(jacobian: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the variances (n, 21, 3) of joints with derivatives J (n, 21, 3, 21) by pose entries."""
    by_component = jacobian.T  # frames last, as they are in memory
    found: FloatArray = np.einsum(
        "kcjn,kcjn,kn->cjn", by_component, by_component, np.ascontiguousarray(variances.T)
    )
    return found.T


class JointIntervals:
    """Shares of true joint coordinates inside the 50 % and 90 % intervals, overall and per joint."""

    names = tuple(METRICS)

    def __init__(self, matched: Matched, joints: Common) -> None:
        self._matched, self._joints = matched, joints
        self._shares = _Shares(METRICS, joints)

    @staticmethod
    def lacks(matched: Matched) -> str:
        """Return why there are none."""
        return ""

    def add(self, rows: slice, jacobian: FloatArray) -> None:
        """Add a block of frames, with the derivatives J (n, 21, 3, 21) of the joints."""
        part, joints = self._matched.part(rows), self._joints
        estimated, true = part.of_estimate("points"), part.of_truth("points")
        errors = true[:, joints.truth] - estimated[:, joints.estimate]
        variances = propagated(jacobian, part.of_estimate("pose_variance"))[:, joints.estimate]
        self._shares.add(pose_metrics.normalised_squares(errors, variances))

    def finish(self, measures: Measures) -> None:
        """Add the metrics."""
        self._shares.finish(measures)


class _Shares:
    """Counts of true coordinates inside intervals, by joint.

    Args:
        metrics: half widths of the intervals by metric, in standard deviations.
        joints: the compared joints.
    """

    def __init__(self, metrics: Mapping[str, float], joints: Common) -> None:
        self._metrics, self._names, self._frames = metrics, joints.names, 0
        self._inside = {metric: np.zeros(len(joints.names), dtype=np.int64) for metric in metrics}

    def add(self, normalised: FloatArray) -> None:
        """Add frames by their normalised squares (n, P, 3)."""
        self._frames += len(normalised)
        for metric, half_width in self._metrics.items():
            inside = pose_metrics.inside_interval(normalised, half_width)
            self._inside[metric] += inside.sum(axis=(0, 2))

    def finish(self, measures: Measures) -> None:
        """Add the shares, overall and per joint."""
        for metric, inside in self._inside.items():
            measures.add_share(metric, int(inside.sum()), 3 * self._frames * len(inside))
            for name, count in zip(self._names, inside.tolist(), strict=True):
                measures.add_share(f"{metric}.{name}", count, 3 * self._frames)


def hand_lacks(matched: Matched, joints: Common) -> str:
    """Return why joints cannot be computed from the poses and compared; empty if they can."""
    track = matched.estimate
    if track.position is None or track.quaternion is None or track.pose_variance is None:
        return "the result has no pose with covariance"
    if track.point_names != JOINT_NAMES or track.shape_names != ANGLE_NAMES:
        return "the result has other joints or angles than the hand model"
    return matched.lacks("points") or ("" if joints.names else OTHER_JOINTS)


# Joint velocities against central differences of the true positions, for ground truth of joints only.
#
# With J the derivative of a joint's coordinates with respect to the tangent vector, u the estimated twist and
# P its stored diagonal covariance, the estimated velocity of a joint is J u, and to first order its variance
# is sum_k J_k^2 P_kk. The true velocity is::
#
#     (p_t+1 - p_t-1) / (stamp_t+1 - stamp_t-1)
#
# for frames whose two neighbours are at most ``FARTHEST`` frame intervals apart.


ERROR = "joint_velocity_error_mm_s"
INTERVALS = {f"joint_velocity_{name}": half_width for name, half_width in pose_metrics.INTERVALS.items()}
_SAME_MM = 0.01
FARTHEST = 3.0
"""Maximum distance of the two neighbours in frame intervals; it is 2 without gaps and 3 with one missing
frame."""


class JointVelocities:
    """|J u - v_true| of joints, and the shares of true velocities inside the 50 % and 90 % intervals."""

    names = (ERROR, *INTERVALS)

    def __init__(self, matched: Matched, joints: Common) -> None:
        self._matched, self._joints = matched, joints
        self._distances = np.empty((len(matched), len(joints.names)))
        self._shares = _Shares(INTERVALS, joints)
        self._is_known = False  # in any frame
        self._usual_ns = usual_interval(matched.truth.stamp_ns) if len(matched.truth) > 1 else 0.0

    @staticmethod
    def lacks(matched: Matched) -> str:
        """Return why a result has no joint velocities; empty if it has."""
        track = matched.estimate
        if len(track) and _is_moved(track):
            return "not available after alignment of the poses"
        if track.twist is None or track.twist_variance is None or estimates_no_velocity(track):
            return "the run does not estimate velocities"
        return ""

    def add(self, rows: slice, jacobian: FloatArray) -> None:
        """Add a block of frames, with the derivatives J (n, 21, 3, 21) of the joints."""
        part, joints = self._matched.part(rows), self._joints
        true = central_differences(part.truth, part.pairs.truth, self._usual_ns)[:, joints.truth]
        self._is_known |= bool(known_frames(true).any())
        twist = np.ascontiguousarray(part.of_estimate("twist").T)
        velocity = np.einsum("kcjn,kn->cjn", jacobian.T, twist).T
        off = true - velocity[:, joints.estimate]
        self._distances[rows] = np.linalg.norm(off, axis=-1)
        variances = propagated(jacobian, part.of_estimate("twist_variance"))[:, joints.estimate]
        known = known_frames(self._distances[rows])
        self._shares.add(pose_metrics.normalised_squares(off, variances)[known])

    def finish(self, measures: Measures) -> None:
        """Add the metrics, of the frames with a true and an estimated velocity."""
        if not self._is_known:
            return measures.lack(NO_VELOCITY, *self.names)
        known = known_frames(self._distances)
        measures.add(ERROR, self._distances, known)
        distances = rows_of(self._distances, np.flatnonzero(known))
        measures.summarise_parts(ERROR, distances, self._joints.names)
        self._shares.finish(measures)


def central_differences(truth: Track, rows: IntArray, usual_ns: float) -> FloatArray:
    """Return the velocities (n, P, 3), mm/s, of the true points in some rows; NaN without two close
    neighbours.

    Args:
        truth: with points.
        rows: (n,) row numbers.
        usual_ns: its frame interval, ns.
    """
    assert truth.points is not None
    velocities: FloatArray = np.full((len(rows), *truth.points.shape[1:]), np.nan)
    at = np.flatnonzero((rows > 0) & (rows < len(truth) - 1))
    spans = (truth.stamp_ns[rows[at] + 1] - truth.stamp_ns[rows[at] - 1]) / NS_PER_S
    near = spans <= FARTHEST * usual_ns / NS_PER_S
    at, spans = at[near], spans[near]
    velocities[at] = (truth.points[rows[at] + 1] - truth.points[rows[at] - 1]) / spans[:, None, None]
    return velocities


def _is_moved(track: Track) -> bool:
    """Whether an alignment has moved the poses away from the wrist joint, their origin."""
    assert track.position is not None and track.points is not None
    return not np.allclose(track.position, track.points[:, 0], rtol=0.0, atol=_SAME_MM)
