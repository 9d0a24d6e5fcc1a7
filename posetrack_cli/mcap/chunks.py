"""The content of MCAP chunks, decompressed within bounds: a chunk may claim anything of its size."""

from __future__ import annotations

import bz2
import zlib

import lz4.frame
import zstandard
from mcap.records import Chunk

from posetrack_cli import limits
from posetrack_cli.errors import RecordingError


class ChunkLimitError(ValueError):
    """A chunk that is larger than any that is read, or holds more records than fit its bytes."""


class ExpansionBudget:
    """How much the chunks of one file may decompress to, in one pass over it.

    Args:
        where: the file, for the error.
        file_bytes: its size.
    """

    def __init__(self, where: object, file_bytes: int) -> None:
        self._where = where
        self._most = self._left = max(limits.EXPANSION_FLOOR_BYTES, limits.EXPANSION * file_bytes)

    def spend(self, size: int) -> None:
        """Count what a chunk says that it decompresses to, before that is done.

        Raises:
            RecordingError: it is too much.
        """
        self._left -= size
        if self._left < 0:
            raise RecordingError(
                "chunks decompress to more than any recording's do",
                where=self._where,
                found=f"more than {self._most} bytes",
                expected=f"{limits.EXPANSION} times the file or {limits.EXPANSION_FLOOR_BYTES} bytes at most",
            )


def decompressed(chunk: Chunk) -> bytes:
    """Return the records of a whole chunk, its size and checksum verified.

    Raises:
        ChunkLimitError: it says that it is larger than ``limits.CHUNK_BYTES``.
        ValueError: its data is of another size than it says, or of another checksum.
        Exception: whatever the decompressors raise of damaged bytes.
    """
    data = bounded_content(chunk.compression, chunk.data, chunk.uncompressed_size)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("crc of a chunk differs")
    return data


def bounded_content(compression: str, data: bytes, size: int) -> bytes:
    """Return what compressed data hold, which is ``size`` bytes; no more are ever made of them.

    Raises:
        ChunkLimitError: the size is larger than ``limits.CHUNK_BYTES``.
        ValueError: it is another, or the compression is not known.
        Exception: whatever the decompressors raise of damaged bytes.
    """
    check_size(size)
    content = _expanded(compression, data, size)
    if len(content) != size:
        raise ValueError(f"chunk of {len(content)} bytes that says {size}")
    return content


def bounded_begin(compression: str, data: bytes) -> bytes:
    """Return the records of a chunk that is cut, as far as its blocks are whole: ``CHUNK_BYTES`` at most."""
    try:
        if compression == "zstd":
            # Reads on as long as there are blocks; the cut is its end.
            with zstandard.ZstdDecompressor().stream_reader(data) as stream:
                return stream.read(limits.CHUNK_BYTES)
        if compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limits.CHUNK_BYTES))
        if compression == "bz2":
            return bz2.BZ2Decompressor().decompress(data, limits.CHUNK_BYTES)
    except (zstandard.ZstdError, RuntimeError, EOFError, OSError):  # RuntimeError and OSError: of lz4 and bz2
        return b""
    return data[: limits.CHUNK_BYTES] if not compression else b""


def check_size(size: int) -> None:
    """Raise ChunkLimitError unless a chunk of this size is read."""
    if size > limits.CHUNK_BYTES:
        raise ChunkLimitError(f"chunk of {size} bytes, at most {limits.CHUNK_BYTES} are read")


def most_records(compressed: int) -> int:
    """Return how many records a chunk of so many compressed bytes may hold."""
    return compressed // limits.BYTES_PER_RECORD + limits.SPARE_RECORDS


def _expanded(compression: str, data: bytes, size: int) -> bytes:
    if not compression:
        return data
    if compression == "zstd":
        stated = zstandard.frame_content_size(data)  # believed by the decompressor, whatever it is told
        if stated > size:
            raise ValueError(f"zstd frame of {stated} bytes in a chunk of {size}")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=size) if size else b""
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    if compression == "bz2":
        return bz2.BZ2Decompressor().decompress(data, size + 1)
    raise ValueError(f"chunk compressed by '{compression}'")
