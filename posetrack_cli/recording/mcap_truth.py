"""Ground truth that a recording carries."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.stream import read_messages
from posetrack_cli.recording.base import TruthMessage


def read_truth(path: Path, topics: Sequence[str]) -> Iterator[TruthMessage]:
    """Yield the messages on some topics undecoded, in order of log time where indexed."""
    if not topics:
        return
    for schema, channel, message in read_messages(path, LossLog(), topics):
        yield TruthMessage(
            topic=channel.topic,
            schema_name=schema.name if schema else "",
            schema_encoding=schema.encoding if schema else "",
            schema_data=schema.data if schema else b"",
            message_encoding=channel.message_encoding,
            log_time_ns=message.log_time,
            data=message.data,
            channel_metadata=dict(channel.metadata),
        )
