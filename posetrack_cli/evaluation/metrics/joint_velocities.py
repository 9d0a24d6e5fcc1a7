"""Velocities of a hand's joints against central differences of the true ones.

A truth of joints alone has no velocity of a pose. With J the derivative of a joint's coordinates by the
tangent vector, u the stated twist and P the stated, diagonal covariance of it, the estimated velocity of a
joint is J u, and to first order its variance is sum_k J_k^2 P_kk. The true one is::

    (p_t+1 - p_t-1) / (stamp_t+1 - stamp_t-1)

of frames whose two neighbours are at most ``FARTHEST`` usual intervals apart.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import PosetrackError
from posetrack_cli.evaluation.coverage import usual_interval
from posetrack_cli.evaluation.metrics import pose_errors
from posetrack_cli.evaluation.metrics.joint_intervals import hand_lacks, jacobians, poses_of
from posetrack_cli.evaluation.metrics.measures import Matched, Measures, common_columns, rows_of
from posetrack_cli.evaluation.metrics.velocity_metrics import NO_VELOCITY, estimates_no_velocity, known_frames
from posetrack_cli.evaluation.track import Track
from posetrack_cli.hand.anatomy import JOINT_NAMES, HandAnatomy
from posetrack_cli.units import NS_PER_S

ERROR = "joint_velocity_error_mm_s"
INTERVALS = {f"joint_velocity_{name}": half_width for name, half_width in pose_errors.INTERVALS.items()}
_SAME_MM = 0.01
FARTHEST = 3.0
"""Two neighbours lie two intervals apart; where more than one frame is missing they are not neighbours."""


def joint_velocities(measures: Measures, matched: Matched, anatomy: Callable[[], HandAnatomy]) -> None:
    """Add |J u - v_true| of joints, and the shares of true velocities inside the 50 % and 90 % intervals.

    Args:
        measures: where to.
        matched: the frames with a truth.
        anatomy: makes the bones of the hand that was tracked; is asked where everything else is there, and
            raises PosetrackError where they are not known.
    """
    joints = common_columns(matched.estimate.point_names, matched.truth.point_names)
    reason = hand_lacks(matched, joints) or matched.lacks("points") or _lacks(matched.estimate)
    if reason or not len(matched):
        return measures.lack(reason or measures.nothing, ERROR, *INTERVALS)
    true = rows_of(central_differences(matched.truth), matched.pairs.truth)[:, joints.truth]
    if not known_frames(true).any():
        return measures.lack(NO_VELOCITY, ERROR, *INTERVALS)
    try:
        velocity, variance = _of_joints(matched, anatomy())
    except PosetrackError as error:
        return measures.lack(f"bones of the hand are not known: {error}", ERROR, *INTERVALS)
    off = true - velocity[:, joints.estimate]
    known = known_frames(off)
    distances: FloatArray = np.linalg.norm(off, axis=-1)
    measures.add(ERROR, distances, known)
    measures.summarise_parts(ERROR, distances[known], joints.names)
    normalised = pose_errors.normalised_squares(off, variance[:, joints.estimate])[known]
    for metric, half_width in INTERVALS.items():
        inside = pose_errors.inside_interval(normalised, half_width)
        measures.share(metric, inside)
        for column, name in enumerate(joints.names):
            measures.share(f"{metric}.{name}", inside[:, column])


def central_differences(truth: Track) -> FloatArray:
    """Return the velocities (N, P, 3), mm/s, of a truth's points; NaN without two near neighbours."""
    assert truth.points is not None
    velocities: FloatArray = np.full(truth.points.shape, np.nan)
    if len(truth) < 3:
        return velocities
    spans = (truth.stamp_ns[2:] - truth.stamp_ns[:-2]) / NS_PER_S
    near = spans <= FARTHEST * usual_interval(truth.stamp_ns) / NS_PER_S
    rows = 1 + np.flatnonzero(near)
    velocities[rows] = (truth.points[rows + 1] - truth.points[rows - 1]) / spans[near][:, None, None]
    return velocities


def _lacks(track: Track) -> str:
    """Why a result has no velocity of joints; empty where it has one."""
    if len(track) and _is_moved(track):
        return "poses are aligned, and no longer those of the joints"
    if track.twist is None or track.twist_variance is None or estimates_no_velocity(track):
        return "the run estimates no velocity"
    return ""


def _is_moved(track: Track) -> bool:
    """Whether an alignment has moved the poses, whose origin is the wrist."""
    assert track.position is not None and track.points is not None
    return not np.allclose(track.position, track.points[:, 0], rtol=0.0, atol=_SAME_MM)


def _of_joints(matched: Matched, anatomy: HandAnatomy) -> tuple[FloatArray, FloatArray]:
    """The estimated velocities (M, 21, 3) of joints, mm/s, and their variances."""
    twist, variance = matched.of_estimate("twist"), matched.of_estimate("twist_variance")
    found: FloatArray = np.empty((2, len(matched), len(JOINT_NAMES), 3))
    with np.errstate(all="ignore"):  # a stranger's poses may be too large for any derivative
        for rows, jacobian in jacobians(anatomy, *poses_of(matched)):
            found[0, rows] = np.einsum("njck,nk->njc", jacobian, twist[rows])
            found[1, rows] = np.einsum("njck,nk->njc", jacobian**2, variance[rows])
    return found[0], found[1]
