"""Export of a result as an MCAP file of protobuf messages only, for readers without JSON."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from mcap.records import Channel, Schema

from posetrack_cli.errors import UsageError
from posetrack_cli.losses import LossLog, loss_line
from posetrack_cli.mcap.protobuf_twin import NoTwinError, ProtobufTwin, twin_of_channel
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.results.copying import Copied, copied_result, unchanged
from posetrack_cli.results.export.source import ExportSource

CHUNK_BYTES = 1024 * 1024


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
        if channel.message_encoding == "protobuf":
            return unchanged(schema, channel)
        try:
            twin = twin_of_channel(schema, channel)
        except NoTwinError as error:
            left_out.append(f"{channel.topic} is left out: {error}")
            return None
        return Copied(twin.schema, "protobuf", lambda data: _encoded(twin, data, channel.topic, losses))

    with McapSink(path, chunk_bytes=CHUNK_BYTES) as sink, copied_result(file, sink, choice):
        pass
    yield from left_out
    if losses.losses:
        yield loss_line(losses.losses)


def _encoded(twin: ProtobufTwin, data: bytes, topic: str, losses: LossLog) -> bytes | None:
    try:
        return twin.encode(data)
    except NoTwinError as error:
        losses.add(f"message left out, {error}", topic)
        return None
