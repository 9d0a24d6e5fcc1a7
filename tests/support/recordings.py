"""Builders of small recordings: folders of images, Foxglove, ROS 1 and ROS 2 MCAP files."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from posetrack_cli.mcap.sink import McapSink

WIDTH, HEIGHT = 24, 16
CAMERA_TOML = "fx = 30.0\nfy = 31.0\ncx = 11.0\ncy = 7.5\n"
PERIOD_NS = 33_333_333
START_NS = 1_700_000_000_000_000_000

HEADER_1 = "std_msgs/Header header\n"
IMAGE = "uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n"
COMPRESSED = "string format\nuint8[] data\n"
INFO_1 = (
    "uint32 height\nuint32 width\nstring distortion_model\nfloat64[] D\nfloat64[9] K\n"
    "float64[9] R\nfloat64[12] P\n"
)
INFO_2 = (
    "uint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
    "float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi\n"
)
RULE = "=" * 80 + "\n"
HEADER_TEXT_1 = RULE + "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
HEADER_TEXT_2 = (
    RULE
    + "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    + RULE
    + "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
ROI_TEXT = (
    RULE
    + "MSG: sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\n"
    + "bool do_rectify\n"
)
DEFINITIONS_1 = {
    "Image": HEADER_1 + IMAGE + HEADER_TEXT_1,
    "CompressedImage": HEADER_1 + COMPRESSED + HEADER_TEXT_1,
    "CameraInfo": HEADER_1 + INFO_1 + HEADER_TEXT_1,
}
DEFINITIONS_2 = {
    "Image": HEADER_1 + IMAGE + HEADER_TEXT_2,
    "CompressedImage": HEADER_1 + COMPRESSED + HEADER_TEXT_2,
    "CameraInfo": HEADER_1 + INFO_2 + HEADER_TEXT_2 + ROI_TEXT,
}
PART_OF_SENSOR = {
    "binning_x": 0,
    "binning_y": 0,
    "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
}
"""What a CameraInfo of ROS 2 has unless fields say otherwise; here those of ROS 1 end before."""

Message = tuple[str, str, int, int, dict[str, Any]]
"""Topic, type without package, stamp ns, log time ns, fields."""


def depth_codes(count: int, seed: int = 0) -> list[np.ndarray]:
    """Random 16-bit images with holes; no two are equal."""
    rng = np.random.default_rng(seed)
    codes = rng.integers(400, 900, size=(count, HEIGHT, WIDTH)).astype(np.uint16)
    codes[:, 3:6, 4:9] = 0
    return list(codes)


def png(codes: np.ndarray) -> bytes:
    return cv2.imencode(".png", codes)[1].tobytes()


def stamps(count: int) -> list[int]:
    return [START_NS + i * PERIOD_NS for i in range(count)]


def write_folder(
    path: Path,
    images: Sequence[np.ndarray],
    *,
    camera: str | None = CAMERA_TOML,
    stamp_lines: Sequence[str] | None = None,
    suffix: str = ".png",
) -> Path:
    path.mkdir(parents=True)
    for index, image in enumerate(images):
        (path / f"{index:06d}{suffix}").write_bytes(cv2.imencode(suffix, image)[1].tobytes())
    if camera is not None:
        (path / "camera.toml").write_text(camera)
    if stamp_lines is None:
        stamp_lines = ["stamp_ns", *map(str, stamps(len(images)))]
    if stamp_lines:
        (path / "timestamps.csv").write_text("\n".join(stamp_lines) + "\n")
    return path


def calibration_fields(width: int = WIDTH, height: int = HEIGHT, upper: bool = True) -> dict[str, Any]:
    names = ("K", "D", "R", "P") if upper else ("k", "d", "r", "p")
    k = [30.0, 0.0, 11.0, 0.0, 31.0, 7.5, 0.0, 0.0, 1.0]
    return {
        "width": width,
        "height": height,
        "distortion_model": "plumb_bob",
        names[0]: k,
        names[1]: [0.0] * 5,
        names[2]: [0.0] * 9,
        names[3]: [0.0] * 12,
    }


def raw_fields(image: np.ndarray, encoding: str, *, padding: int = 0, big: bool = False) -> dict[str, Any]:
    """Fields of an image message, rows padded with bytes that must not be read."""
    ordered = image.astype(image.dtype.newbyteorder(">" if big else "<"))
    rows = [row.tobytes() + b"\xab" * padding for row in ordered]
    return {
        "width": image.shape[1],
        "height": image.shape[0],
        "encoding": encoding,
        "step": len(rows[0]),
        "data": b"".join(rows),
        **({"is_bigendian": 1} if big else {}),
    }


def compressed_depth(codes: np.ndarray, a: float = 0.0, b: float = 0.0) -> bytes:
    return struct.pack("<iff", 0, a, b) + png(codes)


def write_foxglove(
    path: Path,
    messages: Sequence[Message],
    *,
    frame_id: str = "cam",
    flush_every: int = 1,
    finish: bool = True,
    compression: str = "zstd",
) -> Path:
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    classes = {"Image": RawImage, "CompressedImage": CompressedImage, "CameraInfo": CameraCalibration}
    channels: dict[str, int] = {}
    with McapSink(path, compression=compression) as sink:
        for number, (topic, kind, stamp, log_time, fields) in enumerate(messages):
            if topic not in channels:
                channels[topic] = sink.channel(topic, classes[kind])
            message = classes[kind](**{"frame_id": frame_id, **fields})
            if stamp:
                message.timestamp.FromNanoseconds(stamp)
            sink.write(channels[topic], log_time, message.SerializeToString())
            if number % flush_every == flush_every - 1:
                sink.flush()
        if finish:
            sink.finish()
    return path


def ros1_bytes(kind: str, values: Sequence[Any]) -> bytes:
    """Serialise the fields of a ROS 1 message by the wire format of the ROS wiki: little-endian, no gaps.

    Args:
        kind: a letter a field: of ``struct``, or s a string, b bytes; of float64 v any number, f a fixed one.
        values: the fields.
    """
    out = b""
    for code, value in zip(kind, values, strict=True):
        if code in "sb":
            data = value.encode() if code == "s" else bytes(value)
            out += struct.pack("<I", len(data)) + data
        elif code in "vf":
            count = struct.pack("<I", len(value)) if code == "v" else b""
            out += count + struct.pack(f"<{len(value)}d", *value)
        else:
            out += struct.pack(f"<{code}", value)
    return out


ROS1_FIELDS = {
    "Image": ("IIsBIb", ("height", "width", "encoding", "is_bigendian", "step", "data")),
    "CompressedImage": ("sb", ("format", "data")),
    "CameraInfo": ("IIsvfff", ("height", "width", "distortion_model", "D", "K", "R", "P")),
}
ROS1_UNSET = {"distortion_model": "", "encoding": "", "K": [0.0] * 9, "R": [0.0] * 9, "P": [0.0] * 12}


def write_ros1_messages(
    path: Path, schemas: Sequence[tuple[str, str]], messages: Sequence[tuple[str, int, int, bytes]]
) -> Path:
    """Write serialised ROS 1 messages.

    Args:
        schemas: name and definition.
        messages: topic, index of the schema, log time ns, bytes.
    """
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=2000)
        writer.start("ros1", "tests")
        ids = [writer.register_schema(name, "ros1msg", text.encode()) for name, text in schemas]
        channels: dict[str, int] = {}
        for topic, schema, log_time, data in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "ros1", ids[schema])
            writer.add_message(channels[topic], log_time, data, log_time)
        writer.finish()
    return path


def write_ros1(path: Path, messages: Sequence[Message], *, frame_id: str = "cam") -> Path:
    kinds = list(DEFINITIONS_1)
    serialised = []
    for number, (topic, kind, stamp, log_time, fields) in enumerate(messages):
        codes, names = ROS1_FIELDS[kind]
        head = ros1_bytes("IIIs", (number, *divmod(stamp, 10**9), fields.get("frame_id", frame_id)))
        own = ros1_bytes(codes, [fields.get(name, ROS1_UNSET.get(name, 0)) for name in names])
        serialised.append((topic, kinds.index(kind), log_time, head + own))
    schemas = [(f"sensor_msgs/{kind}", DEFINITIONS_1[kind]) for kind in kinds]
    return write_ros1_messages(path, schemas, serialised)


def write_ros2(path: Path, messages: Sequence[Message], *, frame_id: str = "cam") -> Path:
    from mcap_ros2.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=2000)
        schemas = {
            kind: writer.register_msgdef(f"sensor_msgs/msg/{kind}", text)
            for kind, text in DEFINITIONS_2.items()
        }
        for topic, kind, stamp, log_time, fields in messages:
            sec, nanosec = divmod(stamp, 10**9)
            own = {name: value for name, value in fields.items() if name != "frame_id"}
            header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": fields.get("frame_id", frame_id)}
            more = PART_OF_SENSOR if kind == "CameraInfo" else {}
            message = {"header": header, "is_bigendian": 0, **more, **own}
            if kind != "Image":
                del message["is_bigendian"]
            writer.write_message(topic, schemas[kind], message, log_time=log_time, publish_time=log_time)
        writer.finish()
    return path


DISPARITY_FIELDS = (
    "sensor_msgs/Image image\nfloat32 f\nfloat32 {baseline}\nsensor_msgs/RegionOfInterest valid_window\n"
    "float32 min_disparity\nfloat32 max_disparity\nfloat32 delta_d\n"
)
REGION = "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n"


def write_disparity(path: Path, ros: int, disparity: np.ndarray, focal_px: float, baseline_m: float) -> Path:
    """Write one stereo_msgs/DisparityImage, in the wire format of ROS 1, or as CDR."""
    from mcap.writer import Writer

    height, width = disparity.shape
    region = RULE + "MSG: sensor_msgs/RegionOfInterest\n" + REGION
    if ros == 1:
        head = ros1_bytes("IIIs", (0, 5, 0, "cam"))
        image = head + ros1_bytes("IIsBIb", (height, width, "32FC1", 0, 4 * width, disparity.tobytes()))
        data = head + image + struct.pack("<2f4IB3f", focal_px, baseline_m, 0, 0, 0, 0, 0, 0.0, 64.0, 0.125)
        text = HEADER_1 + DISPARITY_FIELDS.format(baseline="T") + HEADER_TEXT_1
        text += RULE + "MSG: sensor_msgs/Image\n" + HEADER_1 + IMAGE + region
        names = ("stereo_msgs/DisparityImage", "ros1msg", "ros1")
    else:
        head = struct.pack("<iI", 5, 0) + struct.pack("<I4s", 4, b"cam\0")
        image = head + struct.pack("<II", height, width) + struct.pack("<I6s", 6, b"32FC1\0") + b"\0"
        image += b"\0" * (-(len(head) + len(image)) % 4) + struct.pack("<II", 4 * width, disparity.nbytes)
        data = b"\0\1\0\0" + head + image + disparity.tobytes() + struct.pack("<2f", focal_px, baseline_m)
        text = HEADER_1 + DISPARITY_FIELDS.format(baseline="t") + HEADER_TEXT_2
        text += RULE + "MSG: sensor_msgs/Image\n" + HEADER_1 + IMAGE + region
        names = ("stereo_msgs/msg/DisparityImage", "ros2msg", "cdr")
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("tests", "tests")
        schema = writer.register_schema(names[0], names[1], text.encode())
        channel = writer.register_channel("/stereo/disparity", names[2], schema)
        writer.add_message(channel, 5, data, 5)
        writer.finish()
    return path


WRITERS: dict[str, Callable[..., Path]] = {"foxglove": write_foxglove, "ros1": write_ros1, "ros2": write_ros2}


@pytest.fixture(scope="session")
def make() -> SimpleNamespace:
    """The builders of this module, for tests that cannot import it."""
    return SimpleNamespace(**{name: value for name, value in globals().items() if not name.startswith("_")})


@pytest.fixture
def foxglove_file(tmp_path: Path) -> Path:
    """Twelve PNG depth frames on /cam/image with a calibration, one chunk per message."""
    first = [("/cam/calibration", "CameraInfo", START_NS, START_NS, calibration_fields())]
    frames = [
        ("/cam/image", "CompressedImage", stamp, stamp, {"format": "png", "data": png(codes)})
        for stamp, codes in zip(stamps(12), depth_codes(12), strict=True)
    ]
    return write_foxglove(tmp_path / "foxglove.mcap", first + frames)
