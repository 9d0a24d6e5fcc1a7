"""Numbers in the EXIF of image files, and the focal length that they state (EXIF 2.3; TIFF 6.0)."""

from __future__ import annotations

import math
import struct

EXIF_BEGIN = b"Exif\0\0"
JPEG_BEGIN, JPEG_MARKERS_WITHOUT_SIZE = b"\xff\xd8", (0x01, *range(0xD0, 0xD8))
JPEG_APP1, JPEG_SCAN = 0xE1, 0xDA
TIFF_BEGIN = b"II*\0", b"MM\0*"
PNG_BEGIN, PNG_EXIF = b"\x89PNG\r\n\x1a\n", b"eXIf"
RIFF_BEGIN, WEBP_EXIF = b"RIFF", b"EXIF"
# Limit on EXIF directory entries, JPEG segments and PNG or WebP chunks.
MOST_ENTRIES = 512
SHORT, LONG, RATIONAL = 3, 4, 5
NOTHING = 0, 0.0
EXIF_DIRECTORY = 0x8769
FOCAL_MM, FOCAL_35_MM = 0x920A, 0xA405
# Pixels of the image, and pixels per unit of the sensor.
WIDTH, HEIGHT, DENSITY, DENSITY_UNIT = 0xA002, 0xA003, 0xA20E, 0xA210
UNITS_MM = {2.0: 25.4, 3.0: 10.0, 4.0: 1.0}
DIAGONAL_35_MM = math.hypot(36.0, 24.0)
# Range of focal lengths over the longer side.
LEAST_RATIO, LARGEST_RATIO = 0.2, 60.0
# Relative difference of the aspect ratios of an image and of its EXIF above which it was cropped.
SAME_ASPECT = 0.02


def focal_ratio_of_file(data: bytes, width: int, height: int) -> float | None:
    """Return the focal length over the longer side that an image's EXIF states; None if it states none.

    Args:
        data: the file.
        width, height: of the image; of another shape than in the EXIF, it was cropped.
    """
    numbers = {tag: value for tag, (_, value) in exif_numbers(data).items()}
    full = numbers.get(WIDTH, 0.0), numbers.get(HEIGHT, 0.0)
    if min(full) > 0.0:
        stated, own = max(full) / min(full), max(width, height) / min(width, height)
        if abs(stated / own - 1.0) > SAME_ASPECT:
            return None
    if numbers.get(FOCAL_35_MM, 0.0) > 0.0:
        return ratio_of_35_mm(numbers[FOCAL_35_MM], width, height)
    density = numbers.get(DENSITY, 0.0) / UNITS_MM.get(numbers.get(DENSITY_UNIT, 2.0), math.inf)
    ratio = numbers.get(FOCAL_MM, 0.0) * density / max(*full, 1.0)
    return ratio if LEAST_RATIO < ratio < LARGEST_RATIO else None


def ratio_of_35_mm(focal_mm: float, width: int, height: int) -> float | None:
    """Return the focal length over the longer side of an image, given the equivalent for 35 mm film.

    The equivalent has the same field of view along the diagonal.
    """
    ratio = focal_mm / DIAGONAL_35_MM * math.hypot(width, height) / max(width, height)
    return ratio if LEAST_RATIO < ratio < LARGEST_RATIO else None


def exif_numbers(data: bytes) -> dict[int, tuple[int, float]]:
    """Return type and value of the numbers in a TIFF, or in the EXIF of a JPEG, PNG or WebP file, by tag."""
    exif = _exif(data)
    order = {b"II": "<", b"MM": ">"}.get(exif[:2])
    if order is None or len(exif) < 8:
        return {}
    found = _directory(exif, order, struct.unpack_from(f"{order}I", exif, 4)[0])
    kind, start = found.get(EXIF_DIRECTORY, NOTHING)
    return {**_directory(exif, order, int(start)), **found} if kind == LONG else found


def _directory(exif: bytes, order: str, start: int) -> dict[int, tuple[int, float]]:
    """Return the single numbers of a directory by tag."""
    found: dict[int, tuple[int, float]] = {}
    if start + 2 > len(exif):
        return found
    (count,) = struct.unpack_from(f"{order}H", exif, start)
    for k in range(min(count, MOST_ENTRIES)):
        at = start + 2 + 12 * k
        if at + 12 > len(exif):
            break
        tag, kind, _ = struct.unpack_from(f"{order}HHI", exif, at)
        if tag in found:
            continue
        if kind == SHORT:
            found[tag] = kind, float(struct.unpack_from(f"{order}H", exif, at + 8)[0])
        elif kind == LONG:
            found[tag] = kind, float(struct.unpack_from(f"{order}I", exif, at + 8)[0])
        elif kind == RATIONAL:
            (place,) = struct.unpack_from(f"{order}I", exif, at + 8)
            if place + 8 <= len(exif):
                above, below = struct.unpack_from(f"{order}II", exif, place)
                found[tag] = kind, above / below if below else 0.0
    return found


def _exif(data: bytes) -> bytes:
    """Return the EXIF block of a file, starting at its TIFF header; empty if there is none."""
    if data.startswith(TIFF_BEGIN):
        return data
    if data.startswith(JPEG_BEGIN):
        return _jpeg_exif(data)
    if data.startswith(PNG_BEGIN):
        return _chunk(data, len(PNG_BEGIN), ">I4s", PNG_EXIF, 4, 1)
    if data.startswith(RIFF_BEGIN):
        return _chunk(data, 12, "<4sI", WEBP_EXIF, 0, 2).removeprefix(EXIF_BEGIN)
    return b""


def _jpeg_exif(data: bytes) -> bytes:
    at = len(JPEG_BEGIN)
    for _ in range(MOST_ENTRIES):
        if at + 4 > len(data) or data[at] != 0xFF:
            return b""
        marker = data[at + 1]
        if marker == 0xFF or marker in JPEG_MARKERS_WITHOUT_SIZE:
            at += 1 if marker == 0xFF else 2
            continue
        size = int.from_bytes(data[at + 2 : at + 4], "big")
        content = data[at + 4 : at + 2 + size]
        if marker == JPEG_SCAN or size < 2:
            return b""
        if marker == JPEG_APP1 and content.startswith(EXIF_BEGIN):
            return content.removeprefix(EXIF_BEGIN)
        at += 2 + size
    return b""


def _chunk(data: bytes, at: int, head: str, wanted: bytes, checksum: int, even: int) -> bytes:
    """Return the content of a PNG or RIFF chunk; ``head`` is length and type in either order."""
    for _ in range(MOST_ENTRIES):
        if at + 8 > len(data):
            break
        first, second = struct.unpack_from(head, data, at)
        length, kind = (first, second) if isinstance(first, int) else (second, first)
        if kind == wanted:
            return data[at + 8 : at + 8 + length]
        at += 8 + length + checksum
        at += -at % even
    return b""
