"""A small reader and writer of MCAP that states whatever it is told to.

A file is a list of records, each a dict: ``op`` and its fields, of a chunk also ``inner``, its own records.
What the format derives (lengths, offsets, CRCs, sizes, counts, the summary) is right unless a field of that
name says otherwise.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

import lz4.frame
import zstandard

Record: TypeAlias = dict[str, Any]

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)

# What each field is: u2 u4 u8 numbers, s text, b bytes, m a map of text, i (u2, u8) pairs, t (u8, u8) pairs
FIELDS: dict[int, tuple[tuple[str, str], ...]] = {
    HEADER: (("profile", "s"), ("library", "s")),
    FOOTER: (("summary_start", "u8"), ("summary_offset_start", "u8"), ("summary_crc", "u4")),
    SCHEMA: (("id", "u2"), ("name", "s"), ("encoding", "s"), ("data", "b")),
    CHANNEL: (
        ("id", "u2"),
        ("schema_id", "u2"),
        ("topic", "s"),
        ("message_encoding", "s"),
        ("metadata", "m"),
    ),
    MESSAGE: (
        ("channel_id", "u2"),
        ("sequence", "u4"),
        ("log_time", "u8"),
        ("publish_time", "u8"),
        ("data", "r"),
    ),
    CHUNK: (
        ("message_start_time", "u8"),
        ("message_end_time", "u8"),
        ("uncompressed_size", "u8"),
        ("uncompressed_crc", "u4"),
        ("compression", "s"),
        ("records", "B"),
    ),
    MESSAGE_INDEX: (("channel_id", "u2"), ("entries", "t")),
    CHUNK_INDEX: (
        ("message_start_time", "u8"),
        ("message_end_time", "u8"),
        ("chunk_start_offset", "u8"),
        ("chunk_length", "u8"),
        ("message_index_offsets", "i"),
        ("message_index_length", "u8"),
        ("compression", "s"),
        ("compressed_size", "u8"),
        ("uncompressed_size", "u8"),
    ),
    ATTACHMENT: (
        ("log_time", "u8"),
        ("create_time", "u8"),
        ("name", "s"),
        ("media_type", "s"),
        ("data", "B"),
        ("crc", "u4"),
    ),
    ATTACHMENT_INDEX: (
        ("offset", "u8"),
        ("length", "u8"),
        ("log_time", "u8"),
        ("create_time", "u8"),
        ("data_size", "u8"),
        ("name", "s"),
        ("media_type", "s"),
    ),
    STATISTICS: (
        ("message_count", "u8"),
        ("schema_count", "u2"),
        ("channel_count", "u4"),
        ("attachment_count", "u4"),
        ("metadata_count", "u4"),
        ("chunk_count", "u4"),
        ("message_start_time", "u8"),
        ("message_end_time", "u8"),
        ("channel_message_counts", "i"),
    ),
    METADATA: (("name", "s"), ("metadata", "m")),
    METADATA_INDEX: (("offset", "u8"), ("length", "u8"), ("name", "s")),
    SUMMARY_OFFSET: (("group_opcode", "u1"), ("group_start", "u8"), ("group_length", "u8")),
    DATA_END: (("data_section_crc", "u4"),),
}
NUMBERS = {"u1": "<B", "u2": "<H", "u4": "<I", "u8": "<Q"}


# Writing


def file_bytes(records: Iterable[Record], *, summary: bool = True, magic: bytes = MAGIC) -> bytes:
    """Return a file of records, which hold the data section; the summary is derived, or left out."""
    out = bytearray(magic)
    spans: list[tuple[Record, int, int]] = []
    for record in records:
        start = len(out)
        out += record_bytes(record)
        spans.append((record, start, len(out) - start))
    if not summary:
        return bytes(out)
    if not any(record["op"] == DATA_END for record, _, _ in spans):
        out += record_bytes({"op": DATA_END})
    start = len(out)
    for record in summary_records(spans):
        out += record_bytes(record)
    footer = {"op": FOOTER, "summary_start": start, "summary_offset_start": 0}
    counted = bytes(out[start:]) + struct.pack("<BQQQ", FOOTER, 20, start, 0)
    return bytes(out) + record_bytes({**footer, "summary_crc": zlib.crc32(counted)}) + magic


def summary_records(spans: list[tuple[Record, int, int]]) -> list[Record]:
    """Return schemas, channels, statistics and indexes of a data section."""
    everything = [record for record, _, _ in spans]
    everything += [inner for record in everything for inner in record.get("inner", ())]
    named = [r for op in (SCHEMA, CHANNEL) for r in everything if r["op"] == op]
    found: list[Record] = [dict(r) for r in {(r["op"], r.get("id")): r for r in named}.values()]
    times = [r.get("log_time", 0) for r in everything if r["op"] == MESSAGE]
    counts: dict[int, int] = {}
    for record in everything:
        if record["op"] == MESSAGE:
            counts[record.get("channel_id", 0)] = counts.get(record.get("channel_id", 0), 0) + 1
    number = {op: sum(r["op"] == op for r in everything) for op in FIELDS}
    found.append(
        {
            "op": STATISTICS,
            "message_count": number[MESSAGE],
            "schema_count": number[SCHEMA],
            "channel_count": number[CHANNEL],
            "attachment_count": number[ATTACHMENT],
            "metadata_count": number[METADATA],
            "chunk_count": number[CHUNK],
            "message_start_time": min(times, default=0),
            "message_end_time": max(times, default=0),
            "channel_message_counts": list(counts.items()),
        }
    )
    for record, start, length in spans:
        index = _index_of(record, start, length)
        if index:
            found.append(index)
    return found


def _index_of(record: Record, start: int, length: int) -> Record | None:
    place = {"offset": start, "length": length}
    if record["op"] == METADATA:
        return {"op": METADATA_INDEX, **place, "name": record.get("name", "")}
    if record["op"] == ATTACHMENT:
        kept = {k: record.get(k, d) for k, d in (("log_time", 0), ("create_time", 0), ("name", ""))}
        size = len(record.get("data", b""))
        return {
            "op": ATTACHMENT_INDEX,
            **place,
            **kept,
            "media_type": record.get("media_type", ""),
            "data_size": size,
        }
    if record["op"] == CHUNK:
        times = [r.get("log_time", 0) for r in record.get("inner", ()) if r["op"] == MESSAGE]
        fields = chunk_fields(record)
        return {
            "op": CHUNK_INDEX,
            "message_start_time": min(times, default=0),
            "message_end_time": max(times, default=0),
            "chunk_start_offset": start,
            "chunk_length": length,
            "compression": fields["compression"],
            "compressed_size": len(fields["records"]),
            "uncompressed_size": fields["uncompressed_size"],
        }
    return None


def record_bytes(record: Record) -> bytes:
    """Return a record: opcode, length, content. ``@content`` and ``@length`` may be stated."""
    content = record.get("@content")
    if content is None:
        content = content_bytes(record)
    length = record.get("@length", len(content))
    return struct.pack("<BQ", record["op"] & 0xFF, length & (2**64 - 1)) + content


def content_bytes(record: Record) -> bytes:
    fields: Mapping[str, Any] = record
    if record["op"] == CHUNK:
        fields = chunk_fields(record)
    out = b"".join(field_bytes(kind, fields.get(name)) for name, kind in FIELDS.get(record["op"], ()))
    if record["op"] == ATTACHMENT and "crc" not in record:
        out = out[:-4] + struct.pack("<I", zlib.crc32(out[:-4]))
    return out


def chunk_fields(record: Record) -> Record:
    """Return a chunk's fields with those derived that are not stated."""
    data = record.get("uncompressed")
    if data is None:
        data = b"".join(map(record_bytes, record.get("inner", ())))
    times = [r.get("log_time", 0) for r in record.get("inner", ()) if r["op"] == MESSAGE]
    derived = {
        "message_start_time": min(times, default=0),
        "message_end_time": max(times, default=0),
        "uncompressed_size": len(data),
        "uncompressed_crc": zlib.crc32(data),
        "compression": "zstd",
    }
    fields = derived | record
    if "records" not in fields:
        fields["records"] = compressed(fields["compression"], data)
    return fields


