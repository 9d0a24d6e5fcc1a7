"""Digests of written files, without run record, configuration, version and measured times.

MCAP files have one digest per topic, so that a difference names the stream that changed.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

RUN_RECORD = "posetrack.run"
# JSON keys and CSV columns that describe the run or its cost
LEFT_OUT = frozenset(
    {"version", "run", "configuration", "bytes", "seconds", "cpu_s", "frames_per_s", "peak_mb", "peak_bytes"}
)
_VERSION = re.compile(r"\bposetrack \d+\.\d\S*(?: \(sources \w+\))?")
_RECORD_TABLE = re.compile(r'<table class="record">.*?</table>', re.DOTALL)
_PRINTED_RECORD = re.compile(rf"^metadata {re.escape(RUN_RECORD)}:.*\n(?:    .*\n)*", re.MULTILINE)
_PRINTED_SIZE = re.compile(r"\b[\d.]+ (?:B|kB|MB)\b")


def digests_of(path: Path) -> dict[str, str]:
    """Return the digests of a file: one with the name "", or one per part of an MCAP or npz file."""
    content = path.read_bytes()
    if path.suffix == ".mkv":  # FFmpeg writes a random identifier
        return {}
    parts = _PARTS[path.suffix](content) if path.suffix in _PARTS else [("", content)]
    return {name: digest_of(part) for name, part in parts}


def printed_digest(content: bytes) -> str:
    """Return the digest of standard output."""
    text = _PRINTED_SIZE.sub("SIZE", _PRINTED_RECORD.sub("", content.decode())).encode()
    return digest_of(_json_text(text) if text.startswith(b"{") else _without_version(text))


def digest_of(content: bytes) -> str:
    """Return the SHA-256 of bytes."""
    return hashlib.sha256(content).hexdigest()


Parts = Iterator[tuple[str, bytes]]


def _without_version(text: bytes) -> bytes:
    return _VERSION.sub("posetrack", text.decode()).encode()


def _mcap(content: bytes) -> Parts:
    """Yield the messages of each topic, the order of topics, metadata and attachments."""
    streams: dict[str, Any] = {}
    order = hashlib.sha256()
    for schema, channel, message in make_reader(io.BytesIO(content)).iter_messages(log_time_order=False):
        if channel.topic not in streams:
            streams[channel.topic] = hashlib.sha256()
            kind = (None, None, b"") if schema is None else (schema.name, schema.encoding, schema.data)
            streams[channel.topic].update(repr((kind, channel.message_encoding, channel.metadata)).encode())
        facts = (message.log_time, message.publish_time, message.sequence, len(message.data))
        streams[channel.topic].update(repr(facts).encode() + message.data)
        order.update(channel.topic.encode() + b"\n")
    for topic, stream in streams.items():
        yield topic, stream.digest()
    yield "order of topics", order.digest()
    for record in make_reader(io.BytesIO(content)).iter_metadata():
        if record.name != RUN_RECORD:
            kept = sorted((k, v) for k, v in record.metadata.items() if _counts(k))
            yield f"metadata {record.name}", repr(kept).encode()
    for attachment in make_reader(io.BytesIO(content)).iter_attachments():
        described = (attachment.media_type, attachment.log_time, attachment.create_time)
        yield f"attachment {attachment.name}", repr(described).encode() + attachment.data


def _npz(content: bytes) -> Parts:
    """Yield each array; JSON texts without the description of the run."""
    with np.load(io.BytesIO(content)) as arrays:
        for name in arrays.files:
            array = arrays[name]
            is_json = array.ndim == 0 and str(array)[:1] == "{"
            data = _json_text(str(array).encode()) if is_json else array.tobytes()
            yield name, repr((array.dtype.kind if is_json else array.dtype.str, array.shape)).encode() + data


def _json_text(content: bytes) -> bytes:
    return json.dumps(_without_run(json.loads(content))).encode()


def _counts(key: str) -> bool:
    """Return whether a key belongs to a result; digests of inputs do not."""
    return key not in LEFT_OUT and not key.endswith("sha256")


def _without_run(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_run(one) for key, one in value.items() if _counts(key)}
    if isinstance(value, list):
        counted = (one for one in value if not (isinstance(one, dict) and one.get("name") == RUN_RECORD))
        return [_without_run(one) for one in counted]
    return value


def _csv(content: bytes) -> bytes:
    """Return a table without cost columns and without the run record in its comments."""
    lines = content.decode().splitlines()
    comments = [line for line in lines if line.startswith("#") and not line.startswith("# run:")]
    rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    cost = {k for k, name in enumerate(rows[0]) if name in LEFT_OUT} if rows else set()
    kept = [[cell for k, cell in enumerate(row) if k not in cost] for row in rows]
    return repr((comments, kept)).encode()


def _html(content: bytes) -> bytes:
    return _without_version(_RECORD_TABLE.sub("", content.decode()).encode())


_PARTS: Mapping[str, Callable[[bytes], Iterable[tuple[str, bytes]]]] = {
    ".mcap": _mcap,
    ".npz": _npz,
    ".json": lambda content: [("", _json_text(content))],
    ".csv": lambda content: [("", _csv(content))],
    ".html": lambda content: [("", _html(content))],
    **dict.fromkeys((".md", ".xml", ".toml", ".tum", ".bvh"), lambda text: [("", _without_version(text))]),
}
