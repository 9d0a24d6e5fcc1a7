"""ROS 1 bags, version 2.0, intact or damaged, read sequentially without relying on the index.

A bag is a sequence of records: a header of named fields, and data. Chunks hold connections and messages,
raw or compressed with bz2 or LZ4 (ROS wiki, "Bags/Format/2.0").
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.records import Channel, Message, Schema

from posetrack_cli import limits
from posetrack_cli.files import begins_with, open_input
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.records import (
    ChunkLimitError,
    ExpansionBudget,
    bounded_begin,
    bounded_content,
    most_records,
)
from posetrack_cli.mcap.stream import (
    DAMAGED,
    DAMAGED_CHUNK,
    DAMAGED_RECORD,
    LARGE_CHUNK,
    TRUNCATED,
    UNKNOWN_CHANNEL,
    McapItem,
    Topics,
    wanted_names,
)
from posetrack_cli.units import NS_PER_S

MAGIC = b"#ROSBAG V2.0\n"
# Record kinds that are read; others are the bag header and chunk indices.
MESSAGE, CHUNK, CHUNK_INFO, CONNECTION = 2, 5, 6, 7
# A bag's names of compressions, mapped to those of ``bounded_content``.
COMPRESSIONS = {b"none": "", b"lz4": "lz4", b"bz2": "bz2"}
# Exceptions of damaged records; bz2 and LZ4 raise the last three.
DAMAGE = (ValueError, LookupError, struct.error, EOFError, RuntimeError, OSError)
_LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")
_PAIR = struct.Struct("<II")
_INDEX_AT = struct.Struct("<Q")


@dataclass(frozen=True)
class _Record:
    """One record: header fields, and offset and length of its data."""

    fields: Mapping[bytes, bytes]
    start: int
    length: int

    @property
    def kind(self) -> int:
        return self.fields[b"op"][0]

    @property
    def end(self) -> int:
        return self.start + self.length

    def number(self, name: bytes) -> int:
        return int(_LENGTH.unpack(self.fields[name])[0])


def is_ros1_bag(path: Path) -> bool:
    """Return whether a file begins like a ROS 1 bag.

    Raises:
        OSError: the file cannot be read.
    """
    return begins_with(path, MAGIC)


class Ros1Bag:
    """A bag, read as far as possible, including interrupted recordings without index.

    Args:
        path: the file.
        losses: receives unreadable data.
    """

    def __init__(self, path: Path, losses: LossLog | None = None) -> None:
        self.path, self.losses = path, LossLog() if losses is None else losses

    def messages(self, topics: Topics = None) -> Iterator[McapItem]:
        """Yield schema, channel and message, of all or some topics, in file order.

        Damaged records and chunks beyond ``limits`` are skipped; the intact part of a truncated chunk is
        read.

        Raises:
            RecordingError: chunks expand beyond ``limits``.
        """
        reading = _Reading(self.path, self.losses, topics)
        with open_input(self.path) as stream:
            size = stream.seek(0, os.SEEK_END)
            position = len(MAGIC)
            while position < size:
                try:
                    record = _read_head(stream, position, size)
                except DAMAGE:
                    self.losses.add(DAMAGED, f"byte {position} of {size}")
                    return
                if record is None or record.end > size:
                    if record is not None and record.kind == CHUNK:
                        yield from reading.chunk(record, stream.read(limits.CHUNK_BYTES), cut=True)
                    self.losses.add(TRUNCATED, f"byte {size} of {size}")
                    return
                try:
                    yield from reading.record(record, stream)
                except DAMAGE:
                    self.losses.add(DAMAGED_RECORD, f"byte {position} of {size}")
                position = record.end

    def counts(self) -> list[tuple[Schema | None, Channel, int]] | None:
        """Return every channel with its number of messages in the index; None without an index."""
        reading, counted = _Reading(self.path, LossLog(), None), dict[int, int]()
        try:
            with open_input(self.path) as stream:
                size = stream.seek(0, os.SEEK_END)
                head = _read_head(stream, len(MAGIC), size)
                position = 0 if head is None else _INDEX_AT.unpack(head.fields[b"index_pos"])[0]
                if not 0 < position < size:
                    return None
                while position < size:
                    record = _read_head(stream, position, size)
                    if record is None or record.end > size or record.length > limits.RECORD_BYTES:
                        return None
                    data = stream.read(record.length)
                    if record.kind == CONNECTION:
                        reading.connection(record, data)
                    elif record.kind == CHUNK_INFO:
                        for connection, count in _PAIR.iter_unpack(data):
                            counted[connection] = counted.get(connection, 0) + count
                    position = record.end
        except DAMAGE:
            return None
        if sum(counted.values()) > limits.MESSAGES:
            return None
        known = reading.known.items()
        return [(schema, channel, counted.get(number, 0)) for number, (schema, channel) in known]


class _Reading:
    """One pass over a bag: its connections, and the wanted topics."""

    def __init__(self, path: Path, losses: LossLog, topics: Topics) -> None:
        self.known: dict[int, tuple[Schema, Channel]] = {}
        self._wants, self._losses = wanted_names(topics), losses
        self._size = path.stat().st_size
        self._budget = ExpansionBudget(path, self._size)
        self._definitions_left = limits.DEFINITION_BYTES

    def record(self, record: _Record, stream: IO[bytes]) -> Iterator[McapItem]:
        """Yield the messages of a record."""
        if record.kind == CHUNK:
            if record.length > limits.CHUNK_BYTES:
                self._losses.add(
                    LARGE_CHUNK, f"{record.length} bytes, before byte {record.end} of {self._size}"
                )
                return
            yield from self.chunk(record, stream.read(record.length), cut=False)
        elif record.kind in (CONNECTION, MESSAGE) and record.length <= limits.CHUNK_BYTES:
            yield from self._item(record, stream.read(record.length), record.end)

    def chunk(self, record: _Record, data: bytes, *, cut: bool) -> Iterator[McapItem]:
        """Yield the messages of a chunk; an unreadable one is a loss, not an error."""
        where = f"before byte {record.end} of {self._size}"
        try:
            yield from self._content(record, data, where, cut=cut)
        except ChunkLimitError as error:
            self._losses.add(LARGE_CHUNK, f"{error}, {where}")
        except DAMAGE:
            self._losses.add(DAMAGED_CHUNK, where)

    def connection(self, record: _Record, data: bytes) -> None:
        """Store a connection's topic and type; the type's definition is only compared later."""
        number = record.number(b"conn")
        if number in self.known:
            return
        self._definitions_left -= len(data)
        if self._definitions_left < 0:
            raise ChunkLimitError(f"connections exceed {limits.DEFINITION_BYTES} bytes")
        own = _fields(data)
        name, definition = _text(own[b"type"]), own[b"message_definition"]
        schema = Schema(id=number + 1, name=name, encoding="ros1msg", data=definition)
        topic = _text(record.fields[b"topic"])
        self.known[number] = schema, Channel(number, topic, "ros1", {}, number + 1)

    def _content(self, record: _Record, data: bytes, where: str, *, cut: bool) -> Iterator[McapItem]:
        stated = record.number(b"size")
        self._budget.spend(min(stated, limits.CHUNK_BYTES))
        name = record.fields[b"compression"]
        if name not in COMPRESSIONS:
            raise ValueError(f"compression {name!r}")
        compression, most = COMPRESSIONS[name], most_records(len(data))
        content = bounded_begin(compression, data) if cut else bounded_content(compression, data, stated)
        position, size = 0, len(content)
        while position < size:
            inner = _head_in(content, position)
            if inner is None or inner.end > size:
                if cut:
                    return
                raise ValueError("chunk ends within a record")
            most -= 1
            if most < 0:
                raise ChunkLimitError(f"chunk of more than {most_records(len(data))} records")
            yield from self._item(inner, content[inner.start : inner.end], where)
            position = inner.end

    def _item(self, record: _Record, data: bytes, where: object) -> Iterator[McapItem]:
        if record.kind == CONNECTION:
            self.connection(record, data)
        elif record.kind == MESSAGE:
            number = record.number(b"conn")
            seconds, rest = _TIME.unpack(record.fields[b"time"])
            if number not in self.known:
                self._losses.add(UNKNOWN_CHANNEL, str(where))
                return
            schema, channel = self.known[number]
            if self._wants(channel.topic):
                stamp = seconds * NS_PER_S + rest
                yield schema, channel, Message(number, stamp, data, stamp, 0)


def _read_head(stream: IO[bytes], position: int, size: int) -> _Record | None:
    """Read a record header and leave the stream at its data; None at the end of the file.

    Raises:
        ValueError: the bytes are not a header.
    """
    stream.seek(position)
    length = stream.read(_LENGTH.size)
    if len(length) < _LENGTH.size:
        return None
    (count,) = _LENGTH.unpack(length)
    if count > limits.BAG_HEAD_BYTES:
        raise ValueError(f"header of {count} bytes")
    head = stream.read(count + _LENGTH.size)
    if len(head) < count + _LENGTH.size:
        return None
    fields = _checked(_fields(head[:count]))
    (data,) = _LENGTH.unpack(head[count:])
    return _Record(fields, position + 2 * _LENGTH.size + count, data)


def _head_in(content: bytes, position: int) -> _Record | None:
    """Return the record at a position of a chunk's content; None at its end."""
    begin = position + _LENGTH.size
    if begin > len(content):
        return None
    (count,) = _LENGTH.unpack_from(content, position)
    end = begin + count
    if end + _LENGTH.size > len(content):
        return None
    fields = _checked(_fields(content[begin:end]))
    return _Record(fields, end + _LENGTH.size, int(_LENGTH.unpack_from(content, end)[0]))


def _fields(data: bytes) -> dict[bytes, bytes]:
    """Return named fields: each a length, name, equals sign and value.

    Raises:
        ValueError, struct.error: the bytes are not fields.
    """
    fields, position = {}, 0
    while position < len(data):
        (length,) = _LENGTH.unpack_from(data, position)
        position += _LENGTH.size
        name, equals, value = data[position : position + length].partition(b"=")
        if not equals or position + length > len(data):
            raise ValueError("not a header field")
        fields[name] = value
        position += length
    return fields


def _checked(fields: dict[bytes, bytes]) -> dict[bytes, bytes]:
    """Raise ValueError unless the fields state the kind of a record."""
    if len(fields.get(b"op", b"")) != 1:
        raise ValueError("not a record")
    return fields


def _text(data: bytes) -> str:
    return data.decode(errors="replace")
