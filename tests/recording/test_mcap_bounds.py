"""Chunks that claim to be larger than any, and indexes that lead where they must not: told, at no cost."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Message, Schema
from mcap.writer import CompressionType, Writer

from posetrack_cli import limits
from posetrack_cli.errors import RecordingError
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.decoding import MessageDecoder, UndecodableMessageError
from posetrack_cli.mcap.records import HEAD, MAGIC, ChunkLimitError, chunk_records, decompressed, record_spans
from posetrack_cli.mcap.stream import DAMAGED_CHUNK, LARGE_CHUNK, McapFile
from posetrack_cli.mcap.summary import read_summary
from posetrack_cli.recording.message_topics import scan_topics

MIB = 1 << 20


@contextmanager
def memory_below(most: int) -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


def chunk(data: bytes, compression: str, size: int | None = None) -> Chunk:
    compress: dict[str, Callable[[bytes], bytes]] = {
        "zstd": zstandard.ZstdCompressor(level=19).compress,
        "lz4": lz4.frame.compress,
        "": bytes,
    }
    size = len(data) if size is None else size
    return Chunk(compression, compress[compression](data), 1, 0, 0, size)


def record(opcode: int, content: bytes) -> bytes:
    return HEAD.pack(opcode, len(content)) + content


def file_of(path: Path, *chunks: Chunk, channel: str = "/a") -> Path:
    """A file without index of some chunks, with one channel before them."""
    name = channel.encode()
    known = struct.pack("<HHI", 1, 0, len(name)) + name + struct.pack("<I", 4) + b"json" + bytes(4)
    content = record(Opcode.CHANNEL, known)
    for one in chunks:
        head = struct.pack("<QQQII", 0, 1, one.uncompressed_size, 0, len(one.compression))
        content += record(
            Opcode.CHUNK, head + one.compression.encode() + struct.pack("<Q", len(one.data)) + one.data
        )
    path.write_bytes(
        MAGIC + record(Opcode.HEADER, bytes(8)) + content + record(Opcode.FOOTER, bytes(20)) + MAGIC
    )
    return path


def message(time: int, data: bytes) -> bytes:
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 0, time, time) + data)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_that_expands_beyond_its_word_is_damaged(compression: str) -> None:
    """What it says is what is made room for, whatever its compressed data says."""
    data = bytes(64 * MIB)
    one = chunk(data, compression, size=1000)
    with memory_below(8 * MIB), pytest.raises(ValueError, match="bytes"):
        decompressed(one)
    assert decompressed(chunk(data[:1000], compression)) == data[:1000]


@pytest.mark.parametrize("compression", ["zstd", "lz4", ""])
def test_a_chunk_larger_than_any_is_a_loss(tmp_path: Path, compression: str) -> None:
    claimed = chunk(b"0" * 100, compression, size=limits.CHUNK_BYTES + 1)
    whole = chunk(message(5, b"data"), compression)
    losses = LossLog()
    path = file_of(tmp_path / "r.mcap", claimed, whole)
    with memory_below(8 * MIB):
        assert [m.data for _, _, m in McapFile(path, losses).messages()] == [b"data"]
    (loss,) = losses.losses
    assert loss.what == LARGE_CHUNK
    assert f"chunk of {limits.CHUNK_BYTES + 1} bytes" in loss.first


def test_all_chunks_together_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "EXPANSION_FLOOR_BYTES", 3000)
    monkeypatch.setattr(limits, "EXPANSION", 2)
    blank = chunk(message(5, bytes(1000)), "zstd")
    two, seven = (file_of(tmp_path / f"{count}.mcap", *[blank] * count) for count in (2, 7))
    assert len(list(McapFile(two).messages())) == 2
    with pytest.raises(RecordingError, match=r"7\.mcap: chunks expand too much on decompression"):
        list(McapFile(seven).messages())


def test_a_chunk_of_more_records_than_bytes_is_a_loss() -> None:
    """And one whose messages hold nothing but stamps at 1 kHz is none."""
    empty = chunk(b"".join(message(0, b"") for _ in range(10_000)), "zstd")
    with pytest.raises(ChunkLimitError, match="more than"):
        list(chunk_records(empty))
    start = 1_700_000_000_000_000_000
    ticks = chunk(b"".join(message(start + i * 1_000_000, b"") for i in range(10_000)), "zstd")
    assert len(list(chunk_records(ticks))) == 10_000


def test_records_without_a_kind_are_no_records() -> None:
    with pytest.raises(ValueError, match="without opcode"):
        list(chunk_records(chunk(bytes(900), "zstd")))


def test_channels_that_are_said_again_are_parsed_once_and_new_ones_are_bounded(tmp_path: Path) -> None:
    """A channel may list any number of empty pairs, eight bytes each: 128 MiB of them take a minute."""
    pairs = bytes(limits.CHANNEL_BYTES)
    head = struct.pack("<HHI", 1, 0, 2) + b"/a" + struct.pack("<I", 4) + b"json"
    large = record(Opcode.CHANNEL, head + struct.pack("<I", len(pairs)) + pairs)
    small = record(Opcode.CHANNEL, head + struct.pack("<I", 0))
    content = small * 1000 + message(1, b"x" * 4000)
    assert len(list(chunk_records(chunk(content, "")))) == 2
    losses = LossLog()
    assert not list(McapFile(file_of(tmp_path / "r.mcap", chunk(large, "zstd")), losses).messages())
    assert [loss.what for loss in losses.losses] == [LARGE_CHUNK]


def test_messages_that_wait_for_their_turn_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "PENDING_BYTES", 3500)
    path = indexed(tmp_path / "r.mcap", [(1, 99), (2, 98), (3, 97)])  # each chunk reaches over the others
    with pytest.raises(RecordingError, match="chunks overlap in time, found 4000 bytes"):
        list(McapFile(path).messages())
    apart = indexed(tmp_path / "s.mcap", [(1, 2), (3, 4), (5, 6)])
    assert len(list(McapFile(apart).messages())) == 6


def indexed(
    path: Path, times: list[tuple[int, int]], change: Callable[[Writer], None] = lambda writer: None
) -> Path:
    """A file with an index, a chunk for each pair of times, after a change to what the writer remembers."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start()
        channel = writer.register_channel("/a", "json", 0)
        for pair in times:
            for time in pair:
                writer.add_message(channel, time, bytes(1000), time)
            writer.flush()
        change(writer)
        writer.finish()
    return path


