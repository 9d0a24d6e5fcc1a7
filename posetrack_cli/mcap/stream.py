"""Messages of MCAP files, intact or damaged: unreadable data count as losses."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from heapq import heappop, heappush
from pathlib import Path
from typing import IO, TypeAlias

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, ChunkIndex, DataEnd, Message, Metadata, Schema
from mcap.summary import Summary

from posetrack_cli import limits
from posetrack_cli.errors import RecordingError
from posetrack_cli.files import begins_with, open_input
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.records import (
    DAMAGE,
    HEAD,
    MAGIC,
    ChunkLimitError,
    ChunkRecord,
    Definitions,
    ExpansionBudget,
    Record,
    RecordSpan,
    chunk_records,
    cut_chunk_records,
    read_record,
    record_spans,
)
from posetrack_cli.mcap.summary import chunk_span, extra_spans, read_summary

TRUNCATED = "file is truncated, the rest is missing"
DAMAGED = "file is damaged, the rest is lost"
DAMAGED_CHUNK = "chunk is damaged, its messages are lost"
LARGE_CHUNK = "chunk is too large, its messages are lost"
DAMAGED_RECORD = "damaged record skipped"
DAMAGED_DATA = "data is damaged, checksum mismatch"
UNKNOWN_CHANNEL = "message skipped, its topic was lost with damaged data"
# A record length up to this (or the file size) beyond the end of the file means truncation, not damage.
SMALLEST_LIMIT = 1 << 30
BLOCK_BYTES = 1 << 20
McapItem: TypeAlias = tuple[Schema | None, Channel, Message]
# Names of topics, or a predicate on names; None for all topics.
Topics: TypeAlias = Collection[str] | Callable[[str], bool] | None


def is_mcap(path: Path) -> bool:
    """Return whether a file begins like an MCAP file.

    Raises:
        RecordingError: the file cannot be read.
    """
    try:
        return begins_with(path, MAGIC)
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error


def wanted_names(topics: Topics) -> Callable[[str], bool]:
    """Return a predicate on topic names."""
    names = topics if topics is None or callable(topics) else frozenset(topics)
    return names if callable(names) else (lambda topic: names is None or topic in names)


class McapFile:
    """A file, read as far as possible.

    Args:
        path: the file.
        losses: receives unreadable data.
    """

    def __init__(self, path: Path, losses: LossLog | None = None) -> None:
        self.path, self.losses = path, LossLog() if losses is None else losses

    def messages(self, topics: Topics = None, *, in_file_order: bool = False) -> Iterator[McapItem]:
        """Yield schema, channel and message, of all or some topics.

        With a usable index they are in log-time order, or in file order on request; without one always in
        file order. Memory holds at most the chunks that overlap in time. Damaged chunks and chunks beyond
        ``limits`` are skipped. A truncated file yields messages up to the last complete one; a file damaged
        between chunks ends there unless it has an index. All of this goes to ``losses``.

        Args:
            topics: names, or a predicate on names, which may change during iteration.
            in_file_order: do not sort by log time.

        Raises:
            RecordingError: chunks expand beyond ``limits``, or too many overlap in time.
        """
        summary, wanted = read_summary(self.path), _Wanted(self, topics)
        if summary is None:
            yield from self._without_index(wanted)
        else:
            wanted.add_summary(summary)
            in_order = self._in_file_order if in_file_order else self._in_log_time_order
            yield from in_order(summary.chunk_indexes, wanted)

    def counts(self) -> list[tuple[Schema | None, Channel, int]] | None:
        """Return every channel with its number of messages in the index; None without an index."""
        summary = read_summary(self.path)
        if summary is None or summary.statistics is None:
            return None
        counts = summary.statistics.channel_message_counts
        channels = summary.channels.values()
        return [(summary.schemas.get(c.schema_id), c, counts.get(c.id, 0)) for c in channels]

    def channels(self) -> list[tuple[Schema | None, Channel]]:
        """Return every channel with its schema, from the index or by reading the whole file."""
        summary, found = read_summary(self.path), _Wanted(self, ())
        if summary is not None:
            found.add_summary(summary)
        else:
            for _ in self._without_index(found):
                pass  # reads definitions only: no topic is wanted
        return found.channels()

    def extras(self) -> Iterator[Metadata | Attachment]:
        """Yield metadata and attachments: by the index, else up to truncation or damage."""
        indexed = extra_spans(read_summary(self.path))
        with open_input(self.path) as stream:
            for span in self._spans(stream) if indexed is None else indexed:
                if span.opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
                    record = self._record(stream, span)
                    if isinstance(record, Metadata | Attachment):
                        yield record

    def _size(self) -> int:
        """Return the current size, bytes; the file may still be growing."""
        return self.path.stat().st_size

    def _in_log_time_order(self, indexes: Sequence[ChunkIndex], wanted: _Wanted) -> Iterator[McapItem]:
        """Yield messages by log time, ties in file order, chunk by chunk."""
        pending: list[tuple[int, int, int, McapItem]] = []
        waiting = 0  # bytes
        with open_input(self.path) as stream:
            ordered = sorted(indexes, key=lambda i: (i.message_start_time, i.chunk_start_offset))
            for index in filter(wanted.is_in, ordered):
                while pending and pending[0][0] < index.message_start_time:
                    item = heappop(pending)[-1]
                    waiting -= len(item[2].data)
                    yield item
                for number, item in enumerate(self._chunk(stream, chunk_span(index), wanted)):
                    heappush(pending, (item[2].log_time, index.chunk_start_offset, number, item))
                    waiting += len(item[2].data)
                if waiting > limits.PENDING_BYTES:
                    raise RecordingError(
                        "chunks overlap in time",
                        where=self.path,
                        found=f"{waiting} bytes of pending messages",
                        expected=f"at most {limits.PENDING_BYTES}",
                        hint="sort the file by time first, e.g. with: mcap sort",
                    )
        while pending:
            yield heappop(pending)[-1]

    def _in_file_order(self, indexes: Sequence[ChunkIndex], wanted: _Wanted) -> Iterator[McapItem]:
        with open_input(self.path) as stream:
            ordered = sorted(indexes, key=lambda i: i.chunk_start_offset)
            for index in filter(wanted.is_in, ordered):
                yield from self._chunk(stream, chunk_span(index), wanted)

    def _without_index(self, wanted: _Wanted) -> Iterator[McapItem]:
        end = len(MAGIC)
        with open_input(self.path) as stream:
            for span in self._spans(stream):
                end = span.end
                if span.opcode == Opcode.CHUNK:
                    yield from self._chunk(stream, span, wanted)
                elif span.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                    record = self._record(stream, span)
                    if isinstance(record, Schema | Channel | Message):
                        yield from wanted.items([record])
                elif span.opcode == Opcode.DATA_END:
                    self._check_data(stream, span)
            with self._chunk_damage(self._size()):
                yield from wanted.items(cut_chunk_records(stream, end))

    def _chunk(self, stream: IO[bytes], span: RecordSpan, wanted: _Wanted) -> list[McapItem]:
        """Return the wanted messages of a chunk."""
        with self._chunk_damage(span.end):
            return wanted.of_chunk(read_record(stream, span))
        return []

    def _spans(self, stream: IO[bytes]) -> Iterator[RecordSpan]:
        """Yield the complete records of the file; ending before its footer is a loss."""
        opcode, end = 0, len(MAGIC)
        for span in record_spans(stream):
            opcode, end = span.opcode, span.end
            yield span
        stream.seek(end)
        rest, size = stream.read(HEAD.size), self._size()
        if opcode == Opcode.FOOTER and rest == MAGIC:
            return
        if len(rest) < HEAD.size or _is_cut(rest, size):
            self.losses.add(TRUNCATED, f"byte {size} of {size}")
        else:
            self.losses.add(DAMAGED, f"byte {end} of {size}")

    def _record(self, stream: IO[bytes], span: RecordSpan) -> Record | None:
        """Return a record, or None if it is unreadable, which is a loss, not an error."""
        try:
            return read_record(stream, span)
        except DAMAGE:
            self.losses.add(DAMAGED_RECORD, f"before byte {span.end} of {self._size()}")
            return None

    @contextmanager
    def _chunk_damage(self, end: int) -> Iterator[None]:
        """Turn damage of a chunk into a loss; only an exceeded expansion budget is an error."""
        try:
            yield
        except RecordingError:
            raise
        except ChunkLimitError as error:
            self.losses.add(LARGE_CHUNK, f"{error}, before byte {end} of {self._size()}")
        except DAMAGE:
            self.losses.add(DAMAGED_CHUNK, f"before byte {end} of {self._size()}")

    def _check_data(self, stream: IO[bytes], span: RecordSpan) -> None:
        """Verify the checksum of the data section, if any, unless losses explain a mismatch."""
        record = self._record(stream, span)
        if not isinstance(record, DataEnd) or record.data_section_crc == 0 or self.losses.losses:
            return
        stream.seek(0)
        crc, left = 0, span.start - HEAD.size
        while left > 0:
            block = stream.read(min(left, BLOCK_BYTES))
            crc, left = zlib.crc32(block, crc), left - len(block)
        if crc != record.data_section_crc:
            self.losses.add(DAMAGED_DATA, f"within {span.start} bytes")


class _Wanted:
    """Joins messages with their channels and schemas, and selects topics."""

    def __init__(self, file: McapFile, topics: Topics) -> None:
        self._wants = wanted_names(topics)
        self._losses = file.losses
        self._budget = ExpansionBudget(file.path, file.path.stat().st_size)
        self._definitions = Definitions()
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._unwanted: set[int] = set()

    def add(self, record: Schema | Channel) -> None:
        """Store a schema or channel."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        else:
            self._channels[record.id] = record
            if not self._wants(record.topic):
                self._unwanted.add(record.id)

    def add_summary(self, summary: Summary) -> None:
        """Store the schemas and channels of an index."""
        for schema in summary.schemas.values():
            self.add(schema)
        for channel in summary.channels.values():
            self.add(channel)

    def channels(self) -> list[tuple[Schema | None, Channel]]:
        """Return every known channel with its schema."""
        return [(self._schemas.get(channel.schema_id), channel) for channel in self._channels.values()]

    def is_in(self, index: ChunkIndex) -> bool:
        """Return whether a chunk may hold wanted messages."""
        ids = index.message_index_offsets
        return not ids or any(self._wants(self._channels[channel_id].topic) for channel_id in ids)

    def of_chunk(self, chunk: Record) -> list[McapItem]:
        """Return the wanted messages of a chunk; a damaged one raises any exception."""
        if isinstance(chunk, Chunk):
            self._budget.spend(chunk.uncompressed_size)
        return list(self.items(chunk_records(chunk, self._unwanted, self._definitions)))

    def items(self, records: Iterable[ChunkRecord]) -> Iterator[McapItem]:
        """Yield the wanted messages among records, and store schemas and channels."""
        for record in records:
            if not isinstance(record, Message):
                self.add(record)
            elif record.channel_id not in self._channels:
                self._losses.add(UNKNOWN_CHANNEL, f"at {record.log_time} ns")
            elif record.channel_id not in self._unwanted:
                channel = self._channels[record.channel_id]
                yield self._schemas.get(channel.schema_id), channel, record


def _is_cut(head: bytes, size: int) -> bool:
    """Return whether a record beyond the end of the file is likely truncated, not damaged."""
    opcode, length = HEAD.unpack(head)
    return bool(opcode != 0 and length <= max(SMALLEST_LIMIT, size))
