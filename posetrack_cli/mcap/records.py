"""Records of MCAP files, and bounded decompression of their chunks."""

from __future__ import annotations

import bz2
import struct
import zlib
from collections.abc import Container, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import IO, TypeAlias

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Message, Metadata, Schema

from posetrack_cli import limits
from posetrack_cli.errors import RecordingError

# Bounded decompression: the stated size of a chunk is not trusted


class ChunkLimitError(ValueError):
    """A chunk that exceeds ``limits`` in size or number of records."""


class ExpansionBudget:
    """Limit on the total decompressed size of a file's chunks, per pass.

    Args:
        where: the file, for the error.
        file_bytes: its size.
    """

    def __init__(self, where: object, file_bytes: int) -> None:
        self._where = where
        self._most = self._left = max(limits.EXPANSION_FLOOR_BYTES, limits.EXPANSION * file_bytes)

    def spend(self, size: int) -> None:
        """Count a chunk's stated decompressed size, before decompressing it.

        Raises:
            RecordingError: the budget is exceeded.
        """
        self._left -= size
        if self._left < 0:
            raise RecordingError(
                "chunks expand too much on decompression",
                where=self._where,
                found=f"more than {self._most} bytes",
                expected=f"at most {limits.EXPANSION} times the file or {limits.EXPANSION_FLOOR_BYTES} bytes",
            )


def decompressed(chunk: Chunk) -> bytes:
    """Return the records of a chunk, with verified size and checksum.

    Raises:
        ChunkLimitError: the stated size exceeds ``limits.CHUNK_BYTES``.
        ValueError: size or checksum differs from the stated one.
        Exception: decompressors raise anything on damaged bytes.
    """
    data = bounded_content(chunk.compression, chunk.data, chunk.uncompressed_size)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("chunk checksum mismatch")
    return data


def bounded_content(compression: str, data: bytes, size: int) -> bytes:
    """Return decompressed data of exactly ``size`` bytes, never producing more.

    Raises:
        ChunkLimitError: the size exceeds ``limits.CHUNK_BYTES``.
        ValueError: the size differs, or the compression is unknown.
        Exception: decompressors raise anything on damaged bytes.
    """
    check_size(size)
    content = _expanded(compression, data, size)
    if len(content) != size:
        raise ValueError(f"chunk of {len(content)} bytes, stated {size}")
    return content


def bounded_begin(compression: str, data: bytes) -> bytes:
    """Return the decompressed whole blocks of a truncated chunk, at most ``CHUNK_BYTES``."""
    try:
        if compression == "zstd":
            # Reads to the last complete block; truncation counts as the end.
            with zstandard.ZstdDecompressor().stream_reader(data) as stream:
                return stream.read(limits.CHUNK_BYTES)
        if compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limits.CHUNK_BYTES))
        if compression == "bz2":
            return bz2.BZ2Decompressor().decompress(data, limits.CHUNK_BYTES)
    except (zstandard.ZstdError, RuntimeError, EOFError, OSError):  # lz4 raises RuntimeError, bz2 OSError
        return b""
    return data[: limits.CHUNK_BYTES] if not compression else b""


def check_size(size: int) -> None:
    """Raise ChunkLimitError if a chunk of this size is not supported."""
    if size > limits.CHUNK_BYTES:
        raise ChunkLimitError(f"chunk of {size} bytes, at most {limits.CHUNK_BYTES} supported")


def most_records(compressed: int) -> int:
    """Return the maximum number of records in a chunk of this compressed size."""
    return compressed // limits.BYTES_PER_RECORD + limits.SPARE_RECORDS


def _expanded(compression: str, data: bytes, size: int) -> bytes:
    if not compression:
        return data
    if compression == "zstd":
        stated = zstandard.frame_content_size(data)  # allocated by the decompressor despite max_output_size
        if stated > size:
            raise ValueError(f"zstd frame of {stated} bytes in a chunk of {size}")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size) if size else b""
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    if compression == "bz2":
        return bz2.BZ2Decompressor().decompress(data, size + 1)
    raise ValueError(f"unknown compression '{compression}'")


# Records of a file, as far as it is intact

