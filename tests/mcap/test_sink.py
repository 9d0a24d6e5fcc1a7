"""The MCAP sink: reproducible bytes, flushed chunks, no footer unless finished."""

from __future__ import annotations

import filecmp
import resource
from dataclasses import asdict
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.reader import make_reader

from posetrack_cli.errors import ResultError
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.sink import LIBRARY, McapSink, SchemaText
from posetrack_cli.mcap.stream import McapFile, read_summary


def write_all(path: Path, finish: bool = True) -> Path:
    with McapSink(path) as sink:
        first = sink.channel("/a", RawImage, metadata={"unit": "mm"})
        second = sink.channel("/b", RawImage)
        odometry = sink.channel("/o", Odometry)
        values = sink.json_channel("/j", "posetrack.values", {"type": "object"})
        for stamp in (5, 6, 7):
            sink.write(first, stamp, RawImage(width=stamp).SerializeToString())
        sink.write(second, 6, b"")
        sink.write(odometry, 6, b"")
        sink.metadata("posetrack.run", {"seed": "1"})
        sink.flush()
        sink.write(values, 8, b"{}")
        sink.attachment("hand.glb", "model/gltf-binary", b"glTF", 5)
        if finish:
            sink.finish()
    return path


def test_what_is_written_can_be_read(tmp_path: Path) -> None:
    path = write_all(tmp_path / "a.mcap")
    items = list(McapFile(path).messages())
    assert [(c.topic, m.log_time, m.publish_time, m.sequence) for _, c, m in items] == [
        ("/a", 5, 5, 0),
        ("/a", 6, 6, 1),
        ("/b", 6, 6, 0),
        ("/o", 6, 6, 0),
        ("/a", 7, 7, 2),
        ("/j", 8, 8, 0),
    ]
    schema, channel, message = items[0]
    assert schema is not None
    assert (schema.name, schema.encoding, channel.message_encoding) == (
        "foxglove.RawImage",
        "protobuf",
        "protobuf",
    )
    assert channel.metadata == {"unit": "mm"}
    assert RawImage.FromString(message.data).width == 5
    names = [record.name for record in McapFile(path).extras()]
    assert names == ["posetrack.run", "hand.glb"]


def test_an_attachment_keeps_when_it_was_made(tmp_path: Path) -> None:
    with McapSink(tmp_path / "a.mcap") as sink:
        sink.attachment("a", "text/plain", b"x", 5, 3)
        sink.attachment("b", "text/plain", b"x", 5)
        sink.finish()
    times = [(one.log_time, one.create_time) for one in McapFile(tmp_path / "a.mcap").extras()]
    assert times == [(5, 3), (5, 5)]


def test_more_channels_than_a_file_can_number_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posetrack_cli.limits.CHANNELS", 2)
    with McapSink(tmp_path / "a.mcap") as sink:
        for topic in "ab":
            sink.channel(topic, RawImage)
        with pytest.raises(ResultError, match="too many topics, expected at most 2"):
            sink.channel("c", RawImage)


def test_one_schema_per_type_and_a_fixed_library(tmp_path: Path) -> None:
    path = write_all(tmp_path / "a.mcap")
    summary = read_summary(path)
    assert summary is not None
    assert [schema.name for schema in summary.schemas.values()] == [
        "foxglove.RawImage",
        "foxglove.Odometry",
        "posetrack.values",
    ]
    with path.open("rb") as stream:
        assert asdict(make_reader(stream).get_header())["library"] == LIBRARY


def test_channel_without_schema(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with McapSink(path, compression="none") as sink:
        sink.write(sink.raw_channel("/x", SchemaText("", "", b""), "json"), 1, b"{}")
        sink.finish()
    ((schema, channel, _),) = McapFile(path).messages()
    assert schema is None
    assert channel.schema_id == 0


def test_bytes_are_the_same_each_time(tmp_path: Path) -> None:
    assert filecmp.cmp(write_all(tmp_path / "a.mcap"), write_all(tmp_path / "b.mcap"), shallow=False)


def test_without_finish_there_is_no_footer_and_flushed_messages_remain(tmp_path: Path) -> None:
    path = write_all(tmp_path / "a.mcap", finish=False)
    log = LossLog()
    assert len(list(McapFile(path, log).messages())) == 5, "the message after the flush is lost"
    assert len(log.losses) == 1
    assert read_summary(path) is None


def test_flush_reaches_the_operating_system(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with McapSink(path) as sink:
        sink.write(sink.channel("/a", RawImage), 1, b"")
        sink.flush()
        assert len(list(McapFile(path).messages())) == 1


def test_exception_does_not_finish_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with pytest.raises(KeyboardInterrupt), McapSink(path) as sink:
        sink.write(sink.channel("/a", RawImage), 1, b"")
        raise KeyboardInterrupt
    assert read_summary(path) is None


def test_full_disk_and_missing_folder_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="cannot be written, found No such file"):
        McapSink(tmp_path / "gone" / "a.mcap")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with (
            pytest.raises(ResultError, match="cannot be written, found File too large"),
            McapSink(tmp_path / "a.mcap", compression="none") as sink,
        ):
            resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, limits[1]))  # as a disk that has no more
            sink.write(sink.channel("/a", RawImage), 1, b"\0" * 100_000)
            sink.flush()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.parametrize("stamp", [-1, 1 << 64])
def test_stamp_that_cannot_be_stored(tmp_path: Path, stamp: int) -> None:
    with McapSink(tmp_path / "a.mcap") as sink:
        channel = sink.channel("/a", RawImage)
        with pytest.raises(ResultError, match="stamp out of range"):
            sink.write(channel, stamp, b"")
