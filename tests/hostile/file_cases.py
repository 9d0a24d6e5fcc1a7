"""Changed images, videos, meshes and npz files, whose checksums are right."""

from __future__ import annotations

import ast
import hashlib
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from hypothesis import strategies as st

from hostile import seeds
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
    trees,
    utf8,
)

Array = np.ndarray[Any, Any]

# Images


PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
PNG_HEADER = struct.Struct(">IIBBBBB")


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_file(width: int, height: int, depth: int, colour: int, data: bytes, *extra: bytes) -> bytes:
    """Return a PNG of a header that may lie, compressed rows, and further chunks in between."""
    head = PNG_HEADER.pack(width, height, depth, colour, 0, 0, 0)
    return b"".join(
        [PNG_MAGIC, png_chunk(b"IHDR", head), *extra, png_chunk(b"IDAT", data), png_chunk(b"IEND", b"")]
    )


def png_chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    chunks, place = [], len(PNG_MAGIC)
    while place + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, place)
        chunks.append((kind, data[place + 8 : place + 8 + length]))
        place += 12 + length
    return chunks


@composite
def changed_png(draw: st.DrawFn, data: bytes) -> bytes:
    """A PNG with a header field, a chunk or the compressed rows changed; CRCs are right."""
    chunks = png_chunks(data)
    for _ in range(draw(st.integers(1, 2))):
        how = draw(st.sampled_from(("header", "header", "rows", "packed", "extra", "drop", "double", "cut")))
        k = draw(st.integers(0, len(chunks) - 1))
        if how == "header":
            chunks = [
                (kind, _changed_header(draw, body) if kind == b"IHDR" else body) for kind, body in chunks
            ]
        elif how == "rows":
            size = draw(st.sampled_from((0, 1, 1000, 10**6, 3 * 10**7)))
            chunks = [
                (kind, zlib.compress(bytes(size)) if kind == b"IDAT" else body) for kind, body in chunks
            ]
        elif how == "packed":
            chunks[k] = (chunks[k][0], draw(changed_bytes(chunks[k][1])))
        elif how == "extra":
            chunks.insert(k, draw(_extra_chunk()))
        elif how == "drop" and len(chunks) > 1:
            del chunks[k]
        elif how == "double":
            chunks.insert(k, chunks[k])
    return PNG_MAGIC + b"".join(png_chunk(kind, body) for kind, body in chunks)


def _changed_header(draw: st.DrawFn, body: bytes) -> bytes:
    if len(body) != PNG_HEADER.size:
        return body
    fields = list(PNG_HEADER.unpack(body))
    k = draw(st.integers(0, len(fields) - 1))
    side = st.sampled_from((0, 1, 20000, 65535, 2**20, 2**24, 2**31 - 1, 2**31, 2**32 - 1))
    fields[k] = draw(
        side if k < 2 else st.integers(0, 255) if draw(st.booleans()) else st.sampled_from((1, 2, 4, 8, 16))
    )
    return PNG_HEADER.pack(*fields)


def _extra_chunk() -> st.SearchStrategy[tuple[bytes, bytes]]:
    bomb = zlib.compress(bytes(30_000_000), 9)
    return st.one_of(
        st.tuples(
            st.sampled_from((b"PLTE", b"tRNS", b"gAMA", b"acTL", b"fcTL", b"eXIf", b"sBIT")),
            st.binary(max_size=40),
        ),
        st.sampled_from(
            ((b"zTXt", b"a\0\0" + bomb), (b"iCCP", b"icc\0\0" + bomb), (b"iTXt", b"a\0\1\0\0\0" + bomb))
        ),
        st.tuples(st.sampled_from((b"tEXt", b"ABCD", b"abcd")), texts().map(utf8)),
    )


# Where headers of other formats hold numbers: (offset, bytes, order)
HEADERS: Mapping[str, tuple[tuple[int, int, str], ...]] = {
    ".bmp": tuple(
        (offset, 2 if offset == 28 else 4, "little") for offset in (2, 10, 14, 18, 22, 28, 30, 34, 46)
    ),
    ".webp": ((4, 4, "little"), (16, 4, "little"), (21, 4, "little"), (26, 2, "little"), (28, 2, "little")),
}


