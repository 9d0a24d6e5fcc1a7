"""Foxglove messages of an estimate, in metres; everything else in posetrack is in millimetres."""

from __future__ import annotations

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rotations import matrices_from_quaternions
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.units import METRES_PER_MM

__all__ = [
    "CameraCalibration",
    "FrameTransforms",
    "JointStates",
    "Message",
    "Odometry",
    "SceneUpdate",
    "frame_transforms",
    "joint_states",
    "odometry",
]


def odometry(estimate: Estimate, subject: Subject) -> Odometry:
    """Return pose, velocity and known covariances in the convention of Foxglove and ROS.

    Pose: position and orientation of the body in the camera frame, its covariance (x, y, z, rotation
    about the camera's x, y, z). Velocity: linear and angular in the body frame, and its covariance. With
    R the rotation of ``camera_T_object`` and a twist (v in camera axes, w in the body frame),
        v_body = R^T v,   Cov(v_body) = R^T diag(var v) R,   Cov(rotation in camera) = R diag(var r) R^T.
    """
    rotation = matrices_from_quaternions(estimate.quaternion)
    message = Odometry(frame_id=subject.camera_frame, body_frame_id=subject.name)
    message.timestamp.FromNanoseconds(estimate.stamp_ns)
    _set_xyz(message.pose.position, estimate.position * METRES_PER_MM)
    _set_quaternion(message.pose.orientation, estimate.quaternion)
    if estimate.pose_variance is not None:
        message.pose_covariance.extend(_covariance(estimate.pose_variance, np.eye(3), rotation))
    if estimate.twist is not None and estimate.twist_variance is not None:
        _set_xyz(message.linear_velocity, rotation.T @ estimate.twist[:3] * METRES_PER_MM)
        _set_xyz(message.angular_velocity, estimate.twist[3:6])
        message.velocity_covariance.extend(_covariance(estimate.twist_variance, rotation.T, np.eye(3)))
    return message


def frame_transforms(estimate: Estimate, subject: Subject) -> FrameTransforms:
    """Return camera -> body, and one frame ``body/point`` per point below its parent's frame.

    All point frames have the body's orientation, so they differ only in translation, and a viewer that
    connects frames by lines draws the skeleton.
    """
    message = FrameTransforms()
    body = message.transforms.add(parent_frame_id=subject.camera_frame, child_frame_id=subject.name)
    body.timestamp.FromNanoseconds(estimate.stamp_ns)
    _set_xyz(body.translation, estimate.position * METRES_PER_MM)
    _set_quaternion(body.rotation, estimate.quaternion)
    names = [f"{subject.name}/{name}" for name in subject.point_names]
    translations = _point_translations(estimate, subject) * METRES_PER_MM
    for name, parent, translation in zip(names, subject.point_parents, translations.tolist(), strict=True):
        child = message.transforms.add(
            parent_frame_id=subject.name if parent < 0 else names[parent], child_frame_id=name
        )
        child.timestamp.CopyFrom(body.timestamp)
        _set_xyz(child.translation, translation)
        child.rotation.w = 1.0
    return message


def joint_states(estimate: Estimate, subject: Subject) -> JointStates:
    """Return value and, if known, rate of every shape parameter (finger angles: rad and rad/s)."""
    message = JointStates()
    message.timestamp.FromNanoseconds(estimate.stamp_ns)
    values = estimate.shape.tolist()
    rates = [None] * len(values) if estimate.twist is None else estimate.twist[6:].tolist()
    for name, value, rate in zip(subject.shape_names, values, rates, strict=True):
        message.joints.add(name=name, position=value, velocity=rate)
    return message


def _point_translations(estimate: Estimate, subject: Subject) -> FloatArray:
    """Return each point relative to its parent, (P, 3) mm, body axes."""
    parents = np.array(subject.point_parents, dtype=np.int64)
    with_origin = np.vstack([estimate.points, estimate.position])  # parent -1 is the last row
    rotation = matrices_from_quaternions(estimate.quaternion)
    return np.asarray((estimate.points - with_origin[parents]) @ rotation, dtype=np.float64)


def _covariance(variance: FloatArray, linear: FloatArray, angular: FloatArray) -> list[float]:
    """Return the row-major 6x6 covariance, metres and radians, with both diagonal blocks rotated."""
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = (linear * variance[:3]) @ linear.T * METRES_PER_MM**2
    matrix[3:, 3:] = (angular * variance[3:6]) @ angular.T
    return [float(value) for value in matrix.ravel()]


def _set_xyz(target: object, xyz: FloatArray | list[float]) -> None:
    target.x, target.y, target.z = (float(value) for value in xyz)  # type: ignore[attr-defined]


def _set_quaternion(target: object, xyzw: FloatArray) -> None:
    target.x, target.y, target.z, target.w = xyzw.tolist()  # type: ignore[attr-defined]