def indexes(writer: Writer) -> list[ChunkIndex]:
    found: list[ChunkIndex] = writer._Writer__chunk_indices  # type: ignore[attr-defined]
    return found


def twice(writer: Writer) -> None:
    indexes(writer)[1] = indexes(writer)[0]


def within(writer: Writer) -> None:
    indexes(writer)[1].chunk_start_offset = indexes(writer)[0].chunk_start_offset + 5


def outside(writer: Writer) -> None:
    indexes(writer)[1].chunk_length = 2**63


def countless(writer: Writer) -> None:
    writer._Writer__statistics.channel_message_counts = {1: 2**63}  # type: ignore[attr-defined]


@pytest.mark.parametrize("change", [twice, within, outside, countless])
def test_an_index_that_leads_astray_is_not_believed(tmp_path: Path, change: Callable[[Writer], None]) -> None:
    """A chunk that is listed often would be decompressed as often. Without index all messages are read."""
    good = indexed(tmp_path / "good.mcap", [(1, 2), (3, 4)])
    assert read_summary(good) is not None
    path = indexed(tmp_path / "bad.mcap", [(1, 2), (3, 4)], change)
    assert read_summary(path) is None
    assert [m.log_time for _, _, m in McapFile(path).messages()] == [1, 2, 3, 4]


def test_a_summary_is_never_decompressed(tmp_path: Path) -> None:
    """Its footer may say that it begins with the first chunk: that is left alone."""
    path = indexed(tmp_path / "r.mcap", [(1, 2)])
    data = bytearray(path.read_bytes())
    with path.open("rb") as stream:
        first = next(span for span in record_spans(stream) if span.opcode == Opcode.CHUNK)
    footer = len(data) - len(MAGIC) - 20
    struct.pack_into("<QQI", data, footer, first.start - HEAD.size, 0, 0)
    data[first.start + 40 : first.end] = b"\xff" * (
        first.end - first.start - 40
    )  # no longer to be decompressed
    path.write_bytes(data)
    assert read_summary(path) is not None
    losses = LossLog()
    assert not list(McapFile(path, losses).messages())
    assert [loss.what for loss in losses.losses] == [DAMAGED_CHUNK]


def test_a_summary_of_another_checksum_is_not_believed(tmp_path: Path) -> None:
    path = indexed(tmp_path / "r.mcap", [(1, 2)])
    data = bytearray(path.read_bytes())
    (crc,) = struct.unpack_from("<I", data, len(data) - 12)
    assert crc, "mcap's writer sums it up"
    start = struct.unpack_from("<Q", data, len(data) - 28)[0]
    assert crc == zlib.crc32(data[start:-12])
    data[-12] ^= 1
    path.write_bytes(data)
    assert read_summary(path) is None


def test_topics_are_told_in_one_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pass for each of 1,000 topics that never decode would read a small file a thousand times."""
    with (tmp_path / "r.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("foxglove.RawImage", "protobuf", b"")
        for number in range(20):
            channel = writer.register_channel(f"/{number}", "protobuf", schema)
            writer.add_message(channel, number, b"\xff", number)
        writer.finish()
    passes = []

    def counted(file: McapFile, *arguments: object) -> object:
        passes.append(arguments)
        return read(file, *arguments)  # type: ignore[arg-type]

    read = McapFile.messages
    monkeypatch.setattr(McapFile, "messages", counted)
    assert len(scan_topics(tmp_path / "r.mcap").by_name) == 20
    assert len(passes) == 1


def test_messages_that_do_not_decode_are_forgotten() -> None:
    """Why nothing of a channel decodes is remembered, but none of its messages is."""
    decoder = MessageDecoder()
    schema, channel = Schema(1, b"uint8 a", "ros1msg", "sensor_msgs/Image"), Channel(1, "/i", "ros1", {}, 1)
    with memory_below(8 * MIB):
        for number in range(200):
            with pytest.raises(UndecodableMessageError, match="differs from the one published by ROS"):
                decoder.decode(schema, channel, Message(1, number, bytes(MIB), number, number))
