"""The topics of one track: every message that shows an estimate."""

from __future__ import annotations

from posetrack_cli.arrays import FloatArray
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Subject, check_estimate
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME, estimate_schema, estimate_to_json
from posetrack_cli.results.export.column_names import shape_unit
from posetrack_cli.results.line_scene import line_scene
from posetrack_cli.results.scene import SceneEncoder


class TrackChannels:
    """Writes the estimates of one track, each on every topic that shows it.

    Topics, registered in this order: ``transforms``, and below ``prefix``: ``odometry``, ``estimate``,
    ``joint_states`` (when the shape entries are angles) and ``scene`` (when it has a mesh or lines).

    Args:
        sink: the file.
        subject: what is tracked; its name is that of the body's frame.
        transforms: topic of the frames.
        prefix: of the other topics, such as ``/hand``.

    Attributes:
        ids: of all channels.
        estimate_id: of the one with the complete estimates.
    """

    def __init__(self, sink: McapSink, subject: Subject, transforms: str, prefix: str) -> None:
        self._sink = sink
        self._subject = subject
        self._transforms = sink.channel(transforms, messages.FrameTransforms)
        self._odometry = sink.channel(f"{prefix}/odometry", messages.Odometry)
        schema = estimate_schema(subject.number_names)
        self.estimate_id = sink.json_channel(f"{prefix}/estimate", ESTIMATE_SCHEMA_NAME, schema)
        angles = subject.shape_names and shape_unit(subject)
        self._joints = sink.channel(f"{prefix}/joint_states", messages.JointStates) if angles else None
        self._scene, self._encoder = None, None
        if subject.triangles is not None or subject.lines:
            self._scene = sink.channel(f"{prefix}/scene", messages.SceneUpdate)
        if subject.triangles is not None:
            self._encoder = SceneEncoder(subject)
        ids = (self._transforms, self._odometry, self.estimate_id, self._joints, self._scene)
        self.ids = frozenset(channel_id for channel_id in ids if channel_id is not None)

    def write(self, estimate: Estimate, vertices: FloatArray | None) -> None:
        """Write one estimate on every topic, the complete one last.

        Raises:
            ResultError: the arrays do not fit the subject or are not finite; nothing is written then.
        """
        check_estimate(estimate, self._subject)
        stamp = estimate.stamp_ns
        scene = self._drawn(estimate, vertices)
        self._write(self._transforms, stamp, messages.frame_transforms(estimate, self._subject))
        self._write(self._odometry, stamp, messages.odometry(estimate, self._subject))
        if self._joints is not None:
            self._write(self._joints, stamp, messages.joint_states(estimate, self._subject))
        if self._scene is not None and scene is not None:
            self._sink.write(self._scene, stamp, scene)
        self._sink.write(self.estimate_id, stamp, estimate_to_json(estimate, self._subject.number_names))

    def _drawn(self, estimate: Estimate, vertices: FloatArray | None) -> bytes | None:
        """The scene of an estimate: its mesh, or its lines."""
        if self._encoder is not None and vertices is not None:
            return self._encoder.encode(estimate.stamp_ns, estimate.status, vertices)
        if self._encoder is None and self._subject.lines:
            return bytes(line_scene(estimate, self._subject).SerializeToString(deterministic=True))
        return None

    def _write(self, channel_id: int, stamp_ns: int, message: messages.Message) -> None:
        self._sink.write(channel_id, stamp_ns, message.SerializeToString(deterministic=True))
