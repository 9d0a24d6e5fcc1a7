"""Files that are cut, damaged or never finished: what is whole is read, and one loss is told."""

from __future__ import annotations

import io
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from posetrack_cli.errors import PosetrackError, RecordingError
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.opening import describe, open_recording


def image_ends(path: Path) -> list[int]:
    """File offsets at which the chunks of the images end; the first chunk is the calibration's."""
    summary = make_reader(io.BytesIO(path.read_bytes())).get_summary()
    assert summary is not None
    return [index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes][1:]


def test_every_cut_keeps_what_is_complete_and_tells_one_loss(
    tmp_path: Path, foxglove_file: Path, make: SimpleNamespace
) -> None:
    data, ends = foxglove_file.read_bytes(), image_ends(foxglove_file)
    cut_path = tmp_path / "cut.mcap.part"
    images = make.depth_codes(12)
    offsets = sorted(
        {*range(ends[0], len(data) - 1, 331), *ends, *(end - 1 for end in ends[1:]), len(data) - 1}
    )
    for offset in offsets:
        cut_path.write_bytes(data[:offset])
        recording = open_recording(cut_path)
        frames = list(recording.frames())
        complete = sum(end <= offset for end in ends)
        assert len(frames) == complete, f"cut at {offset}"
        for frame, image in zip(frames, images, strict=False):
            np.testing.assert_array_equal(frame.depth, image)
        (loss,) = recording.losses
        assert "truncated" in loss.what
        assert loss.first == f"byte {offset} of {offset}"


def test_cuts_before_the_first_image_are_plain_errors(tmp_path: Path, foxglove_file: Path) -> None:
    data, first = foxglove_file.read_bytes(), image_ends(foxglove_file)[0]
    path = tmp_path / "cut.mcap"
    for offset in range(0, first, 37):
        path.write_bytes(data[:offset])
        with pytest.raises(RecordingError):
            open_recording(path)


def test_messages_of_another_kind_on_a_topic_are_counted(tmp_path: Path, make: SimpleNamespace) -> None:
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    with McapSink(tmp_path / "a.mcap") as sink:
        for kind, fields in ((CameraCalibration, make.calibration_fields()), (FrameTransforms, {})):
            sink.write(sink.channel("/cam/info", kind), 5, kind(**fields).SerializeToString())
        sink.finish()
    (loss,) = describe(tmp_path / "a.mcap")["losses"]
    assert (loss["what"], loss["count"]) == ("message on /cam/info is no calibration", 1)


def test_range_that_ends_before_the_cut_loses_nothing(tmp_path: Path, foxglove_file: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(foxglove_file.read_bytes()[: image_ends(foxglove_file)[7] + 50])
    recording = open_recording(path)
    assert len(list(recording.frames(end=5))) == 5
    assert recording.losses == ()


def test_unfinished_file_of_a_killed_writer(tmp_path: Path, make: SimpleNamespace) -> None:
    frames = [("/cam/info", "CameraInfo", 5, 5, make.calibration_fields())]
    frames += [
        ("/cam/image", "Image", 10 + i, 10 + i, make.raw_fields(image, "16UC1"))
        for i, image in enumerate(make.depth_codes(7))
    ]
    path = make.write_foxglove(tmp_path / "r.mcap.part", frames, flush_every=4, finish=False)
    recording = open_recording(path)
    assert recording.frame_count == 7
    assert len(list(recording.frames())) == 7
    assert "truncated" in recording.losses[0].what


def test_garbage_after_complete_chunks(tmp_path: Path, foxglove_file: Path) -> None:
    path = tmp_path / "r.mcap"
    end = image_ends(foxglove_file)[5]
    rng = np.random.default_rng(3)
    for _ in range(20):
        path.write_bytes(foxglove_file.read_bytes()[:end] + rng.bytes(400))
        recording = open_recording(path)
        assert len(list(recording.frames())) == 6
        assert len(recording.losses) == 1


def test_damaged_chunk_in_a_file_with_index(tmp_path: Path, foxglove_file: Path) -> None:
    data = bytearray(foxglove_file.read_bytes())
    ends = image_ends(foxglove_file)
    data[ends[4] - 40] ^= 0xFF
    path = tmp_path / "r.mcap"
    path.write_bytes(data)
    recording = open_recording(path)
    expected = [frame.stamp_ns for frame in open_recording(foxglove_file).frames()]
    del expected[4]
    assert [frame.stamp_ns for frame in recording.frames()] == expected
    (loss,) = recording.losses
    assert loss.what == "chunk is damaged, its messages are lost"
    assert loss.first == f"before byte {ends[4]} of {len(data)}"


def test_a_damaged_first_chunk_of_images_hides_no_later_one(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(6)
    path = make.write_foxglove(tmp_path / "r.mcap", [*calibrated(make, images)], flush_every=1)
    data = bytearray(path.read_bytes())
    data[image_ends(path)[0] - 40] ^= 0xFF
    path.write_bytes(data)
    recording = open_recording(path)
    assert [frame.stamp_ns for frame in recording.frames()] == [11, 12, 13, 14, 15]


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_a_chunk_that_is_cut_gives_its_whole_messages(
    tmp_path: Path, make: SimpleNamespace, compression: str
) -> None:
    """One chunk of everything, as a recorder with large chunks leaves it when its machine stops."""
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 65536, size=(256, 256)).astype(np.uint16) for _ in range(12)]
    path = tmp_path / "r.mcap"
    write_one_chunk(path, make, images, compression)
    data = path.read_bytes()
    for cut in (0.3, 0.6, 0.9):
        path.write_bytes(data[: int(cut * len(data))])
        recording = open_recording(path)
        frames = list(recording.frames())
        # noise does not compress: bytes before the cut are images before the cut, one block may be half
        assert 12 * cut - 3 < len(frames) <= 12 * cut
        for frame, image in zip(frames, images, strict=False):
            np.testing.assert_array_equal(frame.depth, image)
        (loss,) = recording.losses
        assert "truncated" in loss.what and recording.frame_count == len(frames)


