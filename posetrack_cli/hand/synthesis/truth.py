"""The truth about a synthetic frame, in the messages that a tracker's result has."""

from __future__ import annotations

import numpy as np

from posetrack_cli.hand.anatomy import (
    ANGLE_NAMES,
    ANGLES,
    JOINT_NAMES,
    JOINT_PARENTS,
    TANGENT_SIZE,
)
from posetrack_cli.hand.space import pose_rates
from posetrack_cli.hand.synthesis.frames import SyntheticFrame
from posetrack_cli.hand.synthesis.sensor import CAMERA
from posetrack_cli.recording.base import TRUTH_PREFIX
from posetrack_cli.recording.mcap_sink import McapSink
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA, ESTIMATE_SCHEMA_NAME, estimate_to_json

SUBJECT = Subject("hand", CAMERA.name, ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)


def truth_estimate(frame: SyntheticFrame) -> Estimate:
    """Return the truth as an estimate without doubt: confidence 1, all variances 0, no particles.

    The message has no way to leave a velocity out, so where the motion has none (A) it is 0.
    """
    none = np.zeros(TANGENT_SIZE)
    twist = none if frame.twist is None else frame.twist
    return Estimate(
        frame_index=frame.index,
        stamp_ns=frame.stamp_ns,
        status=Status.TRACKING,
        confidence=1.0,
        position=frame.pose[:3],
        quaternion=frame.pose[3:7],
        shape=frame.pose[ANGLES],
        pose_rate=pose_rates(frame.pose, twist),
        twist=twist,
        pose_variance=none,
        twist_variance=none,
        points=frame.joints,
        effective_sample_size=0.0,
        resampled=False,
    )


class TruthChannels:
    """Writes truth below ``/truth/hand/``: ``odometry``, ``joint_states``, ``estimate``, as results do."""

    def __init__(self, sink: McapSink) -> None:
        prefix = f"{TRUTH_PREFIX}{SUBJECT.name}"
        self._sink = sink
        self._odometry = sink.channel(f"{prefix}/odometry", messages.Odometry)
        self._joints = sink.channel(f"{prefix}/joint_states", messages.JointStates)
        self._estimate = sink.json_channel(f"{prefix}/estimate", ESTIMATE_SCHEMA_NAME, ESTIMATE_SCHEMA)

    def write(self, frame: SyntheticFrame) -> None:
        """Write the truth about one frame; a velocity that does not exist is left out where it can be."""
        estimate = truth_estimate(frame)
        odometry = messages.odometry(estimate, SUBJECT)
        joints = messages.joint_states(estimate, SUBJECT)
        if frame.twist is None:
            for name in ("linear_velocity", "angular_velocity", "velocity_covariance"):
                odometry.ClearField(name)
            for joint in joints.joints:
                joint.ClearField("velocity")
        self._write(self._odometry, frame.stamp_ns, odometry)
        self._write(self._joints, frame.stamp_ns, joints)
        self._sink.write(self._estimate, frame.stamp_ns, estimate_to_json(estimate))

    def _write(self, channel: int, stamp_ns: int, message: messages.Message) -> None:
        self._sink.write(channel, stamp_ns, message.SerializeToString(deterministic=True))
