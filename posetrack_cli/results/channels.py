"""Tracks and channels of a result file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.mcap.sink import McapSink, SchemaText, serialised
from posetrack_cli.recording.base import TRUTH_PREFIX, TruthMessage
from posetrack_cli.recording.message_cameras import calibration_message, camera_transforms
from posetrack_cli.recording.topics import CALIBRATION, PLACES_TOPIC, camera_topic
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Subject, kind_of
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME, estimate_schema, estimate_to_json
from posetrack_cli.results.fields import check_estimate
from posetrack_cli.results.scene import SceneEncoder, image_annotations, line_scene
from posetrack_cli.results.topics import (
    FILTERED,
    SMOOTHED,
    SMOOTHED_TRANSFORMS_TOPIC,
    TRANSFORMS_TOPIC,
    body_frame,
    topics_prefix,
)


@dataclass
class StampOrder:
    """Direction of a track's stamps: ascending, or descending as in a backward pass."""

    count: int = 0
    _last_ns: int = 0
    _direction: int = 0  # 1 up, -1 down, 0 not known yet

    def check(self, stamp_ns: int, where: Path) -> None:
        """Raise ResultError if the stamp does not continue the order of the earlier ones."""
        step = stamp_ns - self._last_ns
        if self.count and (step == 0 or step * self._direction < 0):
            found, expected = (
                f"{stamp_ns} ns after {self._last_ns} ns",
                "each frame once, in order or in reverse",
            )
            raise ResultError("smoothed frames are out of order", where=where, found=found, expected=expected)

    def add(self, stamp_ns: int) -> None:
        """Count a stamp."""
        if self.count:
            self._direction = 1 if stamp_ns > self._last_ns else -1
        self.count, self._last_ns = self.count + 1, stamp_ns


# Topics of a result and their order of registration

ANNOTATIONS = "annotations"


class TrackChannels:
    """Writer for the estimates of one track, on all its topics.

    Topics, registered in this order below ``prefix``: ``odometry``, ``estimate``, ``joint_states`` (if the
    shape parameters are angles) and ``scene`` (if the subject has a mesh or lines).

    Args:
        sink: output file.
        subject: tracked subject.
        frame: frame id of the body.
        transforms: channel of the frame transforms.
        prefix: prefix of the other topics, such as ``/hand``.

    Attributes:
        ids: ids of all channels.
        estimate_id: id of the channel with complete estimates.
    """

    def __init__(self, sink: McapSink, subject: Subject, frame: str, transforms: int, prefix: str) -> None:
        self._sink = sink
        kind = kind_of(subject.name if subject.label else frame)
        self._subject = subject = replace(subject, name=frame, label="")
        self._transforms = transforms
        self._odometry = sink.channel(f"{prefix}/odometry", messages.Odometry)
        schema = estimate_schema(subject.number_names)
        self.estimate_id = sink.json_channel(f"{prefix}/estimate", ESTIMATE_SCHEMA_NAME, schema)
        angles = subject.shape_names and kind.shape_unit
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
        self._sink.write(
            self._transforms, stamp, serialised(messages.frame_transforms(estimate, self._subject))
        )
        self._sink.write(self._odometry, stamp, serialised(messages.odometry(estimate, self._subject)))
        if self._joints is not None:
            self._sink.write(self._joints, stamp, serialised(messages.joint_states(estimate, self._subject)))
        if self._scene is not None and scene is not None:
            self._sink.write(self._scene, stamp, scene)
        self._sink.write(self.estimate_id, stamp, estimate_to_json(estimate, self._subject.number_names))

    def _drawn(self, estimate: Estimate, vertices: FloatArray | None) -> bytes | None:
        """Return the scene of an estimate: its mesh or its lines."""
        if self._encoder is not None and vertices is not None:
            return self._encoder.encode(estimate.stamp_ns, estimate.status, vertices)
        if self._encoder is None and self._subject.lines:
            return serialised(line_scene(estimate, self._subject))
        return None