def calibrated(make: SimpleNamespace, images: list[np.ndarray]) -> Iterator[Any]:
    height, width = images[0].shape
    yield "/cam/info", "CameraInfo", 5, 5, make.calibration_fields(width, height)
    for i, image in enumerate(images):
        yield "/cam/image", "Image", 10 + i, 10 + i, make.raw_fields(image, "16UC1")


def write_one_chunk(path: Path, make: SimpleNamespace, images: list[np.ndarray], compression: str) -> None:
    make.write_foxglove(path, [*calibrated(make, images)], flush_every=1000, compression="none")
    with path.open("rb") as source:
        items = list(make_reader(source).iter_messages())
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=1 << 30, compression=CompressionType[compression.upper()])
        writer.start()
        channels: dict[int, int] = {}
        for schema, channel, message in items:
            assert schema is not None
            if channel.id not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "protobuf", schema_id)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.log_time)
        writer.finish()


@pytest.mark.parametrize("finish", [True, False])
def test_flipped_pixel_without_compression_is_found_by_its_checksum(
    tmp_path: Path, make: SimpleNamespace, finish: bool
) -> None:
    frames = [("/cam/info", "CameraInfo", 5, 5, make.calibration_fields())]
    images = make.depth_codes(4)
    frames += [
        ("/cam/image", "Image", 10 + i, 10 + i, make.raw_fields(image, "16UC1"))
        for i, image in enumerate(images)
    ]
    path = make.write_foxglove(tmp_path / "r.mcap", frames, compression="none", finish=finish)
    data = bytearray(path.read_bytes())
    data[data.index(images[2].tobytes()) + 300] ^= 0x01
    path.write_bytes(data)
    recording = open_recording(path)
    assert [frame.stamp_ns for frame in recording.frames()] == [10, 11, 13]
    damaged, *unfinished = recording.losses
    assert "damaged" in damaged.what and len(unfinished) == (0 if finish else 1)


def test_any_flipped_byte_ends_in_frames_or_one_line(tmp_path: Path, foxglove_file: Path) -> None:
    data = foxglove_file.read_bytes()
    path = tmp_path / "r.mcap"
    for position in range(8, len(data), 197):
        damaged = bytearray(data)
        damaged[position] ^= 0x55
        path.write_bytes(damaged)
        try:
            assert len(list(open_recording(path).frames())) <= 12
        except PosetrackError as error:
            assert "\n" not in str(error)


def test_file_without_index_is_read_in_file_order(tmp_path: Path, foxglove_file: Path) -> None:
    path = tmp_path / "plain.mcap"
    with path.open("wb") as stream, foxglove_file.open("rb") as source:
        writer = Writer(stream, use_chunking=False, index_types=IndexType.NONE)
        writer.start()
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            assert schema is not None
            if channel.id not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id
                )
            writer.add_message(channels[channel.id], message.log_time, message.data, message.log_time)
        writer.finish()
    recording = open_recording(path)
    assert (len(list(recording.frames())), recording.losses) == (12, ())


@pytest.mark.parametrize("finish", [True, False])
def test_reading_holds_a_few_frames_only(tmp_path: Path, make: SimpleNamespace, finish: bool) -> None:
    image = np.random.default_rng(0).integers(400, 900, size=(256, 512)).astype(np.uint16)
    fields = make.raw_fields(image, "16UC1")
    calibration = make.calibration_fields(512, 256)
    frames = [("/cam/info", "CameraInfo", 1, 1, calibration)]
    frames += [("/cam/image", "Image", 10 + i, 10 + i, fields) for i in range(80)]
    path = make.write_foxglove(tmp_path / "r.mcap", frames, finish=finish)
    recording = open_recording(path)
    tracemalloc.start()
    count = sum(1 for _ in recording.frames())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert count == 80
    assert peak < 16 * image.nbytes, "80 frames would be 80 images"


def test_losses_are_told_once_per_pass(tmp_path: Path, foxglove_file: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(foxglove_file.read_bytes()[:-200])
    log = LossLog()
    list(McapFile(path, log).messages())
    list(McapFile(path, log).messages())
    assert [loss.count for loss in log.losses] == [2]
    recording = open_recording(path)
    for _ in range(2):
        list(recording.frames())
        assert [loss.count for loss in recording.losses] == [1]
