"""Video in messages: every picture belongs to its message, wherever one begins or what is damaged."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import av
import cv2
import numpy as np
import pytest

from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.message_video import decoded_video
from posetrack_cli.recording.opening import describe, open_recording

COUNT, START_NS, PERIOD_NS = 12, 1_700_000_000_000_000_000, 33_000_000
GREY_LEVELS = 12.0
"""What compression changes on average at most."""
KEYFRAMES = 5


def pictures() -> list[np.ndarray]:
    """A bar that moves by eight pixels each frame (48, 128)."""
    images = []
    for k in range(COUNT):
        image = np.full((48, 128), 60, np.uint8)
        image[:, 8 * k : 8 * k + 16] = 220
        images.append(image)
    return images


def encoded(codec: str, options: dict[str, str]) -> list[bytes]:
    """One packet a picture, without B-frames, a keyframe every five."""
    encoder = av.CodecContext.create(codec, "w")
    encoder.width, encoder.height, encoder.pix_fmt = 128, 48, "yuv420p"
    encoder.time_base, encoder.framerate = Fraction(1, 30), Fraction(30, 1)
    encoder.gop_size, encoder.max_b_frames, encoder.options = KEYFRAMES, 0, options
    found = []
    for number, image in enumerate(pictures()):
        frame = av.VideoFrame.from_ndarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), format="bgr24")
        frame.pts = number
        found += [bytes(packet) for packet in encoder.encode(frame.reformat(format="yuv420p"))]
    found += [bytes(packet) for packet in encoder.encode(None)]
    assert len(found) == COUNT
    return found


CODECS = {
    "h264": ("libx264", {"tune": "zerolatency", "x264-params": "repeat-headers=1:annexb=1"}),
    "h265": ("libx265", {"tune": "zerolatency", "x265-params": "repeat-headers=1:log-level=none"}),
}


@pytest.fixture(params=CODECS, scope="module")
def stream(request: pytest.FixtureRequest) -> tuple[str, list[bytes]]:
    return request.param, encoded(*CODECS[request.param])


def write(path: Path, name: str, data: list[bytes]) -> Path:
    from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo

    with McapSink(path, compression="zstd") as sink:
        channel = sink.channel("/camera/video", CompressedVideo)
        for number, content in enumerate(data):
            message = CompressedVideo(frame_id="camera", format=name, data=content)
            message.timestamp.FromNanoseconds(START_NS + number * PERIOD_NS)
            sink.write(channel, START_NS + number * PERIOD_NS, message.SerializeToString())
        sink.finish()
    return path


def errors(path: Path, **options: int) -> dict[int, float]:
    """Mean difference of each frame from the picture of its number."""
    recording = open_recording(path, "grey", guess=Guess())
    found = {}
    for frame in recording.frames(**options):
        (image,) = frame.images
        assert image is not None and image.shape == (48, 128)
        number = (frame.stamp_ns - START_NS) // PERIOD_NS
        found[number] = float(np.abs(image.astype(int) - pictures()[number]).mean())
    return found


def test_each_message_is_its_picture(tmp_path: Path, stream: tuple[str, list[bytes]]) -> None:
    path = write(tmp_path / "v.mcap", *stream)
    found = errors(path)
    assert list(found) == list(range(COUNT)) and max(found.values()) < GREY_LEVELS
    assert list(errors(path, start=7, stride=2)) == [7, 9, 11], "what is before is decoded all the same"
    assert max(errors(path, start=7, stride=2).values()) < GREY_LEVELS
    (topic,) = describe(path)["topics"]
    assert topic["encoding"] == f"{stream[0]} video"


def test_a_recording_that_begins_between_keyframes(tmp_path: Path, stream: tuple[str, list[bytes]]) -> None:
    name, data = stream
    recording = open_recording(write(tmp_path / "v.mcap", name, data[2:]), "grey", guess=Guess())
    frames = [frame for frame in recording.frames() if frame.images[0] is not None]
    numbers = [(frame.stamp_ns - START_NS) // PERIOD_NS + 2 for frame in frames]
    assert numbers == list(range(KEYFRAMES, COUNT))
    assert recording.losses[0].what == "message skipped, video picture cannot be decoded"


def test_damage_costs_pictures_and_no_order(tmp_path: Path, stream: tuple[str, list[bytes]]) -> None:
    name, data = stream
    damaged = [*data[:6], b"\0\0\0\1" + bytes(40), *data[7:]]
    found = errors(write(tmp_path / "v.mcap", name, damaged))
    after = [number for number in found if number >= 2 * KEYFRAMES]
    assert after == [10, 11] and max(found[number] for number in after) < GREY_LEVELS


def test_formats_that_are_not_read_are_no_images(tmp_path: Path) -> None:
    path = write(tmp_path / "v.mcap", "prores", [b"x"] * 3)
    with pytest.raises(Exception, match="no grey or colour image topics, found /camera/video"):
        open_recording(path, "grey", guess=Guess())


def test_messages_without_any_picture_do_not_pile_up(stream: tuple[str, list[bytes]]) -> None:
    class Message:
        format, data = stream[0], b"no packet"

    taken = 0
    for _, picture in decoded_video((k, Message()) for k in range(1000)):
        assert picture is None
        taken += 1
    assert taken == 1000


def test_messages_of_ros(tmp_path: Path, stream: tuple[str, list[bytes]]) -> None:
    """CDR of foxglove_msgs/msg/CompressedVideo, by its published definition."""
    from mcap_ros2.writer import Writer

    name, data = stream
    definition = (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n"
        f"{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )
    path = tmp_path / "v.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("foxglove_msgs/msg/CompressedVideo", definition)
        for number, content in enumerate(data):
            sec, nanosec = divmod(START_NS + number * PERIOD_NS, 10**9)
            message = {
                "timestamp": {"sec": sec, "nanosec": nanosec},
                "frame_id": "camera",
                "data": content,
                "format": name,
            }
            writer.write_message("/camera/video", schema, message, log_time=START_NS, publish_time=START_NS)
        writer.finish()
    found = errors(path)
    assert list(found) == list(range(COUNT)) and max(found.values()) < GREY_LEVELS


def test_two_calibrated_cameras(tmp_path: Path) -> None:
    """Each topic has a decoder of its own, here of two codecs; cameras come from calibrations."""
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo

    path, baseline_m = tmp_path / "v.mcap", 0.12
    with McapSink(path, compression="zstd") as sink:
        for k, name in enumerate(("left", "right")):
            info = sink.channel(f"/{name}/camera_info", CameraCalibration)
            p = [100.0, 0.0, 63.5, -100.0 * baseline_m * k, 0.0, 100.0, 23.5, 0.0, 0.0, 0.0, 1.0, 0.0]
            calibration = CameraCalibration(
                frame_id=name,
                width=128,
                height=48,
                distortion_model="plumb_bob",
                D=[0.0] * 5,
                K=[100.0, 0.0, 63.5, 0.0, 100.0, 23.5, 0.0, 0.0, 1.0],
                R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
                P=p,
            )
            sink.write(info, START_NS, calibration.SerializeToString())
        own = {
            name: (sink.channel(f"/{name}/video", CompressedVideo), codec, encoded(*CODECS[codec]))
            for name, codec in (("left", "h264"), ("right", "h265"))
        }
        for number in range(COUNT):
            for name, (channel, codec, data) in own.items():
                message = CompressedVideo(frame_id=name, format=codec, data=data[number])
                message.timestamp.FromNanoseconds(START_NS + number * PERIOD_NS)
                sink.write(channel, START_NS + number * PERIOD_NS, message.SerializeToString())
        sink.finish()
    recording = open_recording(path, "grey")
    assert [camera.fx for camera in recording.cameras] == [100.0, 100.0]
    assert recording.cameras[1].camera_T_reference[0][3] == pytest.approx(-1000.0 * baseline_m)
    frames = list(recording.frames())
    assert len(frames) == COUNT and recording.losses == ()
    for number, frame in enumerate(frames):
        for image in frame.images:
            assert image is not None
            assert np.abs(image.astype(int) - pictures()[number]).mean() < GREY_LEVELS


def test_pictures_beyond_the_bound_are_not_decoded(
    monkeypatch: pytest.MonkeyPatch, stream: tuple[str, list[bytes]]
) -> None:
    monkeypatch.setattr("posetrack_cli.limits.IMAGE_PIXELS", 128 * 48 - 1)
    messages = [SimpleNamespace(format=stream[0], data=data) for data in stream[1]]
    assert [picture for _, picture in decoded_video(enumerate(messages))] == [None] * COUNT


def test_messages_of_another_format_cost_themselves(stream: tuple[str, list[bytes]]) -> None:
    name, data = stream
    messages = [SimpleNamespace(format="prores", data=b"x")]
    messages += [SimpleNamespace(format=name, data=content) for content in data]
    found = dict(decoded_video(enumerate(messages)))
    assert [number for number, picture in found.items() if picture is None] == [0]


@pytest.mark.parametrize(
    ("name", "codec", "options"),
    [
        ("vp9", "libvpx-vp9", {"lag-in-frames": "0", "deadline": "realtime"}),
        ("av1", "libsvtav1", {"preset": "12", "svtav1-params": "pred-struct=1:lookahead=0"}),
    ],
)
def test_other_codecs(
    monkeypatch: pytest.MonkeyPatch, name: str, codec: str, options: dict[str, str]
) -> None:
    monkeypatch.setenv("SVT_LOG", "0")  # the encoder reports its settings
    data = encoded(codec, options)
    found = list(decoded_video((k, SimpleNamespace(format=name, data=d)) for k, d in enumerate(data)))
    assert [number for number, _ in found] == list(range(COUNT))
    for number, picture in found:
        assert picture is not None
        assert np.abs(picture[..., 0].astype(int) - pictures()[number]).mean() < GREY_LEVELS
