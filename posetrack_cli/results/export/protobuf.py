"""Copies of a result in which JSON messages are protobuf, for readers without JSON such as rerun."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from mcap.records import Channel, Schema

from posetrack_cli.errors import UsageError
from posetrack_cli.limits import MIB
from posetrack_cli.losses import LossLog, loss_line
from posetrack_cli.mcap.protobuf_twin import NoTwinError, ProtobufTwin, twin_of_channel
from posetrack_cli.mcap.sink import McapSink, SchemaText
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.results.copying import Copied, copied_result, unchanged
from posetrack_cli.results.export.source import ExportSource


def write_protobuf(source: ExportSource, path: Path) -> Iterator[str]:
    """Write a copy of a result, with JSON messages as protobuf; all other messages are copied.

    Topics that have neither encoding are left out.

    Yields:
        Notes on topics and messages that are left out.

    Raises:
        UsageError: only some of the frames or another topic is asked for.
        ResultError: the file cannot be written.
    """
    if not source.lost or source.topic != source.result.estimate_topic:
        what, hint = "--schemas protobuf exports all frames and topics", "omit the options that select some"
        raise UsageError(what, found=source.topic, hint=hint)
    file, losses = McapFile(source.result.path), LossLog()
    left_out: list[str] = []

    def choice(schema: Schema | None, channel: Channel) -> Copied | None:
        try:
            return as_protobuf(schema, channel, losses)
        except NoTwinError as error:
            left_out.append(f"{channel.topic} is left out: {error}")
            return None

    with McapSink(path, chunk_bytes=MIB) as sink, copied_result(file, sink, choice):
        pass
    yield from left_out
    if losses.losses:
        yield loss_line(losses.losses)


def as_protobuf(schema: Schema | None, channel: Channel, losses: LossLog) -> Copied:
    """Return the protobuf copy of a channel of protobuf or JSON messages.

    Args:
        schema, channel: the channel.
        losses: receives the messages that do not fit the schema and are left out.

    Raises:
        NoTwinError: there is none.
    """
    if channel.message_encoding == "protobuf":
        return unchanged(schema, channel)
    twin = twin_of_channel(schema, channel)
    stated = SchemaText(twin.name, "protobuf", twin.definition)
    return Copied(stated, "protobuf", partial(_encoded, twin, channel.topic, losses))


def _encoded(twin: ProtobufTwin, topic: str, losses: LossLog, data: bytes) -> bytes | None:
    try:
        return twin.encode(data)
    except NoTwinError as error:
        losses.add(f"message left out, {error}", topic)
        return None
