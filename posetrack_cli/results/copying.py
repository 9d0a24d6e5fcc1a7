"""Copies of results, one chunk at a time."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from mcap.records import Attachment, Channel, Schema

from posetrack_cli.mcap.sink import McapSink, SchemaText
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.results.records import SUMMARY_RECORD

Encode: TypeAlias = Callable[[bytes], bytes | None]


class Copied(NamedTuple):
    """How a channel is copied.

    Attributes:
        schema: schema of the copy.
        message_encoding: encoding of its messages.
        encode: returns the copy of a message, None to leave it out.
    """

    schema: SchemaText
    message_encoding: str
    encode: Encode


Choice: TypeAlias = Callable[[Schema | None, Channel], Copied | None]
"""Returns how a channel is copied; None if it is left out."""


def unchanged(schema: Schema | None, channel: Channel) -> Copied:
    """Copy a channel as it is."""
    text = (
        SchemaText("", "", b"") if schema is None else SchemaText(schema.name, schema.encoding, schema.data)
    )
    return Copied(text, channel.message_encoding, lambda data: data)


@contextmanager
def copied_result(
    file: McapFile,
    sink: McapSink,
    choice: Choice = unchanged,
    *,
    without: Collection[str] = (),
    in_file_order: bool = False,
) -> Iterator[None]:
    """Copy a result, then run the block, which may add to the copy, then finish the file.

    The summary comes last, so that a truncated copy is recognised as unfinished.

    Args:
        file: the result; its losses are what cannot be copied.
        sink: the copy.
        choice: how channels are copied.
        without: names of metadata records to leave out.
        in_file_order: keep the order of messages instead of sorting them by log time.
    """
    summaries = []
    for extra in file.extras():
        if isinstance(extra, Attachment):
            sink.attachment(extra.name, extra.media_type, extra.data, extra.log_time, extra.create_time)
        elif extra.name == SUMMARY_RECORD:
            summaries.append(extra.metadata)
        elif extra.name not in without:
            sink.metadata(extra.name, extra.metadata)
    _copy_messages(file, sink, choice, in_file_order=in_file_order)
    yield
    for summary in summaries:
        sink.metadata(SUMMARY_RECORD, summary)
    sink.finish()


def _copy_messages(file: McapFile, sink: McapSink, choice: Choice, *, in_file_order: bool) -> None:
    channels = _Channels(sink, choice)
    # Channels are registered first, to keep their order and those without messages.
    for schema, channel in sorted(file.channels(), key=lambda pair: pair[1].id):
        channels.of(schema, channel)
    for schema, channel, message in file.messages(in_file_order=in_file_order):
        channel_id, encode = channels.of(schema, channel)
        data = encode(message.data)
        if data is not None:
            sink.write(channel_id, message.log_time, data)
    sink.flush()


def _left_out(data: bytes) -> None:
    """Copy no message."""


@dataclass
class _Channels:
    """Registry of the copied channels."""

    sink: McapSink
    choice: Choice
    _known: dict[tuple[object, ...], tuple[int, Encode]] = field(default_factory=dict)

    def of(self, schema: Schema | None, channel: Channel) -> tuple[int, Encode]:
        """Return id and encoder of the copy of a channel, which is registered on the first call."""
        stated = unchanged(schema, channel)
        key = (channel.topic, *stated[:2], tuple(sorted(channel.metadata.items())))
        if key not in self._known:
            copied = self.choice(schema, channel)
            if copied is None:
                self._known[key] = -1, _left_out
            else:
                about = channel.topic, copied.schema, copied.message_encoding, channel.metadata
                self._known[key] = self.sink.raw_channel(*about), copied.encode
        return self._known[key]
