"""RVL, ROS's run-length code of depth, against an encoder that writes it digit by digit."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from posetrack_cli import limits
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.compression import decode_rvl
from posetrack_cli.recording.opening import describe, open_recording
from support.rvl import encoded


def decoded(data: bytes) -> np.ndarray:
    return decode_rvl(data[8:], *struct.unpack_from("<II", data))


def images() -> Iterator[np.ndarray]:
    random = np.random.default_rng(0)
    yield np.zeros((3, 5), np.uint16)
    yield np.full((4, 4), 65535, np.uint16)
    yield np.array([[0, 1, 0, 65535, 1, 0]], np.uint16)  # differences of both signs, as large as can be
    for share in (0.0, 0.1, 0.9):
        codes = random.integers(1, 65536, (7, 11)).astype(np.uint16)
        yield np.where(random.random(codes.shape) < share, 0, codes).astype(np.uint16)
    yield (900 + np.arange(24 * 32).reshape(24, 32) // 5).astype(np.uint16)


@pytest.mark.parametrize("codes", list(images()))
def test_codes_come_back(codes: np.ndarray) -> None:
    np.testing.assert_array_equal(decoded(encoded(codes)), codes)


def test_the_example_written_by_hand() -> None:
    # 2 pixels without and 3 with readings 5, 6, 4: differences 5, 1, -2 folded to 10, 2, 3; 10 is 12 in octal
    data = struct.pack("<II", 5, 1) + struct.pack("<I", int("23a12300", 16))
    np.testing.assert_array_equal(decoded(data), [[0, 0, 5, 6, 4]])


@pytest.mark.parametrize("keep", range(8, 60, 4))
def test_a_cut_image_cannot_be_read(keep: int) -> None:
    data = encoded(np.arange(1, 101, dtype=np.uint16).reshape(10, 10) * 7)
    assert len(data) > 60
    with pytest.raises(UnreadableImageError, match="incomplete"):
        decoded(data[:keep])


@pytest.mark.parametrize(
    ("size", "words", "error"),
    [
        ((0, 7), b"", "empty"),
        ((1 << 31, 1 << 31), b"", "more than"),
        ((limits.IMAGE_PIXELS, 2), b"", "more than"),
        ((2, 2), b"\xff" * 400, "damaged"),  # a number without an end
        ((2, 2), struct.pack("<I", int("50000000", 16)), "damaged"),  # 5 of 4 pixels
        ((2, 2), struct.pack("<I", int("05000000", 16)), "damaged"),
        ((2, 2), struct.pack("<I", 0) * 9, "incomplete"),  # runs of nothing
    ],
)
def test_a_damaged_image_cannot_be_read(size: tuple[int, int], words: bytes, error: str) -> None:
    with pytest.raises(UnreadableImageError, match=error):
        decode_rvl(words, *size)


@pytest.mark.parametrize("flavour", ["ros1", "ros2"])
def test_messages_of_compressed_depth(tmp_path: Path, make: SimpleNamespace, flavour: str) -> None:
    codes = make.depth_codes(2)
    head = struct.pack("<iff", 0, 0.0, 0.0)
    contents = [{"format": "16UC1; compressedDepth rvl", "data": head + encoded(image)} for image in codes]
    path = write(make, tmp_path, flavour, contents)
    for frame, image in zip(open_recording(path).frames(), codes, strict=True):
        np.testing.assert_array_equal(frame.depth, image)
    (topic,) = [topic for topic in describe(path)["topics"] if topic["encoding"]]
    assert topic["encoding"] == "16UC1 compressedDepth, rvl"
    assert (topic["width"], topic["height"], topic["depth"]) == (make.WIDTH, make.HEIGHT, True)


def test_messages_of_inverse_depth(tmp_path: Path, make: SimpleNamespace) -> None:
    a, b = 100.0 * 101.0, 1 - 100.0 * 101.0 / 10.0  # as ROS quantises up to 10 m: v = a / z + b
    metres = np.linspace(0.5, 5.0, make.WIDTH * make.HEIGHT).reshape(make.HEIGHT, make.WIDTH)
    data = struct.pack("<iff", 0, a, b) + encoded(np.round(a / metres + b).astype(np.uint16))
    path = write(make, tmp_path, "ros2", [{"format": "32FC1; compressedDepth rvl", "data": data}])
    (frame,) = open_recording(path).frames()
    bound = 1000 * metres**2 / (2 * a) * 1.01  # half a step of v is z^2 / (2 a) metres
    assert (np.abs(frame.depth - 1000 * metres) <= bound).all()


def test_a_damaged_message_is_a_loss(tmp_path: Path, make: SimpleNamespace) -> None:
    head = struct.pack("<iff", 0, 0.0, 0.0)
    whole = [head + encoded(image) for image in make.depth_codes(3)]
    data = [whole[0], whole[1][:40], whole[2]]
    path = write(
        make, tmp_path, "ros2", [{"format": "16UC1; compressedDepth rvl", "data": one} for one in data]
    )
    recording = open_recording(path)
    assert [frame.index for frame in recording.frames()] == [0, 2]
    assert [loss.what for loss in recording.losses] == ["image skipped, image is incomplete"]


def write(make: SimpleNamespace, folder: Path, flavour: str, contents: list[dict[str, object]]) -> Path:
    calibration = make.calibration_fields(upper=flavour != "ros2")
    messages = [("/cam/camera_info", "CameraInfo", make.START_NS, make.START_NS, calibration)]
    messages += [
        ("/cam/image/compressedDepth", "CompressedImage", stamp, stamp, content)
        for stamp, content in zip(make.stamps(len(contents)), contents, strict=True)
    ]
    path: Path = make.WRITERS[flavour](folder / "r.mcap", messages)
    return path
