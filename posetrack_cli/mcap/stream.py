"""Messages of MCAP files, intact or not: what is readable is read, what is not is a loss."""

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
LARGE_CHUNK = "chunk is larger than any that is read, its messages are lost"
DAMAGED_RECORD = "record is damaged and left out"
DAMAGED_DATA = "data is damaged, its checksum differs"
UNKNOWN_CHANNEL = "message of a topic that was lost with damaged data"
SMALLEST_LIMIT = 1 << 30
BLOCK_BYTES = 1 << 20
McapItem: TypeAlias = tuple[Schema | None, Channel, Message]
Topics: TypeAlias = Collection[str] | Callable[[str], bool] | None
"""Names of topics, or what tells of a name whether it is wanted; None for all topics."""


def is_mcap(path: Path) -> bool:
    """Whether a file begins as an MCAP file does.

    Raises:
        RecordingError: if it cannot be read.
    """
    try:
        return begins_with(path, MAGIC)
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error


def wanted_names(topics: Topics) -> Callable[[str], bool]:
    """Return what tells of the name of a topic whether it is wanted."""
    names = topics if topics is None or callable(topics) else frozenset(topics)
    return names if callable(names) else (lambda topic: names is None or topic in names)


class McapFile:
    """A file to be read, as far as it can be.

    Args:
        path: the file.
        losses: gets what cannot be read; by default nobody is told.
    """

    def __init__(self, path: Path, losses: LossLog | None = None) -> None:
        self.path, self.losses = path, LossLog() if losses is None else losses

    def messages(self, topics: Topics = None, *, in_file_order: bool = False) -> Iterator[McapItem]:
        """Yield schema, channel and message of all messages, or of those on some topics.

        With a usable index they come in order of log time, or if asked for as they lie in the file; without
        one always so. At most the chunks that overlap in time are in memory. A damaged chunk is left out, and
        one beyond ``limits``. Where the file is cut the messages end with the last whole one; where it is
        damaged between chunks they end, too, if there is no index. ``losses`` gets each of these.

        Args:
            topics: names, or what tells of a name whether it is wanted, which may change meanwhile.
            in_file_order: whether an index is not to change the order.

        Raises:
            RecordingError: chunks decompress to more than any recording's, or too much of them overlaps in
                time.
        """
        summary, wanted = read_summary(self.path), _Wanted(self, topics)
        if summary is None:
            yield from self._without_index(wanted)
        else:
            wanted.learn_all(summary)
            in_order = self._in_file_order if in_file_order else self._in_log_time_order
            yield from in_order(summary.chunk_indexes, wanted)

    def counts(self) -> list[tuple[Schema | None, Channel, int]] | None:
        """Return every channel with the number of its messages, as the index tells; None if it does not."""
        summary = read_summary(self.path)
        if summary is None or summary.statistics is None:
            return None
        told = summary.statistics.channel_message_counts
        channels = summary.channels.values()
        return [(summary.schemas.get(c.schema_id), c, told.get(c.id, 0)) for c in channels]

    def channels(self) -> list[tuple[Schema | None, Channel]]:
        """Return every channel with its schema: from the index, or by reading all of a file that has none."""
        summary, found = read_summary(self.path), _Wanted(self, ())
        if summary is not None:
            found.learn_all(summary)
        else:
            for _ in self._without_index(found):
                pass  # no topic is wanted
        return found.channels()

    def extras(self) -> Iterator[Metadata | Attachment]:
        """Yield the metadata and attachments: by the index, or else up to a cut or damage."""
        indexed = extra_spans(read_summary(self.path))
        with open_input(self.path) as stream:
            for span in self._spans(stream) if indexed is None else indexed:
                if span.opcode in (Opcode.METADATA, Opcode.ATTACHMENT):
                    record = self._record(stream, span)
                    if isinstance(record, Metadata | Attachment):
                        yield record

    def _size(self) -> int:
        """Of the file, bytes; one that is being written grows."""
        return self.path.stat().st_size

    def _in_log_time_order(self, indexes: Sequence[ChunkIndex], wanted: _Wanted) -> Iterator[McapItem]:
        """Yield messages by log time, those of equal times as they lie in the file, chunk by chunk."""
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
                        found=f"{waiting} bytes of messages that wait for their turn",
                        expected=f"at most {limits.PENDING_BYTES}",
                        hint="write it anew in order of time, for example with: mcap sort",
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
        """Yield the whole records of the file; that they end before its footer is a loss."""
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
        """Return a record, or None if it cannot be read, which is a loss and no error."""
        try:
            return read_record(stream, span)
        except DAMAGE:
            self.losses.add(DAMAGED_RECORD, f"the one before byte {span.end} of {self._size()}")
            return None

    @contextmanager
    def _chunk_damage(self, end: int) -> Iterator[None]:
        """A chunk that cannot be read is a loss and no error; that all of them are too large is one."""
        try:
            yield
        except RecordingError:
            raise
        except ChunkLimitError as error:
            self.losses.add(LARGE_CHUNK, f"{error}, the one before byte {end} of {self._size()}")
        except DAMAGE:
            self.losses.add(DAMAGED_CHUNK, f"the one before byte {end} of {self._size()}")

    def _check_data(self, stream: IO[bytes], span: RecordSpan) -> None:
        """Check the checksum of all data, if any; a difference that nothing else showed is a loss."""
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
    """Puts messages together with their channels and schemas, and picks those on some topics."""

    def __init__(self, file: McapFile, topics: Topics) -> None:
        self._wants = wanted_names(topics)
        self._losses = file.losses
        self._budget = ExpansionBudget(file.path, file.path.stat().st_size)
        self._definitions = Definitions()
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._unwanted: set[int] = set()

    def learn(self, record: Schema | Channel) -> None:
        """Remember a schema or channel."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        else:
            self._channels[record.id] = record
            if not self._wants(record.topic):
                self._unwanted.add(record.id)

    def learn_all(self, summary: Summary) -> None:
        """Remember the schemas and channels of an index."""
        for schema in summary.schemas.values():
            self.learn(schema)
        for channel in summary.channels.values():
            self.learn(channel)

    def channels(self) -> list[tuple[Schema | None, Channel]]:
        """Every channel met, with its schema."""
        return [(self._schemas.get(channel.schema_id), channel) for channel in self._channels.values()]

    def is_in(self, index: ChunkIndex) -> bool:
        """Whether a chunk may hold messages that are wanted."""
        ids = index.message_index_offsets
        return not ids or any(self._wants(self._channels[channel_id].topic) for channel_id in ids)

    def of_chunk(self, chunk: Record) -> list[McapItem]:
        """Return the messages of a chunk that are wanted; a damaged one raises whatever its bytes lead to."""
        if isinstance(chunk, Chunk):
            self._budget.spend(chunk.uncompressed_size)
        return list(self.items(chunk_records(chunk, self._unwanted, self._definitions)))

    def items(self, records: Iterable[ChunkRecord]) -> Iterator[McapItem]:
        """Yield the messages among some records that are wanted; learns from the others."""
        for record in records:
            if not isinstance(record, Message):
                self.learn(record)
            elif record.channel_id not in self._channels:
                self._losses.add(UNKNOWN_CHANNEL, f"at {record.log_time} ns")
            elif record.channel_id not in self._unwanted:
                channel = self._channels[record.channel_id]
                yield self._schemas.get(channel.schema_id), channel, record


def _is_cut(head: bytes, size: int) -> bool:
    """Whether a record that reaches beyond the end may well be as long as its head says.

    Lengths above the limit are damage; one below that reaches beyond the end is a record cut short.
    """
    opcode, length = HEAD.unpack(head)
    return bool(opcode != 0 and length <= max(SMALLEST_LIMIT, size))
