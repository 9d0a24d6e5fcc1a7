"""Bags as recordings, whatever their container: depth and colour of the files that rosbags wrote."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.conversion import convert_recording
from posetrack_cli.recording.opening import describe, open_recording
from support.bags import (
    COLOUR,
    COUNT,
    CX,
    DEPTH,
    DEPTH_INFO,
    FX,
    HEIGHT,
    PERIOD_NS,
    START_NS,
    WIDTH,
    Messages,
    Row,
    colours,
    depth_codes,
    write_bag,
    write_folder,
)

WRITERS: dict[str, Callable[[Path], Path]] = {
    "bag": lambda folder: write_bag(folder / "r.bag"),
    "bag, bz2": lambda folder: write_bag(folder / "r.bag", "bz2"),
    "bag, lz4": lambda folder: write_bag(folder / "r.bag", "lz4"),
    "folder of mcap": lambda folder: write_folder(folder / "r", "mcap"),
    "folder of db3": lambda folder: write_folder(folder / "r", "sqlite3"),
    "folder of db3, zstd": lambda folder: write_folder(folder / "r", "sqlite3", "message"),
    "db3": lambda folder: write_folder(folder / "r", "sqlite3") / "r.db3",
}
GREY_LEVELS = 1.0
"""Rounding of luma."""


@pytest.fixture(params=WRITERS, scope="module")
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return WRITERS[request.param](tmp_path_factory.mktemp("bags"))


def test_depth(path: Path) -> None:
    recording = open_recording(path)
    frames = list(recording.frames())
    assert [frame.stamp_ns for frame in frames] == [START_NS + k * PERIOD_NS for k in range(COUNT)]
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.depth, depth_codes(number))
    (camera,) = recording.cameras
    assert (camera.width, camera.height, camera.fx, camera.cx) == (WIDTH, HEIGHT, FX, CX)
    assert (recording.frame_count, recording.losses, recording.remarks) == (COUNT, (), ())


def test_colour(path: Path) -> None:
    """Of depth and colour in one recording each takes its own, unasked."""
    recording = open_recording(path, "grey", guess=Guess())
    frames = list(recording.frames())
    assert len(frames) == COUNT
    for number, frame in enumerate(frames):
        assert np.abs(frame.images[0] - colours(number) @ [0.299, 0.587, 0.114]).max() <= GREY_LEVELS
    assert (recording.cameras[0].name, recording.is_guessed, recording.remarks) == ("color_frame", False, ())


def test_identity_and_description(path: Path) -> None:
    identity = open_recording(path).identity()
    kinds = {".bag": "bag", ".db3": "db3", "": "ros2"}
    assert (identity["kind"], identity["topic"]) == (kinds[path.suffix], DEPTH)
    described = describe(path)
    assert (described["kind"], described["complete"], described["losses"]) == (kinds[path.suffix], True, [])
    topics = {topic["topic"]: topic for topic in described["topics"]}
    assert topics[DEPTH]["depth"] and not topics[COLOUR]["depth"]
    assert topics[COLOUR]["messages"] == COUNT
    files = [one for one in path.iterdir() if one.suffix in (".mcap", ".db3")] if path.is_dir() else [path]
    assert described["bytes"] == sum(one.stat().st_size for one in files)


# What is taken of several topics, and RealSense's own bags

SENSOR = "/device_0/sensor_0"
UNIT_MM = 0.25


def of_realsense(messages: Messages) -> Iterator[Row]:
    """As librealsense 2.56 writes them: calibrations in a namespace beside, the unit an option."""
    yield f"{SENSOR}/Depth_0/info/camera_info", 0, messages.camera_info("")
    yield "/device_0/sensor_1/Color_0/info/camera_info", 0, messages.camera_info("")
    yield f"{SENSOR}/option/Depth_Units/value", 0, messages.value(UNIT_MM / 1000)
    for number in range(COUNT):
        image = messages.image(number, "1", "mono16", depth_codes(number))
        yield f"{SENSOR}/Depth_0/image/data", number, image
        infrared = messages.image(number, "1", "mono8", colours(number)[..., 0].copy())
        yield f"{SENSOR}/Infrared_1/image/data", number, infrared
        colour = messages.image(number, "1", "rgb8", colours(number))
        yield "/device_0/sensor_1/Color_0/image/data", number, colour


def test_realsense_tells_its_unit_and_its_cameras(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "r.bag", "lz4", of_realsense)
    recording = open_recording(path)
    for number, frame in enumerate(recording.frames()):
        np.testing.assert_allclose(frame.depth, UNIT_MM * depth_codes(number), rtol=1e-6)
    assert (recording.cameras[0].fx, recording.identity()["camera_topic"]) == (
        FX,
        f"{SENSOR}/Depth_0/info/camera_info",
    )
    colour = open_recording(path, "grey", guess=Guess())
    assert colour.remarks == (
        "colour read from /device_0/sensor_1/Color_0/image/data; "
        f"choose another with --cameras: {SENSOR}/Infrared_1/image/data",
    )
    assert np.abs(next(colour.frames()).images[0] - colours(0) @ [0.299, 0.587, 0.114]).max() <= GREY_LEVELS
    converted = tmp_path / "r.mcap"
    assert convert_recording(recording, converted).frames == COUNT
    for number, frame in enumerate(open_recording(converted).frames()):
        np.testing.assert_allclose(frame.depth, UNIT_MM * depth_codes(number), rtol=1e-6)


@pytest.mark.parametrize("unit", [0.0, -1.0, float("nan"), 1e9])
def test_a_unit_that_cannot_be_is_one_line(tmp_path: Path, unit: float) -> None:
    def rows(messages: Messages) -> Iterator[Row]:
        for topic, number, message in of_realsense(messages):
            yield topic, number, messages.value(unit) if topic.endswith("Units/value") else message

    path = write_bag(tmp_path / "r.bag", rows=rows)
    with pytest.raises(RecordingError, match=r"Depth_Units/value: implausible depth unit, found"):
        open_recording(path)


@pytest.mark.parametrize(
    ("others", "remark"),
    [
        (["/camera/infra1/image_rect_raw"], "/camera/infra1/image_rect_raw"),
        (["/camera/aligned_depth_to_color/image_raw"], "/camera/aligned_depth_to_color/image_raw"),
        (["/camera/depth_registered/image", "/ir"], "/camera/depth_registered/image, /ir"),
    ],
)
def test_the_likeliest_depth_is_taken_and_said(tmp_path: Path, others: list[str], remark: str) -> None:
    def rows(messages: Messages) -> Iterator[Row]:
        for topic, number, message in messages.usual():
            yield topic, number, message
            if topic == DEPTH:
                for other in others:
                    yield other, number, messages.image(number, "its_frame", "mono16", depth_codes(number))

    path = write_bag(tmp_path / "r.bag", rows=rows)
    recording = open_recording(path)
    assert recording.remarks == (f"depth read from {DEPTH}; choose another with --topic: {remark}",)
    assert open_recording(path, topic=others[0], camera_topic=DEPTH_INFO).identity()["topic"] == others[0]


def test_of_two_cameras_of_depth_none_is_likelier(tmp_path: Path) -> None:
    def rows(messages: Messages) -> Iterator[Row]:
        for topic, number, message in messages.usual():
            yield topic, number, message
            yield topic.replace("/camera", "/other"), number, message

    path = write_bag(tmp_path / "r.bag", rows=rows)
    with pytest.raises(UsageError, match=r"several depth topics, .*; choose one with --topic"):
        open_recording(path)


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "bgra8", "rgb16"])
def test_colour_to_draw_on_is_kept(tmp_path: Path, encoding: str) -> None:
    """Blue, green and red, whatever their order is in messages."""

    def rows(messages: Messages) -> Iterator[Row]:
        yield COLOUR, 0, messages.image(0, "f", encoding, stored)

    shown = colours(3)
    order = shown if encoding.startswith("rgb") else shown[..., ::-1]
    opaque = np.dstack([order, np.full(order.shape[:2], 255, np.uint8)]) if "a8" in encoding else order
    stored = np.ascontiguousarray(opaque.astype("u2") << 8 if encoding.endswith("16") else opaque)
    path = write_bag(tmp_path / "r.bag", rows=rows)
    (image,) = next(open_recording(path, "grey", guess=Guess(), in_colour=True).frames()).images
    np.testing.assert_array_equal(image, shown[..., ::-1])
