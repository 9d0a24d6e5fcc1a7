"""The last chunk of a file that ends within it: what lies before the cut."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # opcode, length of the content
CHUNK_HEAD = struct.Struct("<QQQII")  # first and last time, size, checksum, length of the compression's name
LENGTH = struct.Struct("<Q")


def cut_chunk_records(path: Path) -> Iterator[Schema | Channel | Message]:
    """Yield the whole schemas, channels and messages in the chunk that a file breaks off in, if it does.

    Compressed chunks give what their whole blocks hold. The checksum of the chunk covers what is missing,
    so that none is verified.
    """
    yield from _whole_records(_decompressed(_cut_chunk(path)))


def _cut_chunk(path: Path) -> bytes:
    """Return what there is of the content of the chunk at the end, empty if there is no such chunk."""
    with path.open("rb") as stream:
        size, position = path.stat().st_size, len(MAGIC)
        while position + HEAD.size <= size:
            stream.seek(position)
            opcode, length = HEAD.unpack(stream.read(HEAD.size))
            position += HEAD.size + length
            if position > size and opcode == Opcode.CHUNK:
                return stream.read()
    return b""


def _decompressed(content: bytes) -> bytes:
    """Return the records of a chunk's content as far as it goes."""
    if len(content) < CHUNK_HEAD.size:
        return b""
    name_end = CHUNK_HEAD.size + CHUNK_HEAD.unpack_from(content)[-1]
    name, data = content[CHUNK_HEAD.size : name_end], content[name_end + LENGTH.size :]
    try:
        if name == b"zstd":
            return zstandard.ZstdDecompressor().decompressobj().decompress(data)
        if name == b"lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data))
    except (zstandard.ZstdError, RuntimeError, EOFError):  # RuntimeError: lz4 has no error of its own
        return b""
    return data if name == b"" else b""


def _whole_records(data: bytes) -> Iterator[Schema | Channel | Message]:
    position = 0
    while position + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, position)
        start, position = position + HEAD.size, position + HEAD.size + length
        if position > len(data):
            return
        stream = ReadDataStream(BytesIO(data[start:position]))
        if opcode == Opcode.SCHEMA:
            yield Schema.read(stream)
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(stream)
        elif opcode == Opcode.MESSAGE:
            yield Message.read(stream, length)
