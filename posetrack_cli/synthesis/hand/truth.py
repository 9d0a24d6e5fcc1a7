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
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.recording.base import TRUTH_PREFIX
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA, ESTIMATE_SCHEMA_NAME, estimate_to_json
from posetrack_cli.synthesis.hand.frames import SyntheticFrame
from posetrack_cli.synthesis.hand.sensor import CAMERA

SUBJECT = Subject("hand", CAMERA.name, ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)


def truth_estimate(frame: SyntheticFrame) -> Estimate:
    """Return the truth as an estimate without doubt: confidence 1, all variances 0, no particles.

    It has no velocity where the motion has none (A).
    """
    none = np.zeros(TANGENT_SIZE)
    return Estimate(
        frame_index=frame.index,
        stamp_ns=frame.stamp_ns,
        status=Status.TRACKING,
        confidence=1.0,
        position=frame.pose[:3],
        quaternion=frame.pose[3:7],
        shape=frame.pose[ANGLES],
        pose_rate=None if frame.twist is None else pose_rates(frame.pose, frame.twist),
        twist=frame.twist,
        pose_variance=none,
        twist_variance=None if frame.twist is None else none,
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
        """Write the truth about one frame."""
        estimate = truth_estimate(frame)
        self._write(self._odometry, frame.stamp_ns, messages.odometry(estimate, SUBJECT))
        self._write(self._joints, frame.stamp_ns, messages.joint_states(estimate, SUBJECT))
        self._sink.write(self._estimate, frame.stamp_ns, estimate_to_json(estimate))

    def _write(self, channel: int, stamp_ns: int, message: messages.Message) -> None:
        self._sink.write(channel, stamp_ns, message.SerializeToString(deterministic=True))