@composite
def changed_image(draw: st.DrawFn, suffix: str, image: Array) -> bytes:
    """An image file of a format, its header, EXIF or bytes changed."""
    data = seeds.encoded(suffix, image)
    if suffix in EXIF_PLACES and draw(st.integers(0, 4)) == 0:
        return EXIF_PLACES[suffix](data, draw(st.one_of(changed_bytes(EXIF), _changed_entry())))
    if suffix == ".png" and draw(st.integers(0, 4)) > 0:
        return draw(changed_png(data))
    if suffix == ".pgm" and draw(st.booleans()):
        sizes = st.sampled_from(
            ("0", "1", "64", "20000", "100000", "2147483647", "4294967296", "-1", "a", "9" * 400)
        )
        head = f"P{draw(st.integers(1, 7))}\n{draw(sizes)} {draw(sizes)}\n{draw(sizes)}\n"
        return head.encode() + draw(one_of((b"", data[20:])))
    if suffix in (".tif", ".tiff") and draw(st.booleans()):
        return _changed_tiff(draw, data)
    if suffix in (".jpg", ".jpeg") and draw(st.booleans()):
        return _changed_jpeg(draw, data)
    if suffix in HEADERS and draw(st.booleans()):
        return _changed_numbers(draw, data, HEADERS[suffix])
    return draw(changed_bytes(data))


ENTRY = struct.Struct(">HHIHH")
EXIF = b"MM\0*" + struct.pack(">IH", 8, 1) + ENTRY.pack(274, 3, 1, 6, 0) + bytes(4)
"""A directory with one entry: turned by a quarter."""


def _changed_entry() -> st.SearchStrategy[bytes]:
    """EXIF whose numbers are others."""
    short, long = st.integers(0, 2**16 - 1), st.integers(0, 2**32 - 1)
    kinds, values = st.sampled_from((0, 1, 3, 4, 65535)), st.one_of(st.integers(0, 9), short)
    return st.builds(
        lambda start, count, kind, several, value: (
            b"MM\0*" + struct.pack(">IH", start, count) + ENTRY.pack(274, kind, several, value, 0)
        ),
        *(st.one_of(st.just(8), long), st.one_of(st.just(1), short)),
        *(kinds, long, values),
    )


def _jpeg_with(data: bytes, exif: bytes) -> bytes:
    block = b"Exif\0\0" + exif
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(block) + 2 & 0xFFFF) + block + data[2:]


def _png_with(data: bytes, exif: bytes) -> bytes:
    head, *others = png_chunks(data)
    return PNG_MAGIC + b"".join(png_chunk(*chunk) for chunk in (head, (b"eXIf", exif), *others))


def _webp_with(data: bytes, exif: bytes) -> bytes:
    body = data[8:] + b"EXIF" + struct.pack("<I", len(exif)) + exif + bytes(len(exif) % 2)
    return b"RIFF" + struct.pack("<I", len(body)) + body


EXIF_PLACES = {".jpg": _jpeg_with, ".png": _png_with, ".webp": _webp_with}
"""How the formats hold EXIF."""


def _changed_numbers(draw: st.DrawFn, data: bytes, places: tuple[tuple[int, int, str], ...]) -> bytes:
    out = bytearray(data)
    for _ in range(draw(st.integers(1, 2))):
        offset, width, order = draw(st.sampled_from(places))
        number = draw(integers()) % (1 << 8 * width)
        out[offset : offset + width] = number.to_bytes(width, "little" if order == "little" else "big")
    return bytes(out)


TIFF_ENTRY = ((0, 2), (2, 2), (4, 4), (8, 4))
"""Where an entry of a directory has tag, type, count and value, and their lengths."""


