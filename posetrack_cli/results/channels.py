"""The topics of a result: which message goes where, and in which order they are registered."""

from __future__ import annotations

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import TRUTH_PREFIX, TruthMessage
from posetrack_cli.recording.mcap_calibration import calibration_message
from posetrack_cli.recording.mcap_sink import McapSink
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Subject, check_estimate
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA, ESTIMATE_SCHEMA_NAME, estimate_to_json
from posetrack_cli.results.scene import SceneEncoder

CALIBRATION_TOPIC = "/camera/calibration"
TRANSFORM_TOPIC = "/tf"


class ResultChannels:
    """Writes estimates and truth to the topics of a sink.

    Topics: ``/camera/calibration``, ``/tf``, and below ``/<subject>/``: ``odometry``, ``estimate``,
    ``joint_states`` (when the subject has shape entries) and ``scene`` (when it has a mesh). They are
    registered in a fixed order, so a channel's id is the same in every file of one kind of subject.
    """

    def __init__(self, sink: McapSink, subject: Subject, camera: Camera) -> None:
        self._sink = sink
        self._subject = subject
        self._camera = camera
        prefix = f"/{subject.name}"
        self._calibration = sink.channel(CALIBRATION_TOPIC, messages.CameraCalibration)
        self._transforms = sink.channel(TRANSFORM_TOPIC, messages.FrameTransforms)
        self._odometry = sink.channel(f"{prefix}/odometry", messages.Odometry)
        self._estimate = sink.json_channel(f"{prefix}/estimate", ESTIMATE_SCHEMA_NAME, ESTIMATE_SCHEMA)
        self._joints = (
            sink.channel(f"{prefix}/joint_states", messages.JointStates) if subject.shape_names else None
        )
        self._scene, self._encoder = None, None
        if subject.triangles is not None:
            self._scene = sink.channel(f"{prefix}/scene", messages.SceneUpdate)
            self._encoder = SceneEncoder(subject)
        ids = (self._calibration, self._transforms, self._odometry, self._estimate, self._joints, self._scene)
        self.own_ids = frozenset(channel_id for channel_id in ids if channel_id is not None)
        self._truth: dict[tuple[object, ...], int] = {}

    def write_calibration(self, stamp_ns: int) -> None:
        """Write the camera's calibration, in the frame that the estimates are given in."""
        self._sink.write(self._calibration, stamp_ns, self._calibration_bytes(stamp_ns))

    def write_estimate(self, estimate: Estimate, vertices: FloatArray | None) -> None:
        """Write one estimate on every topic that shows it, the complete one last.

        Raises:
            ResultError: the arrays do not fit the subject or are not finite; nothing is written then.
        """
        check_estimate(estimate, self._subject)
        stamp = estimate.stamp_ns
        scene = None
        if self._encoder is not None and vertices is not None:
            scene = self._encoder.encode(stamp, estimate.status, vertices)
        self._write(self._transforms, stamp, messages.frame_transforms(estimate, self._subject))
        self._write(self._odometry, stamp, messages.odometry(estimate, self._subject))
        if self._joints is not None:
            self._write(self._joints, stamp, messages.joint_states(estimate, self._subject))
        if self._scene is not None and scene is not None:
            self._sink.write(self._scene, stamp, scene)
        self._sink.write(self._estimate, stamp, estimate_to_json(estimate))

    def write_truth(self, message: TruthMessage) -> None:
        """Write a truth message as it is, on its own topic.

        Raises:
            ResultError: its topic is no truth topic, so it might be taken for a result.
        """
        self._sink.write(self.truth_channel(message), message.log_time_ns, message.data)

    def truth_channel(self, message: TruthMessage) -> int:
        """Return the channel of a truth message's topic and schema, registered when it is new."""
        if not message.topic.startswith(TRUTH_PREFIX):
            raise ResultError("no truth topic", where=message.topic, expected=f"{TRUTH_PREFIX}...")
        schema = (message.schema_name, message.schema_encoding, message.schema_data, message.message_encoding)
        key = (message.topic, *schema, tuple(sorted(message.channel_metadata.items())))
        if key not in self._truth:
            self._truth[key] = self._sink.raw_channel(message.topic, *schema, message.channel_metadata)
        return self._truth[key]

    def write_replayed(self, channel_id: int, stamp_ns: int, data: bytes) -> None:
        """Write a message of an interrupted run as it is.

        Raises:
            UsageError: it is the calibration of another camera.
        """
        if channel_id == self._calibration and data != self._calibration_bytes(stamp_ns):
            raise UsageError("the unfinished result is of another camera", where=self._camera.name)
        self._sink.write(channel_id, stamp_ns, data)

    def _calibration_bytes(self, stamp_ns: int) -> bytes:
        message = calibration_message(self._camera, stamp_ns, self._subject.camera_frame)
        return bytes(message.SerializeToString(deterministic=True))

    def _write(self, channel_id: int, stamp_ns: int, message: messages.Message) -> None:
        self._sink.write(channel_id, stamp_ns, message.SerializeToString(deterministic=True))
