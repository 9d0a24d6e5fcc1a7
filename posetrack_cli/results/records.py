"""Walk the records of an MCAP file as far as they are whole, also of a file whose writer was killed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk

from posetrack_cli.errors import ResultError
from posetrack_cli.recording.mcap_salvage import HEAD, MAGIC


@dataclass(frozen=True)
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


def record_spans(path: Path) -> Iterator[RecordSpan]:
    """Yield the records in file order, ending at the footer or before the first record cut short.

    Raises:
        ResultError: the file cannot be opened or is no MCAP file.
    """
    try:
        with path.open("rb") as stream:
            size = path.stat().st_size
            if stream.read(len(MAGIC)) != MAGIC:
                raise ResultError("is no MCAP file", where=path, hint="results are .mcap files")
            position = len(MAGIC)
            while position + HEAD.size <= size:
                opcode, length = HEAD.unpack(stream.read(HEAD.size))
                span = RecordSpan(opcode, position + HEAD.size, position + HEAD.size + length)
                if opcode == 0 or span.end > size:
                    return
                yield span
                if opcode == Opcode.FOOTER:
                    return
                position = stream.seek(span.end)
    except OSError as error:
        raise ResultError("cannot be read", where=path, found=error.strerror or error) from error


def read_record(path: Path, span: RecordSpan) -> McapRecord:
    """Read one metadata, attachment, schema, channel or chunk record.

    Raises:
        ResultError: its content is damaged.
    """
    kinds: dict[int, type[Metadata] | type[Attachment] | type[Schema] | type[Channel] | type[Chunk]] = {
        Opcode.METADATA: Metadata,
        Opcode.ATTACHMENT: Attachment,
        Opcode.SCHEMA: Schema,
        Opcode.CHANNEL: Channel,
        Opcode.CHUNK: Chunk,
    }
    try:
        with path.open("rb") as stream:
            stream.seek(span.start)
            content = stream.read(span.end - span.start)
        record: McapRecord = kinds[span.opcode].read(ReadDataStream(BytesIO(content)))
        return record
    except Exception as error:  # the parser raises whatever the damaged bytes lead to
        raise _damaged(path, span, error) from error


def chunk_records(path: Path, span: RecordSpan) -> list[Schema | Channel | Message]:
    """Read a chunk's schemas, channels and messages, in order, its checksum verified.

    Raises:
        ResultError: the chunk is damaged.
    """
    chunk = read_record(path, span)
    try:
        assert isinstance(chunk, Chunk)
        records = breakup_chunk(chunk, validate_crc=True)
    except Exception as error:  # decompressors have errors of their own, and none in common
        raise _damaged(path, span, error) from error
    return [record for record in records if isinstance(record, Schema | Channel | Message)]


def _damaged(path: Path, span: RecordSpan, error: Exception) -> ResultError:
    return ResultError(
        f"record at byte {span.start} is damaged", where=path, found=error or type(error).__name__
    )