class ResultChannels:
    """Writer for estimates and ground truth, on the topics of a sink.

    Registers in a fixed order, so that channel ids are equal in all files of one kind of subject:
    ``/camera/calibration`` (one per camera), ``/tf``, ``/<subject>/...`` of each subject
    (``TrackChannels``), annotations of each camera image (if a subject has lines), and camera poses on
    ``/tf_static`` (if there are several). Ground truth topics follow as they occur, and finally
    ``/smoothed/tf`` and ``/smoothed/<subject>/...`` if there is a smoothed track.

    Args:
        sink: output file.
        subjects: tracked subjects, in the same camera frame.
        cameras: all cameras; estimates are relative to the first.
    """

    def __init__(self, sink: McapSink, subjects: Sequence[Subject], cameras: Sequence[Camera]) -> None:
        self._sink = sink
        self._subjects = tuple(subjects)
        self._camera_frame = self._subjects[0].camera_frame
        self._cameras = tuple(cameras)
        self._calibrations = self._channels(CALIBRATION, messages.CameraCalibration)
        self._filtered = self._track(FILTERED, TRANSFORMS_TOPIC)
        self._smoothed: tuple[TrackChannels, ...] = ()
        has_lines = any(subject.lines for subject in self._subjects)
        self._annotations = self._channels(ANNOTATIONS, ImageAnnotations) if has_lines else {}
        own = (channel for track in self._filtered for channel in track.ids)
        self.own_ids = {*self._calibrations, *own, *self._annotations}
        if len(self._cameras) > 1:
            self._places = sink.channel(PLACES_TOPIC, messages.FrameTransforms)
            self.own_ids.add(self._places)
        self._truth: dict[tuple[object, ...], int] = {}
        self._replayed: Counter[int] = Counter()  # messages by channel

    def _channels(self, what: str, message_class: Any) -> dict[int, Camera]:
        """Register a topic for each camera."""
        count = len(self._cameras)
        return {
            self._sink.channel(camera_topic(camera, what, count), message_class): camera
            for camera in self._cameras
        }

    def _track(self, track: str, transforms: str) -> tuple[TrackChannels, ...]:
        channel = self._sink.channel(transforms, messages.FrameTransforms)
        places = ((body_frame(one.frame, track), topics_prefix(one.topic, track)) for one in self._subjects)
        return tuple(
            TrackChannels(self._sink, subject, frame, channel, prefix)
            for subject, (frame, prefix) in zip(self._subjects, places, strict=True)
        )

    def write_calibration(self, stamp_ns: int) -> None:
        """Write every camera's calibration, and the poses of the others relative to the first."""
        for channel_id, camera in self._calibrations.items():
            self._sink.write(channel_id, stamp_ns, self._calibration_bytes(camera, stamp_ns))
        if len(self._cameras) > 1:
            placed = camera_transforms(self._cameras, self._camera_frame, stamp_ns)
            self._sink.write(self._places, stamp_ns, serialised(placed))

    def write_estimates(self, estimates: Sequence[Estimate], vertices: Sequence[FloatArray | None]) -> None:
        """Write the estimates of one frame, one per subject, on all their topics.

        Raises:
            ResultError: the arrays do not fit the subject or are not finite.
        """
        for track, estimate, mesh in zip(self._filtered, estimates, vertices, strict=True):
            track.write(estimate, mesh)
        for channel_id, camera in self._annotations.items():
            drawn = ImageAnnotations()
            for estimate, subject in zip(estimates, self._subjects, strict=True):
                drawn.MergeFrom(image_annotations(estimate, subject, camera))
            self._sink.write(channel_id, estimates[0].stamp_ns, serialised(drawn))

    def write_smoothed(self, estimate: Estimate, vertices: FloatArray | None, subject: int = 0) -> None:
        """Write one estimate of a smoothed track, whose topics are registered on first use.

        Args:
            estimate: the estimate.
            vertices: mesh, or None.
            subject: number of the subject.

        Raises:
            ResultError: see ``write_estimates``.
        """
        self._smoothed_tracks()[subject].write(estimate, vertices)

    def copy(self, messages: Iterable[tuple[str, int, bytes]], track: str = FILTERED) -> None:
        """Write messages (topic, log time, bytes) of another result of the same kind unchanged.

        Raises:
            ResultError: this result does not have one of the topics.
        """
        if track == SMOOTHED:
            self._smoothed_tracks()
        for topic, stamp_ns, data in messages:
            self._sink.write(self._sink.channel_of(topic), stamp_ns, data)

    def _smoothed_tracks(self) -> tuple[TrackChannels, ...]:
        if not self._smoothed:
            self._smoothed = self._track(SMOOTHED, SMOOTHED_TRANSFORMS_TOPIC)
        return self._smoothed

    def write_truth(self, message: TruthMessage) -> None:
        """Write a ground truth message unchanged on its own topic.

        Raises:
            ResultError: its topic is not a truth topic, so it could be mistaken for a result.
        """
        self._sink.write(self.truth_channel(message), message.log_time_ns, message.data)

    def truth_channel(self, message: TruthMessage) -> int:
        """Return the channel of a truth message's topic and schema, registering new ones."""
        if not message.topic.startswith(TRUTH_PREFIX):
            raise ResultError("not a truth topic", where=message.topic, expected=f"{TRUTH_PREFIX}...")
        schema = SchemaText(message.schema_name, message.schema_encoding, message.schema_data)
        about = message.topic, schema, message.message_encoding
        key = (*about, tuple(sorted(message.channel_metadata.items())))
        if key not in self._truth:
            self._truth[key] = self._sink.raw_channel(*about, message.channel_metadata)
        return self._truth[key]

    def write_replayed(self, channel_id: int, stamp_ns: int, data: bytes) -> None:
        """Write a message of an interrupted run unchanged.

        Raises:
            UsageError: it is the calibration of another camera.
            ResultError: its channel does not belong to this result.
        """
        if channel_id not in self.own_ids and channel_id not in self._truth.values():
            raise ResultError("message on an unknown channel", where=channel_id)
        camera = self._calibrations.get(channel_id)
        if camera is not None and data != self._calibration_bytes(camera, stamp_ns):
            raise UsageError("the unfinished result belongs to another camera", where=camera.name)
        self._sink.write(channel_id, stamp_ns, data)
        self._replayed[channel_id] += 1

    @property
    def estimates_replayed(self) -> int:
        """Number of replayed estimates of each subject of the interrupted run."""
        return min(self._replayed[track.estimate_id] for track in self._filtered)

    @property
    def truth_replayed(self) -> int:
        """Number of replayed truth messages."""
        return sum(self._replayed[channel_id] for channel_id in self._truth.values())

    def _calibration_bytes(self, camera: Camera, stamp_ns: int) -> bytes:
        frame = self._camera_frame if camera is self._cameras[0] else camera.name
        return serialised(calibration_message(camera, stamp_ns, frame))
