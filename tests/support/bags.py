"""Recordings of ROS as rosbags writes them: a small depth camera and one of colour, by their usual topics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

WIDTH, HEIGHT, COUNT = 64, 48, 6
START_NS, PERIOD_NS = 1_700_000_000_000_000_000, 33_000_000
DEPTH, DEPTH_INFO = "/camera/depth/image_rect_raw", "/camera/depth/camera_info"
COLOUR, COLOUR_INFO = "/camera/color/image_raw", "/camera/color/camera_info"
FX, FY, CX, CY = 70.0, 71.0, 31.5, 23.5

Row: TypeAlias = tuple[str, int, Any]
"""Topic, number of the instant, message."""


def depth_codes(number: int) -> np.ndarray:
    """A tilted plane that moves away."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    return (600 + 2 * u + v + 10 * number).astype(np.uint16)


def colours(number: int) -> np.ndarray:
    """A gradient, red green blue."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    return np.stack([3 * u, 4 * v, np.full_like(u, 20 * number)], axis=-1).astype(np.uint8)


class Messages:
    """The messages of one generation of ROS."""

    def __init__(self, store: Stores) -> None:
        self.store = get_typestore(store)
        self._types: Any = self.store.types
        self._is_first = store is Stores.ROS1_NOETIC

    def header(self, number: int, frame: str) -> Any:
        sec, nanosec = divmod(START_NS + number * PERIOD_NS, 10**9)
        stamp = self._types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
        first = {"seq": number} if self._is_first else {}
        return self._types["std_msgs/msg/Header"](**first, stamp=stamp, frame_id=frame)

    def image(self, number: int, frame: str, encoding: str, pixels: np.ndarray) -> Any:
        return self._types["sensor_msgs/msg/Image"](
            header=self.header(number, frame),
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=pixels.strides[0],
            data=pixels.view(np.uint8).reshape(-1),
        )

    def camera_info(self, frame: str) -> Any:
        region = self._types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        letters = "DKRP" if self._is_first else "dkrp"
        k = np.array([FX, 0, CX, 0, FY, CY, 0, 0, 1.0])
        p = np.array([FX, 0, CX, 0, 0, FY, CY, 0, 0, 0, 1.0, 0])
        matrices = dict(zip(letters, (np.zeros(5), k, np.eye(3).ravel(), p), strict=True))
        return self._types["sensor_msgs/msg/CameraInfo"](
            header=self.header(0, frame),
            height=HEIGHT,
            width=WIDTH,
            distortion_model="plumb_bob",
            **matrices,
            binning_x=0,
            binning_y=0,
            roi=region,
        )

    def value(self, number: float) -> Any:
        return self._types["std_msgs/msg/Float32"](data=number)

    def usual(self) -> Iterator[Row]:
        """As a driver would: each camera's calibration, then its images."""
        yield DEPTH_INFO, 0, self.camera_info("depth_frame")
        yield COLOUR_INFO, 0, self.camera_info("color_frame")
        for number in range(COUNT):
            yield DEPTH, number, self.image(number, "depth_frame", "16UC1", depth_codes(number))
            yield COLOUR, number, self.image(number, "color_frame", "rgb8", colours(number))

    def write(self, rows: Iterable[Row], writer: Any, serialise: Any) -> None:
        known: dict[str, Any] = {}
        for topic, number, message in rows:
            if topic not in known:
                known[topic] = writer.add_connection(topic, message.__msgtype__, typestore=self.store)
            data = serialise(message, message.__msgtype__)
            writer.write(known[topic], START_NS + number * PERIOD_NS, bytes(data))


def write_bag(
    path: Path,
    compression: str = "none",
    rows: Callable[[Messages], Iterable[Row]] = Messages.usual,
    chunk_bytes: int = 20_000,
) -> Path:
    """A ROS 1 bag, of several chunks."""
    messages = Messages(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    writer.chunk_threshold = chunk_bytes
    if compression != "none":
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    with writer:
        messages.write(rows(messages), writer, messages.store.serialize_ros1)
    return path


def write_folder(path: Path, storage: str, compression: str = "none", version: int = 9) -> Path:
    """A folder of ROS 2; of compressions there is ``message``, and ``file``."""
    messages = Messages(Stores.ROS2_HUMBLE)
    writer = Writer2(path, version=version, storage_plugin=StoragePlugin[storage.upper()])
    if compression != "none":
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        messages.write(messages.usual(), writer, messages.store.serialize_cdr)
    return path