def _changed_tiff(draw: st.DrawFn, data: bytes) -> bytes:
    """Entries of the directory: tag, type, count or value."""
    order = "little" if data[:2] == b"II" else "big"
    first = int.from_bytes(data[4:8], order)
    count = int.from_bytes(data[first : first + 2], order)
    places = [
        (first + 2 + 12 * k + offset, width, order) for k in range(count) for offset, width in TIFF_ENTRY
    ]
    places += [(4, 4, order), (first, 2, order), (first + 2 + 12 * count, 4, order)]
    return _changed_numbers(draw, data, tuple(p for p in places if p[0] + p[1] <= len(data)))


@composite
def changed_stack(draw: st.DrawFn, images: Array) -> bytes:
    """A TIFF of several pages, entries of any of their directories or bytes changed."""
    data = seeds.stack(images)
    if draw(st.integers(0, 3)) == 0:
        return draw(changed_bytes(data))
    places: list[tuple[int, int, str]] = [(4, 4, "little")]
    directory = int.from_bytes(data[4:8], "little")
    while directory:
        count = int.from_bytes(data[directory : directory + 2], "little")
        entries = [directory + 2 + 12 * k for k in range(count)]
        places += [(e + offset, width, "little") for e in entries for offset, width in TIFF_ENTRY]
        places += [(directory, 2, "little"), (entries[-1] + 12, 4, "little")]
        directory = int.from_bytes(data[entries[-1] + 12 : entries[-1] + 16], "little")
    return _changed_numbers(draw, data, tuple(places))


def _changed_jpeg(draw: st.DrawFn, data: bytes) -> bytes:
    """Sizes and components of the frame header, or a segment's length."""
    places: list[tuple[int, int, str]] = []
    place = 2
    while place + 4 <= len(data) and data[place] == 0xFF and data[place + 1] != 0xDA:
        marker, length = data[place + 1], int.from_bytes(data[place + 2 : place + 4], "big")
        places.append((place + 2, 2, "big"))
        if marker in (0xC0, 0xC1, 0xC2):
            places += [
                (place + 4, 1, "big"),
                (place + 5, 2, "big"),
                (place + 7, 2, "big"),
                (place + 9, 1, "big"),
            ] * 3
        place += 2 + length
    return _changed_numbers(draw, data, tuple(places))


# Videos


PLAYLISTS = (
    "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nother.avi\n#EXT-X-ENDLIST\n",
    "#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/x.ts\n",
    "#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n",
    "ffconcat version 1.0\nfile other.avi\n",
    "ffconcat version 1.0\nfile /dev/zero\n",
    "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\n"
    "a=rtpmap:96 H264/90000\n",
    '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011"><BaseURL>other.avi</BaseURL></MPD>',
    "[InternetShortcut]\nURL=file:///etc/passwd\n",
    "RTSPtext\nrtsp://127.0.0.1:9/\n",
    "other.avi\n",
    "<svg/>",
)


@composite
def changed_video(draw: st.DrawFn, data: bytes) -> bytes:
    """A video whose boxes, tables and frames are changed, or a text that leads players to other files."""
    if draw(st.integers(0, 5)) == 0:
        return utf8(draw(st.sampled_from(PLAYLISTS)))
    out = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        if draw(st.integers(0, 3)) == 0:
            out = bytearray(draw(changed_bytes(bytes(out))))
            continue
        heads = [at for at in range(0, max(0, len(out) - 8)) if bytes(out[at : at + 4]) in VIDEO_MARKS]
        if heads:
            place = draw(st.sampled_from(heads)) + draw(st.sampled_from((-4, *range(4, 84, 4))))
            new = draw(packed_numbers())
            place = max(0, place)
            out[place : place + len(new)] = new
    return bytes(out)


VIDEO_MARKS = (
    *(b"RIFF", b"avih", b"strh", b"strf", b"movi", b"idx1", b"00dc", b"LIST"),
    *(
        b"ftyp",
        b"moov",
        b"mvhd",
        b"trak",
        b"tkhd",
        b"mdhd",
        b"stts",
        b"stsz",
        b"stco",
        b"stsc",
        b"stsd",
        b"mdat",
        b"elst",
    ),
)


# Meshes


