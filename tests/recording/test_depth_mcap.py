"""Depth from MCAP: every encoding, topics, calibrations and stamps."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import PosetrackError, RecordingError, UsageError
from posetrack_cli.mcap.sink import McapSink, SchemaText
from posetrack_cli.recording.opening import open_recording

FLAVOURS = ["foxglove", "ros1", "ros2"]
ULP = float(np.finfo(np.float32).eps)


def with_camera(make: SimpleNamespace, flavour: str, frames: list[Any], **fields: Any) -> list[Any]:
    """Put a calibration beside the images, ten seconds before the first."""
    calibration = {**make.calibration_fields(upper=flavour != "ros2"), **fields}
    return [("/cam/info", "CameraInfo", make.START_NS, make.START_NS - 10**10, calibration), *frames]


def write(
    make: SimpleNamespace,
    path: Path,
    flavour: str,
    kind: str,
    contents: list[dict[str, Any]],
    topic: str = "/cam/image",
) -> Path:
    frames = [
        (topic, kind, stamp, stamp + 5000, content)
        for stamp, content in zip(make.stamps(len(contents)), contents, strict=True)
    ]
    return make.WRITERS[flavour](path / "r.mcap", with_camera(make, flavour, frames))


def depths(path: Path, **options: Any) -> list[np.ndarray]:
    return [frame.depth for frame in open_recording(path, **options).frames()]


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("encoding", ["16UC1", "mono16"])
@pytest.mark.parametrize("padding", [0, 6])
def test_raw_millimetres(
    tmp_path: Path, make: SimpleNamespace, flavour: str, encoding: str, padding: int
) -> None:
    images = make.depth_codes(3)
    fields = [make.raw_fields(image, encoding, padding=padding) for image in images]
    recording = open_recording(write(make, tmp_path, flavour, "Image", fields))
    frames = list(recording.frames())
    for frame, image in zip(frames, images, strict=True):
        assert frame.depth.dtype == np.float32
        assert frame.depth.flags.c_contiguous
        np.testing.assert_array_equal(frame.depth, image)
    assert [frame.stamp_ns for frame in frames] == make.stamps(3), "the header's stamps, not the log times"
    camera = recording.cameras[0]
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (30.0, 31.0, 11.0, 7.5)
    assert (camera.width, camera.height, camera.name) == (make.WIDTH, make.HEIGHT, "cam")
    assert (recording.frame_count, recording.losses) == (3, ())


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_raw_metres_where_nan_inf_and_negative_are_no_reading(
    tmp_path: Path, make: SimpleNamespace, flavour: str
) -> None:
    metres = make.depth_codes(1)[0].astype(np.float32) / 1000
    metres[0, :5] = [np.nan, np.inf, -np.inf, -0.5, 3e38]
    (depth,) = depths(write(make, tmp_path, flavour, "Image", [make.raw_fields(metres, "32FC1")]))
    assert not depth[0, :5].any()
    np.testing.assert_allclose(depth[1:], metres[1:] * 1000.0, rtol=2 * ULP)


@pytest.mark.parametrize("flavour", ["ros1", "ros2"])
@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_big_endian_images(tmp_path: Path, make: SimpleNamespace, flavour: str, encoding: str) -> None:
    image = make.depth_codes(1)[0]
    stored = image if encoding == "16UC1" else image.astype(np.float32) / 1000
    (depth,) = depths(
        write(make, tmp_path, flavour, "Image", [make.raw_fields(stored, encoding, padding=4, big=True)])
    )
    np.testing.assert_allclose(depth, image, rtol=2 * ULP)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_png(tmp_path: Path, make: SimpleNamespace, flavour: str) -> None:
    images = make.depth_codes(2)
    contents = [{"format": "png", "data": make.png(image)} for image in images]
    for depth, image in zip(
        depths(write(make, tmp_path, flavour, "CompressedImage", contents)), images, strict=True
    ):
        np.testing.assert_array_equal(depth, image)


@pytest.mark.parametrize("flavour", ["ros1", "ros2"])
@pytest.mark.parametrize("suffix", ["", " png"])
def test_compressed_depth_of_millimetres(
    tmp_path: Path, make: SimpleNamespace, flavour: str, suffix: str
) -> None:
    image = make.depth_codes(1)[0]
    content = {"format": f"16UC1; compressedDepth{suffix}", "data": make.compressed_depth(image)}
    path = write(make, tmp_path, flavour, "CompressedImage", [content], "/cam/image/compressedDepth")
    np.testing.assert_array_equal(depths(path)[0], image)


@pytest.mark.parametrize("flavour", ["ros1", "ros2"])
def test_compressed_depth_of_inverse_metres(tmp_path: Path, make: SimpleNamespace, flavour: str) -> None:
    # As ROS quantises: A = q (q + 1), B = 1 - A / max; v = A / z + B.
    quantisation, max_depth = 100.0, 10.0
    a = quantisation * (quantisation + 1)
    b = 1 - a / max_depth
    metres = np.linspace(0.5, 5.0, make.WIDTH * make.HEIGHT).reshape(make.HEIGHT, make.WIDTH)
    codes = np.round(a / metres + b).astype(np.uint16)
    codes[0, 0] = 0
    content = {"format": "32FC1; compressedDepth png", "data": make.compressed_depth(codes, a, b)}
    (depth,) = depths(write(make, tmp_path, flavour, "CompressedImage", [content]))
    assert depth[0, 0] == 0
    # Half a quantisation step in v is z^2 / (2 A) metres.
    bound = 1000 * metres**2 / (2 * a) * 1.01
    assert (np.abs(depth - 1000 * metres)[1:] <= bound[1:]).all()


def test_zero_stamp_falls_back_to_the_log_time(tmp_path: Path, make: SimpleNamespace) -> None:
    image = make.raw_fields(make.depth_codes(1)[0], "16UC1")
    frames = [("/cam/image", "Image", 0, 77_000, image)]
    path = make.write_foxglove(tmp_path / "r.mcap", with_camera(make, "foxglove", frames))
    assert [frame.stamp_ns for frame in open_recording(path).frames()] == [77_000]


def test_messages_are_read_in_order_of_log_time(tmp_path: Path, make: SimpleNamespace) -> None:
    images, times = make.depth_codes(6), make.stamps(6)
    frames = [
        ("/cam/image", "Image", times[i], times[i], make.raw_fields(images[i], "16UC1"))
        for i in (0, 2, 1, 4, 3, 5)
    ]
    path = make.write_foxglove(tmp_path / "r.mcap", with_camera(make, "foxglove", frames), flush_every=3)
    recording = open_recording(path)
    assert [frame.stamp_ns for frame in recording.frames()] == times
    assert recording.losses == ()


def test_stamps_that_go_back_or_repeat_are_dropped(tmp_path: Path, make: SimpleNamespace) -> None:
    images, times = make.depth_codes(5), make.stamps(5)
    own = [times[0], times[1], times[1], times[0], times[4]]
    frames = [
        ("/cam/image", "Image", own[i], times[i], make.raw_fields(images[i], "16UC1")) for i in range(5)
    ]
    recording = open_recording(
        make.write_foxglove(tmp_path / "r.mcap", with_camera(make, "foxglove", frames))
    )
    assert [frame.index for frame in recording.frames()] == [0, 1, 4]
    (loss,) = recording.losses
    assert loss.count == 2
    assert loss.first.startswith(f"frame 2 at {times[1]} ns")


def test_colour_and_8_bit_topics_are_no_candidates(tmp_path: Path, make: SimpleNamespace) -> None:
    grey = np.zeros((make.HEIGHT, make.WIDTH), np.uint8)
    frames = [
        ("/a/grey", "Image", 1, 1, make.raw_fields(grey, "mono8")),
        ("/b/png", "CompressedImage", 1, 1, {"format": "png", "data": make.png(grey)}),
        ("/c/jpeg", "CompressedImage", 1, 1, {"format": "jpeg", "data": b"\xff\xd8\xff"}),
    ]
    depth = ("/d/depth", "Image", 1, 1, make.raw_fields(make.depth_codes(1)[0], "16UC1"))
    found = open_recording(
        make.write_foxglove(tmp_path / "a.mcap", with_camera(make, "foxglove", [*frames, depth]))
    )
    assert found.identity()["topic"] == "/d/depth"
    text = message_of(make.write_foxglove(tmp_path / "b.mcap", with_camera(make, "foxglove", frames)))
    assert "no depth topic" in text
    assert "/a/grey (foxglove.RawImage, mono8)" in text
    assert "/b/png (foxglove.CompressedImage, png 8-bit grey)" in text
    assert "/c/jpeg (foxglove.CompressedImage, jpeg)" in text
    chosen = message_of(tmp_path / "a.mcap", topic="/a/grey")
    assert "topic has no depth images" in chosen
    assert "/d/depth" in chosen


def two_topics(make: SimpleNamespace, path: Path) -> Path:
    images = make.depth_codes(2)
    frames = [
        ("/left/depth", "Image", 5, 5, make.raw_fields(images[0], "16UC1")),
        ("/right/depth", "Image", 5, 5, make.raw_fields(images[1], "16UC1")),
    ]
    return make.write_foxglove(path / "two.mcap", with_camera(make, "foxglove", frames))


def test_two_candidates_are_listed_and_either_can_be_chosen(tmp_path: Path, make: SimpleNamespace) -> None:
    path = two_topics(make, tmp_path)
    with pytest.raises(UsageError) as caught:  # as several cameras of a head are
        open_recording(path)
    text = str(caught.value)
    assert "/left/depth (foxglove.RawImage, 16UC1), /right/depth (foxglove.RawImage, 16UC1)" in text
    assert "--topic" in text
    np.testing.assert_array_equal(depths(path, topic="/right/depth")[0], make.depth_codes(2)[1])


def test_wrong_topic_lists_candidates_and_the_nearest(tmp_path: Path, make: SimpleNamespace) -> None:
    text = message_of(two_topics(make, tmp_path), topic="/right/dept")
    assert "no such topic" in text
    assert "/left/depth (foxglove.RawImage, 16UC1)" in text
    assert "did you mean '/right/depth'?" in text


@pytest.mark.parametrize(
    ("calibrations", "chosen"),
    [
        ({"/x/info": "cam", "/cam/info": "other"}, "/x/info"),
        ({"/cam/info": "a", "/rgb/info": "b"}, "/cam/info"),
        ({"/cam/info": "cam", "/rgb/info": "cam"}, "/cam/info"),
        ({"/cam/info": ""}, "/cam/info"),
        ({"/rgb/info": ""}, "/rgb/info"),
        ({"/rgb/info": "/cam"}, "/rgb/info"),
    ],
)
def test_calibration_by_frame_then_namespace_then_alone(
    tmp_path: Path, make: SimpleNamespace, calibrations: dict[str, str], chosen: str
) -> None:
    infos = [
        (topic, "CameraInfo", 5, 5, {**make.calibration_fields(), "frame_id": frame})
        for topic, frame in calibrations.items()
    ]
    frames = [("/cam/image", "Image", 5, 5, make.raw_fields(make.depth_codes(1)[0], "16UC1"))]
    path = make.write_foxglove(tmp_path / "r.mcap", infos + frames)
    assert open_recording(path).identity()["camera_topic"] == chosen


def test_calibrations_that_fit_equally_are_listed(tmp_path: Path, make: SimpleNamespace) -> None:
    infos = [
        (topic, "CameraInfo", 5, 5, {**make.calibration_fields(), "frame_id": "far"})
        for topic in ("/a/info", "/b/info")
    ]
    frames = [("/cam/image", "Image", 5, 5, make.raw_fields(make.depth_codes(1)[0], "16UC1"))]
    path = make.write_foxglove(tmp_path / "r.mcap", infos + frames)
    assert "/a/info (frame 'far'), /b/info (frame 'far'); choose one with --camera-topic" in message_of(path)
    assert open_recording(path, camera_topic="/b/info").identity()["camera_topic"] == "/b/info"
    assert "did you mean '/b/info'?" in message_of(path, camera_topic="/b/inf")


def test_no_calibration_needs_a_camera_file(tmp_path: Path, make: SimpleNamespace) -> None:
    frames = [("/cam/image", "Image", 5, 5, make.raw_fields(make.depth_codes(1)[0], "16UC1"))]
    path = make.write_foxglove(tmp_path / "r.mcap", frames)
    assert "no intrinsics" in message_of(path)
    assert "--camera" in message_of(path)
    camera = tmp_path / "camera.toml"
    camera.write_text(make.CAMERA_TOML + "crop = [1, 2, 10, 8]\nmirror = true\n")
    recording = open_recording(path, camera_file=camera)
    depth = next(iter(recording.frames())).depth
    np.testing.assert_array_equal(depth, make.depth_codes(1)[0][2:10, 1:11][:, ::-1])
    assert recording.cameras[0].cx == 10 - 1 - (11.0 - 1)
    with pytest.raises(UsageError, match="--camera-topic does not apply"):
        open_recording(path, camera_file=camera, camera_topic="/x")
    codes = make.depth_codes(1)[0]
    missing = int(codes[0, 0])
    camera.write_text(make.CAMERA_TOML + f"depth_unit_mm = 2.0\nmissing = {missing}\n")
    depth = next(iter(open_recording(path, camera_file=camera).frames())).depth
    np.testing.assert_array_equal(depth, np.where(codes == missing, 0, 2.0 * codes))


def test_calibration_of_another_size_or_none_at_all(tmp_path: Path, make: SimpleNamespace) -> None:
    frames = [("/cam/image", "Image", 5, 5, make.raw_fields(make.depth_codes(1)[0], "16UC1"))]
    wide = make.write_foxglove(tmp_path / "a.mcap", with_camera(make, "foxglove", frames, width=640))
    assert "found 640x16, expected 24x16 as on /cam/image" in message_of(wide)
    zero = make.write_foxglove(tmp_path / "b.mcap", with_camera(make, "foxglove", frames, K=[0.0] * 9))
    assert "not calibrated" in message_of(zero)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_distortion_is_read(tmp_path: Path, make: SimpleNamespace, flavour: str) -> None:
    key = "d" if flavour == "ros2" else "D"
    frames = [("/cam/image", "Image", 5, 5, make.raw_fields(make.depth_codes(1)[0], "16UC1"))]
    fields = {key: [0.1, -0.2, 0.001, 0.002, 0.05]}
    path = make.WRITERS[flavour](tmp_path / "r.mcap", with_camera(make, flavour, frames, **fields))
    assert open_recording(path).cameras[0].distortion == (0.1, -0.2, 0.001, 0.002, 0.05)


def test_unknown_distortion_model_is_refused(tmp_path: Path, make: SimpleNamespace) -> None:
    frames = [("/cam/image", "Image", 5, 5, make.raw_fields(make.depth_codes(1)[0], "16UC1"))]
    odd = {"distortion_model": "fisheye62", "D": [0.1] * 6}
    path = make.write_foxglove(tmp_path / "r.mcap", with_camera(make, "foxglove", frames, **odd))
    with pytest.raises(PosetrackError, match="unsupported distortion"):
        open_recording(path)


def test_mirror_flips_pixels_and_camera_together(foxglove_file: Path) -> None:
    plain, mirrored = open_recording(foxglove_file), open_recording(foxglove_file, mirror=True)
    for a, b in zip(plain.frames(), mirrored.frames(), strict=True):
        np.testing.assert_array_equal(a.depth[:, ::-1], b.depth)
    point = np.array([40.0, 10.0, 500.0])
    u = plain.cameras[0].pixels_from_points(point)[0][0]
    flipped = mirrored.cameras[0].pixels_from_points(point * [-1, 1, 1])[0][0]
    assert flipped == pytest.approx(plain.cameras[0].width - 1 - u)


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("data", b"\0" * 10, "10 bytes are too few for 24x16 16UC1"),
        ("step", 7, "are too few for"),
    ],
)
def test_image_too_short_is_skipped(
    tmp_path: Path, make: SimpleNamespace, field: str, value: Any, says: str
) -> None:
    contents = [make.raw_fields(image, "16UC1") for image in make.depth_codes(3)]
    contents[1][field] = value
    recording = open_recording(write(make, tmp_path, "foxglove", "Image", contents))
    assert [frame.index for frame in recording.frames()] == [0, 2]
    (loss,) = recording.losses
    assert says in loss.what
    assert loss.first.startswith("frame 1, /cam/image at ")


@pytest.mark.parametrize("place", [0, 1, 3])
def test_an_image_of_another_size_is_left_out_and_counted(
    tmp_path: Path, make: SimpleNamespace, place: int
) -> None:
    """Also if it is the first, which does not decide for the others."""
    contents = [make.raw_fields(image, "16UC1") for image in make.depth_codes(4)]
    contents.insert(place, make.raw_fields(np.ones((8, 8), np.uint16), "16UC1"))
    recording = open_recording(write(make, tmp_path, "foxglove", "Image", contents))
    assert [frame.index for frame in recording.frames()] == [k for k in range(5) if k != place]
    (loss,) = recording.losses
    assert loss.what == "image skipped, format is 8x8 16UC1, not 24x16 16UC1 like the first"


def test_messages_that_do_not_decode_are_skipped(tmp_path: Path, make: SimpleNamespace) -> None:
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    path = tmp_path / "r.mcap"
    with McapSink(path) as sink:
        info, image = sink.channel("/cam/info", CameraCalibration), sink.channel("/cam/image", RawImage)
        sink.write(info, 1, CameraCalibration(**make.calibration_fields()).SerializeToString())
        good = RawImage(**make.raw_fields(make.depth_codes(1)[0], "16UC1")).SerializeToString()
        for stamp, data in ((10, b"\xff\xff"), (20, good), (30, b"\xff\xff"), (40, good)):
            sink.write(image, stamp, data)
        sink.finish()
    recording = open_recording(path)
    assert [frame.index for frame in recording.frames()] == [1, 3]
    (loss,) = recording.losses
    assert (loss.count, loss.first) == (2, "frame 0 at 10 ns")


def test_truth_is_passed_on_undecoded(tmp_path: Path, make: SimpleNamespace) -> None:
    path = tmp_path / "r.mcap"
    with McapSink(path) as sink:
        from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
        from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

        info, image = sink.channel("/cam/info", CameraCalibration), sink.channel("/cam/image", RawImage)
        truth = sink.raw_channel(
            "/truth/hand", SchemaText("hand", "jsonschema", b"{}"), "json", {"units": "mm"}
        )
        sink.write(info, 1, CameraCalibration(**make.calibration_fields()).SerializeToString())
        sink.write(image, 1, RawImage(**make.raw_fields(make.depth_codes(1)[0], "16UC1")).SerializeToString())
        sink.write(truth, 7, b'{"a":1}')
        sink.finish()
    (message,) = open_recording(path).truth()
    assert (message.topic, message.schema_name, message.schema_encoding) == (
        "/truth/hand",
        "hand",
        "jsonschema",
    )
    assert (message.schema_data, message.message_encoding, message.log_time_ns) == (b"{}", "json", 7)
    assert (message.data, dict(message.channel_metadata)) == (b'{"a":1}', {"units": "mm"})
    assert list(open_recording(path, mirror=True).truth()) == [], "truth is not about the mirrored scene"


def test_identity_names_topics_and_no_path(foxglove_file: Path, tmp_path: Path) -> None:
    import hashlib

    identity = open_recording(foxglove_file).identity()
    assert identity["sha256"] == hashlib.sha256(foxglove_file.read_bytes()).hexdigest()
    assert (identity["topic"], identity["camera_topic"]) == ("/cam/image", "/cam/calibration")
    assert (identity["kind"], identity["frames"], identity["name"]) == ("mcap", "12", "foxglove.mcap")
    assert str(tmp_path) not in str(identity)


def message_of(path: Path, **options: Any) -> str:
    """The line that opening a recording fails with."""
    with pytest.raises(RecordingError) as caught:
        open_recording(path, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)
