"""Whether true joints lie within the intervals that a result states of its pose.

A result states variances of the pose's entries, not of joints. With J the derivative of a joint's coordinates
by the tangent vector and P the stated, diagonal covariance, to first order::

    var = diag(J diag(P) J^T) = sum_k J_k^2 P_kk

Of the wrist, which is the pose's position, that is what is stated; for other joints it leaves out how errors
of the entries hang together, which no result states. A truth of joints alone has no other intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import PosetrackError
from posetrack_cli.evaluation.metrics import pose_errors
from posetrack_cli.evaluation.metrics.measures import Common, Matched, Measures, common_columns
from posetrack_cli.hand.anatomy import ANGLE_NAMES, JOINT_NAMES, HandAnatomy
from posetrack_cli.hand.inner import thumbs_of
from posetrack_cli.hand.kinematics import joint_jacobian

METRICS = {f"joint_{name}": half_width for name, half_width in pose_errors.INTERVALS.items()}
BLOCK_FRAMES = 512
"""Derivatives are many times the size of a long track: so many frames at a time."""


def joint_variances(
    anatomy: HandAnatomy, poses: FloatArray, thumbs: FloatArray, variances: FloatArray
) -> FloatArray:
    """Return the variances (N, 21, 3), mm^2, camera axes, of the joints of poses.

    Args:
        anatomy: of the hand.
        poses: (N, 22) position, mm, quaternion and angles, rad.
        thumbs: (N, 2) their inner angles (``hand.inner``), rad.
        variances: (N, 21) of the tangent vector's entries, mm^2 and rad^2.
    """
    found: FloatArray = np.empty((len(poses), len(JOINT_NAMES), 3))
    with np.errstate(all="ignore"):  # a stranger's poses may be too large for any derivative
        for rows, jacobian in jacobians(anatomy, poses, thumbs):
            found[rows] = np.einsum("njck,nk->njc", jacobian**2, variances[rows])
    return found


def jacobians(
    anatomy: HandAnatomy, poses: FloatArray, thumbs: FloatArray
) -> Iterator[tuple[slice, FloatArray]]:
    """Yield blocks of rows, and J (n, 21, 3, 21) of their poses; see ``joint_variances``."""
    for rows in (slice(first, first + BLOCK_FRAMES) for first in range(0, len(poses), BLOCK_FRAMES)):
        yield rows, joint_jacobian(anatomy, poses[rows], thumbs[rows])


def poses_of(matched: Matched) -> tuple[FloatArray, FloatArray]:
    """Return the estimated poses (M, 22), and the inner angles (M, 2) of their thumbs."""
    poses = np.hstack([matched.of_estimate(name) for name in ("position", "quaternion", "shape")])
    numbers = None if matched.estimate.numbers is None else matched.of_estimate("numbers")
    return poses, thumbs_of(numbers, len(poses))


def joint_intervals(measures: Measures, matched: Matched, anatomy: Callable[[], HandAnatomy]) -> None:
    """Add the shares of true joint coordinates inside the 50 % and 90 % intervals, also joint by joint.

    Args:
        measures: where to.
        matched: the frames with a truth.
        anatomy: makes the bones of the hand that was tracked; is asked where everything else is there, and
            raises PosetrackError where they are not known.
    """
    joints = common_columns(matched.estimate.point_names, matched.truth.point_names)
    reason = hand_lacks(matched, joints) or ("" if len(matched) else measures.nothing)
    if reason:
        return measures.lack(reason, *METRICS)
    try:
        normalised = dict(_normalised(matched, joints, anatomy()))
    except PosetrackError as error:
        return measures.lack(f"bones of the hand are not known: {error}", *METRICS)
    together = np.stack(list(normalised.values()), axis=1)
    for metric, half_width in METRICS.items():
        measures.share(metric, pose_errors.inside_interval(together, half_width))
        for name, own in normalised.items():
            measures.share(f"{metric}.{name}", pose_errors.inside_interval(own, half_width))


def hand_lacks(matched: Matched, joints: Common) -> str:
    """Return why a pose tells nothing of joints that could be compared; empty where it does."""
    track = matched.estimate
    if track.position is None or track.quaternion is None or track.pose_variance is None:
        return "the result has no pose with covariance"
    if track.point_names != JOINT_NAMES or track.shape_names != ANGLE_NAMES:
        return "the result has other joints or angles than the hand's"
    return matched.lacks("points") or ("" if joints.names else "the truth has other joints")


def _normalised(matched: Matched, joints: Common, anatomy: HandAnatomy) -> Iterator[tuple[str, FloatArray]]:
    """The squares (M, 3) of each joint's errors over their variances."""
    variances = joint_variances(anatomy, *poses_of(matched), matched.of_estimate("pose_variance"))
    for name, mine, theirs in zip(joints.names, joints.estimate, joints.truth, strict=True):
        errors = matched.of_truth("points", theirs) - matched.of_estimate("points", mine)
        yield name, pose_errors.normalised_squares(errors, variances[:, mine])
