"""Write MCAP files whose bytes depend on nothing but what is written."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, NamedTuple

from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from posetrack_cli import limits
from posetrack_cli.errors import ResultError
from posetrack_cli.files import open_output
from posetrack_cli.outputs import lock

LIBRARY = "posetrack"
"""Fixed: the default would carry a version and change the bytes with every update of mcap."""

CHUNK_BYTES = 64 * 1024 * 1024
COMPRESSIONS = {"zstd": CompressionType.ZSTD, "none": CompressionType.NONE}


class SchemaText(NamedTuple):
    """What describes the messages of a channel; all empty for a channel without schema.

    Attributes:
        name: of the type.
        encoding: ``protobuf``, ``jsonschema``, ``ros1msg``...
        data: the definition.
    """

    name: str
    encoding: str
    data: bytes


def serialised(message: Any) -> bytes:
    """Return the bytes of a protobuf message; equal messages have equal bytes."""
    return bytes(message.SerializeToString(deterministic=True))


class McapSink:
    """An MCAP file that is being written: channels, messages, metadata and attachments.

    A chunk ends when ``flush`` is called or when it holds ``chunk_bytes``; what was flushed can be
    read even if the process is killed. Only ``finish`` writes the footer: leaving the ``with`` block,
    also by an exception, closes the file as it is.

    Args:
        path: the file, overwritten if it exists; no symbolic link.
        compression: of the chunks; "none" for payloads that are compressed already.
        chunk_bytes: uncompressed size at which a chunk ends by itself.
        profile: of MCAP that the file follows, such as ``ros2``; empty for none.

    Raises:
        ResultError: here and in every method, when the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        *,
        compression: Literal["zstd", "none"] = "zstd",
        chunk_bytes: int = CHUNK_BYTES,
        profile: str = "",
    ) -> None:
        self.path = path
        self._schemas: dict[SchemaText, int] = {}
        self._sequences: dict[int, int] = {}
        self._topics: dict[str, int] = {}
        self._failed = False
        with self._reported():
            self._stream = open_output(path)
            lock(self._stream)
            self._writer = Writer(self._stream, chunk_size=chunk_bytes, compression=COMPRESSIONS[compression])
            self._writer.start(profile, LIBRARY)

    def channel(self, topic: str, message_class: Any, *, metadata: Mapping[str, str] | None = None) -> int:
        """Register a topic of protobuf messages of one generated class and return its channel id."""
        name = message_class.DESCRIPTOR.full_name
        data = build_file_descriptor_set(message_class).SerializeToString(deterministic=True)
        return self.raw_channel(topic, SchemaText(name, "protobuf", data), "protobuf", metadata)

    def json_channel(self, topic: str, schema_name: str, schema: Mapping[str, Any]) -> int:
        """Register a topic of JSON messages described by a JSON schema and return its channel id."""
        data = json.dumps(schema, separators=(",", ":")).encode()
        return self.raw_channel(topic, SchemaText(schema_name, "jsonschema", data), "json")

    def raw_channel(
        self,
        topic: str,
        schema: SchemaText,
        message_encoding: str,
        metadata: Mapping[str, str] | None = None,
    ) -> int:
        """Register a topic of messages that are encoded already and return its channel id.

        Equal schemas are written once.

        Raises:
            ResultError: there are as many channels as a file can have; and as of the class.
        """
        if len(self._sequences) >= limits.CHANNELS:
            raise ResultError("too many topics", where=self.path, expected=f"at most {limits.CHANNELS}")
        with self._reported():
            schema_id = self._schema(schema)
            channel_id = self._writer.register_channel(
                topic, message_encoding, schema_id, dict(metadata or {})
            )
        self._sequences[channel_id] = 0
        self._topics[topic] = channel_id
        return channel_id

    def channel_of(self, topic: str) -> int:
        """Return the id of the channel that a topic was registered as, the last of several.

        Raises:
            ResultError: there is none.
        """
        if topic not in self._topics:
            raise ResultError("no such topic", where=self.path, found=topic)
        return self._topics[topic]

    def write(self, channel_id: int, stamp_ns: int, data: bytes) -> None:
        """Write one message with log time = publish time = ``stamp_ns``, numbered per channel from 0."""
        if not 0 <= stamp_ns < 1 << 64:
            raise ResultError("stamp cannot be stored", where=self.path, found=f"{stamp_ns} ns")
        sequence = self._sequences[channel_id]
        self._sequences[channel_id] = sequence + 1
        with self._reported():
            self._writer.add_message(channel_id, stamp_ns, data, stamp_ns, sequence & 0xFFFFFFFF)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record, outside the chunk in progress."""
        with self._reported():
            self._writer.add_metadata(name, dict(values))

    def attachment(
        self, name: str, media_type: str, data: bytes, stamp_ns: int = 0, created_ns: int | None = None
    ) -> None:
        """Attach a file's bytes, logged at ``stamp_ns``, and created then if nothing else is given."""
        created_ns = stamp_ns if created_ns is None else created_ns
        with self._reported():
            self._writer.add_attachment(created_ns, stamp_ns, name, media_type, data)

    def flush(self) -> None:
        """End the chunk and hand everything to the operating system."""
        with self._reported():
            self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        """Write what is left, the index and the footer, and close the file."""
        with self._reported():
            self._writer.finish()  # type: ignore[no-untyped-call]
        self.close()

    def close(self) -> None:
        """Close the file without a footer, as a killed writer leaves it; harmless after ``finish``."""
        if self._failed:
            self._abandon()
            return
        with self._reported():
            self._stream.close()

    def __enter__(self) -> McapSink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _schema(self, schema: SchemaText) -> int:
        if not any(schema):
            return 0
        if schema not in self._schemas:
            self._schemas[schema] = int(self._writer.register_schema(*schema))
        return self._schemas[schema]

    def _abandon(self) -> None:
        """Close after a failed write: the rest of the buffer fails again, which was told already."""
        with suppress(OSError):
            self._stream.close()

    @contextmanager
    def _reported(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._failed = True
            raise ResultError("cannot be written", where=self.path, found=error.strerror or error) from error
