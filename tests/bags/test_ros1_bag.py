"""ROS 1 bags that rosbags wrote: read whole, damaged, cut and unfinished; and what attacks must not cost."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from rosbags.rosbag1 import Reader

from posetrack_cli import limits
from posetrack_cli.bags.ros1_bag import MAGIC, Ros1Bag, is_ros1_bag
from posetrack_cli.errors import RecordingError
from support.bags import COUNT, DEPTH, write_bag

COMPRESSIONS = ("none", "bz2", "lz4")


def field(name: str, value: bytes) -> bytes:
    content = name.encode() + b"=" + value
    return struct.pack("<I", len(content)) + content


def record(kind: int, data: bytes, **fields: bytes) -> bytes:
    """A record of a bag by its specification."""
    head = field("op", bytes([kind])) + b"".join(field(name, value) for name, value in fields.items())
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def u32(number: int) -> bytes:
    return struct.pack("<I", number)


CONNECTION = record(
    7,
    field("type", b"std_msgs/Float32") + field("md5sum", b"*") + field("message_definition", b"float32 data"),
    conn=u32(0),
    topic=b"/value",
)
HEAD = record(3, b" ", index_pos=bytes(8), conn_count=u32(1), chunk_count=u32(1))


def message(number: int) -> bytes:
    return record(2, struct.pack("<f", number), conn=u32(0), time=struct.pack("<II", 5, number))


def chunk(content: bytes, compression: str = "none", size: int | None = None) -> bytes:
    packed: dict[str, Callable[[bytes], bytes]] = {"none": bytes, "bz2": bz2.compress}
    stated = len(content) if size is None else size
    data = packed[compression](content)
    return record(5, data, compression=compression.encode(), size=u32(stated))


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_messages_are_those_that_rosbags_reads(tmp_path: Path, compression: str) -> None:
    path = write_bag(tmp_path / "r.bag", compression)
    bag = Ros1Bag(path)
    with Reader(path) as reader:
        expected = sorted((c.topic, stamp, bytes(data)) for c, stamp, data in reader.messages())
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert len(reader.chunks) > 1
    found = [(channel.topic, item.log_time, item.data) for _, channel, item in bag.messages()]
    assert sorted(found) == expected
    assert {channel.topic: count for _, channel, count in bag.counts() or ()} == counts
    assert {schema.name for schema, _, _ in bag.messages() if schema} == {
        "sensor_msgs/Image",
        "sensor_msgs/CameraInfo",
    }
    assert bag.losses.losses == ()
    assert [channel.topic for _, channel, _ in bag.messages([DEPTH])] == [DEPTH] * COUNT


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_bag_that_is_cut_is_read_as_far_as_it_goes(tmp_path: Path, compression: str) -> None:
    """Also within a chunk; rosbags refuses any bag without its end."""
    path = write_bag(tmp_path / "r.bag", compression)
    whole = [item.data for _, _, item in Ros1Bag(path).messages()]
    data = path.read_bytes()
    counts = []
    for share in (0.3, 0.5, 0.7):
        path.write_bytes(data[: int(share * len(data))])
        bag = Ros1Bag(path)
        found = [item.data for _, _, item in bag.messages()]
        assert found == whole[: len(found)]
        assert [loss.what for loss in bag.losses.losses] == ["file is truncated, the rest is missing"]
        assert bag.counts() is None
        counts.append(len(found))
    assert counts == sorted(counts) and 0 < counts[2] < len(whole)
    assert compression != "none" or len(set(counts)) == 3


def test_a_recording_that_was_interrupted_is_read(tmp_path: Path) -> None:
    """rosbag writes the size of a chunk when it is full: of the last one messages lie as if in no chunk."""
    path = tmp_path / "r.bag.active"
    unfinished = chunk(b"", size=0) + message(2) + message(3)[:-3]
    path.write_bytes(MAGIC + HEAD + chunk(CONNECTION + message(0) + message(1)) + unfinished)
    bag = Ros1Bag(path)
    assert is_ros1_bag(path)
    assert [item.log_time for _, _, item in bag.messages()] == [5_000_000_000 + k for k in range(3)]
    assert bag.counts() is None


def test_a_damaged_chunk_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "r.bag"
    bad = bytearray(chunk(message(1) + message(2), "bz2"))
    bad[-10] ^= 255
    unknown = chunk(message(3), "none").replace(b"compression=none", b"compression=nono")
    wrong_size = chunk(message(4), "bz2", size=5)
    good = chunk(CONNECTION + message(0)), chunk(message(5))
    path.write_bytes(MAGIC + HEAD + good[0] + bad + unknown + wrong_size + good[1])
    bag = Ros1Bag(path)
    assert [item.log_time for _, _, item in bag.messages()] == [5_000_000_000, 5_000_000_005]
    (loss,) = bag.losses.losses
    assert (loss.what, loss.count) == ("chunk is damaged, its messages are lost", 3)


@pytest.mark.parametrize(
    "data", [b"\xff\xff\xff\xff", b"\x05\0\0\0\x01\0\0\0x\0\0\0\0", b"\x10\0\0\0" + b"x" * 40]
)
def test_what_is_no_record_ends_the_reading(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "r.bag"
    path.write_bytes(MAGIC + HEAD + chunk(CONNECTION + message(0)) + data + chunk(message(1)))
    bag = Ros1Bag(path)
    assert len(list(bag.messages())) == 1
    assert len(bag.losses.losses) == 1


SPOILED = {
    "a message of no connection": record(2, b"data", time=bytes(8)),
    "a message of a short time": record(2, b"data", conn=u32(0), time=bytes(4)),
    "a message of a short connection": record(2, b"data", conn=b"\0", time=bytes(8)),
    "a connection of no topic": record(
        7, field("type", b"x") + field("message_definition", b""), conn=u32(1)
    ),
    "a connection of no type": record(7, field("message_definition", b""), conn=u32(1), topic=b"/x"),
    "a connection whose data are no fields": record(7, b"ab", conn=u32(1), topic=b"/x"),
    "a connection of no number": record(7, field("type", b"x"), topic=b"/x"),
}


@pytest.mark.parametrize("name", SPOILED)
def test_a_damaged_record_outside_chunks_is_left_out(tmp_path: Path, name: str) -> None:
    """What is behind it is read: the record's own lengths are right."""
    path = tmp_path / "r.bag"
    before = MAGIC + HEAD + CONNECTION + message(0)
    path.write_bytes(before + SPOILED[name] + message(1))
    bag = Ros1Bag(path)
    assert [item.log_time for _, _, item in bag.messages()] == [5_000_000_000, 5_000_000_001]
    (loss,) = bag.losses.losses
    size = path.stat().st_size
    assert (loss.what, loss.first) == ("damaged record skipped", f"byte {len(before)} of {size}")


