"""Decoding of protobuf, ROS 1 and ROS 2 messages with built-in layouts, chosen by schema name."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from mcap.records import Channel, Message, Schema

from posetrack_cli import limits
from posetrack_cli.mcap.ros_messages import Dialect, OtherLayoutError, check_definition, ros_decoder
from posetrack_cli.units import NS_PER_S

RAW_IMAGE = "image"
COMPRESSED_IMAGE = "compressed image"
CALIBRATION = "calibration"
DISPARITY_IMAGE = "disparity image"
VIDEO_IMAGE = "video picture"
IMAGES = (RAW_IMAGE, COMPRESSED_IMAGE, DISPARITY_IMAGE, VIDEO_IMAGE)

# Kind of message by schema name.
KINDS = {
    "foxglove.RawImage": RAW_IMAGE,
    "sensor_msgs/Image": RAW_IMAGE,
    "sensor_msgs/msg/Image": RAW_IMAGE,
    "foxglove.CompressedImage": COMPRESSED_IMAGE,
    "sensor_msgs/CompressedImage": COMPRESSED_IMAGE,
    "sensor_msgs/msg/CompressedImage": COMPRESSED_IMAGE,
    "foxglove.CompressedVideo": VIDEO_IMAGE,
    "foxglove_msgs/msg/CompressedVideo": VIDEO_IMAGE,
    "stereo_msgs/DisparityImage": DISPARITY_IMAGE,
    "stereo_msgs/msg/DisparityImage": DISPARITY_IMAGE,
    "foxglove.CameraCalibration": CALIBRATION,
    "sensor_msgs/CameraInfo": CALIBRATION,
    "sensor_msgs/msg/CameraInfo": CALIBRATION,
}

TRANSFORM_TYPES = (
    "foxglove.FrameTransform",
    "foxglove.FrameTransforms",
    "tf2_msgs/TFMessage",
    "tf2_msgs/msg/TFMessage",
    "tf/tfMessage",
)
TRUTH_TYPES = ("foxglove.Odometry", "foxglove.JointStates")
# Types of sensor settings
VALUE_TYPES = ("std_msgs/Float32", "std_msgs/msg/Float32", "std_msgs/String", "std_msgs/msg/String")
# Schema names of all decoded messages.
READ = (*KINDS, *TRANSFORM_TYPES, *TRUTH_TYPES, *VALUE_TYPES)
_FOXGLOVE = "foxglove."
# MCAP's name of the definition language by message encoding.
_DEFINITIONS: dict[Dialect, str] = {"ros1": "ros1msg", "cdr": "ros2msg"}
# Definition language if types are only named, as in ROS 2 databases.
NO_DEFINITION = "none"


class UndecodableMessageError(Exception):
    """A message that cannot be decoded; readers skip it and count a loss."""


class MessageDecoder:
    """Decodes messages of one file, with one decoder per channel.

    No decoder is built from a file's schema. Protobuf messages use the bundled Foxglove types, which by
    protobuf's rules also read older and newer versions; ROS messages use the published layouts
    (``ros_messages``).
    """

    def __init__(self) -> None:
        self._decoders: dict[int, Callable[[bytes], Any] | str] = {}  # or why nothing decodes them

    def decode(
        self, schema: Schema | None, channel: Channel, message: Message, kind: str | None = None
    ) -> Any:
        """Return the decoded message.

        Raises:
            UndecodableMessageError: the message does not fit its layout or is too large, or the layout is
                unknown, or not of the given kind.
        """
        if kind is not None and kind_of(schema) != kind:
            raise UndecodableMessageError(f"message on {channel.topic} is no {kind}")
        try:
            if channel.id not in self._decoders:
                self._decoders[channel.id] = _decoder(schema, channel)
            decoder = self._decoders[channel.id]
            if isinstance(decoder, str):
                raise OtherLayoutError(decoder)
            if len(message.data) > limits.MESSAGE_BYTES and kind_of(schema) not in IMAGES:
                raise OtherLayoutError(f"larger than {limits.MESSAGE_BYTES} bytes")
            return decoder(message.data)
        except OtherLayoutError as error:
            raise UndecodableMessageError(f"{_undecodable(channel)}, {error}") from error
        except Exception as error:  # decoders raise anything on damaged bytes
            raise UndecodableMessageError(_undecodable(channel)) from error


def kind_of(schema: Schema | None) -> str | None:
    """Return the kind of message of a schema, None if it is neither image nor calibration."""
    return KINDS.get(schema.name) if schema is not None else None


def stamp_of(decoded: Any, message: Message) -> int:
    """Return the capture time of an image or calibration, ns: its own stamp, or log time if 0."""
    return own_stamp_of(decoded) or message.log_time


def own_stamp_of(decoded: Any) -> int:
    """Return the stamp in an image or calibration message, ns; 0 if not set."""
    header = getattr(decoded, "header", None)
    if header is None:
        stamp = decoded.timestamp
        if hasattr(stamp, "nanosec"):  # of a ROS message without a header
            return int(stamp.sec * NS_PER_S + stamp.nanosec)
        return int(stamp.seconds * NS_PER_S + stamp.nanos)
    return int(header.stamp.sec * NS_PER_S + header.stamp.nanosec)


def frame_id_of(decoded: Any) -> str:
    """Return the coordinate frame of an image or calibration."""
    return str(getattr(decoded, "header", decoded).frame_id)


def _undecodable(channel: Channel) -> str:
    return f"message on {channel.topic} cannot be decoded"


def _decoder(schema: Schema | None, channel: Channel) -> Callable[[bytes], Any] | str:
    """Return the decoder of a channel's messages, or why there is none."""
    if schema is None or schema.name not in READ:
        return "unsupported type"
    try:
        if channel.message_encoding == "protobuf" and schema.name.startswith(_FOXGLOVE):
            return _foxglove_decoder(schema.name.removeprefix(_FOXGLOVE))
        for dialect, language in _DEFINITIONS.items():
            if channel.message_encoding == dialect and schema.encoding in (language, NO_DEFINITION):
                return _ros_decoder(dialect, schema)
    except OtherLayoutError as error:
        return str(error)
    return "unsupported encoding for its type"


def _foxglove_decoder(name: str) -> Callable[[bytes], Any]:
    generated = import_module(f"foxglove_schemas_protobuf.{name}_pb2")  # name is in READ: not user input
    decode: Callable[[bytes], Any] = getattr(generated, name).FromString
    return decode


def _ros_decoder(dialect: Dialect, schema: Schema) -> Callable[[bytes], Any]:
    name = schema.name.rpartition("/")[2]
    if schema.encoding != NO_DEFINITION:
        check_definition(dialect, name, schema.data.decode(errors="replace"))
    return ros_decoder(dialect, name)
