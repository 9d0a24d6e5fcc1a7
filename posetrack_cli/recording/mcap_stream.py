"""Messages of MCAP files, intact or not: what is readable is read, what is not is a loss."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, TypeVar

from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from posetrack_cli.errors import RecordingError
from posetrack_cli.recording.losses import LossLog

MAGIC = b"\x89MCAP0\r\n"
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
    chunks that overlap in time are in memory. Where the file is cut or damaged the messages end, and
    ``losses`` gets one loss.
    """
    indexed = read_summary(path) is not None
    with path.open("rb") as stream:
        if indexed:
            reader: SeekingReader | NonSeekingReader = _seeking(stream, path)
        else:
            reader = NonSeekingReader(stream, validate_crcs=True, record_size_limit=path.stat().st_size)
        messages = reader.iter_messages(topics, log_time_order=indexed)
        yield from _until_damage(messages, stream, path, losses)


def read_extras(path: Path) -> Iterator[Metadata | Attachment]:
    """Yield the metadata and attachments of a file, up to where it is cut or damaged."""
    with path.open("rb") as stream:
        reader = StreamReader(stream, emit_chunks=True, record_size_limit=path.stat().st_size)
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
        except Exception:  # the library raises whatever the damaged bytes lead to
            size, position = path.stat().st_size, stream.tell()
            what = (
                "file is truncated, the rest is missing"
                if position >= size
                else "file is damaged, the rest is lost"
            )
            losses.add(what, f"byte {position} of {size}")
            return
        yield item


def _seeking(stream: Any, path: Path) -> SeekingReader:
    return SeekingReader(stream, validate_crcs=True, record_size_limit=path.stat().st_size)


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