def compressed(kind: Any, data: bytes) -> bytes:
    """Return data as a compression has it; unknown ones leave it as it is."""
    if kind == "zstd":
        return zstandard.ZstdCompressor(level=3).compress(data)
    if kind == "lz4":
        packed: bytes = lz4.frame.compress(data)
        return packed
    return data


def field_bytes(kind: str, value: Any) -> bytes:
    """Return one field; numbers are taken modulo their width."""
    if kind in NUMBERS:
        width = struct.calcsize(NUMBERS[kind])
        return (int(value or 0) % (1 << 8 * width)).to_bytes(width, "little")
    if kind == "r":
        return bytes(value or b"")
    if kind in "sb":
        data = _text_bytes(value)
        return struct.pack("<I", len(data)) + data
    if kind == "B":
        data = _text_bytes(value)
        return struct.pack("<Q", len(data)) + data
    pairs = list(value.items()) if isinstance(value, Mapping) else list(value or ())
    kinds = {"m": ("s", "s"), "i": ("u2", "u8"), "t": ("u8", "u8")}[kind]
    data = b"".join(field_bytes(kinds[0], a) + field_bytes(kinds[1], b) for a, b in pairs)
    return struct.pack("<I", len(data)) + data


def _text_bytes(value: Any) -> bytes:
    if isinstance(value, str):
        return value.encode("utf-8", "surrogatepass")
    return bytes(value or b"")


