"""Changed MCAP records."""

from __future__ import annotations

import zlib
from copy import deepcopy
from functools import cache
from typing import Any

import lz4.frame
import zstandard
from hypothesis import strategies as st

from hostile.mcap_bytes import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FIELDS,
    FOOTER,
    MAGIC,
    MESSAGE,
    METADATA,
    NUMBERS,
    SCHEMA,
    STATISTICS,
    Record,
    content_bytes,
    file_bytes,
    record_bytes,
    summary_records,
)
from hostile.seeds import every
from hostile.values import changed_bytes, composite, integers, one_of, packed_numbers, texts, utf8


@composite
def changed_file(draw: st.DrawFn, records: list[Record], most: int = 3) -> bytes:
    """A file whose records are changed in one to ``most`` ways; then perhaps cut."""
    records = deepcopy(records)
    for _ in range(draw(st.integers(1, most))):
        change = draw(
            st.sampled_from((_field, _field, _field, _field, _list, _list, _length, _chunk, _chunk, _new))
        )
        change(draw, records)
    how = draw(
        st.sampled_from(("whole", "whole", "whole", "no summary", "lying summary", "lying summary", "cut"))
    )
    if how == "lying summary":
        return draw(lying_summary(records))
    data = file_bytes(records, summary=how != "no summary")
    return data[: draw(st.integers(0, len(data)))] if how == "cut" else data


def _field(draw: st.DrawFn, records: list[Record]) -> None:
    """One field of one record holds something else."""
    record = draw(one_of(every(records)))
    fields = FIELDS.get(record["op"], ())
    if not fields:
        return
    name, kind = draw(st.sampled_from(fields))
    record[name] = draw(field_value(kind, record.get(name)))


def field_value(kind: str, before: Any) -> st.SearchStrategy[Any]:
    if kind.startswith("u"):
        return st.one_of(integers(), st.sampled_from(_near(before)))
    if kind == "s":
        return st.one_of(
            texts(),
            st.sampled_from(("zstd", "lz4", "", "ros1", "ros1msg", "cdr", "json", "protobuf", "ros2msg")),
        )
    if kind in "bBr":
        data = before if isinstance(before, bytes) else b""
        return st.one_of(changed_bytes(data), texts().map(utf8), st.just(b""))
    if kind == "m":
        return st.dictionaries(texts(), texts(), max_size=4)
    return st.lists(st.tuples(integers(), integers()), max_size=5)


def _near(before: Any) -> tuple[int, ...]:
    number = before if isinstance(before, int) else 0
    return (number, number + 1, max(0, number - 1), 2 * number + 1)


def _list(draw: st.DrawFn, records: list[Record]) -> None:
    """Records are dropped, doubled, moved or exchanged, in the file or in a chunk."""
    lists = [records, *(r["inner"] for r in records if r.get("inner"))]
    own = draw(one_of(lists))
    if not own:
        return
    k = draw(st.integers(0, len(own) - 1))
    how = draw(st.sampled_from(("drop", "double", "move", "many", "out")))
    if how == "drop":
        del own[k]
    elif how == "double":
        own.insert(draw(st.integers(0, len(own))), deepcopy(own[k]))
    elif how == "move":
        own.insert(draw(st.integers(0, len(own) - 1)), own.pop(k))
    elif how == "many":
        own[k:k] = [own[k]] * draw(st.sampled_from((10, 300)))
    else:
        records.append(own.pop(k))


def _length(draw: st.DrawFn, records: list[Record]) -> None:
    """A record's head or its own lengths lie, or its content ends early."""
    record = draw(one_of(every(records)))
    how = draw(st.sampled_from(("opcode", "length", "content")))
    if how == "opcode":
        content = content_bytes(record)
        record["@content"] = content
        record["op"] = draw(st.sampled_from((0, *range(1, 17), 0x80, 0xFF)))
    elif how == "length":
        length = len(record.get("@content", b"") or content_bytes(record))
        record["@length"] = draw(st.one_of(integers(), st.sampled_from(_near(length))))
    else:
        record["@content"] = draw(changed_bytes(content_bytes(record)))


def _chunk(draw: st.DrawFn, records: list[Record]) -> None:
    """A chunk is compressed in another way, in itself damaged with a right CRC, or states other sizes."""
    chunks = [r for r in records if r["op"] == CHUNK]
    if not chunks:
        return
    chunk = draw(one_of(chunks))
    how = draw(st.sampled_from(("compression", "inner", "bomb", "size", "split", "nested")))
    if how == "compression":
        chunk["compression"] = draw(st.sampled_from(("", "zstd", "lz4", "lzma", "ZSTD", "\x1b[2J")))
    elif how == "inner":
        chunk["uncompressed"] = draw(changed_bytes(b"".join(map(record_bytes, chunk.get("inner", ())))))
    elif how == "bomb":
        kind, mebibytes = draw(st.sampled_from((("zstd", 300), ("lz4", 64), ("zstd", 4096), ("zstd", 40))))
        chunk |= {"compression": kind, "records": bomb(kind, mebibytes), "inner": []}
        chunk["uncompressed_size"] = draw(st.sampled_from((mebibytes << 20, 0, 1000, 2**63, 2**64 - 1)))
        chunk["uncompressed_crc"] = 0
    elif how == "size":
        chunk["uncompressed_size"] = draw(integers())
        chunk["uncompressed_crc"] = draw(st.sampled_from((0, 1)))
    elif how == "split":
        inner = chunk.get("inner", [])
        k = draw(st.integers(0, len(inner)))
        records.append({"op": CHUNK, "compression": "lz4", "inner": inner[k:]})
        chunk["inner"] = inner[:k]
    else:
        chunk["inner"] = [*chunk.get("inner", []), {"op": CHUNK, "inner": chunk.get("inner", [])}]


