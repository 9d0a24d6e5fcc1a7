"""The last chunk of a file that ends within it: what lies before the cut."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import IO

from mcap.opcode import Opcode

from posetrack_cli import limits
from posetrack_cli.mcap.chunks import decompressed_begin, most_records
from posetrack_cli.mcap.records import HEAD, ChunkRecord, content_records

CHUNK_HEAD = struct.Struct("<QQQII")  # first and last time, size, checksum, length of the compression's name
LENGTH = struct.Struct("<Q")


def cut_chunk_records(stream: IO[bytes], position: int) -> Iterator[ChunkRecord]:
    """Yield the whole schemas, channels and messages in the chunk that an open file breaks off in, if any.

    Compressed chunks give what their whole blocks hold. The checksum of the chunk covers what is missing,
    so that none is verified; bytes that are no records raise whatever they lead to.

    Args:
        stream: the file.
        position: offset of the record that is cut.
    """
    stream.seek(position)
    head = stream.read(HEAD.size)
    if len(head) == HEAD.size and HEAD.unpack(head)[0] == Opcode.CHUNK:
        records, most = _decompressed(stream.read(limits.CHUNK_BYTES))
        yield from content_records(records, most=most, cut=True)


def _decompressed(content: bytes) -> tuple[bytes, int]:
    """Return the records of a chunk's content as far as it goes, and how many there may be."""
    if len(content) < CHUNK_HEAD.size:
        return b"", 0
    name_end = CHUNK_HEAD.size + CHUNK_HEAD.unpack_from(content)[-1]
    name, data = content[CHUNK_HEAD.size : name_end], content[name_end + LENGTH.size :]
    return decompressed_begin(name.decode("ascii", "replace"), data), most_records(len(data))
