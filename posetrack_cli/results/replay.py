"""Write the flushed part of an interrupted result once more, byte for byte, into a new sink."""

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
    "sources": "build of posetrack",
    "libraries": "set of libraries",
    "processor": "kind of processor",
}
"""Entries of the run record that no option brings back (``build``), and what they describe."""


class Replay:
    """Writes the flushed part of an interrupted result once more.

    Args:
        part: the interrupted result.
        sink: where to.
        channels: of the sink.

    Attributes:
        attached: the names of the attachments written.
    """

    def __init__(self, part: Path, sink: McapSink, channels: ResultChannels) -> None:
        self._part, self._sink, self._channels = part, sink, channels
        self._schemas: dict[int, Schema] = {}
        self.attached: set[str] = set()

    def run(self, file_bytes: int) -> None:
        """Write the chunks and attachments in the first ``file_bytes``.

        What lies behind (frames after the last checkpoint, a chunk cut short, a footer) is left out. Chunks
        end where they ended before; one chunk is in memory at a time.

        Raises:
            ResultError: the file is shorter than that, or damaged.
            UsageError: it is of another camera.
        """
        position = 0
        with opened(self._part) as stream:
            for span in record_spans(stream):
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
                "checkpoint does not fit the unfinished result",
                where=self._part,
                found=f"{position} whole bytes",
                expected=file_bytes,
                hint=RESTART_HINT,
            )

    def _attach(self, record: Attachment) -> None:
        self._sink.attachment(record.name, record.media_type, record.data, record.log_time)
        self.attached.add(record.name)

    def _write(self, records: list[ChunkRecord]) -> None:
        """Write a chunk."""
        for record in records:
            if isinstance(record, Schema):
                self._schemas[record.id] = record
            elif isinstance(record, Channel):
                self._adopt(record)
            else:
                self._channels.write_replayed(record.channel_id, record.log_time, record.data)
        self._sink.flush()

    def _adopt(self, channel: Channel) -> None:
        """Register a truth channel where it was registered before; the result's own exist already."""
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
            raise ResultError(
                "channels cannot be written in their old order", where=channel.topic, hint=RESTART_HINT
            )


def check_unfinished(part: Path) -> None:
    """Raise ResultError unless there is an unfinished result."""
    if not part.exists():
        raise ResultError("no unfinished result to resume", where=part, hint="run without --resume")


def check_same_run(part: Path, expected: Mapping[str, Mapping[str, str]]) -> None:
    """Refuse to go on with a result that another run began.

    Args:
        part: the unfinished result.
        expected: the metadata records that this run would begin with, by name.

    Raises:
        UsageError: a record differs; the error names the keys, and their values then and now.
        ResultError: the file is missing, or killed before its records were written.
    """
    check_unfinished(part)
    stored = _first_metadata(part)
    for name, now in expected.items():
        then = stored.get(name)
        if then is None:
            raise ResultError(f"holds no {name}", where=part, hint=RESTART_HINT)
        compared = (then.keys() | now.keys()) - {PATH_KEY}  # the recording may have moved meanwhile
        keys = sorted(key for key in compared if then.get(key) != now.get(key))
        for stated, what in _MADE_WITH.items():
            if stated in keys:
                raise UsageError(
                    f"the unfinished result is of another {what}, so equal bytes cannot be promised",
                    where=part,
                    found=only_in(then.get(stated, "nothing"), now[stated]),
                    expected=only_in(now[stated], then.get(stated, "")),
                    hint=RESTART_HINT,
                )
        if keys:
            raise UsageError(
                "the unfinished result is of another run",
                where=part,
                found=_listed(then, keys),
                expected=_listed(now, keys),
                hint=f"resume with the options it was begun with, or {RESTART_HINT}",
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
    """Nothing is resumed that is damaged: whatever reading a record raises becomes one line."""
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
    """Return the keys with their values, long values cut."""
    return " ".join(f"{key}={_cut(record.get(key, 'nothing'))}" for key in keys)


def _cut(text: str, length: int = 40) -> str:
    return text if len(text) <= length else text[: length - 3] + "..."
