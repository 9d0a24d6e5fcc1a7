"""Read a result, also one that is unfinished or whose writer was killed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata, Schema

from posetrack_cli.errors import ResultError, nearest_name
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import RUN_RECORD, TRUTH_PREFIX, TruthMessage
from posetrack_cli.recording.mcap_calibration import camera_from_message
from posetrack_cli.recording.output import part_path
from posetrack_cli.results.channels import CALIBRATION_TOPIC
from posetrack_cli.results.estimate import FIELD_NAMES, Estimate, Subject, array_shapes
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME, estimate_from_json
from posetrack_cli.results.messages import CameraCalibration
from posetrack_cli.results.records import RecordSpan, chunk_records, read_record, record_spans
from posetrack_cli.results.subject_record import SUBJECT_RECORD, subject_from_record
from posetrack_cli.results.writer import SUMMARY_RECORD

NO_SCHEMA = Schema(id=0, name="", encoding="", data=b"")


@dataclass(frozen=True)
class Result:
    """A result file; its messages are read when they are asked for, one chunk in memory at a time.

    Attributes:
        path: the file, NAME or NAME.part.
        subject: what was tracked.
        run: the run record.
        summary: written at the end; empty for a run that did not finish.
        truncated: whether the file ends without a footer, as a killed writer leaves it. Every flushed
            estimate can be read all the same.
    """

    path: Path
    subject: Subject
    run: Mapping[str, str]
    summary: Mapping[str, str]
    truncated: bool

    @property
    def finished(self) -> bool:
        """Whether the run came to its end."""
        return bool(self.summary)

    @property
    def estimate_topic(self) -> str:
        """The topic of this result's own estimates."""
        return f"/{self.subject.name}/estimate"

    @cached_property
    def channels(self) -> tuple[tuple[Schema, Channel], ...]:
        """Every channel with its schema, ordered by topic."""
        found = {channel.id: (schema, channel) for schema, channel in self._channels()}
        return tuple(sorted(found.values(), key=lambda pair: (pair[1].topic, pair[1].id)))

    @property
    def truth_topics(self) -> tuple[str, ...]:
        """The topics of ground truth."""
        topics = (channel.topic for _, channel in self.channels)
        return tuple(topic for topic in topics if topic.startswith(TRUTH_PREFIX))

    def estimates(self, topic: str | None = None) -> Iterator[Estimate]:
        """Yield the estimates in file order.

        Args:
            topic: any topic of ``posetrack.Estimate``, such as a truth topic; by default the result's own.

        Raises:
            ResultError: there is no such topic, or a chunk is damaged.
        """
        if topic is not None:
            known = {c.topic for s, c in self.channels if s.name == ESTIMATE_SCHEMA_NAME}
            if topic not in known:
                raise ResultError(
                    f"no estimates on topic '{topic}'", where=self.path, hint=nearest_name(topic, known)
                )
        wanted = topic or self.estimate_topic
        for _, _, message in self._messages(lambda channel: channel.topic == wanted):
            yield estimate_from_json(message.data)

    def truth(self) -> Iterator[TruthMessage]:
        """Yield the messages of ground truth undecoded, in file order."""
        for schema, channel, message in self._messages(lambda c: c.topic.startswith(TRUTH_PREFIX)):
            yield TruthMessage(
                topic=channel.topic,
                schema_name=schema.name,
                schema_encoding=schema.encoding,
                schema_data=schema.data,
                message_encoding=channel.message_encoding,
                log_time_ns=message.log_time,
                data=message.data,
                channel_metadata=channel.metadata,
            )

    def camera(self) -> Camera:
        """Return the camera that the estimates are relative to; its name is the frame id.

        Raises:
            ResultError: the file ends before its first flush.
        """
        for _, _, message in self._messages(lambda channel: channel.topic == CALIBRATION_TOPIC):
            calibration = CameraCalibration.FromString(message.data)
            return camera_from_message(calibration, calibration.frame_id, CALIBRATION_TOPIC)
        raise ResultError("holds no camera calibration", where=self.path)

    def _messages(self, wanted: Callable[[Channel], bool]) -> Iterator[tuple[Schema, Channel, Message]]:
        """Yield the messages of the channels that are wanted, in file order."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        for span in record_spans(self.path):
            if span.opcode != Opcode.CHUNK:
                continue
            for record in chunk_records(self.path, span):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif wanted(channels[record.channel_id]):
                    channel = channels[record.channel_id]
                    yield schemas.get(channel.schema_id, NO_SCHEMA), channel, record

    def _channels(self) -> Iterator[tuple[Schema, Channel]]:
        """Yield the channels from the index, or from the chunks of a file without one."""
        schemas: dict[int, Schema] = {}
        for span in record_spans(self.path):
            for record in self._definitions(span):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                else:
                    yield schemas.get(record.schema_id, NO_SCHEMA), record

    def _definitions(self, span: RecordSpan) -> Iterator[Schema | Channel]:
        if span.opcode == Opcode.CHUNK and self.truncated:
            records: list[Any] = list(chunk_records(self.path, span))
        elif span.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            records = [read_record(self.path, span)]
        else:
            return
        yield from (record for record in records if isinstance(record, Schema | Channel))


def read_result(path: Path | str) -> Result:
    """Open a result file, finished or not.

    Raises:
        ResultError: it is missing, no MCAP file, or not written by posetrack.
    """
    path = Path(path)
    if not path.exists() and part_path(path).exists():
        raise ResultError("does not exist", where=path, hint=f"an unfinished run left {part_path(path)}")
    metadata: dict[str, Mapping[str, str]] = {}
    truncated = True
    for span in record_spans(path):
        truncated = span.opcode != Opcode.FOOTER
        if span.opcode == Opcode.METADATA:
            record = read_record(path, span)
            if isinstance(record, Metadata):
                metadata[record.name] = record.metadata
    if RUN_RECORD not in metadata or SUBJECT_RECORD not in metadata:
        raise ResultError("is no result of posetrack", where=path, expected=f"metadata {RUN_RECORD}")
    subject = subject_from_record(metadata[SUBJECT_RECORD])
    return Result(path, subject, metadata[RUN_RECORD], metadata.get(SUMMARY_RECORD, {}), truncated)


def load_arrays(path: Path | str, topic: str | None = None) -> dict[str, np.ndarray[Any, Any]]:
    """Load all estimates of a result as arrays, in three lines of Python::

        from posetrack_cli.results import load_arrays
        result = load_arrays("result.mcap")
        print(result["position"])

    Args:
        path: the result.
        topic: as of ``Result.estimates``.

    Returns:
        One array per field of ``Estimate``, under its name, with the frames (N) along the first axis;
        ``status`` as text, a missing cost or time as NaN.

    Raises:
        ResultError: as of ``read_result`` and ``Result.estimates``.
    """
    result = read_result(path)
    estimates = list(result.estimates(topic))
    return {name: _column(name, estimates, result.subject) for name in FIELD_NAMES}


def _column(name: str, estimates: list[Estimate], subject: Subject) -> np.ndarray[Any, Any]:
    """Return one field of all estimates, with the right shape and type also when there are none."""
    values = [getattr(estimate, name) for estimate in estimates]
    shapes = array_shapes(subject)
    if name in shapes:
        return np.array(values, dtype=np.float64) if values else np.empty((0, *shapes[name]))
    kinds: dict[str, Any] = {
        "frame_index": np.int64,
        "stamp_ns": np.int64,
        "status": np.str_,
        "resampled": np.bool_,
    }
    return np.array(values, dtype=kinds.get(name, np.float64))