@composite
def changed_glb(draw: st.DrawFn) -> bytes:
    """A skinned hand with entries of its JSON, bytes of its numbers or the container changed."""
    text, binary = seeds.glb_parts(seeds.glb())
    how = draw(st.sampled_from(("json", "json", "json", "json", "numbers", "text", "container", "chain")))
    if how == "json":
        text = utf8(json_text(draw(changed_tree(json.loads(text)))))
    elif how == "numbers":
        binary = draw(changed_bytes(binary))
    elif how == "text":
        text = draw(changed_bytes(text))
    elif how == "chain":
        content = json.loads(text)
        count, loop = draw(st.sampled_from(((3000, False), (10, True), (1, True))))
        first = len(content["nodes"])
        content["nodes"] += [{"children": [first + k + 1]} for k in range(count)] + [
            {"children": [first] if loop else []}
        ]
        content["nodes"][draw(st.integers(0, 25))]["children"] = [first]
        text = json.dumps(content).encode()
    data = seeds.glb_bytes(text, binary)
    return draw(changed_bytes(data)) if how == "container" else data


# npz


def npz_arrays(data: bytes) -> dict[str, bytes]:
    """Return the members of an npz file by name."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def npz_bytes(
    members: list[tuple[str, bytes]], *, packed: bool = False, bomb: tuple[str, tuple[int, ...]] | None = None
) -> bytes:
    """Return an npz file; with a bomb it also has zeros of a name and shape, at most 160 MB, packed."""
    import warnings

    stream = io.BytesIO()
    kind = zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", kind) as archive:
        warnings.simplefilter("ignore")  # of two members of one name
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name or "x"), content, kind)
        if bomb is not None:
            head = npy_bytes(str({"descr": "<f8", "fortran_order": False, "shape": bomb[1]}), b"")
            size = min(int(np.prod([float(side) for side in bomb[1]])) * 8, 160_000_000)
            archive.writestr(zipfile.ZipInfo(bomb[0] or "x"), head + bytes(size), zipfile.ZIP_DEFLATED, 1)
    return stream.getvalue()


def resigned(data: bytes) -> bytes:
    """Return a state with the digest that its contents ask for: what lies behind that check is met, too.

    One that has none, or whose arrays cannot be read, stays as it is.
    """
    try:
        members = npz_arrays(data)
        arrays = {
            name.removesuffix(".npy"): np.load(io.BytesIO(content), allow_pickle=False)
            for name, content in members.items()
        }
    except Exception:  # it was changed to something else
        return data
    if arrays.pop("digest", None) is None:
        return data
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(json.dumps([name, arrays[name].dtype.str, arrays[name].shape]).encode())
        digest.update(arrays[name].tobytes())
    signed = npy_of(np.frombuffer(digest.digest(), np.uint8))
    return npz_bytes([(name, signed if name == "digest.npy" else c) for name, c in members.items()])


def npy_parts(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return header and numbers of an npy file."""
    length = int.from_bytes(data[8:10], "little")
    return ast.literal_eval(data[10 : 10 + length].decode()), data[10 + length :]


def npy_bytes(head: str, body: bytes) -> bytes:
    text = head.encode("latin-1", "replace")
    text += b" " * (-(10 + len(text) + 1) % 64) + b"\n"
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(text) & 0xFFFF) + text + body


def npy_of(array: Array) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)
    return stream.getvalue()


@composite
def changed_npz(draw: st.DrawFn, data: bytes) -> bytes:
    """An npz file with arrays of other shapes, types and numbers, or members gone, doubled or huge."""
    members = list(npz_arrays(data).items())
    for _ in range(draw(st.integers(1, 3))):
        how = draw(
            st.sampled_from(
                ("numbers", "numbers", "array", "array", "head", "json", "json", "member", "bytes", "bomb")
            )
        )
        k = draw(st.integers(0, len(members) - 1))
        name, content = members[k]
        if how == "json":
            texts_at = [i for i, (_, c) in enumerate(members) if _json_of(c) is not None]
            if texts_at:
                k = draw(st.sampled_from(texts_at))
                members[k] = (members[k][0], draw(_changed_json(members[k][1])))
        elif how == "member":
            _change_members(draw, members, k)
        elif how == "bytes":
            members[k] = (name, draw(changed_bytes(content)))
        elif how == "bomb":
            shape = draw(
                st.sampled_from(((50_000_000,), (2**31,), (2**40,), (2**63,), (0, 2**62), (1,) * 40))
            )
            return npz_bytes([*members[:k], *members[k + 1 :]], bomb=(name, shape))
        else:
            members[k] = (name, draw(_changed_npy(content, how)))
    if draw(st.integers(0, 9)) == 0:
        return draw(changed_bytes(npz_bytes(members)))
    return npz_bytes(members, packed=draw(st.booleans()))


