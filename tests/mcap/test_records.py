"""The walk over records against mcap's own readers, and what it makes of files that those refuse."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, IndexType, Writer

from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.records import (
    HEAD,
    MAGIC,
    chunk_records,
    content_records,
    read_record,
    record_spans,
)
from posetrack_cli.mcap.stream import McapFile

messages = st.lists(
    st.tuples(st.integers(0, 2), st.integers(0, 2**64 - 1), st.binary(max_size=40)), max_size=12
)
compressions = st.sampled_from(list(CompressionType))


def written(
    of: list[tuple[int, int, bytes]], compression: CompressionType = CompressionType.NONE, **options: object
) -> bytes:
    """A file of messages (channel, time, data) on three topics, metadata before and after, chunks of four."""
    stream = io.BytesIO()
    writer = Writer(stream, compression=compression, **options)
    writer.start()
    writer.add_metadata("first", {"a": "1"})
    schema = writer.register_schema("s", "jsonschema", b"{}")
    ids = [writer.register_channel(f"/{name}", "json", schema) for name in "abc"]
    for number, (which, time, data) in enumerate(of):
        writer.add_message(ids[which], time, data, time, number)
        if number % 4 == 3 and options.get("use_chunking", True):
            writer.flush()
    writer.add_metadata("last", {"b": "2"})
    writer.finish()
    return stream.getvalue()


def chunks(data: bytes) -> list[Chunk]:
    records = StreamReader(io.BytesIO(data), emit_chunks=True).records
    return [record for record in records if isinstance(record, Chunk)]


@settings(max_examples=40, deadline=None)
@given(messages, compressions)
def test_spans_are_the_records_that_mcaps_reader_finds(of: list, compression: CompressionType) -> None:
    data = written(of, compression)
    stream = io.BytesIO(data)
    spans = list(record_spans(stream))
    assert spans[0].start == len(MAGIC) + HEAD.size
    assert [a.end + HEAD.size for a in spans[:-1]] == [b.start for b in spans[1:]]
    assert spans[-1].end + len(MAGIC) == len(data)
    expected = list(StreamReader(io.BytesIO(data), emit_chunks=True).records)
    readable = (Opcode.METADATA, Opcode.CHUNK, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.DATA_END)
    kinds = {type(read_record(stream, span)) for span in spans if span.opcode in readable}
    found = [read_record(stream, span) for span in spans if span.opcode in readable]
    assert found == [record for record in expected if type(record) in kinds]


@settings(max_examples=40, deadline=None)
@given(messages, compressions, st.sets(st.integers(1, 3)))
def test_chunks_hold_what_mcaps_reader_finds_but_for_unwanted_messages(
    of: list, compression: CompressionType, unwanted: set[int]
) -> None:
    for chunk in chunks(written(of, compression)):
        expected = [
            record
            for record in breakup_chunk(chunk)
            if not (isinstance(record, Message) and record.channel_id in unwanted)
        ]
        assert list(chunk_records(chunk, unwanted)) == expected


@settings(max_examples=40, deadline=None)
@given(messages.filter(bool), st.data())
def test_content_that_is_cut_gives_its_whole_records(of: list, drawn: st.DataObject) -> None:
    content = chunks(written(of))[0].data
    whole = list(content_records(content))
    size = drawn.draw(st.integers(0, len(content) - 1))
    begun = list(content_records(content[:size], cut=True))
    assert begun == whole[: len(begun)]
    assert len(begun) < len(whole)
    ends = [0, *_ends(content)]
    assert len(begun) == sum(end <= size for end in ends[1:])
    if size not in ends:
        with pytest.raises(ValueError, match="ends within a record"):
            list(content_records(content[:size]))


def _ends(content: bytes) -> list[int]:
    """Where the records of a chunk's content end, by their lengths."""
    ends, position = [], 0
    while position < len(content):
        position += 9 + struct.unpack_from("<Q", content, position + 1)[0]
        ends.append(position)
    return ends


def test_a_message_shorter_than_its_head_is_damage() -> None:
    content = HEAD.pack(Opcode.MESSAGE, 5) + bytes(5)
    with pytest.raises(ValueError, match="a message of 5 bytes"):
        list(content_records(content))


