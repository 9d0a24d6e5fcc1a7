"""Write MCAP files with reproducible bytes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, NamedTuple

from mcap.writer import CompressionType, Writer

from posetrack_cli import limits
from posetrack_cli.errors import ResultError
from posetrack_cli.files import open_output
from posetrack_cli.outputs import lock

# Fixed: the default includes a version and changes the bytes with every mcap update.
LIBRARY = "posetrack"

CHUNK_BYTES = 64 * 1024 * 1024
COMPRESSIONS = {"zstd": CompressionType.ZSTD, "none": CompressionType.NONE}


class SchemaText(NamedTuple):
    """Description of a channel's messages; all empty without schema.

    Attributes:
        name: name of the type.
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
    """An MCAP file being written: channels, messages, metadata and attachments.

    A chunk ends on ``flush`` or at ``chunk_bytes``; flushed data can be read even if the process is killed.
    Only ``finish`` writes the footer: leaving the ``with`` block, also by an exception, closes the file
    without one.

    Args:
        path: the file, overwritten if it exists; not a symbolic link.
        compression: compression of the chunks; "none" for compressed payloads.
        chunk_bytes: uncompressed chunk size.
        profile: MCAP profile, such as ``ros2``; empty for none.

    Raises:
        ResultError: in every method, if the file cannot be written.
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
        """Register a topic of protobuf messages of a generated class and return its channel id."""
        from mcap_protobuf.schema import build_file_descriptor_set

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
        """Register a topic of already encoded messages and return its channel id.

        Equal schemas are written once.

        Raises:
            ResultError: there are too many channels; and as for the class.
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
        """Return the channel id of a topic, the last of several.

        Raises:
            ResultError: the topic is not registered.
        """
        if topic not in self._topics:
            raise ResultError("no such topic", where=self.path, found=topic)
        return self._topics[topic]

    def write(self, channel_id: int, stamp_ns: int, data: bytes) -> None:
        """Write one message with log time = publish time = ``stamp_ns``, numbered per channel from 0."""
        if not 0 <= stamp_ns < 1 << 64:
            raise ResultError(
                "stamp out of range", where=self.path, found=f"{stamp_ns} ns", expected="0 to 2^64 - 1"
            )
        sequence = self._sequences[channel_id]
        self._sequences[channel_id] = sequence + 1
        with self._reported():
            self._writer.add_message(channel_id, stamp_ns, data, stamp_ns, sequence & 0xFFFFFFFF)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record, outside the current chunk."""
        with self._reported():
            self._writer.add_metadata(name, dict(values))

    def attachment(
        self, name: str, media_type: str, data: bytes, stamp_ns: int = 0, created_ns: int | None = None
    ) -> None:
        """Attach data logged at ``stamp_ns``, by default also its creation time."""
        created_ns = stamp_ns if created_ns is None else created_ns
        with self._reported():
            self._writer.add_attachment(created_ns, stamp_ns, name, media_type, data)

    def flush(self) -> None:
        """End the chunk and hand all data to the operating system."""
        with self._reported():
            self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        """Write the remaining data, index and footer, and close the file."""
        with self._reported():
            self._writer.finish()  # type: ignore[no-untyped-call]
        self.close()

    def close(self) -> None:
        """Close the file without a footer, like a killed writer; harmless after ``finish``."""
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
        """Close after a failed write, ignoring the repeated error of the rest of the buffer."""
        with suppress(OSError):
            self._stream.close()

    @contextmanager
    def _reported(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._failed = True
            raise ResultError("cannot be written", where=self.path, found=error.strerror or error) from error
