"""Decode MCAP messages: protobuf, ROS 1 and ROS 2, by the schema that the file carries."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mcap.records import Channel, Message, Schema

from posetrack_cli.recording.stamps import NS_PER_S

RAW_IMAGE = "image"
COMPRESSED_IMAGE = "compressed image"
CALIBRATION = "calibration"

KINDS = {
    "foxglove.RawImage": RAW_IMAGE,
    "sensor_msgs/Image": RAW_IMAGE,
    "sensor_msgs/msg/Image": RAW_IMAGE,
    "foxglove.CompressedImage": COMPRESSED_IMAGE,
    "sensor_msgs/CompressedImage": COMPRESSED_IMAGE,
    "sensor_msgs/msg/CompressedImage": COMPRESSED_IMAGE,
    "foxglove.CameraCalibration": CALIBRATION,
    "sensor_msgs/CameraInfo": CALIBRATION,
    "sensor_msgs/msg/CameraInfo": CALIBRATION,
}
"""What a message is, by its schema's name: decoded messages are dynamic classes, types say nothing."""


class UndecodableMessageError(Exception):
    """One message does not decode; readers skip it and count a loss."""


class MessageDecoder:
    """Decodes messages of one file; keeps one decoder per schema."""

    def __init__(self) -> None:
        self._decoders: dict[int, Callable[[bytes], Any]] = {}

    def decode(self, schema: Schema | None, channel: Channel, message: Message) -> Any:
        """Return the decoded message.

        Raises:
            UndecodableMessageError: if it does not fit its schema, or the encoding is not known.
        """
        try:
            if channel.id not in self._decoders:
                self._decoders[channel.id] = _decoder(schema, channel)
            return self._decoders[channel.id](message.data)
        except Exception as error:  # the libraries raise whatever the bytes lead to
            raise UndecodableMessageError(f"message on {channel.topic} does not decode") from error


def kind_of(schema: Schema | None) -> str | None:
    """Return whether messages of a schema are images, compressed images, calibrations, or neither."""
    return KINDS.get(schema.name) if schema is not None else None


def stamp_of(decoded: Any, message: Message) -> int:
    """Return when an image or calibration was taken, ns: its own stamp, or the log time if that is 0."""
    header = getattr(decoded, "header", None)
    if header is None:
        stamp = decoded.timestamp
        own = stamp.seconds * NS_PER_S + stamp.nanos
    elif hasattr(header.stamp, "nanosec"):
        own = header.stamp.sec * NS_PER_S + header.stamp.nanosec
    else:
        own = header.stamp.secs * NS_PER_S + header.stamp.nsecs
    return int(own) or message.log_time


def frame_id_of(decoded: Any) -> str:
    """Return the coordinate frame an image or calibration belongs to."""
    return str(getattr(decoded, "header", decoded).frame_id)


def _decoder(schema: Schema | None, channel: Channel) -> Callable[[bytes], Any]:
    decoder = _factory(channel.message_encoding).decoder_for(channel.message_encoding, schema)
    if decoder is None:
        raise ValueError(f"no decoder for {channel.message_encoding}")
    return decoder  # type: ignore[no-any-return]


def _factory(message_encoding: str) -> Any:
    """Return the decoder factory of an encoding; imports only the one that is needed."""
    if message_encoding == "protobuf":
        from mcap_protobuf.decoder import DecoderFactory as Protobuf

        return Protobuf()
    if message_encoding == "ros1":
        from mcap_ros1.decoder import DecoderFactory as Ros1

        return Ros1()
    from mcap_ros2.decoder import DecoderFactory as Ros2

    return Ros2()
