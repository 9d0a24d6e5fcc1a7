"""The index (summary section) of an MCAP file: locations of chunks, metadata and attachments."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from functools import lru_cache
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, ChunkIndex, MetadataIndex, Schema, Statistics
from mcap.summary import Summary

from posetrack_cli import limits
from posetrack_cli.files import open_input
from posetrack_cli.mcap.records import DAMAGE, HEAD, MAGIC, RecordSpan

_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, of the offsets, checksum
_FOOTER_LENGTH = _FOOTER.size - HEAD.size
_CRC_SIZE = 4
_SUMMARY_KINDS: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.STATISTICS: Statistics,
}


def read_summary(path: Path) -> Summary | None:
    """Return a file's index, or None if messages cannot be found by it; it is shared and not to be changed.

    That is so for truncated files, files without chunks or index, and an index that points to one place
    twice or outside the file. None of its own records is decompressed.
    """
    with open_input(path) as stream:
        try:
            return _usable(_summary_bytes(stream), stream.seek(0, 2))
        except DAMAGE:
            return None


# An index of an hour takes .3 s to parse, and one command opens its file several times.
@lru_cache(maxsize=2)
def _usable(records: bytes, size: int) -> Summary | None:
    summary = _parsed(records)
    return summary if summary is not None and _is_usable(summary, size) else None


def chunk_span(index: ChunkIndex) -> RecordSpan:
    """Return the location of a chunk according to the index."""
    end = index.chunk_start_offset + index.chunk_length
    return RecordSpan(Opcode.CHUNK, index.chunk_start_offset + HEAD.size, end)


def extra_spans(summary: Summary | None) -> list[RecordSpan] | None:
    """Return the locations of metadata and attachments in order; None if the index is incomplete."""
    if summary is None or summary.statistics is None:
        return None
    counts = (summary.statistics.metadata_count, summary.statistics.attachment_count)
    if counts != (len(summary.metadata_indexes), len(summary.attachment_indexes)):
        return None
    return sorted(_extras(summary), key=lambda span: span.start)


def _extras(summary: Summary) -> list[RecordSpan]:
    places = [(i.offset, i.length, Opcode.METADATA) for i in summary.metadata_indexes]
    places += [(i.offset, i.length, Opcode.ATTACHMENT) for i in summary.attachment_indexes]
    return [RecordSpan(kind, offset + HEAD.size, offset + length) for offset, length, kind in places]


def _summary_bytes(stream: IO[bytes]) -> bytes:
    """Return the verified records of the summary; empty if there is no summary or no proper end."""
    footer_at = stream.seek(0, 2) - len(MAGIC) - _FOOTER.size
    if footer_at < len(MAGIC):
        return b""
    stream.seek(footer_at)
    footer, end = stream.read(_FOOTER.size), stream.read()
    opcode, length, start, _, crc = _FOOTER.unpack(footer)
    if (opcode, length, end) != (Opcode.FOOTER, _FOOTER_LENGTH, MAGIC):
        return b""
    if not len(MAGIC) <= start < footer_at or footer_at - start > limits.SUMMARY_BYTES:
        return b""
    stream.seek(start)
    records = stream.read(footer_at - start)
    if crc and zlib.crc32(records + footer[:-_CRC_SIZE]) != crc:
        return b""
    return records


def _parsed(records: bytes) -> Summary | None:
    if not records:
        return None
    summary, position = Summary(), 0
    while position < len(records):
        opcode, length = HEAD.unpack_from(records, position)
        start, position = position + HEAD.size, position + HEAD.size + length
        if position > len(records):
            return None
        if opcode in _SUMMARY_KINDS:
            _keep(summary, _SUMMARY_KINDS[opcode].read(ReadDataStream(BytesIO(records[start:position]))))
    return summary


def _keep(summary: Summary, record: Any) -> None:
    if isinstance(record, Statistics):
        summary.statistics = record
    elif isinstance(record, Schema):
        summary.schemas[record.id] = record
    elif isinstance(record, Channel):
        summary.channels[record.id] = record
    elif isinstance(record, ChunkIndex):
        summary.chunk_indexes.append(record)
    elif isinstance(record, AttachmentIndex):
        summary.attachment_indexes.append(record)
    elif isinstance(record, MetadataIndex):
        summary.metadata_indexes.append(record)


def _is_usable(summary: Summary, size: int) -> bool:
    """Return whether all messages can be found: chunks indexed, channels and schemas repeated."""
    statistics = summary.statistics
    if (
        not summary.chunk_indexes
        or statistics is None
        or statistics.chunk_count != len(summary.chunk_indexes)
        or sum(statistics.channel_message_counts.values()) > limits.MESSAGES
    ):
        return False
    if not _are_apart([*map(chunk_span, summary.chunk_indexes), *_extras(summary)], size):
        return False
    used = {channel_id for index in summary.chunk_indexes for channel_id in index.message_index_offsets}
    schemas = {0, *summary.schemas}
    return used <= set(summary.channels) and all(c.schema_id in schemas for c in summary.channels.values())


def _are_apart(spans: Iterable[RecordSpan], size: int) -> bool:
    """Return whether records do not overlap; a repeated one would be read again and again."""
    ordered = sorted(spans, key=lambda span: span.start)
    if any(span.end < span.start for span in ordered) or ordered[-1].end > size:
        return False
    return all(before.end + HEAD.size <= span.start for before, span in pairwise(ordered))
