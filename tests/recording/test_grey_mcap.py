"""Grey images of several cameras from MCAP: topics, encodings, where the cameras are, what goes wrong."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.recording.message_cameras import extrinsics_of_transforms
from posetrack_cli.recording.message_topics import scan_topics
from posetrack_cli.recording.opening import open_recording
from support import images as support

LEFT, RIGHT = support.grey_images(5), support.grey_images(5, seed=1)
BASELINE_M, FX = 0.12, 40.0
COUNT = 5
FLAVOURS = ("foxglove", "ros1", "ros2")


def calibration(flavour: str, tx_m: float = 0.0, **changes: Any) -> dict[str, Any]:
    """CameraInfo of the plain rectified pair: P's last column is -fx times the baseline."""
    k = [FX, 0.0, 15.0, 0.0, 41.0, 12.0, 0.0, 0.0, 1.0]
    p = [FX, 0.0, 15.0, -FX * tx_m, 0.0, 41.0, 12.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    values = {"K": k, "D": [0.0] * 5, "R": np.eye(3).ravel().tolist(), "P": p} | changes
    names = {name: name.lower() for name in values} if flavour == "ros2" else {name: name for name in values}
    size = {"width": support.WIDTH, "height": support.HEIGHT, "distortion_model": "plumb_bob"}
    return size | {names[name]: value for name, value in values.items()}


def messages(
    make: SimpleNamespace,
    flavour: str,
    images: dict[str, list[np.ndarray | None]],
    *,
    offsets_ms: tuple[float, ...] = (0.0, 0.0, 0.0),
    places_m: tuple[float, ...] = (0.0, BASELINE_M, 2 * BASELINE_M),
    encode: str = "raw",
) -> list[Any]:
    """Calibrations first, then images by time, on /stereo/NAME/..."""
    found = []
    for (name, frames), offset, place in zip(images.items(), offsets_ms, places_m, strict=False):
        info = calibration(flavour, place) | {"frame_id": name}
        found.append((f"/stereo/{name}/camera_info", "CameraInfo", support.START_NS, support.START_NS, info))
        for stamp, image in zip(support.stamps(len(frames), round(offset * 1e6)), frames, strict=True):
            if image is not None:
                found.append((f"/stereo/{name}/image_raw", *image_message(make, image, stamp, name, encode)))
    return sorted(found, key=lambda message: message[3])


def image_message(make: SimpleNamespace, image: np.ndarray, stamp: int, frame: str, encode: str) -> Any:
    if encode == "raw":
        return "Image", stamp, stamp, make.raw_fields(image, "mono8", padding=3) | {"frame_id": frame}
    data = cv2.imencode(f".{encode}", image)[1].tobytes()
    return "CompressedImage", stamp, stamp, {"format": encode, "data": data, "frame_id": frame}


def write(
    make: SimpleNamespace, path: Path, found: list[Any], flavour: str = "foxglove", **options: Any
) -> Path:
    return make.WRITERS[flavour](path, found, **options)  # type: ignore[no-any-return]


@pytest.fixture
def stereo(tmp_path: Path, make: SimpleNamespace) -> Path:
    found = messages(make, "foxglove", {"left": LEFT, "right": RIGHT})
    return write(make, tmp_path / "stereo.mcap", found)


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("encode", ["raw", "png", "jpeg"])
def test_images_of_both_cameras_from_every_kind_of_file(
    tmp_path: Path, make: SimpleNamespace, flavour: str, encode: str
) -> None:
    found = messages(make, flavour, {"left": LEFT, "right": RIGHT}, offsets_ms=(0, 2), encode=encode)
    recording = open_recording(write(make, tmp_path / "r.mcap", found, flavour), "grey")
    frames = list(recording.frames())
    assert [frame.stamp_ns for frame in frames] == support.stamps(COUNT)
    for frame, left, right in zip(frames, LEFT, RIGHT, strict=True):
        for image, expected in zip(frame.images, (left, right), strict=True):
            if encode == "jpeg":  # what the codec makes of noise, decoded by the same library
                expected = cv2.imdecode(cv2.imencode(".jpeg", expected)[1], cv2.IMREAD_GRAYSCALE)
            np.testing.assert_array_equal(image, expected)
    assert [camera.name for camera in recording.cameras] == ["left", "right"]
    np.testing.assert_allclose(
        recording.cameras[1].camera_T_reference, [[1, 0, 0, -120], [0, 1, 0, 0], [0, 0, 1, 0]]
    )
    assert (recording.losses, recording.frame_count) == ((), COUNT)


def test_a_camera_that_drops_out_or_ends_early(tmp_path: Path, make: SimpleNamespace) -> None:
    right = [RIGHT[0], None, RIGHT[2], None, None]
    found = messages(make, "foxglove", {"left": LEFT, "right": right})
    recording = open_recording(write(make, tmp_path / "r.mcap", found), "grey")
    frames = list(recording.frames())
    assert [frame.images[1] is None for frame in frames] == [False, True, False, True, True]
    np.testing.assert_array_equal(frames[2].images[1], RIGHT[2])
    assert [(loss.what, loss.count) for loss in recording.losses] == [("no image of camera 'right'", 3)]
    assert recording.frame_count is None


def test_stamps_beyond_the_tolerance_are_told(tmp_path: Path, make: SimpleNamespace) -> None:
    found = messages(make, "foxglove", {"left": LEFT, "right": RIGHT}, offsets_ms=(0, 15))
    path = write(make, tmp_path / "r.mcap", found)
    with pytest.raises(
        RecordingError, match=r"r.mcap: no matching stamps for cameras left, right, found at least 15 ms"
    ):
        list(open_recording(path, "grey").frames())
    assert [
        len(f.images)
        for f in open_recording(path, "grey", tolerance_ms=16).frames()
        if f.images[1] is not None
    ] == [2] * 5


def test_cameras_asked_for_by_name_or_topic_the_first_is_the_reference(
    tmp_path: Path, make: SimpleNamespace
) -> None:
    images = {name: support.grey_images(3, seed) for seed, name in enumerate(["left", "middle", "right"])}
    path = write(make, tmp_path / "r.mcap", messages(make, "foxglove", images))
    recording = open_recording(path, "grey", cameras=["right", "/stereo/left/image_raw"])
    assert [camera.name for camera in recording.cameras] == ["right", "left"]
    assert recording.cameras[1].camera_T_reference[0][3] == pytest.approx(240.0)
    np.testing.assert_array_equal(next(iter(recording.frames())).images[1], images["left"][0])
    assert [camera.name for camera in open_recording(path, "grey").cameras] == ["left", "right", "middle"]
    (alone,) = open_recording(path, "grey", cameras=["middle"]).cameras
    np.testing.assert_array_equal(alone.camera_T_reference, np.eye(3, 4))
    with pytest.raises(RecordingError, match="no topic for camera 'top', found /stereo/left"):
        open_recording(path, "grey", cameras=["top"])


@pytest.mark.parametrize(
    ("encoding", "channels", "weights"),
    [
        ("bgr8", 3, [0.114, 0.587, 0.299]),
        ("rgb8", 3, [0.299, 0.587, 0.114]),
        ("bgra8", 4, [0.114, 0.587, 0.299, 0.0]),
        ("rgba8", 4, [0.299, 0.587, 0.114, 0.0]),
        ("uyvy", 2, [0.0, 1.0]),
        ("yuyv", 2, [1.0, 0.0]),
    ],
)
def test_colour_becomes_grey(
    tmp_path: Path, make: SimpleNamespace, encoding: str, channels: int, weights: list[float]
) -> None:
    colour = np.random.default_rng(1).integers(
        0, 256, (support.HEIGHT, support.WIDTH, channels), dtype=np.uint8
    )
    found = messages(make, "ros2", {"left": LEFT[:1], "right": RIGHT[:1]})
    fields = make.raw_fields(colour.reshape(support.HEIGHT, -1), encoding) | {"width": support.WIDTH}
    found[-1] = (*found[-1][:4], fields | {"frame_id": "right"})
    (frame,) = open_recording(write(make, tmp_path / "r.mcap", found, "ros2"), "grey").frames()
    np.testing.assert_allclose(frame.images[1], colour @ np.array(weights), atol=1.0)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns(tmp_path: Path, make: SimpleNamespace, pattern: str) -> None:
    values = {"r": 200, "g": 120, "b": 40}
    tile = np.array([values[c] for c in pattern], np.uint8).reshape(2, 2)
    mosaic = np.tile(tile, (support.HEIGHT // 2, support.WIDTH // 2))
    found = messages(make, "ros2", {"left": LEFT[:1], "right": RIGHT[:1]})
    found[-1] = (*found[-1][:4], make.raw_fields(mosaic, f"bayer_{pattern}8") | {"frame_id": "right"})
    (frame,) = open_recording(write(make, tmp_path / "r.mcap", found, "ros2"), "grey").frames()
    luma = 0.299 * 200 + 0.587 * 120 + 0.114 * 40
    np.testing.assert_allclose(frame.images[1][2:-2, 2:-2], luma, atol=1.5)


@pytest.mark.parametrize("big", [False, True])
def test_sixteen_bits_are_used_where_there_is_nothing_else(
    tmp_path: Path, make: SimpleNamespace, big: bool
) -> None:
    codes = [
        np.random.default_rng(i).integers(0, 4096, (support.HEIGHT, support.WIDTH)).astype(np.uint16)
        for i in (1, 2)
    ]
    found = messages(make, "ros2", {"left": LEFT[:1], "right": RIGHT[:1]})
    for image, name in zip(codes, ("left", "right"), strict=True):
        index = next(i for i, m in enumerate(found) if m[0] == f"/stereo/{name}/image_raw")
        fields = make.raw_fields(image, "mono16", big=big) | {"frame_id": name}
        found[index] = (*found[index][:4], fields)
    recording = open_recording(write(make, tmp_path / "r.mcap", found, "ros2"), "grey")
    (frame,) = recording.frames()
    for image, expected in zip(frame.images, codes, strict=True):
        np.testing.assert_array_equal(image, expected >> 4)
    assert recording.identity()["stored"] == "12-bit grey"


def test_depth_beside_colour_is_left_alone(tmp_path: Path, make: SimpleNamespace) -> None:
    found = messages(make, "foxglove", {"left": LEFT, "right": RIGHT})
    depth = make.raw_fields(np.full((9, 9), 700, np.uint16), "16UC1") | {"frame_id": "depth"}
    found.append(("/depth/image", "Image", support.START_NS, support.START_NS, depth))
    path = write(make, tmp_path / "r.mcap", found)
    assert [camera.name for camera in open_recording(path, "grey").cameras] == ["left", "right"]


def test_of_a_topic_raw_and_compressed_the_raw_one_counts(tmp_path: Path, make: SimpleNamespace) -> None:
    found = messages(make, "foxglove", {"left": LEFT, "right": RIGHT})
    twin = image_message(make, LEFT[0], support.START_NS, "left", "jpeg")
    found.append(("/stereo/left/image_raw/compressed", *twin))
    recording = open_recording(write(make, tmp_path / "r.mcap", found), "grey")
    assert recording.identity()["topics"] == "/stereo/left/image_raw,/stereo/right/image_raw"


def test_rectified_images_take_intrinsics_from_p(tmp_path: Path, make: SimpleNamespace) -> None:
    found = []
    for topic, kind, stamp, log, fields in messages(make, "ros2", {"left": LEFT, "right": RIGHT}):
        if kind == "CameraInfo":
            fields = fields | {"k": [99.0, 0, 1, 0, 99, 1, 0, 0, 1], "d": [0.3, 0, 0, 0, 0]}
            fields["r"] = support.TURN.ravel().tolist()
        found.append((topic.replace("image_raw", "image_rect"), kind, stamp, log, fields))
    for camera in open_recording(write(make, tmp_path / "r.mcap", found, "ros2"), "grey").cameras:
        assert (camera.fx, camera.cx, camera.distortion) == (FX, 15.0, ())
        np.testing.assert_allclose(np.array(camera.camera_T_reference)[:, :3], np.eye(3), atol=1e-12)


def test_r_and_p_of_a_stereo_calibration_place_the_cameras_as_opencv_does(
    tmp_path: Path, make: SimpleNamespace
) -> None:
    first, second = support.rig()
    place = np.array(second.camera_T_reference)
    size, k, d = (support.WIDTH, support.HEIGHT), first.matrix, np.array(first.distortion)
    r1, r2, p1, p2, *_ = cv2.stereoRectify(k, d, k, d, size, place[:, :3], place[:, 3] / 1000.0, flags=0)
    found = []
    for message in messages(make, "ros2", {"left": LEFT, "right": RIGHT}):
        if message[1] == "CameraInfo":
            r, p = (r1, p1) if "left" in message[0] else (r2, p2)
            own = {"k": k.ravel().tolist(), "d": d.tolist(), "r": r.ravel().tolist(), "p": p.ravel().tolist()}
            message = (*message[:4], message[4] | own)
        found.append(message)
    cameras = open_recording(write(make, tmp_path / "r.mcap", found, "ros2"), "grey").cameras
    np.testing.assert_allclose(cameras[1].camera_T_reference, place, atol=1e-9)
    assert cameras[0].distortion == first.distortion


@pytest.mark.parametrize("parents", ["of the first", "of the world"])
def test_transforms_place_cameras_whose_calibrations_do_not(
    tmp_path: Path, make: SimpleNamespace, parents: str
) -> None:
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    from posetrack_cli.mcap.sink import McapSink
    from posetrack_cli.recording.message_cameras import camera_transforms

    cameras = support.rig(["left", "right", "third"])
    transforms = camera_transforms(cameras, "left", support.START_NS)
    if parents == "of the world":  # world -> base -> left, the others below base
        for child in transforms.transforms:
            child.parent_frame_id = "base"
        transforms.transforms.add(parent_frame_id="base", child_frame_id="left").rotation.w = 1.0
        transforms.transforms.add(parent_frame_id="/world", child_frame_id="base").rotation.w = 1.0
    images = {camera.name: LEFT for camera in cameras}
    found = messages(make, "foxglove", images, places_m=(0, 0, 0))
    write(make, tmp_path / "without.mcap", found)
    with pytest.raises(RecordingError, match=r"no extrinsics for cameras left, right, third.*pass --camera"):
        open_recording(tmp_path / "without.mcap", "grey")
    copied = tmp_path / "with.mcap"
    with McapSink(copied) as sink:
        topic = sink.channel("/tf", FrameTransforms)
        sink.write(topic, support.START_NS, transforms.SerializeToString())
        copy_messages(tmp_path / "without.mcap", sink)
        sink.finish()
    for expected, camera in zip(
        cameras, open_recording(copied, "grey", cameras=["left", "right", "third"]).cameras, strict=True
    ):
        np.testing.assert_allclose(camera.camera_T_reference, expected.camera_T_reference, atol=1e-9)


def copy_messages(path: Path, sink: Any) -> None:
    from posetrack_cli.mcap.sink import SchemaText
    from posetrack_cli.mcap.stream import McapFile

    channels: dict[str, int] = {}
    for schema, channel, message in McapFile(path).messages():
        if channel.topic not in channels:
            channels[channel.topic] = sink.raw_channel(
                channel.topic, SchemaText(schema.name, schema.encoding, schema.data), channel.message_encoding
            )
        sink.write(channels[channel.topic], message.log_time, message.data)


GEOMETRY = {
    "TransformStamped": "std_msgs/Header header\nstring child_frame_id\nTransform transform\n",
    "Transform": "Vector3 translation\nQuaternion rotation\n",
    "Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
}


def tf_definition(make: SimpleNamespace, header: str) -> str:
    nested = "".join(f"{make.RULE}MSG: geometry_msgs/{name}\n{text}" for name, text in GEOMETRY.items())
    return "geometry_msgs/TransformStamped[] transforms\n" + nested + header


def test_ros_2_static_transforms(tmp_path: Path, make: SimpleNamespace) -> None:
    from mcap_ros2.writer import Writer

    half = np.sqrt(0.5)
    with (tmp_path / "r.mcap").open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef("tf2_msgs/msg/TFMessage", tf_definition(make, make.HEADER_TEXT_2))
        turn = {"x": 0.0, "y": half, "z": 0.0, "w": half}  # a quarter turn about y
        for x in (0.1, 0.9):  # the first counts
            transform = {
                "header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": "left"},
                "child_frame_id": "right",
                "transform": {"translation": {"x": x, "y": 0.0, "z": 0.02}, "rotation": turn},
            }
            writer.write_message("/tf_static", schema, {"transforms": [transform]}, 1, 1)
        writer.finish()
    left, right, other = extrinsics_of_transforms(scan_topics(tmp_path / "r.mcap"), ["left", "right", "x"])
    np.testing.assert_array_equal(left, np.eye(3, 4))
    assert other is None
    # the right camera's own origin is at (100, 0, 20) mm for the left; its x axis points along -z there
    np.testing.assert_allclose(right[:, :3] @ [100, 0, 20] + right[:, 3], 0.0, atol=1e-9)
    np.testing.assert_allclose(right[:, :3] @ [0, 0, -1], [1, 0, 0], atol=1e-12)


def test_ros_1_transforms(tmp_path: Path, make: SimpleNamespace) -> None:
    data = make.ros1_bytes("IIIIss", (1, 0, 0, 0, "/left", "right"))  # one transform: its header, its child
    data += make.ros1_bytes("ddddddd", (0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    schema = "tf2_msgs/TFMessage", tf_definition(make, make.HEADER_TEXT_1)
    path = make.write_ros1_messages(tmp_path / "r.mcap", [schema], [("/tf", 0, 1, data)])
    _, right = extrinsics_of_transforms(scan_topics(path), ["left", "right"])
    np.testing.assert_allclose(right[:, 3], [-100, 0, 0])


def test_a_camera_file_replaces_the_calibration(tmp_path: Path, stereo: Path) -> None:
    cameras = support.rig()
    file = tmp_path / "camera.toml"
    file.write_text(camera_file_text(cameras))
    recording = open_recording(stereo, "grey", camera_file=file)
    for camera, expected in zip(recording.cameras, cameras, strict=True):
        assert camera.values() == expected.values()
    assert recording.identity()["calibration"] == "camera file"
    file.write_text(camera_file_text([Camera(**{**c.__dict__, "name": c.name[:1]}) for c in cameras]))
    with pytest.raises(RecordingError, match=r"no topic for camera 'l' in camera.toml, found /stereo/left"):
        open_recording(stereo, "grey", camera_file=file)


def test_mirror_and_one_camera(stereo: Path) -> None:
    recording = open_recording(stereo, "grey", cameras=["right"], mirror=True)
    np.testing.assert_array_equal(next(iter(recording.frames())).images[0], RIGHT[0][:, ::-1])
    assert recording.cameras[0].cx == support.WIDTH - 1 - 15.0


def test_truth_is_passed_on(tmp_path: Path, make: SimpleNamespace) -> None:
    found = messages(make, "foxglove", {"left": LEFT, "right": RIGHT})
    truth = image_message(make, LEFT[0], support.START_NS, "left", "raw")
    path = write(make, tmp_path / "r.mcap", [*found, ("/truth/image", *truth)])
    assert [message.topic for message in open_recording(path, "grey").truth()] == ["/truth/image"]
    assert list(open_recording(path, "grey", mirror=True).truth()) == []
    assert len(open_recording(path, "grey").cameras) == 2, "images of the truth are no camera"


def spoilt(make: SimpleNamespace, path: Path, what: str) -> Path:
    found = messages(make, "foxglove", {"left": LEFT, "right": RIGHT})
    if what == "uncalibrated":
        found = [
            m if "right" not in m[0] or m[1] != "CameraInfo" else (*m[:4], m[4] | {"K": [0.0] * 9})
            for m in found
        ]
    if what == "no calibration":
        found = [m for m in found if m[1] != "CameraInfo"]
    if what == "one calibration":
        found = [m for m in found if m[0] != "/stereo/right/camera_info"]
    if what == "size":
        found = [m if m[1] != "CameraInfo" else (*m[:4], m[4] | {"width": 30}) for m in found]
    if what == "no images":
        found = [m for m in found if m[1] == "CameraInfo"]
    return write(make, path, found)


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("uncalibrated", "camera is not calibrated, found K = 0"),
        ("no calibration", "no camera calibration for /stereo/left/image_raw: no intrinsics"),
        (
            "one calibration",
            "calibration belongs to another camera, found /stereo/left/camera_info with frame 'left'",
        ),
        ("size", "calibration and images differ in size, found 30x24, expected 32x24"),
        ("no images", "no grey or colour image topics, found no image topics"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(
    tmp_path: Path, make: SimpleNamespace, what: str, message: str
) -> None:
    with pytest.raises(RecordingError) as caught:
        open_recording(spoilt(make, tmp_path / "r.mcap", what), "grey")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_that_do_not_apply(stereo: Path) -> None:
    with pytest.raises(UsageError, match="--fps does not apply to an MCAP file"):
        open_recording(stereo, "grey", fps=30)


def test_a_cut_file_is_read_as_far_as_it_goes(tmp_path: Path, stereo: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(stereo.read_bytes()[: stereo.stat().st_size // 2])
    recording = open_recording(path, "grey")
    frames = list(recording.frames())
    assert 0 < len(frames) < COUNT
    truncated = [loss for loss in recording.losses if "truncated" in loss.what]
    assert [loss.count for loss in truncated] == [1], "once, though every camera's pass meets it"


def test_images_that_are_damaged_are_counted(tmp_path: Path, make: SimpleNamespace) -> None:
    found = messages(make, "foxglove", {"left": LEFT, "right": RIGHT})
    index = next(
        i for i, m in enumerate(found) if m[0].endswith("right/image_raw") and m[2] > support.START_NS
    )
    found[index] = (*found[index][:4], found[index][4] | {"data": b"too short"})
    recording = open_recording(write(make, tmp_path / "r.mcap", found), "grey")
    assert [frame.images[1] is None for frame in recording.frames()] == [False, True, False, False, False]
    (loss,) = recording.losses
    assert loss.what == "image skipped, 9 bytes are too few for 32x24 mono8"


def test_an_image_of_another_size_is_left_out_and_counted(tmp_path: Path, make: SimpleNamespace) -> None:
    found = messages(make, "foxglove", {"left": LEFT, "right": RIGHT})
    small = make.raw_fields(LEFT[0][:10], "mono8") | {"frame_id": "right"}
    index = max(i for i, m in enumerate(found) if m[0].endswith("right/image_raw"))
    found[index] = (*found[index][:4], small)
    recording = open_recording(write(make, tmp_path / "r.mcap", found), "grey")
    assert [frame.images[1] is None for frame in recording.frames()] == [False] * (COUNT - 1) + [True]
    (loss,) = recording.losses
    assert loss.what == "image skipped, size is 32x10, not 32x24 like the first"


def test_bits_are_those_of_several_images(tmp_path: Path, make: SimpleNamespace) -> None:
    found = []
    for number, (topic, kind, stamp, log, fields) in enumerate(messages(make, "foxglove", {"left": LEFT})):
        if kind == "Image":
            values = LEFT[len(found) - 1].astype(np.uint16) * 257
            dark = values >> 7 if len(found) == 1 else values
            fields = make.raw_fields(dark, "mono16") | {"frame_id": "left"}
        if kind == "Image" or not number:
            found.append((topic, kind, stamp, log, fields))
    recording = open_recording(write(make, tmp_path / "r.mcap", found), "grey")
    assert recording.identity()["stored"] == "16-bit grey"


def test_identity_tells_topics_and_how_it_was_read(stereo: Path) -> None:
    identity = open_recording(stereo, "grey", tolerance_ms=7.5).identity()
    assert (identity["kind"], identity["cameras"], identity["tolerance_ms"]) == ("mcap", "left,right", "7.5")
    assert identity["stored"] == "8-bit grey"
