"""The records of an MCAP file, one by one, as far as they are whole: what every reader of MCAP here walks."""

from __future__ import annotations

import struct
from collections.abc import Container, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import IO, TypeAlias

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # opcode, length of the content
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time

ChunkRecord: TypeAlias = Schema | Channel | Message
Record: TypeAlias = ChunkRecord | Chunk | Metadata | Attachment | DataEnd

_KINDS: dict[int, type[Schema | Channel | Chunk | Metadata | Attachment | DataEnd]] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
    Opcode.DATA_END: DataEnd,
}


@dataclass(frozen=True, slots=True)
class RecordSpan:
    """Where a whole record lies in its file.

    Attributes:
        opcode: kind of the record.
        start: offset of its content, bytes.
        end: offset after its last byte.
    """

    opcode: int
    start: int
    end: int


def record_spans(stream: IO[bytes]) -> Iterator[RecordSpan]:
    """Yield the records of an open MCAP file in order, ending after the footer or before one cut short.

    Only their heads are read; the caller may read elsewhere in between.
    """
    size, position = stream.seek(0, 2), len(MAGIC)
    while position + HEAD.size <= size:
        stream.seek(position)
        opcode, length = HEAD.unpack(stream.read(HEAD.size))
        start, position = position + HEAD.size, position + HEAD.size + length
        if opcode == 0 or position > size:
            return
        yield RecordSpan(opcode, start, position)
        if opcode == Opcode.FOOTER:
            return


def read_record(stream: IO[bytes], span: RecordSpan) -> Record:
    """Read a record of any of the kinds of ``Record``; a damaged one raises whatever its bytes lead to."""
    stream.seek(span.start)
    content = stream.read(span.end - span.start)
    if span.opcode == Opcode.MESSAGE:
        return _message(content, 0, len(content))
    record: Record = _KINDS[span.opcode].read(_stream(content))
    return record


def chunk_records(chunk: Record, unwanted: Container[int] = ()) -> Iterator[ChunkRecord]:
    """Yield a chunk's schemas, channels and messages in order, its checksum verified.

    A damaged chunk raises whatever its bytes lead to, in the middle if it has no checksum.

    Args:
        chunk: its record.
        unwanted: ids of channels whose messages are left out, which costs little; looked at as it goes.

    Raises:
        ValueError: it ends within a record, or is no chunk.
    """
    if not isinstance(chunk, Chunk):
        raise ValueError(f"{type(chunk).__name__} is no chunk")
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    yield from content_records(stream.read(size), unwanted)


def content_records(
    data: bytes, unwanted: Container[int] = (), *, cut: bool = False
) -> Iterator[ChunkRecord]:
    """Yield the records of a chunk's content as ``chunk_records`` does; content that is cut ends anywhere."""
    position = 0
    while position + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, position)
        start, end = position + HEAD.size, position + HEAD.size + length
        if end > len(data):
            break
        position = end
        if opcode == Opcode.MESSAGE:
            if int.from_bytes(data[start : start + 2], "little") not in unwanted:
                yield _message(data, start, end)
        elif opcode == Opcode.SCHEMA:
            yield Schema.read(_stream(data[start:end]))
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(_stream(data[start:end]))
    if position != len(data) and not cut:
        raise ValueError(f"chunk ends within a record, at {position} of {len(data)} bytes")


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))


def _message(data: bytes, start: int, end: int) -> Message:
    if end - start < _MESSAGE_HEAD.size:
        raise ValueError(f"a message of {end - start} bytes")
    channel_id, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(data, start)
    return Message(channel_id, log_time, data[start + _MESSAGE_HEAD.size : end], publish_time, sequence)