# Reading what is valid


def read_records(data: bytes) -> list[Record]:
    """Return the data section of a valid file; chunks are opened, indexes and the summary left out."""
    records = []
    for record in _records(data, len(MAGIC)):
        if record["op"] == DATA_END:
            break
        if record["op"] == CHUNK:
            inner = _opened(record)
            records.append({"op": CHUNK, "compression": record["compression"], "inner": inner})
        elif record["op"] not in (MESSAGE_INDEX,):
            record.pop("crc", None)
            records.append(record)
    return records


def _opened(chunk: Record) -> list[Record]:
    packed = chunk["records"]
    if chunk["compression"] == "zstd":
        packed = zstandard.ZstdDecompressor().decompress(packed, max_output_size=chunk["uncompressed_size"])
    elif chunk["compression"] == "lz4":
        packed = lz4.frame.decompress(packed)
    return list(_records(packed, 0))


def _records(data: bytes, position: int) -> Iterable[Record]:
    while position + 9 <= len(data):
        op, length = struct.unpack_from("<BQ", data, position)
        content = data[position + 9 : position + 9 + length]
        position += 9 + length
        record: Record = {"op": op}
        offset = 0
        for name, kind in FIELDS[op]:
            record[name], offset = _field(kind, content, offset)
        yield record
        if op == FOOTER:
            return


def _field(kind: str, data: bytes, offset: int) -> tuple[Any, int]:
    if kind in NUMBERS:
        (number,) = struct.unpack_from(NUMBERS[kind], data, offset)
        return number, offset + struct.calcsize(NUMBERS[kind])
    if kind == "r":
        return data[offset:], len(data)
    head = "<Q" if kind == "B" else "<I"
    (length,) = struct.unpack_from(head, data, offset)
    offset += struct.calcsize(head)
    value, end = data[offset : offset + length], offset + length
    if kind in "bB":
        return value, end
    if kind == "s":
        return value.decode(), end
    kinds = {"m": ("s", "s"), "i": ("u2", "u8"), "t": ("u8", "u8")}[kind]
    pairs, place = [], 0
    while place < length:
        first, place = _field(kinds[0], value, place)
        second, place = _field(kinds[1], value, place)
        pairs.append((first, second))
    return (dict(pairs) if kind == "m" else pairs), end
