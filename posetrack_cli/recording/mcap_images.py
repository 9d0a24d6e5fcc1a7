"""Depth images in MCAP messages: which encodings hold depth, and how to decode them."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from posetrack_cli.arrays import Float32Array, ImageArray
from posetrack_cli.mcap.decoding import COMPRESSED_IMAGE, RAW_IMAGE
from posetrack_cli.recording.depth import depth_from_codes, depth_from_metres
from posetrack_cli.recording.image_files import PNG_SIGNATURE, decode_codes
from posetrack_cli.recording.stored import DepthEncoding, UnreadableImageError

RAW_DEPTH: dict[str, DepthEncoding] = {"16UC1": "16UC1", "mono16": "16UC1", "32FC1": "32FC1"}
COMPRESSED_DEPTH_HEADER = struct.Struct("<iff")
PNG_SIZE_AND_TYPE = struct.Struct(">IIBB")
PNG_SIZE_AT = 16
PNG_COLOUR_TYPES = {0: "grey", 2: "colour", 3: "palette", 4: "grey with alpha", 6: "colour with alpha"}


@dataclass(frozen=True)
class ImageDescription:
    """What an image message holds, told without decoding its pixels.

    Attributes:
        encoding: as people name it: ``16UC1``, ``png 16-bit grey``, ``jpeg``...
        width, height: pixels; 0 if unknown.
        depth: how it stores depth, None if it does not.
    """

    encoding: str
    width: int
    height: int
    depth: DepthEncoding | None


def describe_image(decoded: Any, kind: str) -> ImageDescription:
    """Describe an image message of kind RAW_IMAGE or COMPRESSED_IMAGE."""
    if kind == RAW_IMAGE:
        encoding = str(decoded.encoding)
        return ImageDescription(encoding, int(decoded.width), int(decoded.height), RAW_DEPTH.get(encoding))
    return _describe_compressed(str(decoded.format), bytes(decoded.data))


def decode_depth(decoded: Any, kind: str, where: str) -> Float32Array:
    """Return the (height, width) depth of an image message, mm, 0 = no reading.

    Raises:
        UnreadableImageError: if the data are too short or damaged, or are no depth.
    """
    if kind == COMPRESSED_IMAGE:
        return _decode_compressed(decoded, where)
    pixels = _raw_pixels(decoded)
    return depth_from_metres(pixels) if pixels.dtype.kind == "f" else depth_from_codes(pixels)


def millimetre_png(decoded: Any, kind: str) -> bytes | None:
    """Return the 16-bit PNG of depth in mm that a message carries, None if it does not carry one."""
    if kind != COMPRESSED_IMAGE:
        return None
    data = bytes(decoded.data)
    if _describe_compressed(str(decoded.format), data).depth != "16UC1":
        return None
    return data[_png_offset(data) :]


def _raw_pixels(decoded: Any) -> ImageArray:
    """Return the (height, width) pixels of a raw image; rows may be padded to ``step`` bytes."""
    if decoded.encoding not in RAW_DEPTH:
        raise UnreadableImageError(f"encoding {decoded.encoding} is no depth")
    order = ">" if getattr(decoded, "is_bigendian", 0) else "<"
    dtype = np.dtype(order + ("f4" if RAW_DEPTH[decoded.encoding] == "32FC1" else "u2"))
    width, height, data = int(decoded.width), int(decoded.height), bytes(decoded.data)
    step = int(decoded.step) or width * dtype.itemsize
    needed = step * (height - 1) + width * dtype.itemsize
    if min(width, height) < 1 or step < width * dtype.itemsize or len(data) < needed:
        raise UnreadableImageError(f"{len(data)} bytes do not hold {width}x{height} {decoded.encoding}")
    strided: ImageArray = np.ndarray((height, width), dtype, data, strides=(step, dtype.itemsize))
    return strided.astype(dtype.newbyteorder("="))


def _describe_compressed(image_format: str, data: bytes) -> ImageDescription:
    offset = _png_offset(data)
    if offset is None:
        return ImageDescription(image_format, 0, 0, None)
    start = offset + PNG_SIZE_AT
    width, height, bits, colour = PNG_SIZE_AND_TYPE.unpack(data[start : start + PNG_SIZE_AND_TYPE.size])
    name = f"png {bits}-bit {PNG_COLOUR_TYPES.get(colour, 'unknown')}"
    depth: DepthEncoding | None = "16UC1" if (bits, colour) == (16, 0) else None
    if offset:
        stored = image_format.split(";")[0].strip()
        name = f"{stored} compressedDepth, {name}"
        depth = RAW_DEPTH.get(stored) if depth else None
    return ImageDescription(name, width, height, depth)


def _png_offset(data: bytes) -> int | None:
    """Return where the PNG begins: 0, or after compressedDepth's header; None if there is no PNG."""
    for offset in (0, COMPRESSED_DEPTH_HEADER.size):
        header_end = offset + PNG_SIZE_AT + PNG_SIZE_AND_TYPE.size
        if data.startswith(PNG_SIGNATURE, offset) and len(data) >= header_end:
            return offset
    return None


def _decode_compressed(decoded: Any, where: str) -> Float32Array:
    data = bytes(decoded.data)
    description = _describe_compressed(str(decoded.format), data)
    if description.depth is None:
        raise UnreadableImageError(f"format {description.encoding or 'unknown'} is no depth")
    offset = _png_offset(data) or 0
    codes = decode_codes(data[offset:], where)
    if description.depth == "16UC1":
        return depth_from_codes(codes)
    return depth_from_inverse(codes, *COMPRESSED_DEPTH_HEADER.unpack(data[:offset])[1:])


def depth_from_inverse(codes: ImageArray, a: float, b: float) -> Float32Array:
    """Return depth, mm, of compressedDepth's quantised inverse depth: z = a / (v - b) metres, v = 0 none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        metres = np.where(codes > 0, a / (codes.astype(np.float64) - b), 0.0)
    return depth_from_metres(metres)
