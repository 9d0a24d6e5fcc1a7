"""What a head tracker says about a frame, as results hold it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rotations import quaternion_rate
from posetrack_cli.head.face.points import MEAN_SHAPE
from posetrack_cli.head.face.pose import POSE_SIZE, HeadPose
from posetrack_cli.head.tracker.confidence import NO_SIGNS
from posetrack_cli.head.tracker.frame_tracker import FrameFit, TrackState
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status

UNSEEN = HeadPose(np.array([0.0, 0.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0]))
"""Pose reported before the first detection: before the camera, looking at it; its status is lost."""
UNKNOWN_SD = np.array([300.0] * 3 + [1.0] * 3)
"""(6,) mm and rad, of a head whose place is not known."""


@dataclass(frozen=True, eq=False)
class Description:
    """A face as the result of a frame states it.

    Attributes:
        coefficients: (B,) deformation; where a fit has fewer, the rest of its variances and rates is 0.
        deviations: (B,) standard deviations of the coefficients while the face is not seen.
        diagnostics: (M,) what ``head.subject`` names.
        systematic: (6,) variances of what the whole track is wrong by, mm^2 in camera axes and rad^2 in the
            head's, beside those of a frame; None where nothing is known.
    """

    coefficients: FloatArray
    deviations: FloatArray
    diagnostics: FloatArray
    systematic: FloatArray | None = None


def tracked_estimate(
    frame: Frame,
    fit: FrameFit,
    status: Status,
    confidence: float,
    face: Description,
    signs: FloatArray,
) -> Estimate:
    """Return the estimate of a frame in which the head was followed, and what its confidence rests on.

    Velocities are differences of two frames' estimates, whose errors are taken for independent.
    """
    count, now = len(face.coefficients), fit.track
    rotation = now.pose.rotation
    variance = in_body_axes(padded(fit.variance, POSE_SIZE + count), rotation)
    rate = padded(fit.coefficient_rate, count)
    stated = variance.copy()
    if face.systematic is not None:
        stated[:POSE_SIZE] += face.systematic
    twist = np.concatenate([now.velocity[:3], rotation.T @ now.velocity[3:], rate])
    return Estimate(
        frame_index=frame.index,
        stamp_ns=frame.stamp_ns,
        status=status,
        confidence=confidence,
        position=now.pose.position,
        quaternion=now.pose.quaternion,
        shape=face.coefficients,
        pose_rate=np.concatenate([twist[:3], quaternion_rate(now.pose.quaternion, twist[3:6]), rate]),
        twist=twist,
        pose_variance=stated,
        twist_variance=2.0 * variance / fit.dt**2,
        points=now.pose.points(now.shape),
        effective_sample_size=fit.effective_sample_size,
        resampled=True,
        numbers=np.concatenate([face.diagnostics, signs]),
    )


def lost_estimate(frame: Frame, track: TrackState | None, face: Description) -> Estimate:
    """Return the estimate of a frame in which the head was not found: where it was last, status lost."""
    pose = UNSEEN if track is None else track.pose
    shape = MEAN_SHAPE if track is None else track.shape
    count = len(face.coefficients)
    nothing = np.zeros(POSE_SIZE + count)
    variance = np.concatenate([np.square(UNKNOWN_SD), np.square(face.deviations)])
    return Estimate(
        frame_index=frame.index,
        stamp_ns=frame.stamp_ns,
        status=Status.LOST,
        confidence=0.0,
        position=pose.position,
        quaternion=pose.quaternion,
        shape=face.coefficients,
        pose_rate=np.zeros(POSE_SIZE + 1 + count),
        twist=nothing,
        pose_variance=variance,
        twist_variance=variance,
        points=pose.points(shape),
        effective_sample_size=None,
        resampled=False,
        numbers=np.concatenate([face.diagnostics, NO_SIGNS]),
    )


def padded(values: FloatArray, count: int) -> FloatArray:
    """Return the first ``count`` values; zeros where there are fewer."""
    filled = np.zeros(count)
    filled[: len(values)] = values[:count]
    return filled


def in_body_axes(variance: FloatArray, rotation: FloatArray) -> FloatArray:
    """Variances (6 + B,) whose rotation part is about the head's axes instead of the camera's."""
    turned = variance.copy()
    turned[3:6] = np.square(rotation.T) @ variance[3:6]
    return turned
