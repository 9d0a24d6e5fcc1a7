"""Replay of the flushed part of an interrupted result, byte for byte, into a new sink."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from posetrack_cli.build import only_in
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.mcap.records import (
    DAMAGE,
    ChunkRecord,
    RecordSpan,
    chunk_records,
    read_record,
    record_spans,
)
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.recording.base import PATH_KEY, TruthMessage
from posetrack_cli.results.channels import ResultChannels
from posetrack_cli.results.reader import opened
from posetrack_cli.results.spool import RESTART_HINT

_MADE_WITH = {
    "sources": "posetrack build",
    "libraries": "set of libraries",
    "processor": "processor type",
}
"""Entries of the run record that depend on the installation (``build``), with their descriptions."""


class Replay:
    """Copies the flushed part of an interrupted result.

    Args:
        part: interrupted result.
        sink: destination.
        channels: channels of the sink.

    Attributes:
        attached: names of the copied attachments.
    """

    def __init__(self, part: Path, sink: McapSink, channels: ResultChannels) -> None:
        self._part, self._sink, self._channels = part, sink, channels
        self._schemas: dict[int, Schema] = {}
        self.attached: set[str] = set()

    def run(self, file_bytes: int) -> None:
        """Copy the chunks and attachments in the first ``file_bytes``.

        Later data (frames after the last checkpoint, a truncated chunk, a footer) is dropped. Chunk
        boundaries are kept; one chunk is in memory at a time.

        Raises:
            ResultError: the file is shorter or damaged.
            UsageError: it belongs to another camera.
        """
        position = 0
        with opened(self._part) as stream:
            for span in record_spans(stream):
                # Bytes after the last checkpoint belong to frames that are tracked again.
                if span.end > file_bytes:
                    break
                position = span.end
                if span.opcode in (Opcode.ATTACHMENT, Opcode.CHUNK):
                    with _damage(self._part, span):
                        record = read_record(stream, span)
                        records = [] if span.opcode == Opcode.ATTACHMENT else list(chunk_records(record))
                    if isinstance(record, Attachment):
                        self._attach(record)
                    else:
                        self._write(records)
        if position != file_bytes:
            raise ResultError(
                "checkpoint does not match the unfinished result",
                where=self._part,
                found=f"{position} complete bytes",
                expected=file_bytes,
                hint=RESTART_HINT,
            )

    def _attach(self, record: Attachment) -> None:
        self._sink.attachment(record.name, record.media_type, record.data, record.log_time)
        self.attached.add(record.name)

    def _write(self, records: list[ChunkRecord]) -> None:
        for record in records:
            if isinstance(record, Schema):
                self._schemas[record.id] = record
            elif isinstance(record, Channel):
                self._adopt(record)
            else:
                self._channels.write_replayed(record.channel_id, record.log_time, record.data)
        self._sink.flush()

    def _adopt(self, channel: Channel) -> None:
        """Register a truth channel in its original order; the result's own channels already exist."""
        if channel.id in self._channels.own_ids:
            return
        schema = self._schemas.get(channel.schema_id, Schema(id=0, name="", encoding="", data=b""))
        as_message = TruthMessage(
            topic=channel.topic,
            schema_name=schema.name,
            schema_encoding=schema.encoding,
            schema_data=schema.data,
            message_encoding=channel.message_encoding,
            log_time_ns=0,
            data=b"",
            channel_metadata=channel.metadata,
        )
        if self._channels.truth_channel(as_message) != channel.id:
            raise ResultError("channel order cannot be restored", where=channel.topic, hint=RESTART_HINT)


def check_unfinished(part: Path) -> None:
    """Raise ResultError unless there is an unfinished result."""
    if not part.exists():
        raise ResultError("no unfinished result to resume", where=part, hint="run without --resume")


def check_same_run(part: Path, expected: Mapping[str, Mapping[str, str]]) -> None:
    """Check that an unfinished result belongs to this run.

    Args:
        part: unfinished result.
        expected: metadata records this run would start with, by name.

    Raises:
        UsageError: a record differs; the error lists the keys with old and new values.
        ResultError: the file is missing, or ends before its records.
    """
    check_unfinished(part)
    stored = _first_metadata(part)
    for name, now in expected.items():
        then = stored.get(name)
        if then is None:
            raise ResultError(f"has no {name}", where=part, hint=RESTART_HINT)
        compared = (then.keys() | now.keys()) - {PATH_KEY}  # the recording may have been moved
        keys = sorted(key for key in compared if then.get(key) != now.get(key))
        for stated, what in _MADE_WITH.items():
            if stated in keys:
                raise UsageError(
                    f"the unfinished result was made with a different {what}",
                    where=part,
                    found=only_in(then.get(stated, "nothing"), now[stated]),
                    expected=only_in(now[stated], then.get(stated, "")),
                    hint=RESTART_HINT,
                )
        if keys:
            raise UsageError(
                "the unfinished result belongs to another run",
                where=part,
                found=_listed(then, keys),
                expected=_listed(now, keys),
                hint=f"resume with its original options, or {RESTART_HINT}",
            )


def _first_metadata(part: Path) -> dict[str, Mapping[str, str]]:
    """Return the metadata before the first chunk."""
    found: dict[str, Mapping[str, str]] = {}
    with opened(part) as stream:
        for span in record_spans(stream):
            if span.opcode == Opcode.CHUNK:
                break
            if span.opcode == Opcode.METADATA:
                with _damage(part, span):
                    record = read_record(stream, span)
                assert isinstance(record, Metadata)
                found[record.name] = record.metadata
    return found


@contextmanager
def _damage(part: Path, span: RecordSpan) -> Iterator[None]:
    """Convert errors on damaged records into a ResultError; damaged files are never resumed."""
    try:
        yield
    except DAMAGE as error:
        raise ResultError(
            f"record at byte {span.start} is damaged",
            where=part,
            found=error or type(error).__name__,
            hint=RESTART_HINT,
        ) from error


def _listed(record: Mapping[str, str], keys: list[str]) -> str:
    """Return the keys with their values, shortened."""
    return " ".join(f"{key}={_cut(record.get(key, 'nothing'))}" for key in keys)


def _cut(text: str, length: int = 40) -> str:
    return text if len(text) <= length else text[: length - 3] + "..."
