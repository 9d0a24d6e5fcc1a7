"""The topics of a result: which message goes where, and in which order they are registered."""

from __future__ import annotations

from dataclasses import replace

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import TRUTH_PREFIX, TruthMessage
from posetrack_cli.recording.mcap_calibration import calibration_message
from posetrack_cli.recording.mcap_sink import McapSink
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.results.track_channels import TrackChannels
from posetrack_cli.results.tracks import (
    FILTERED,
    SMOOTHED,
    SMOOTHED_TRANSFORMS_TOPIC,
    TRANSFORMS_TOPIC,
    body_frame,
    topics_prefix,
)

CALIBRATION_TOPIC = "/camera/calibration"


class ResultChannels:
    """Writes estimates and truth to the topics of a sink.

    Topics: ``/camera/calibration``, ``/tf`` and ``/<subject>/...`` (``TrackChannels``), registered in a fixed
    order, so a channel's id is the same in every file of one kind of subject; then those of truth when they
    come; in the end ``/smoothed/tf`` and ``/smoothed/<subject>/...``, if there is a smoothed track.
    """

    def __init__(self, sink: McapSink, subject: Subject, camera: Camera) -> None:
        self._sink = sink
        self._subject = subject
        self._camera = camera
        self._calibration = sink.channel(CALIBRATION_TOPIC, messages.CameraCalibration)
        self._filtered = self._track(FILTERED, TRANSFORMS_TOPIC)
        self._smoothed: TrackChannels | None = None
        self.own_ids = frozenset({self._calibration, *self._filtered.ids})
        self._truth: dict[tuple[object, ...], int] = {}

    def _track(self, track: str, transforms: str) -> TrackChannels:
        subject = replace(self._subject, name=body_frame(self._subject.name, track))
        return TrackChannels(self._sink, subject, transforms, topics_prefix(self._subject.name, track))

    def write_calibration(self, stamp_ns: int) -> None:
        """Write the camera's calibration, in the frame that the estimates are given in."""
        self._sink.write(self._calibration, stamp_ns, self._calibration_bytes(stamp_ns))

    def write_estimate(self, estimate: Estimate, vertices: FloatArray | None) -> None:
        """Write one estimate on every topic that shows it.

        Raises:
            ResultError: the arrays do not fit the subject or are not finite; nothing is written then.
        """
        self._filtered.write(estimate, vertices)

    def write_smoothed(self, estimate: Estimate, vertices: FloatArray | None) -> None:
        """Write one estimate of the smoothed track; its topics are registered with the first.

        Raises:
            ResultError: as of ``write_estimate``.
        """
        if self._smoothed is None:
            self._smoothed = self._track(SMOOTHED, SMOOTHED_TRANSFORMS_TOPIC)
        self._smoothed.write(estimate, vertices)

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