def _change_members(draw: st.DrawFn, members: list[tuple[str, bytes]], k: int) -> None:
    how = draw(st.sampled_from(("drop", "drop", "double", "rename", "new")))
    if how == "drop" and len(members) > 1:
        del members[k]
    elif how == "rename":
        members[k] = (
            draw(st.sampled_from(("x", "x.npy", "../../pwned", "json.npy", "array..npy", "\x1b[2J"))),
            members[k][1],
        )
    else:
        members.append(members[k] if how == "double" else ("new.npy", npy_of(np.zeros(3))))


@composite
def _changed_npy(draw: st.DrawFn, content: bytes, how: str) -> bytes:
    try:
        head, body = npy_parts(content)
        array: Array = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception:  # it was changed before
        return draw(changed_bytes(content))
    if how == "head":
        shapes = ((), (1,), (2**31,), (2**62,), (-1,), (0,), tuple(array.shape[::-1]), (*array.shape, 1))
        key = draw(st.sampled_from(("shape", "descr", "fortran_order")))
        values = {
            "shape": shapes,
            "descr": ("<f8", "<f4", "|O", "<U4", ">f8", "V9", "x", "<M8[ns]"),
            "fortran_order": (True, 3),
        }
        head = {**head, key: draw(st.sampled_from(values[key]))}
        return npy_bytes(str(head), body)
    if how == "array":
        return npy_of(draw(_other_array(array)))
    values_at_edge = st.sampled_from(
        (0.0, -1.0, 1.0, 1e30, 1e300, np.nan, np.inf, 2.0**31, 2.0**62, -(2.0**62))
    )
    array = array.copy()
    if array.size and array.dtype.kind in "fiub":
        places = draw(st.lists(st.integers(0, array.size - 1), min_size=1, max_size=3))
        with np.errstate(all="ignore"):
            value = np.array(draw(values_at_edge)).astype(array.dtype)
        if draw(st.integers(0, 3)) == 0:
            array[...] = value
        else:
            array.reshape(-1)[places] = value
    return npy_of(array)


def _other_array(array: Array) -> st.SearchStrategy[Array]:
    options: list[Array] = [
        np.zeros(0),
        np.zeros(()),
        np.zeros((3, 3)),
        np.array(["a", "\x1b[2J"]),
        np.zeros(1 << 14),
    ]
    options += [array.astype(kind) for kind in ("f4", "i8", "u1", "c16", "?") if array.dtype.kind in "fiub"]
    if array.ndim:
        options += [array[:0], array[:-1], np.concatenate([array, array]), array.reshape(-1), array[None]]
    return one_of(options)


def _json_of(content: bytes) -> Any:
    """Return the JSON of an array of bytes or text, or None."""
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
        return json.loads(array.tobytes() if array.dtype == np.uint8 else str(array))
    except Exception:  # most arrays hold none
        return None


@composite
def _changed_json(draw: st.DrawFn, content: bytes) -> bytes:
    array = np.load(io.BytesIO(content), allow_pickle=False)
    tree = _json_of(content)
    if draw(st.integers(0, 4)) > 0 or not isinstance(tree, dict):
        text = json_text(draw(st.one_of(changed_tree(tree), changed_tree(tree), trees())))
    else:
        text = draw(changed_text(json.dumps(tree))).decode("utf-8", "replace")
    if array.dtype == np.uint8:
        return npy_of(np.frombuffer(utf8(text), np.uint8))
    return npy_of(np.array(text.encode("utf-8", "replace").decode()))