def test_a_head_that_ends_within_a_field_ends_the_reading(tmp_path: Path) -> None:
    path = tmp_path / "r.bag"
    head = field("op", b"\x02") + b"abc"
    path.write_bytes(MAGIC + u32(len(head)) + head + u32(0) + CONNECTION)
    bag = Ros1Bag(path)
    assert list(bag.messages()) == [] and bag.counts() is None
    assert [loss.what for loss in bag.losses.losses] == ["file is damaged, the rest is lost"]


def test_a_bomb_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A kilobyte of bz2 makes gigabytes; rosbags unpacks what there is, whatever the chunk says."""
    monkeypatch.setattr(limits, "CHUNK_BYTES", 1 << 20)
    monkeypatch.setattr(limits, "EXPANSION_FLOOR_BYTES", 1 << 21)
    zeros = bytes(1 << 22)
    path = tmp_path / "r.bag"
    for stated, what in ((1 << 22, "too large"), (100, "damaged")):
        path.write_bytes(MAGIC + HEAD + chunk(zeros, "bz2", size=stated) + chunk(CONNECTION + message(0)))
        bag = Ros1Bag(path)
        assert len(list(bag.messages())) == 1
        assert [what in loss.what for loss in bag.losses.losses] == [True]
    path.write_bytes(MAGIC + HEAD + 3 * chunk(bytes(1 << 20), "bz2"))
    with pytest.raises(RecordingError, match="chunks expand too much on decompression"):
        list(Ros1Bag(path).messages())


def test_a_chunk_of_more_records_than_fit_its_bytes(tmp_path: Path) -> None:
    path = tmp_path / "r.bag"
    path.write_bytes(MAGIC + HEAD + chunk(CONNECTION + 20_000 * message(0), "bz2"))
    bag = Ros1Bag(path)
    assert len(list(bag.messages())) < 20_000
    assert bag.losses.losses[0].what.startswith("chunk is too large")


def test_an_index_that_lies_is_not_believed(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "r.bag")
    data = bytearray(path.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    for position in (0, 7, len(data) - 3, 2**63):
        struct.pack_into("<Q", data, at, position)
        path.write_bytes(data)
        bag = Ros1Bag(path)
        assert bag.counts() is None
        assert len(list(bag.messages())) == 2 * COUNT + 2
