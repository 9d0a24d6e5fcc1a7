"""The truth about a synthetic frame, in the messages that a tracker's result has."""

from __future__ import annotations

import numpy as np

from posetrack_cli.geometry.rotations import quaternion_rate
from posetrack_cli.head.subject import head_subject
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.recording.base import TRUTH_PREFIX
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA, ESTIMATE_SCHEMA_NAME, estimate_to_json
from posetrack_cli.synthesis.head.expressions import EXPRESSIONS
from posetrack_cli.synthesis.head.frames import SyntheticHeadFrame

COMPONENTS = 0
"""A model's deformation coefficients are its own: the truth has none. Its points tell the deformation."""


def truth_estimate(frame: SyntheticHeadFrame) -> Estimate:
    """Return the truth as an estimate without doubt: confidence 1, all variances 0, no particles.

    Its points are the ten true ones in the reference camera's axes.
    """
    none = np.zeros(6)
    pose_rate = np.concatenate([frame.twist[:3], quaternion_rate(frame.pose.quaternion, frame.twist[3:])])
    return Estimate(
        frame_index=frame.index,
        stamp_ns=frame.stamp_ns,
        status=Status.TRACKING,
        confidence=1.0,
        position=frame.pose.position,
        quaternion=frame.pose.quaternion,
        shape=np.zeros(COMPONENTS),
        pose_rate=pose_rate,
        twist=frame.twist,
        pose_variance=none,
        twist_variance=none,
        points=frame.pose.points(frame.shape),
        effective_sample_size=None,
        resampled=False,
    )


class TruthChannels:
    """Writes truth below ``/truth/head/``: ``odometry`` and ``estimate``, as results do, and ``expression``.

    The last are the strengths of ``EXPRESSIONS`` as JointStates, which no result has.
    """

    def __init__(self, sink: McapSink, camera_frame: str) -> None:
        self._sink = sink
        self._subject = head_subject(camera_frame, COMPONENTS)
        prefix = f"{TRUTH_PREFIX}{self._subject.name}"
        self._odometry = sink.channel(f"{prefix}/odometry", messages.Odometry)
        self._expression = sink.channel(f"{prefix}/expression", messages.JointStates)
        self._estimate = sink.json_channel(f"{prefix}/estimate", ESTIMATE_SCHEMA_NAME, ESTIMATE_SCHEMA)

    def write(self, frame: SyntheticHeadFrame) -> None:
        """Write the truth about one frame."""
        estimate = truth_estimate(frame)
        self._write(self._odometry, frame.stamp_ns, messages.odometry(estimate, self._subject))
        self._write(self._expression, frame.stamp_ns, _expression(frame))
        self._sink.write(self._estimate, frame.stamp_ns, estimate_to_json(estimate))

    def _write(self, channel: int, stamp_ns: int, message: messages.Message) -> None:
        self._sink.write(channel, stamp_ns, message.SerializeToString(deterministic=True))


def _expression(frame: SyntheticHeadFrame) -> messages.JointStates:
    message = messages.JointStates()
    message.timestamp.FromNanoseconds(frame.stamp_ns)
    for name, value in zip(EXPRESSIONS, frame.strengths.tolist(), strict=True):
        message.joints.add(name=name, position=value)
    return message
