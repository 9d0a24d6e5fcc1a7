"""Messages of MCAP files, intact or not: what is readable is read, what is not is a loss."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from heapq import heappop, heappush
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk
from mcap.summary import Summary

from posetrack_cli.errors import RecordingError
from posetrack_cli.recording.losses import LossLog
from posetrack_cli.recording.mcap_salvage import HEAD, MAGIC, cut_chunk_records

TRUNCATED = "file is truncated, the rest is missing"
DAMAGED = "file is damaged, the rest is lost"
DAMAGED_CHUNK = "chunk is damaged, its messages are lost"
SMALLEST_LIMIT = 1 << 30
McapItem = tuple[Schema | None, Channel, Message]
T = TypeVar("T")


def check_mcap(path: Path) -> None:
    """Raise RecordingError unless the file begins as an MCAP file does."""
    try:
        with path.open("rb") as stream:
            begin = stream.read(len(MAGIC))
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    if begin != MAGIC:
        raise RecordingError(
            "is not an MCAP file", where=path, found=f"it begins with {begin!r}" if begin else "an empty file"
        )


def read_summary(path: Path) -> Summary | None:
    """Return the index at the end of the file, or None if there is none that messages can be found by.

    That is so for truncated files, and for files written without chunks or without index.
    """
    with path.open("rb") as stream:
        stream.seek(-min(len(MAGIC), path.stat().st_size), 2)
        if stream.read() != MAGIC:
            return None
        stream.seek(0)
        try:
            summary = _seeking(stream, path).get_summary()
        except Exception:  # the library raises whatever the damaged bytes lead to
            return None
    return summary if summary is not None and _is_usable(summary) else None


def read_messages(path: Path, losses: LossLog, topics: Collection[str] | None = None) -> Iterator[McapItem]:
    """Yield schema, channel and message of all messages, or of those on some topics.

    With a usable index they come in order of log time, else as they lie in the file. At most the
    chunks that overlap in time are in memory. A damaged chunk is left out. Where the file is cut the
    messages end with the last whole one; where it is damaged between chunks they end, too, if there is no
    index. ``losses`` gets each of these.
    """
    summary = read_summary(path)
    wanted = _Wanted(topics)
    if summary is not None:
        yield from _in_log_time_order(path, losses, summary, wanted)
    else:
        yield from _in_file_order(path, losses, wanted)


class _Wanted:
    """Puts messages together with their channels and schemas, and picks those on some topics."""

    def __init__(self, topics: Collection[str] | None) -> None:
        self._topics = topics
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}

    def learn(self, record: object) -> None:
        """Remember a schema or channel."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = record

    def has(self, channel_id: int) -> bool:
        """Whether a channel is known and on one of the topics."""
        channel = self._channels.get(channel_id)
        return channel is not None and (self._topics is None or channel.topic in self._topics)

    def items(self, records: Iterable[object]) -> Iterator[McapItem]:
        """Yield the messages among some records that are wanted; learns from the others."""
        for record in records:
            self.learn(record)
            if isinstance(record, Message) and self.has(record.channel_id):
                channel = self._channels[record.channel_id]
                yield self._schemas.get(channel.schema_id), channel, record


def _in_log_time_order(path: Path, losses: LossLog, summary: Summary, wanted: _Wanted) -> Iterator[McapItem]:
    """Yield messages by log time, those of equal times as they lie in the file; chunk after chunk is read."""
    for record in (*summary.schemas.values(), *summary.channels.values()):
        wanted.learn(record)
    pending: list[tuple[int, int, int, McapItem]] = []
    with path.open("rb") as stream:
        for index in sorted(
            summary.chunk_indexes, key=lambda i: (i.message_start_time, i.chunk_start_offset)
        ):
            offsets = index.message_index_offsets
            if offsets and not any(wanted.has(channel_id) for channel_id in offsets):
                continue
            while pending and pending[0][0] < index.message_start_time:
                yield heappop(pending)[-1]
            stream.seek(index.chunk_start_offset + HEAD.size)
            records: list[McapRecord] = []
            with _chunk_damage(stream, path, losses):
                chunk = Chunk.read(ReadDataStream(BytesIO(stream.read(index.chunk_length - HEAD.size))))
                records = breakup_chunk(chunk, validate_crc=True)
            for number, item in enumerate(wanted.items(records)):
                heappush(pending, (item[2].log_time, index.chunk_start_offset, number, item))
    while pending:
        yield heappop(pending)[-1]


def _in_file_order(path: Path, losses: LossLog, wanted: _Wanted) -> Iterator[McapItem]:
    with path.open("rb") as stream:
        reader = StreamReader(stream, emit_chunks=True, validate_crcs=True, record_size_limit=_limit(path))
        for record in _until_damage(reader.records, stream, path, losses):
            records = [record]
            if isinstance(record, Chunk):
                with _chunk_damage(stream, path, losses):
                    records = breakup_chunk(record, validate_crc=True)
            yield from wanted.items(records)
    if any(loss.what == TRUNCATED for loss in losses.losses):
        yield from wanted.items(cut_chunk_records(path))


@contextmanager
def _chunk_damage(stream: Any, path: Path, losses: LossLog) -> Iterator[None]:
    """A chunk that cannot be read is a loss and no error."""
    try:
        yield
    except Exception:  # the library raises whatever the damaged bytes lead to
        losses.add(DAMAGED_CHUNK, f"the one before byte {stream.tell()} of {path.stat().st_size}")


def read_extras(path: Path) -> Iterator[Metadata | Attachment]:
    """Yield the metadata and attachments of a file, up to where it is cut or damaged."""
    with path.open("rb") as stream:
        reader = StreamReader(stream, emit_chunks=True, record_size_limit=_limit(path))
        for record in _until_damage(reader.records, stream, path, LossLog()):
            if isinstance(record, Metadata | Attachment):
                yield record


def _until_damage(items: Iterator[T], stream: Any, path: Path, losses: LossLog) -> Iterator[T]:
    """Yield items until reading fails, which is a loss and no error."""
    while True:
        try:
            item = next(items)
        except StopIteration:
            return
        except CRCValidationError:  # of all data: nothing of it is missing
            if not losses.losses:
                losses.add(DAMAGED, f"byte {stream.tell()} of {path.stat().st_size}")
            return
        except Exception:  # the library raises whatever the damaged bytes lead to
            size, position = path.stat().st_size, stream.tell()
            losses.add(TRUNCATED if position >= size else DAMAGED, f"byte {position} of {size}")
            return
        yield item


def _seeking(stream: Any, path: Path) -> SeekingReader:
    return SeekingReader(stream, validate_crcs=True, record_size_limit=_limit(path))


def _limit(path: Path) -> int:
    """Lengths above are damage; one below that reaches beyond the end is a record cut short."""
    return max(SMALLEST_LIMIT, path.stat().st_size)


def _is_usable(summary: Summary) -> bool:
    """Whether every message can be found: chunks are indexed, channels and schemas are repeated."""
    statistics = summary.statistics
    if (
        not summary.chunk_indexes
        or statistics is None
        or statistics.chunk_count != len(summary.chunk_indexes)
    ):
        return False
    used = {channel_id for index in summary.chunk_indexes for channel_id in index.message_index_offsets}
    schemas = {0, *summary.schemas}
    return used <= set(summary.channels) and all(c.schema_id in schemas for c in summary.channels.values())
