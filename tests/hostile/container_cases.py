"""Changed records of bags, databases, metadata.yaml and Matroska: valid files some of whose records lie."""

from __future__ import annotations

import bz2
import json
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from copy import deepcopy
from functools import cache
from typing import Any

import cv2
import lz4.frame
import numpy as np
import zstandard
from hypothesis import strategies as st

from hostile import seeds as of
from hostile.mcap_bytes import Record
from hostile.mcap_cases import bomb
from hostile.values import (
    changed_bytes,
    changed_text,
    changed_tree,
    composite,
    integers,
    json_text,
    one_of,
    packed_numbers,
    texts,
    utf8,
)
from support.kinect import calibration, codes

INNER = "inner"
"""Key of a record's own records."""
MANY_OF = 100
"""Records of which one may be repeated: repeated within others that are, they would take all memory."""


def _every(records: list[Record]) -> list[Record]:
    return [each for record in records for each in (record, *_every(record.get(INNER, [])))]


def _lists(records: list[Record]) -> Iterator[list[Record]]:
    yield records
    for record in records:
        if record.get(INNER):
            yield from _lists(record[INNER])


def _moved(draw: st.DrawFn, records: list[Record]) -> None:
    """Records are dropped, doubled, put elsewhere or repeated, within any list of them."""
    lists = [own for own in _lists(records) if own]
    if not lists:
        return
    own, other = draw(one_of(lists)), draw(one_of(lists))
    k = draw(st.integers(0, len(own) - 1))
    how = draw(st.sampled_from(("drop", "double", "move", "out", "many")))
    record = own[k] if how in ("double", "many") else own.pop(k)
    if how in ("double", "move"):
        other.insert(draw(st.integers(0, len(other))), deepcopy(record))
    elif how == "out":
        records.append(record)
    elif how == "many" and len(_every(records)) < MANY_OF:
        own[k:k] = [record] * draw(st.sampled_from((10, 300)))


# Bags of ROS 1: records of ``fields``, ``data`` or ``inner`` records; "@head" and "@data" state other lengths

BAG_MAGIC = b"#ROSBAG V2.0\n"
PACKERS: dict[bytes, Callable[[bytes], bytes]] = {
    b"none": bytes,
    b"bz2": bz2.compress,
    b"lz4": lz4.frame.compress,
}
BAG_NAMES = (b"op", b"conn", b"time", b"size", b"compression", b"topic", b"index_pos", b"count", b"ver", b"x")


@cache
def bag_records(kind: str) -> list[Record]:
    """Return the records of a bag as rosbags writes it; not to be changed."""
    return _read_bag(of.bag(kind)[len(BAG_MAGIC) :])


def _read_bag(data: bytes) -> list[Record]:
    records, at = [], 0
    while at < len(data):
        head, at = _with_length(data, at)
        content, at = _with_length(data, at)
        fields, place = [], 0
        while place < len(head):
            pair, place = _with_length(head, place)
            name, _, value = pair.partition(b"=")
            fields.append((name, value))
        record: Record = {"fields": fields, "data": content}
        values = dict(fields)
        if values[b"op"] == b"\x05":
            unpacked = {b"none": bytes, b"bz2": bz2.decompress, b"lz4": lz4.frame.decompress}
            record[INNER] = _read_bag(unpacked[values[b"compression"]](content))
        records.append(record)
    return records


def _with_length(data: bytes, at: int) -> tuple[bytes, int]:
    (length,) = struct.unpack_from("<I", data, at)
    return data[at + 4 : at + 4 + length], at + 4 + length


def bag_bytes(records: list[Record]) -> bytes:
    """Return records as a bag stores them; a chunk's size is right unless "@size" says otherwise."""
    return b"".join(map(_bag_record, records))