DAMAGE: tuple[type[Exception], ...] = (Exception,)  # mcap and decompressors raise anything on damaged bytes
MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # opcode, length of the content
CHUNK_HEAD_BYTES = 64  # size of a chunk record without its data, rounded up
CHUNK_HEAD = struct.Struct("<QQQII")  # first and last time, size, checksum, length of the compression's name
LENGTH = struct.Struct("<Q")
_SCHEMA, _CHANNEL, _MESSAGE = map(
    int, (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
)  # enums compare slowly
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
    """Location of a complete record in its file.

    Attributes:
        opcode: kind of the record.
        start: offset of its content, bytes.
        end: offset after its last byte.
    """

    opcode: int
    start: int
    end: int


def record_spans(stream: IO[bytes]) -> Iterator[RecordSpan]:
    """Yield the records of an open MCAP file in order, up to the footer or a truncated record.

    Only their headers are read; the caller may seek in between.
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
    """Read a record of a kind in ``Record``; a damaged one raises any exception.

    Raises:
        ChunkLimitError: the chunk or record exceeds ``limits``.
    """
    if span.opcode == Opcode.CHUNK:
        check_size(span.end - span.start - CHUNK_HEAD_BYTES)
    elif span.end - span.start > limits.RECORD_BYTES:
        raise ChunkLimitError(f"record of {span.end - span.start} bytes")
    stream.seek(span.start)
    content = stream.read(span.end - span.start)
    if span.opcode == Opcode.MESSAGE:
        return _message(content, 0, len(content))
    record: Record = _KINDS[span.opcode].read(_stream(content))
    return record


class Definitions:
    """Schemas and channels in the chunks of a file; repeated ones are parsed once."""

    def __init__(self) -> None:
        self._contents: dict[tuple[int, bytes], bytes] = {}
        self._left = {Opcode.SCHEMA: limits.DEFINITION_BYTES, Opcode.CHANNEL: limits.CHANNEL_BYTES}

    def parsed(self, opcode: int, content: bytes) -> Schema | Channel | None:
        """Return a schema or channel, None if it repeats the last one with its number.

        Raises:
            ChunkLimitError: the total size exceeds ``limits``.
        """
        key = opcode, content[:2]  # the number
        if self._contents.get(key) == content:
            return None
        kind = Opcode(opcode)
        self._left[kind] -= len(content)
        if self._left[kind] < 0:
            raise ChunkLimitError("total size of schemas or channels exceeds the limit")
        self._contents[key] = content
        record: Schema | Channel = (Schema if kind is Opcode.SCHEMA else Channel).read(_stream(content))
        return record


def chunk_records(
    chunk: Record, unwanted: Container[int] = (), definitions: Definitions | None = None
) -> Iterator[ChunkRecord]:
    """Yield a chunk's schemas, channels and messages in order, after verifying its checksum.

    A damaged chunk raises any exception, possibly midway if it has no checksum.

    Args:
        chunk: its record.
        unwanted: ids of channels whose messages are skipped cheaply; may change during iteration.
        definitions: definitions of earlier chunks; known schemas and channels are skipped.

    Raises:
        ChunkLimitError: the chunk exceeds ``limits``.
        ValueError: it ends within a record, or is not a chunk.
    """
    if not isinstance(chunk, Chunk):
        raise ValueError(f"{type(chunk).__name__} is not a chunk")
    most = most_records(len(chunk.data))
    yield from content_records(decompressed(chunk), unwanted, definitions, most=most)


def content_records(
    data: bytes,
    unwanted: Container[int] = (),
    definitions: Definitions | None = None,
    *,
    most: int | None = None,
    cut: bool = False,
) -> Iterator[ChunkRecord]:
    """Yield the records of a chunk's content as ``chunk_records`` does; ``cut`` allows truncation.

    Raises:
        ChunkLimitError: there are more than ``most`` records; by default the limit for uncompressed data.
    """
    most = most_records(len(data)) if most is None else most
    known = Definitions() if definitions is None else definitions
    position, count, size = 0, 0, len(data)
    while position + HEAD.size <= size:
        opcode, length = HEAD.unpack_from(data, position)
        start, end = position + HEAD.size, position + HEAD.size + length
        if end > size:
            break
        position, count = end, count + 1
        if count > most:
            raise ChunkLimitError(f"chunk of more than {most} records")
        if opcode == _MESSAGE:
            if int.from_bytes(data[start : start + 2], "little") not in unwanted:
                yield _message(data, start, end)
        elif opcode in (_SCHEMA, _CHANNEL):
            record = known.parsed(opcode, data[start:end])
            if record is not None:
                yield record
        elif opcode == 0:
            raise ValueError("record without opcode")
    if position != size and not cut:
        raise ValueError(f"chunk ends within a record, at {position} of {size} bytes")


def cut_chunk_records(stream: IO[bytes], position: int) -> Iterator[ChunkRecord]:
    """Yield the complete schemas, channels and messages of a chunk truncated by the file's end.

    Compressed chunks are read up to their last complete block. The checksum covers the missing part and is
    not verified; bytes that are not records raise any exception.

    Args:
        stream: the file.
        position: offset of the truncated record.
    """
    stream.seek(position)
    head = stream.read(HEAD.size)
    if len(head) == HEAD.size and HEAD.unpack(head)[0] == Opcode.CHUNK:
        records, most = _cut_content(stream.read(limits.CHUNK_BYTES))
        yield from content_records(records, most=most, cut=True)


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))


def _message(data: bytes, start: int, end: int) -> Message:
    if end - start < _MESSAGE_HEAD.size:
        raise ValueError(f"a message of {end - start} bytes")
    channel_id, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(data, start)
    return Message(channel_id, log_time, data[start + _MESSAGE_HEAD.size : end], publish_time, sequence)


def _cut_content(content: bytes) -> tuple[bytes, int]:
    """Return the available records of a truncated chunk, and their maximum number."""
    if len(content) < CHUNK_HEAD.size:
        return b"", 0
    name_end = CHUNK_HEAD.size + CHUNK_HEAD.unpack_from(content)[-1]
    name, data = content[CHUNK_HEAD.size : name_end], content[name_end + LENGTH.size :]
    return bounded_begin(name.decode("ascii", "replace"), data), most_records(len(data))
