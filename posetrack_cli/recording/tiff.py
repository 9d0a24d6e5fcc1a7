"""Pages of a TIFF: their location, and each as a separate file (TIFF 6.0, sections 2, 8 and 15)."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path

from posetrack_cli import limits
from posetrack_cli.files import open_input

HEADERS = {b"II*\0": "<", b"MM\0*": ">"}  # first bytes: byte order
ENTRY_BYTES, INLINE_BYTES = 12, 4
SHORT, LONG = 3, 4
NUMBERS = {SHORT: "H", LONG: "I"}  # ``struct`` codes of the types of sizes, offsets and lengths
TYPE_BYTES = {1: 1, 2: 1, SHORT: 2, LONG: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
NEW_SUBFILE_TYPE, SUBFILE_TYPE = 254, 255
REDUCED, MASK = 1, 4  # bits of the new subfile type: thumbnail, transparency mask
OLD_REDUCED = 2
WIDTH, LENGTH, BITS, SAMPLES, SAMPLE_FORMAT = 256, 257, 258, 277, 339
KIND_TAGS = (WIDTH, LENGTH, BITS, SAMPLES, SAMPLE_FORMAT)  # pages with equal values are of one kind
# Tags of strip and tile offsets, mapped to the tags of their lengths.
PIECES = {273: 279, 324: 325}
STRIP_ROWS, PLANAR, TILE_WIDTH, TILE_LENGTH = 278, 284, 322, 323
SEPARATE_PLANES = 2
DROPPED = (330, 34665, 34853)  # tags with offsets of further directories

# One page, or all, may have this many times the bytes of their file, as equal values may be stored once.
LARGEST = 2


@dataclass(frozen=True)
class Page:
    """A page of a TIFF.

    Attributes:
        number: index in the file, from 0.
        offset: offset of its directory.
    """

    number: int
    offset: int


@dataclass(frozen=True)
class Pages:
    """The pages of a file with images of one kind.

    Attributes:
        images: pages of the most frequent size, bits and channels.
        others: number of pages of another size or kind.
    """

    images: tuple[Page, ...]
    others: int


def find_pages(path: Path) -> Pages | None:
    """Return the pages of a TIFF, None if the file is not one or its first directory is damaged.

    Thumbnails and masks are not pages. The chain of directories ends at damage, a cycle, or when the file
    is too small for its pages; with several pages the next one then counts as damaged.
    """
    try:
        with open_input(path) as stream:
            order = HEADERS.get(stream.read(4))
            return None if order is None else _found(stream, order)
    except OSError:
        return None


def page_bytes(path: Path, page: Page) -> bytes:
    """Return one page as a TIFF of its own; a damaged page gives a file that no decoder accepts.

    Raises:
        OSError: the file cannot be read.
    """
    with open_input(path) as stream:
        header = stream.read(4)
        order = HEADERS.get(header)
        if order is None:
            return b""
        directory = _directory(stream, order, page.offset)
        return b"" if directory is None else _file_of(stream, header, order, directory[0])


@dataclass(frozen=True)
class _Entry:
    """An entry of a directory.

    Attributes:
        tag, kind, count: tag, type and number of values.
        value: four bytes: the values, or their offset.
    """

    tag: int
    kind: int
    count: int
    value: bytes

    @property
    def bytes(self) -> int:
        """Length of all values."""
        return TYPE_BYTES.get(self.kind, 1) * self.count

    def short(self, order: str) -> int | None:
        """Return the first value as a number, None if it is not inline."""
        if self.bytes > INLINE_BYTES or self.kind not in NUMBERS:
            return None
        return int(struct.unpack_from(order + NUMBERS[self.kind], self.value)[0])


def _found(stream: BufferedReader, order: str) -> Pages | None:
    size = stream.seek(0, 2)
    offset = _number_at(stream, order, 4)
    pages: list[tuple[Page, object]] = []
    read, stored, number, seen = 0, 0, 0, {0}
    while offset not in seen and number < limits.TIFF_PAGES:
        seen.add(offset)
        directory = _directory(stream, order, offset)
        if directory is None:
            break
        entries, following = directory
        sizes = [entry for entry in entries if entry.tag in PIECES.values() and entry.bytes <= size]
        read += 2 + ENTRY_BYTES * len(entries) + sum(entry.bytes for entry in sizes)
        if read > size:  # directories overlap
            break
        stored += sum(sum(_values(stream, order, entry, size)) for entry in sizes)
        if stored > LARGEST * size:  # pages share their pixels
            break
        values = {entry.tag: (entry.count, entry.short(order)) for entry in entries}
        _, subfile = values.get(NEW_SUBFILE_TYPE, (1, 0))
        if not (subfile or 0) & (REDUCED | MASK) and values.get(SUBFILE_TYPE) != (1, OLD_REDUCED):
            pages.append((Page(number, offset), tuple(values.get(tag) for tag in KIND_TAGS)))
        number, offset = number + 1, following
    if not pages:
        return None
    (usual, _), *_ = Counter(kind for _, kind in pages).most_common(1)
    alike = tuple(page for page, kind in pages if kind == usual)
    damaged = (Page(number, offset),) if offset and len(alike) > 1 else ()
    return Pages(alike + damaged, len(pages) - len(alike))


def _directory(stream: BufferedReader, order: str, offset: int) -> tuple[list[_Entry], int] | None:
    """Return the entries of a directory and the offset of the next, None if truncated."""
    stream.seek(offset)
    head = stream.read(2)
    if len(head) < 2:
        return None
    (count,) = struct.unpack(f"{order}H", head)
    data = stream.read(ENTRY_BYTES * count)
    if not count or len(data) < ENTRY_BYTES * count:
        return None
    entries = [_Entry(*fields) for fields in struct.iter_unpack(f"{order}HHI4s", data)]
    return entries, _number_at(stream, order, offset + 2 + len(data))


def _number_at(stream: BufferedReader, order: str, offset: int) -> int:
    stream.seek(offset)
    return int(struct.unpack(f"{order}I", stream.read(4).ljust(4, b"\0"))[0])


def _file_of(stream: BufferedReader, header: bytes, order: str, entries: list[_Entry]) -> bytes:
    """Return a TIFF of one page with these entries; empty if the page cannot be complete."""
    size = stream.seek(0, 2)
    by_tag = {entry.tag: entry for entry in reversed(entries) if entry.tag not in DROPPED}
    kept = sorted(by_tag.values(), key=lambda entry: entry.tag)
    end = 8 + 2 + ENTRY_BYTES * len(kept) + 4
    tail, packed = bytearray(), bytearray()
    for entry in kept:
        value, kind = entry.value, entry.kind
        if entry.tag in PIECES:
            sizes = by_tag.get(PIECES[entry.tag])
            offsets = _values(stream, order, entry, size)
            counts = [] if sizes is None else _values(stream, order, sizes, size)
            if not _pieces(order, by_tag) <= len(offsets) == len(counts) or sum(counts) > size:
                return b""
            places = []
            for offset, count in zip(offsets, counts, strict=True):
                stream.seek(offset)
                places.append(end + len(tail))
                tail += stream.read(count)
            data, kind = struct.pack(f"{order}{len(places)}I", *places), LONG
        elif entry.bytes > INLINE_BYTES:
            data = _data(stream, order, entry, size)
        else:
            data = value
        if len(data) > INLINE_BYTES:
            value = struct.pack(f"{order}I", end + len(tail))
            tail += data
        else:
            value = data.ljust(INLINE_BYTES, b"\0")
        packed += struct.pack(f"{order}HHI4s", entry.tag, kind, entry.count, value)
        if end + len(tail) > min(LARGEST * size, limits.IMAGE_BYTES):
            return b""
    return b"".join(
        [header, struct.pack(f"{order}IH", 8, len(kept)), bytes(packed), bytes(INLINE_BYTES), bytes(tail)]
    )


def _pieces(order: str, by_tag: Mapping[int, _Entry]) -> int:
    """Return the minimum number of strips or tiles of a page."""

    def value(tag: int, default: int) -> int:
        found = by_tag[tag].short(order) if tag in by_tag else None
        return max(default if found is None else found, 1)

    width, length = value(WIDTH, 1), value(LENGTH, 1)
    planes = value(SAMPLES, 1) if value(PLANAR, 1) == SEPARATE_PLANES else 1
    if TILE_WIDTH in by_tag:
        return -(-width // value(TILE_WIDTH, width)) * -(-length // value(TILE_LENGTH, length)) * planes
    return -(-length // value(STRIP_ROWS, length)) * planes


def _data(stream: BufferedReader, order: str, entry: _Entry, size: int) -> bytes:
    """Return the stored values of an entry, as far as the file has them."""
    if entry.bytes <= INLINE_BYTES:
        return entry.value[: entry.bytes]
    (offset,) = struct.unpack(f"{order}I", entry.value)
    stream.seek(offset)
    return stream.read(min(entry.bytes, size))


def _values(stream: BufferedReader, order: str, entry: _Entry, size: int) -> list[int]:
    """Return the numbers of an entry, as far as the file has them."""
    code, data = NUMBERS.get(entry.kind), _data(stream, order, entry, size)
    if code is None:
        return []
    count = len(data) // TYPE_BYTES[entry.kind]
    return list(struct.unpack_from(f"{order}{count}{code}", data))