def _bag_record(record: Record) -> bytes:
    fields, data = record["fields"], record["data"]
    if INNER in record:
        content = bag_bytes(record[INNER])
        packer = PACKERS.get(record.get("@packer", dict(fields).get(b"compression", b"none")), bytes)
        data = record.get("@packed", packer(record.get("@content", content)))
        size = struct.pack("<I", record.get("@size", len(content)) % (1 << 32))
        fields = [(name, size if name == b"size" and len(value) == 4 else value) for name, value in fields]
    pairs = [name + b"=" + value for name, value in fields]
    head = record.get("@fields", b"".join(struct.pack("<I", len(pair)) + pair for pair in pairs))
    lengths = (record.get("@head", len(head)) % (1 << 32), record.get("@data", len(data)) % (1 << 32))
    return struct.pack("<I", lengths[0]) + head + struct.pack("<I", lengths[1]) + data


@composite
def changed_bag(draw: st.DrawFn) -> bytes:
    """A bag some of whose records have other fields, data, lengths, places or compression; perhaps cut."""
    records = deepcopy(bag_records(draw(st.sampled_from(sorted(key.decode() for key in PACKERS)))))
    for _ in range(draw(st.integers(1, 4))):
        change = draw(
            st.sampled_from((_bag_field, _bag_field, _bag_field, _bag_data, _moved, _bag_chunk, _bag_lengths))
        )
        change(draw, records)
    data = BAG_MAGIC + bag_bytes(records)
    return data[: draw(st.integers(0, len(data)))] if draw(st.integers(0, 9)) == 0 else data


def _bag_field(draw: st.DrawFn, records: list[Record]) -> None:
    record = draw(one_of(_every(records)))
    fields = record["fields"]
    how = draw(st.sampled_from(("value", "value", "op", "drop", "drop", "rename", "double", "new", "bytes")))
    value = st.one_of(
        packed_numbers(), st.binary(max_size=9), texts().map(utf8), st.sampled_from(sorted(PACKERS))
    )
    if how == "new" or not fields:
        fields.append((draw(st.sampled_from(BAG_NAMES)), draw(value)))
        return
    k = draw(st.integers(0, len(fields) - 1))
    name, before = fields[k]
    if how == "value":
        fields[k] = (name, draw(st.one_of(value, changed_bytes(before))))
    elif how == "op":
        record["fields"] = [(n, bytes([draw(st.integers(0, 9))]) if n == b"op" else v) for n, v in fields]
    elif how == "drop":
        del fields[k]
    elif how == "rename":
        fields[k] = (draw(st.sampled_from(BAG_NAMES)), before)
    elif how == "double":
        fields.append((name, draw(value)))
    else:
        record["@fields"] = draw(st.one_of(st.binary(max_size=30), packed_numbers()))


def _bag_data(draw: st.DrawFn, records: list[Record]) -> None:
    record = draw(one_of(_every(records)))
    if INNER in record:
        record["@content"] = draw(changed_bytes(bag_bytes(record[INNER])))
    else:
        record["data"] = draw(st.one_of(changed_bytes(record["data"]), st.binary(max_size=12)))


def _bag_chunk(draw: st.DrawFn, records: list[Record]) -> None:
    chunks = [record for record in records if INNER in record]
    if not chunks:
        return
    chunk = draw(one_of(chunks))
    how = draw(st.sampled_from(("size", "packer", "packed", "bomb", "open", "nested")))
    if how == "size":
        chunk["@size"] = draw(integers())
    elif how == "packer":
        chunk["@packer"] = draw(st.sampled_from(sorted(PACKERS)))
    elif how == "packed":
        packed = PACKERS[draw(st.sampled_from(sorted(PACKERS)))](bag_bytes(chunk[INNER]))
        chunk["@packed"] = draw(changed_bytes(packed))
    elif how == "bomb":
        chunk["@packed"] = bomb("lz4", 64)
        chunk["fields"] = [(n, b"lz4" if n == b"compression" else v) for n, v in chunk["fields"]]
        chunk["@size"] = draw(st.sampled_from((64 << 20, 0, 1 << 31)))
    elif how == "open":
        at = records.index(chunk)
        records[at : at + 1] = chunk[INNER]
    else:
        chunk[INNER] = [*chunk[INNER], deepcopy(chunk)]


def _bag_lengths(draw: st.DrawFn, records: list[Record]) -> None:
    record = draw(one_of(_every(records)))
    record[draw(st.sampled_from(("@head", "@data")))] = draw(integers())


# Databases of ROS 2: tables of columns, and rows

