"""Small files that state to be large, made without ever being so."""

from __future__ import annotations

import bz2
import sqlite3
import struct
import zlib
from contextlib import closing
from functools import cache, reduce
from operator import xor

import lz4.block

from hostile.file_cases import npy_bytes, png_file

MIB = 1 << 20
_RLE_BYTES = 1 << 17


@cache
def zstd_zeros(mebibytes: int) -> bytes:
    """Return a zstd frame of zeros, 4 bytes for each 128 KiB (RFC 8878, 3.1.1)."""
    size = mebibytes * MIB
    head = struct.pack("<IBBQ", 0xFD2FB528, 0xC0, 0x38, size)  # 8 bytes of content size; window of 128 KiB
    block = (_RLE_BYTES << 3 | 1 << 1).to_bytes(3, "little") + b"\0"
    last = (_RLE_BYTES << 3 | 1 << 1 | 1).to_bytes(3, "little") + b"\0"
    return head + block * (size // _RLE_BYTES - 1) + last


@cache
def lz4_zeros(mebibytes: int) -> bytes:
    """Return an lz4 frame of zeros in independent blocks of 4 MiB; 1/255 of what it states."""
    block = lz4.block.compress(bytes(4 * MIB), store_size=False)
    # version 1, independent blocks, no sums; blocks of 4 MiB; the header's checksum is that of these two
    head = struct.pack("<I", 0x184D2204) + b"\x60\x70\x73"
    return head + (struct.pack("<I", len(block)) + block) * (mebibytes // 4) + struct.pack("<I", 0)


@cache
def tiff_of_one_page() -> bytes:
    """Return a TIFF of 700 directories that all show one strip of 2 kB: 1024 x 1024 pixels of zeros."""
    strip = zlib.compress(bytes(2 << 20), 9)
    tags = {256: 1024, 257: 1024, 258: 16, 259: 8, 262: 1, 273: 8, 277: 1, 278: 1024, 279: len(strip)}
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    start, size = 8 + len(strip), 2 + len(entries) + 4
    pages = (
        struct.pack("<H", len(tags)) + entries + struct.pack("<I", start + (k + 1) * size) for k in range(700)
    )
    return b"II*\0" + struct.pack("<I", start) + strip + b"".join(pages)


@cache
def tiff_of_overlapping_directories() -> bytes:
    """Return a TIFF of 900 kB, every second byte of which begins a directory of 1024 entries."""
    words = [struct.pack("<H", 1024)] * 450_000
    return b"II*\0" + struct.pack("<I", 8) + b"".join(words)


def _deflated_zeros(mebibytes: int, tail: bytes = b"") -> bytes:
    """Return a raw deflate stream of zeros and a tail: one block, repeated."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    block = packer.compress(bytes(MIB)) + packer.flush(zlib.Z_FULL_FLUSH)
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    return block * mebibytes + packer.compress(tail) + packer.flush()


@cache
def png_zeros(side: int, depth: int) -> bytes:
    """Return a whole grey PNG that is black."""
    size = side * (1 + side * depth // 8)
    mebibytes, rest = divmod(size, MIB)
    packed = b"\x78\xda" + _deflated_zeros(mebibytes, bytes(rest))
    adler = ((size % 65521) << 16) | 1
    return png_file(side, side, depth, 0, packed + struct.pack(">I", adler))


def bz2_zeros(mebibytes: int) -> bytes:
    """Return a bz2 stream of zeros: one block of a mebibyte, repeated bit by bit, and the sum over all."""
    one = bz2.compress(bytes(MIB))
    bits = f"{int.from_bytes(one, 'big'):0{8 * len(one)}b}"
    end = bits.rindex(f"{0x177245385090:048b}")  # what the stream ends with
    head, block, crc, total = bits[:32], bits[32:end], int(bits[80:112], 2), 0
    for _ in range(mebibytes):
        total = (total << 1 & 0xFFFFFFFF | total >> 31) ^ crc
    whole = head + block * mebibytes + bits[end : end + 48] + f"{total:032b}"
    whole += "0" * (-len(whole) % 8)
    return int(whole, 2).to_bytes(len(whole) // 8, "big")


def _sum_before_zeros(head: bytes, mebibytes: int) -> int:
    """The CRC-32 of bytes and zeros behind them; what a mebibyte makes of each bit of it adds up."""
    block = bytes(MIB)
    of_nothing = zlib.crc32(block, 0)
    of_bits = [zlib.crc32(block, 1 << bit) ^ of_nothing for bit in range(32)]
    crc = zlib.crc32(head)
    for _ in range(mebibytes):
        crc = reduce(xor, (changed for bit, changed in enumerate(of_bits) if crc >> bit & 1), of_nothing)
    return crc


@cache
def npz_zeros(mebibytes: int, name: str) -> bytes:
    """Return an npz file of one array of zeros."""
    head = npy_bytes(str({"descr": "|u1", "fortran_order": False, "shape": (mebibytes * MIB,)}), b"")
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = packer.compress(head) + packer.flush(zlib.Z_FULL_FLUSH) + _deflated_zeros(mebibytes)
    crc, encoded = _sum_before_zeros(head, mebibytes), name.encode()
    about = (20, 0, 8, 0, 33, crc, len(packed), len(head) + mebibytes * MIB, len(encoded), 0)
    local = struct.pack("<4s5H3I2H", b"PK\3\4", *about) + encoded + packed
    central = struct.pack("<4s6H3I5H2I", b"PK\1\2", 20, *about, 0, 0, 0, 0, 0) + encoded
    end = struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 1, 1, len(central), len(local), 0)
    return local + central + end


# Bags


def bag() -> bytes:
    """A small bag whose chunks are half a gigabyte of zeros, and say it, or that they are small."""
    data = bz2_zeros(512)
    head = _record(3, b" ", index_pos=bytes(8), conn_count=bytes(4), chunk_count=bytes(4))
    small, large = (struct.pack("<I", size) for size in (1000, 1 << 29))
    chunks = [_record(5, data, compression=b"bz2", size=size) for size in (small, large)]
    return b"#ROSBAG V2.0\n" + head + b"".join(chunks)


def _record(kind: int, data: bytes, **fields: bytes) -> bytes:
    pairs = {"op": bytes([kind]), **fields}
    contents = [name.encode() + b"=" + value for name, value in pairs.items()]
    head = b"".join(struct.pack("<I", len(content)) + content for content in contents)
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def bag_of(record: bytes) -> bytes:
    """A bag of one record outside chunks."""
    head = _record(3, b" ", index_pos=bytes(8), conn_count=bytes(4), chunk_count=bytes(4))
    return b"#ROSBAG V2.0\n" + head + record


SPOILED_RECORDS = {
    "a message of no connection": _record(2, b"data", time=bytes(8)),
    "a message of a short time": _record(2, b"data", conn=bytes(4), time=bytes(3)),
    "a connection of no topic": _record(7, b"", conn=bytes(4)),
    "a connection of junk": _record(7, b"ab", conn=bytes(4), topic=b"/x"),
    "a head with spare bytes": struct.pack("<I", 11) + b"\4\0\0\0op=\2abc" + bytes(4),
}
_TOPICS = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
_TOPIC = "INSERT INTO topics VALUES (1, '/a', 'sensor_msgs/msg/Image', 'cdr')"
_ROWS = "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1), (1, 2), (1, 3)"
TEXT_TOPICS = (
    _TOPICS,
    _TOPIC,
    "CREATE TABLE messages(topic_id TEXT, timestamp INTEGER, data BLOB)",
    "INSERT INTO messages VALUES (1, 1, x'00'), (NULL, 1, x'00'), ('x', 'y', 'z')",
)
DATABASES = {
    "an endless view": (
        _TOPICS,
        _TOPIC,
        "CREATE VIEW messages AS WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) "
        "SELECT 1 AS topic_id, n AS timestamp, x'00' AS data FROM c",
    ),
    "computed messages": (
        _TOPICS,
        _TOPIC,
        "CREATE TABLE messages(topic_id INTEGER, timestamp INTEGER, data AS (hex(zeroblob(400000000))))",
        _ROWS,
    ),
    "messages that take long": (
        _TOPICS,
        _TOPIC,
        "CREATE TABLE messages(topic_id INTEGER, timestamp INTEGER, "
        "data AS (length(hex(zeroblob(60000000)))))",
        _ROWS,
    ),
}


@cache
def database(statements: tuple[str, ...]) -> bytes:
    """The file of a database of some statements."""
    with closing(sqlite3.connect(":memory:")) as connection:
        for statement in statements:
            connection.execute(statement)
        connection.commit()
        return connection.serialize()