@cache
def bomb(kind: str, mebibytes: int) -> bytes:
    """Zeros as zstd or lz4 has them: a few bytes."""
    block = bytes(1 << 20)
    if kind == "zstd":
        packer = zstandard.ZstdCompressor(level=1).compressobj(size=mebibytes << 20)
        return b"".join(packer.compress(block) for _ in range(mebibytes)) + packer.flush()
    packer = lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB)
    parts = [packer.begin(), *(packer.compress(block) for _ in range(mebibytes)), packer.flush()]
    return b"".join(parts)


def _new(draw: st.DrawFn, records: list[Record]) -> None:
    """A record that was not there: of the file's channels, or of ones nobody has heard of."""
    ids = [r["id"] for r in every(records) if "id" in r] or [1]
    identity = st.one_of(st.sampled_from(ids), st.integers(0, 65535))
    kinds: dict[int, dict[str, st.SearchStrategy[Any]]] = {
        SCHEMA: {"id": identity, "name": texts(), "encoding": texts(), "data": st.binary(max_size=30)},
        CHANNEL: {
            "id": identity,
            "schema_id": identity,
            "topic": texts(),
            "message_encoding": st.sampled_from(("", "json", "cdr", "ros1", "protobuf", "x")),
            "metadata": st.dictionaries(texts(), texts(), max_size=2),
        },
        MESSAGE: {
            "channel_id": identity,
            "log_time": integers(),
            "publish_time": integers(),
            "data": st.binary(max_size=60),
        },
        METADATA: {
            "name": st.sampled_from(
                ("posetrack.run", "posetrack.subject", "posetrack.summary", "posetrack.cameras", "\x1b[2J")
            ),
            "metadata": st.dictionaries(texts(), texts(), max_size=3),
        },
        ATTACHMENT: {
            "name": st.one_of(st.just("model.npz"), texts()),
            "media_type": texts(),
            "data": st.binary(max_size=60),
        },
        DATA_END: {"data_section_crc": integers()},
        CHUNK: {"inner": st.just([])},
        FOOTER: {"summary_start": integers()},
    }
    op = draw(st.sampled_from(sorted(kinds)))
    record = {"op": op} | {name: draw(value) for name, value in kinds[op].items()}
    chunks = [r["inner"] for r in records if r.get("inner")]
    own = draw(one_of([records, *chunks]))
    own.insert(draw(st.integers(0, len(own))), record)


@composite
def lying_summary(draw: st.DrawFn, records: list[Record]) -> bytes:
    """A file whose summary, with a right CRC, tells offsets, counts and names that its data has not."""
    out = bytearray(MAGIC)
    spans = []
    for record in records:
        start = len(out)
        out += record_bytes(record)
        spans.append((record, start, len(out) - start))
    out += record_bytes({"op": DATA_END})
    summary = summary_records(spans)
    for _ in range(draw(st.integers(1, 3))):
        _lie(draw, summary, len(out))
    start = len(out)
    body = b"".join(map(record_bytes, summary))
    footer = {"op": FOOTER, "summary_start": start, "summary_offset_start": 0}
    if draw(st.integers(0, 4)) == 0:
        footer[draw(st.sampled_from(("summary_start", "summary_offset_start")))] = draw(
            st.one_of(integers(), st.integers(0, len(out)))
        )
    head = record_bytes({**footer, "summary_crc": 0})[:-4]
    return bytes(out) + body + record_bytes({**footer, "summary_crc": zlib.crc32(body + head)}) + MAGIC


def _lie(draw: st.DrawFn, summary: list[Record], end: int) -> None:
    k = draw(st.integers(0, len(summary) - 1))
    how = draw(st.sampled_from(("field", "field", "field", "double", "drop", "overlap")))
    if how == "drop" and len(summary) > 1:
        del summary[k]
    elif how == "double":
        copies = draw(st.sampled_from((1, 1000)))
        summary[k:k] = [summary[k]] * copies
        for record in summary:
            if record["op"] == STATISTICS and summary[k]["op"] == CHUNK_INDEX:
                record["chunk_count"] += copies
    elif how == "overlap":
        for record in summary:
            if record["op"] == CHUNK_INDEX:
                record |= {"message_start_time": 0, "message_end_time": 2**64 - 1}
    else:
        record = summary[k] = dict(summary[k])
        name, kind = draw(st.sampled_from(FIELDS[record["op"]]))
        is_place = kind in NUMBERS and ("offset" in name or "start" in name)
        place = st.integers(0, end) if is_place else st.nothing()
        record[name] = draw(st.one_of(field_value(kind, record.get(name)), place))


def packed() -> st.SearchStrategy[bytes]:
    return st.one_of(packed_numbers(), st.binary(max_size=30))