KINDS = (
    "INTEGER",
    "TEXT",
    "BLOB",
    "REAL",
    "NUMERIC",
    "",
    "INTEGER PRIMARY KEY",
    "TEXT COLLATE NOCASE",
    "ANY",
)
TABLE_ENDS = ("", "", "", " STRICT", " WITHOUT ROWID")
COLUMN_NAMES = ("id", "name", "type", "topic_id", "timestamp", "data", "rowid", "\u00e9", "a b", "x\u202ey")
PAGE_SIZES = (512, 1024, 4096, 65536)
PAGE_BYTES = 4096
NOT_UTF8 = b"\xff\xfe"
STATEMENTS = (
    "CREATE VIEW messages AS SELECT 1 AS topic_id, 2 AS timestamp, x'00' AS data",
    "CREATE VIEW topics AS SELECT 1 AS id, '/a' AS name, 'x' AS type, 'cdr' AS serialization_format",
    "CREATE TABLE message_definitions(topic_type TEXT, encoding TEXT, encoded_message_definition TEXT)",
    "INSERT INTO message_definitions VALUES ('sensor_msgs/msg/Image', 'ros2msg', 'x y')",
    "INSERT INTO message_definitions VALUES (x'ff', 1, NULL)",
    "CREATE INDEX own ON messages(topic_id)",
    "CREATE INDEX part ON messages(timestamp) WHERE topic_id > 0",
    "CREATE INDEX computed ON messages(length(data))",
    "CREATE TRIGGER fires AFTER INSERT ON messages BEGIN DELETE FROM topics; END",
    "CREATE VIRTUAL TABLE extra USING fts5(a)",
    "ALTER TABLE messages ADD COLUMN more AS (hex(data))",
    "ALTER TABLE topics RENAME COLUMN name TO called",
    "DROP TABLE messages",
    "DELETE FROM topics",
    "UPDATE messages SET topic_id = CAST(topic_id AS TEXT)",
    "UPDATE messages SET data = NULL",
    "PRAGMA user_version = -1",
)


def _tables() -> dict[str, tuple[list[list[str]], list[list[Any]]]]:
    """The tables of a database as rosbags writes it, each its columns (name, kind) and its rows."""
    tables = {}
    with closing(sqlite3.connect(":memory:")) as database:
        database.deserialize(of.bag("db3"))
        for name in ("topics", "messages", "message_definitions"):
            columns = [[row[1], row[2]] for row in database.execute(f"PRAGMA table_info({name})")]
            if columns:
                rows = database.execute(f"SELECT * FROM {name}").fetchall()
                tables[name] = (columns, [list(row) for row in rows])
    return tables