THREE = [(0, 30, b"x"), (1, 10, b"y"), (0, 20, b"z"), (2, 5, b"w"), (0, 1, b"v")]


def stamps(path: Path, losses: LossLog, **options: bool) -> list[int]:
    return [message.log_time for _, _, message in McapFile(path, losses).messages(["/a", "/c"], **options)]


def test_order_is_that_of_time_or_that_of_the_file(tmp_path: Path) -> None:
    path, losses = tmp_path / "r.mcap", LossLog()
    path.write_bytes(written(THREE))
    assert stamps(path, losses) == [1, 5, 20, 30]
    assert stamps(path, losses, in_file_order=True) == [30, 20, 5, 1]
    by_prefix = McapFile(path, losses).messages(lambda topic: topic > "/b", in_file_order=True)
    assert [message.log_time for _, _, message in by_prefix] == [5]
    assert losses.losses == ()


@pytest.mark.parametrize("options", [{}, {"use_chunking": False}, {"index_types": IndexType.NONE}])
def test_channels_and_metadata_are_found_with_and_without_an_index(tmp_path: Path, options: dict) -> None:
    path, losses = tmp_path / "r.mcap", LossLog()
    path.write_bytes(written(THREE, **options))
    assert [channel.topic for _, channel in McapFile(path, losses).channels()] == ["/a", "/b", "/c"]
    assert {schema.name for schema, _ in McapFile(path, losses).channels() if schema} == {"s"}
    assert [record.name for record in McapFile(path, losses).extras()] == ["first", "last"]
    assert stamps(path, losses, in_file_order=True) == [30, 20, 5, 1]
    assert losses.losses == ()


def test_a_file_without_chunks_that_fails_its_checksum_is_read_and_told(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    data = bytearray(written(THREE, use_chunking=False, enable_data_crcs=True))
    path.write_bytes(data)
    whole = LossLog()
    assert (stamps(path, whole), whole.losses) == ([30, 20, 5, 1], ())
    data[data.index(b"x", 200)] = ord("q")
    path.write_bytes(data)
    damaged = LossLog()
    assert stamps(path, damaged) == [30, 20, 5, 1]
    assert [loss.what for loss in damaged.losses] == ["data is damaged, checksum mismatch"]


def test_a_damaged_record_between_chunks_is_left_out_and_the_rest_is_read(tmp_path: Path) -> None:
    path, losses = tmp_path / "r.mcap", LossLog()
    data = bytearray(written(THREE, use_chunking=False))
    data[data.index(b"/b")] = 0xFF  # no UTF-8
    path.write_bytes(data)
    assert stamps(path, losses) == [30, 20, 5, 1]
    assert [(loss.what, loss.count) for loss in losses.losses] == [
        ("damaged record skipped", 1),
        ("message skipped, its topic was lost with damaged data", 1),
    ]


def test_a_length_that_cannot_be_is_damage_and_no_cut(tmp_path: Path) -> None:
    path, losses = tmp_path / "r.mcap", LossLog()
    data = written(THREE, use_chunking=False)
    head = data.index(HEAD.pack(Opcode.METADATA, 0)[:1] + struct.pack("<Q", 22), 100)
    path.write_bytes(data[: head + 1] + struct.pack("<Q", 2**62) + data[head + 9 :])
    assert stamps(path, losses) == [30, 20, 5, 1]
    (loss,) = losses.losses
    assert loss.what == "file is damaged, the rest is lost"
    assert loss.first == f"byte {head} of {len(data)}"


def test_checksums_of_chunks_are_verified() -> None:
    chunk = chunks(written(THREE))[0]
    assert chunk.uncompressed_crc == zlib.crc32(chunk.data)
    chunk.data = chunk.data[:-1] + b"?"
    with pytest.raises(ValueError, match="checksum mismatch"):
        list(chunk_records(chunk))


def test_kinds_of_records() -> None:
    records = list(chunk_records(chunks(written(THREE))[0]))
    assert {type(record) for record in records} == {Schema, Channel, Message}
