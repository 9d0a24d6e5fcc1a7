"""Image files that are damaged: told by an exception, and by nothing else."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest

from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.image_files import PNG_SIGNATURE, decode_any, decode_codes, encode_png

CODES = np.random.default_rng(0).integers(0, 999, (30, 40)).astype(np.uint16)


def damaged() -> list[bytes]:
    """A PNG with one bit flipped, everywhere behind the signature; and cut, also right before its end."""
    whole = encode_png(CODES)
    images = [whole[:cut] for cut in (9, 20, 60, len(whole) // 2, len(whole) - 12, len(whole) - 1)]
    for position in range(8, len(whole), 31):
        flipped = bytearray(whole)
        flipped[position] ^= 0x10
        images.append(bytes(flipped))
    return images


def test_a_whole_image_is_decoded() -> None:
    np.testing.assert_array_equal(decode_codes(encode_png(CODES), "x"), CODES)


def test_every_damage_is_found_and_no_library_prints_about_it(capfd: pytest.CaptureFixture[str]) -> None:
    for data in damaged():
        with pytest.raises(UnreadableImageError):
            decode_codes(data, "x")
    assert capfd.readouterr() == ("", "")


def png_of(width: int, height: int) -> bytes:
    """A whole 8-bit grey PNG of zeros."""

    def part(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )

    compress = zlib.compressobj(9)
    rows = b"".join(compress.compress(bytes(1 + width)) for _ in range(height)) + compress.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return PNG_SIGNATURE + part(b"IHDR", head) + part(b"IDAT", rows) + part(b"IEND", b"")


def bmp_of(width: int, height: int) -> bytes:
    """The head of a 24-bit BMP, without its pixels."""
    return b"BM" + struct.pack("<IIIIiiHHIIIIII", 54, 0, 54, 40, width, height, 1, 24, *[0] * 6) + bytes(99)


def tiff_of(width: int, height: int, tile: int | None = None) -> bytes:
    """An 8-bit grey TIFF of zeros, in strips or tiles."""
    data = zlib.compress(bytes(width * height if tile is None else tile * tile))
    data += bytes(len(data) % 2)
    strips = {273: 8, 278: height, 279: len(data)}
    tiles = {322: tile, 323: tile, 324: 8, 325: len(data)}
    entries = {256: width, 257: height, 258: 8, 259: 8, 262: 1, 277: 1} | (strips if tile is None else tiles)
    packed = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in sorted(entries.items()))
    start = struct.pack("<I", 8 + len(data))
    return b"II*\0" + start + data + struct.pack("<H", len(entries)) + packed + bytes(4)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (png_of(20_000, 2_000), "more than 33554432 pixels"),
        (bmp_of(20_000, 20_000), "more than 33554432 pixels"),
        (b"P5 20000 20000 255\n" + bytes(99), "more than 33554432 pixels"),
        (tiff_of(16, 16, tile=4096), "tiles of more than 4194304 pixels"),
        (b"GIF89a" + bytes(99), "unsupported image format"),
        (b"v/1\x01" + bytes(99), "unsupported image format"),
        (PNG_SIGNATURE + png_of(1, 1)[-12:], "cannot be decoded"),
    ],
)
def test_images_beyond_all_bounds_are_not_decoded(data: bytes, reason: str) -> None:
    with pytest.raises(UnreadableImageError, match=reason):
        decode_any(data)


def test_images_within_the_bounds_are_decoded() -> None:
    assert decode_any(png_of(7680, 4320)).shape == (4320, 7680)
    assert decode_any(tiff_of(16, 16, tile=128)).shape == (16, 16)
    assert decode_any(tiff_of(16, 16)).shape == (16, 16)


def test_a_jpeg_of_many_scans_is_not_decoded() -> None:
    image = np.random.default_rng(1).integers(0, 255, (64, 64), np.uint8)
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    assert decode_any(data).shape == (64, 64)
    last = data[data.rfind(b"\xff\xda") : -2]
    with pytest.raises(UnreadableImageError, match="more than 30 scans"):
        decode_any(data[:-2] + 30 * last + data[-2:])