@composite
def changed_database(draw: st.DrawFn) -> bytes:
    """A database of other columns, kinds, rows, statements, encodings, names or pages."""
    tables = deepcopy(_tables())
    statements: list[str] = []
    for _ in range(draw(st.integers(1, 4))):
        columns, rows = tables[draw(st.sampled_from(sorted(tables)))]
        change = draw(st.sampled_from((_db3_column, _db3_column, _db3_row, _db3_row, None)))
        if change is None:
            statements.append(draw(st.sampled_from(STATEMENTS)))
        else:
            change(draw, columns, rows)
    data = _database(tables, statements, draw(st.sampled_from(PAGE_SIZES)), draw(st.integers(0, 9)) == 0)
    how = draw(st.sampled_from(("whole", "whole", "whole", "name", "name", "pages", "bytes")))
    if how == "name":  # of a table or column, or a text, in bytes that are not UTF-8
        word = draw(st.sampled_from((b"timestamp", b"topic_id", b"topics", b"data", b"CREATE", b"/camera")))
        return data.replace(word, NOT_UTF8 + word[len(NOT_UTF8) :])
    if how == "pages":
        out = bytearray(data)
        for _ in range(draw(st.integers(1, 4))):
            at = PAGE_BYTES * draw(st.integers(0, len(out) // PAGE_BYTES)) + draw(st.integers(0, 120))
            new = draw(packed_numbers())
            out[at : at + len(new)] = new
        return bytes(out)
    return draw(changed_bytes(data)) if how == "bytes" else data


def _db3_column(draw: st.DrawFn, columns: list[list[str]], rows: list[list[Any]]) -> None:
    """A column is of another kind or name, or there is one more."""
    how = draw(st.sampled_from(("kind", "kind", "kind", "name", "column")))
    k = draw(st.integers(0, len(columns) - 1))
    if how == "kind":
        columns[k][1] = draw(st.sampled_from(KINDS))
    elif how == "name":
        columns[k][0] = draw(st.sampled_from(COLUMN_NAMES))
    else:
        columns.insert(k, [draw(st.sampled_from(COLUMN_NAMES)), draw(st.sampled_from(KINDS))])
        for row in rows:
            row.insert(k, None)


def _db3_row(draw: st.DrawFn, columns: list[list[str]], rows: list[list[Any]]) -> None:
    """A row has another value, is there many times, or its data is compressed."""
    if not rows:
        return
    row = draw(one_of(rows))
    how = draw(st.sampled_from(("value", "value", "value", "many", "zstd")))
    if how == "value":
        k = draw(st.integers(0, len(columns) - 1))
        row[k] = draw(_values(row[k]))
    elif how == "many":
        rows.extend([list(row)] * draw(st.sampled_from((1, 2, 500))))
    elif isinstance(row[-1], bytes):
        row[-1] = draw(st.sampled_from((zstandard.compress(row[-1]), bomb("zstd", 300))))


def _values(before: Any) -> st.SearchStrategy[Any]:
    odd = st.sampled_from(
        (None, -1, 0, 2**63 - 1, -(2**63), 1e308, float("inf"), "2", "x", b"", b"2", b"\xff")
    )
    changed = changed_bytes(before if isinstance(before, bytes) else b"0")
    return st.one_of(odd, changed, texts().filter(lambda text: "\ud800" not in text))


def _database(
    tables: dict[str, tuple[list[list[str]], list[list[Any]]]], statements: list[str], page: int, utf16: bool
) -> bytes:
    """The file of a database; statements that SQLite refuses are left out."""
    with closing(sqlite3.connect(":memory:")) as database:
        database.execute(f"PRAGMA page_size = {page}")
        if utf16:
            database.execute("PRAGMA encoding = 'UTF-16le'")
        for name, (columns, rows) in tables.items():
            words = ", ".join(f'"{column}" {kind}' for column, kind in columns)
            for end in ("", *TABLE_ENDS):
                with suppress(sqlite3.Error):
                    database.execute(f"CREATE TABLE {name}({words}){end}")
                    break
            for row in rows:
                with suppress(sqlite3.Error, OverflowError):
                    database.execute(f"INSERT INTO {name} VALUES ({', '.join('?' * len(row))})", row)
        for statement in statements:
            with suppress(sqlite3.Error):
                database.execute(statement)
        database.commit()
        return database.serialize()


# metadata.yaml

METADATA = """rosbag2_bagfile_information:
  version: 9
  storage_identifier: sqlite3
  relative_file_paths:
    - r_0.db3
    - r_1.db3
  duration:
    nanoseconds: 165000000
  topics_with_message_count:
    - topic_metadata:
        name: /camera/depth/image_rect_raw
        type: sensor_msgs/msg/Image
        serialization_format: cdr
      message_count: 6
  files:
    - path: r_0.db3
      message_count: 6
"""
METADATA_PIECES = (
    "a" * 400_000,
    ".db3" * 100_000,
    "a.db3/" * 50_000,
    "a.mcap" * 50_000,
    "'" * 300_000,
    "- a.db3 " * 40_000,
    "[" * 100_000,
    "\\" * 100_000,
    "x" * 300 + ".mcap",
    "../../etc/passwd.db3",
    "\x1b[2J.db3",
    "\u202e.mcap",
    "&a [*a, *a]",
    "!!python/object/apply:os.system ['id>pwned']",
    "r_0.db3.zstd",
)


@composite
def changed_metadata(draw: st.DrawFn) -> bytes:
    """metadata.yaml with other words, lines and bytes, also long ones."""
    data: bytes = draw(changed_text(METADATA, METADATA_PIECES))
    return data * draw(st.sampled_from((1, 1, 1, max(1, 1_000_000 // (len(data) + 1)))))


# Matroska: elements of an ``id`` with ``data`` or ``inner`` elements; "@size" states another size

EBML, SEGMENT, INFO, TRACKS, TRACK, VIDEO = 0x1A45DFA3, 0x18538067, 0x1549A966, 0x1654AE6B, 0xAE, 0xE0
CLUSTER, BLOCK, ATTACHMENTS, FILE, FILE_DATA = 0x1F43B675, 0xA3, 0x1941A469, 0x61A7, 0x465C
CODEC, PRIVATE, TRACK_NAME = 0x86, 0x63A2, 0x536E
NUMBERS = {
    "of tracks": (0xD7, 0x73C5, 0x83, 0x23E383, 0x55EE, 0x6DE7, 0x9C, 0x55AA),
    "of video": (0xB0, 0xBA, 0x54B0, 0x54BA, 0x54B2, 0x9A, 0x53B8, 0x53C0),
    "of clusters": (0xE7, 0x2AD7B1, 0x4489, 0x9B, 0xA7),
}
CODEC_NAMES = (
    *("V_MS/VFW/FOURCC", "V_UNCOMPRESSED", "V_MJPEG", "V_FFV1", "V_MPEG4/ISO/AVC", "V_MPEGH/ISO/HEVC"),
    *(
        "V_VP9",
        "V_AV1",
        "V_THEORA",
        "V_PRORES",
        "V_SNOW",
        "V_REAL/RV40",
        "V_QUICKTIME",
        "A_AAC",
        "S_TEXT/UTF8",
    ),
)
FOURCCS = (
    *(b"MPNG", b"b16g", b"MJPG", b"FFV1", b"H264", b"WMV3", b"Y16 ", b"BGR\x18", b"DIVX", b"gif "),
    *(b"M8RG", b"cvid", b"SNOW", b"FSV1", b"ULRG", b"HFYU", b"MSVC", b"DIV3", b"\0\0\0\0"),
)
TITLES = ("DEPTH", "IR", "COLOR", "", "\x1b[2J")
SIZE = (320, 288)


@cache
def pictures() -> tuple[bytes, ...]:
    """Frames of a Kinect in PNG, the first three as they should be, the others of other formats and sizes."""
    depth = codes(0, SIZE)
    blank = np.full((*depth.shape, 3), 90, np.uint8)
    others = [depth.astype(np.uint8), blank, np.dstack([blank, blank[..., :1]]), blank.astype(np.uint16) << 8]
    others += [
        np.dstack([blank, blank[..., :1]]).astype(np.uint16),
        depth[:100],
        depth[:, :100],
        depth[:1, :1],
    ]
    images = [*(codes(number, SIZE) for number in range(3)), *others]
    return tuple(bytes(cv2.imencode(".png", image)[1]) for image in images)


def matroska(pictures_of: tuple[bytes, ...], attached: bytes, title: str = "DEPTH") -> list[Record]:
    """Return the elements of a recording of a Kinect whose depth is in PNG."""
    head = struct.pack("<IiiHH4sI", 40, *SIZE, 1, 24, b"MPNG", 0) + bytes(16)
    video = {"id": VIDEO, INNER: [_number(0xB0, SIZE[0]), _number(0xBA, SIZE[1])]}
    track = [_number(0xD7, 1), _number(0x73C5, 7), _number(0x83, 1), _number(0x23E383, 33_000_000)]
    track += [{"id": TRACK_NAME, "data": title.encode()}, {"id": CODEC, "data": b"V_MS/VFW/FOURCC"}]
    track += [{"id": PRIVATE, "data": head}, video]
    file = [{"id": 0x466E, "data": b"calibration.json"}, {"id": 0x4660, "data": b"application/json"}]
    file += [{"id": FILE_DATA, "data": attached}, _number(0x46AE, 5)]
    blocks = [
        {"id": BLOCK, "data": b"\x81" + struct.pack(">hB", 33 * number, 0x80) + data}
        for number, data in enumerate(pictures_of)
    ]
    inner = [
        {"id": INFO, INNER: [_number(0x2AD7B1, 1_000_000)]},
        {"id": TRACKS, INNER: [{"id": TRACK, INNER: track}]},
        {"id": ATTACHMENTS, INNER: [{"id": FILE, INNER: file}]},
        {"id": CLUSTER, INNER: [_number(0xE7, 0), *blocks]},
    ]
    return [
        {"id": EBML, INNER: [_number(0x4286, 1), {"id": 0x4282, "data": b"matroska"}, _number(0x4287, 4)]},
        {"id": SEGMENT, INNER: inner},
    ]


def _number(identity: int, value: int) -> Record:
    return {"id": identity, "data": value.to_bytes(max(1, (value.bit_length() + 7) // 8), "big")}


def matroska_bytes(elements: list[Record]) -> bytes:
    """Return elements as they are stored."""
    return b"".join(map(_element, elements))


def _element(element: Record) -> bytes:
    data = element["data"] if "data" in element else matroska_bytes(element[INNER])
    identity = element["id"].to_bytes(max(1, (element["id"].bit_length() + 7) // 8), "big")
    size = (element.get("@size", len(data)) % (1 << 56)) | 1 << 56
    return identity + size.to_bytes(8, "big") + data


@composite
def changed_matroska(draw: st.DrawFn) -> bytes:
    """A Kinect's file with frames, codecs, sizes, numbers, titles, elements or the calibration changed."""
    frames = [draw(one_of(pictures()[:3])), *draw(st.lists(one_of(pictures()), max_size=5))]
    attached = json.dumps(calibration()).encode()
    if draw(st.integers(0, 4)) == 0:
        attached = utf8(json_text(draw(changed_tree(calibration()))))
    title = draw(st.sampled_from(("DEPTH",) * 6 + TITLES))
    elements = matroska(tuple(frames), attached, title)
    for _ in range(draw(st.integers(0, 4))):
        change = draw(
            st.sampled_from((_mkv_number, _mkv_number, _mkv_codec, _mkv_frame, _mkv_size, _moved, _mkv_data))
        )
        change(draw, elements)
    data = matroska_bytes(elements)
    return data[: draw(st.integers(0, len(data)))] if draw(st.integers(0, 9)) == 0 else data


def _mkv_number(draw: st.DrawFn, elements: list[Record]) -> None:
    """A number of a track, of its video or of a cluster is another, or is added."""
    kind = draw(st.sampled_from(sorted(NUMBERS)))
    identity = draw(st.sampled_from(NUMBERS[kind]))
    element = {"id": identity, "data": draw(st.one_of(packed_numbers(), st.binary(max_size=8)))}
    places = {"of tracks": TRACK, "of video": VIDEO, "of clusters": CLUSTER}
    own = [each[INNER] for each in _every(elements) if each["id"] == places[kind] and INNER in each]
    if own:
        chosen = draw(one_of(own))
        chosen[:] = [each for each in chosen if each["id"] != identity] + [element]


def _mkv_codec(draw: st.DrawFn, elements: list[Record]) -> None:
    for element in _every(elements):
        if element["id"] == CODEC and draw(st.booleans()):
            element["data"] = draw(st.sampled_from(CODEC_NAMES)).encode()
        elif element["id"] == PRIVATE:
            head = bytearray(element["data"].ljust(40, b"\0"))
            head[16:20] = draw(st.sampled_from(FOURCCS))
            element["data"] = bytes(head)


def _mkv_frame(draw: st.DrawFn, elements: list[Record]) -> None:
    blocks = [each for each in _every(elements) if each["id"] == BLOCK]
    if blocks:
        block = draw(one_of(blocks))
        block["data"] = draw(
            st.one_of(changed_bytes(block["data"]), one_of([block["data"][:4] + data for data in pictures()]))
        )


def _mkv_size(draw: st.DrawFn, elements: list[Record]) -> None:
    """An element states another size, or that it does not know it."""
    element = draw(one_of(_every(elements)))
    element["@size"] = draw(st.one_of(integers(), st.just((1 << 56) - 1)))


def _mkv_data(draw: st.DrawFn, elements: list[Record]) -> None:
    element = draw(one_of(_every(elements)))
    data = element.get("data") or matroska_bytes(element.get(INNER, []))
    element["data"] = draw(st.one_of(changed_bytes(data), texts().map(utf8)))
