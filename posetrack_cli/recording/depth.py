"""Depth images: which stored values and messages hold depth, and how they become millimetres."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.mcap.decoding import COMPRESSED_IMAGE, DISPARITY_IMAGE, RAW_IMAGE, VIDEO_IMAGE
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.image_files import PNG_SIGNATURE, PNG_SIZE_AT, decode_codes
from posetrack_cli.recording.pixels import check_size, raw_values

DepthEncoding = Literal["16UC1", "32FC1"]

MM_PER_M = 1000.0
DISPARITY = "disparity"
"""How a topic, a folder and an encoding are named that hold the shift between two images, pixels."""
RAW_DEPTH: dict[str, DepthEncoding] = {"16UC1": "16UC1", "mono16": "16UC1", "32FC1": "32FC1"}
DTYPES: dict[DepthEncoding, str] = {"16UC1": "u2", "32FC1": "f4"}
COMPRESSED_DEPTH_HEADER = struct.Struct("<iff")
PNG_SIZE_AND_TYPE = struct.Struct(">IIBB")
RVL_FORMAT = "compressedDepth rvl"
"""Part of the format of messages of compressedDepth's other codec; the usual one is PNG."""
RVL_SIZE = struct.Struct("<II")
"""Width and height, before the words of ``rvl``."""
PNG_COLOUR_TYPES = {0: "grey", 2: "colour", 3: "palette", 4: "grey with alpha", 6: "colour with alpha"}


@dataclass(frozen=True)
class Depth:
    """Depth as 16-bit codes or floating-point numbers of some unit; a kind of ``Pixels``.

    Attributes:
        width, height: of the stored images, pixels.
        encoding: ``16UC1`` if every depth is a whole number of millimetres, else ``32FC1``.
        unit_mm: millimetres per stored unit, also of floating-point numbers.
        missing: stored code that means no reading; 0 always means it, too.
        stored: as people name how messages store it: ``16UC1``, ``png 16-bit grey``...
        disparity_px_m: focal length times baseline, px m, where images hold disparity; else None.
        is_float: whether image files hold floats.
    """

    width: int
    height: int
    encoding: DepthEncoding
    unit_mm: float = 1.0
    missing: int = 0
    stored: str = ""
    disparity_px_m: float | None = None
    is_float: bool = False

    is_numbered_as_stored: ClassVar[bool] = True

    def from_file(self, data: bytes, where: object) -> Float32Array:
        """Return (height, width) depth, mm, of an image file."""
        try:
            values = decode_codes(data, str(where))
        except RecordingError as error:  # which names the file; the first image would have been refused
            raise UnreadableImageError(str(error).removeprefix(f"{where}: ")) from error
        if (values.dtype.kind == "f") != self.is_float:
            kinds = "16-bit integers", "32-bit floats"
            found, expected = kinds[not self.is_float], kinds[self.is_float]
            raise UnreadableImageError(f"it has {found}, not {expected} as the others")
        return self.from_stored(values)

    def from_stored(self, codes: ImageArray) -> Float32Array:
        """Return (height, width) depth, mm, of codes as they are stored."""
        check_size(codes, self)
        return depth_from_stored(codes, self.unit_mm, self.missing)

    def from_message(self, decoded: Any, kind: str, where: str) -> Float32Array:
        """Return (height, width) depth, mm, of an image message."""
        here = describe_image(decoded, kind)
        first = ImageDescription(self.stored, self.width, self.height, here.depth)
        if here.width and here != first:
            found = f"{here.width}x{here.height} {here.encoding}"
            expected = f"{first.width}x{first.height} {first.encoding}"
            raise UnreadableImageError(f"it is {found}, not {expected} as the others")
        values = stored_depth(decoded, kind, where, self.disparity_px_m)
        return depth_from_stored(values, self.unit_mm, self.missing)

    def png_of_message(self, decoded: Any, kind: str) -> bytes | None:
        """Return the 16-bit PNG of depth in mm that a message carries, None if it does not carry one."""
        if kind != COMPRESSED_IMAGE or self.unit_mm != 1.0 or self.missing:
            return None
        data = bytes(decoded.data)
        offset = _png_offset(data)
        if offset is None or _describe_compressed(str(decoded.format), data).depth != "16UC1":
            return None
        return data[offset:]


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
    if kind == VIDEO_IMAGE:
        return ImageDescription(f"{decoded.format} video", 0, 0, None)
    if kind == DISPARITY_IMAGE:
        image = decoded.image
        depth: DepthEncoding | None = "32FC1" if str(image.encoding) == "32FC1" else None
        return ImageDescription(DISPARITY, int(image.width), int(image.height), depth)
    return _describe_compressed(str(decoded.format), bytes(decoded.data))


def stored_depth(decoded: Any, kind: str, where: str, disparity_px_m: float | None = None) -> ImageArray:
    """Return the (height, width) values of a depth message: integer codes, or floats, in its own unit.

    Args:
        decoded, kind: the message.
        where: for errors.
        disparity_px_m: focal length times baseline, where the values are disparities; depth in m is returned.

    Raises:
        UnreadableImageError: if the data are too short or damaged, or are no depth.
    """
    if kind == COMPRESSED_IMAGE:
        return _decode_compressed(decoded, where)
    if kind == DISPARITY_IMAGE:
        baseline = decoded.T if hasattr(decoded, "T") else decoded.t  # in ROS 1 and in ROS 2
        decoded, disparity_px_m = decoded.image, float(decoded.f) * float(baseline)
    if decoded.encoding not in RAW_DEPTH:
        raise UnreadableImageError(f"encoding {decoded.encoding} is no depth")
    values = raw_values(decoded, DTYPES[RAW_DEPTH[decoded.encoding]])
    return values if disparity_px_m is None else depth_from_disparity(values, disparity_px_m)


def depth_from_stored(values: ImageArray, unit_mm: float, missing: int = 0) -> Float32Array:
    """Return depth, mm, of stored integer codes or floats of ``unit_mm`` each, 0 = no reading."""
    if values.dtype.kind == "f":
        return depth_from_floats(values, unit_mm)
    return depth_from_codes(values, unit_mm, missing)


def depth_from_codes(codes: ImageArray, unit_mm: float = 1.0, missing: int = 0) -> Float32Array:
    """Return depth, mm, of unsigned integer codes of ``unit_mm`` each; 0 and ``missing`` become 0.

    So do depths that no camera reads (``limits``).
    """
    depth = (codes * np.float64(unit_mm)).astype(np.float32) if unit_mm != 1.0 else codes.astype(np.float32)
    if missing:
        depth[codes == missing] = 0.0
    usual = codes.dtype.itemsize <= 2 and limits.NEAREST_MM <= unit_mm <= limits.FARTHEST_MM / 65535
    return depth if usual else _readings(depth)


def depth_from_floats(values: ImageArray, unit_mm: float = MM_PER_M) -> Float32Array:
    """Return depth, mm, of floats of ``unit_mm`` each; NaN, inf and what no camera reads become 0."""
    with np.errstate(over="ignore", invalid="ignore"):
        depth = (values.astype(np.float64) * unit_mm).astype(np.float32)
    return _readings(depth)


def depth_from_inverse(codes: ImageArray, a: float, b: float) -> FloatArray:
    """Return depth, m, of compressedDepth's quantised inverse depth: z = a / (v - b), v = 0 none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(codes > 0, a / (codes.astype(np.float64) - b), 0.0)


def depth_from_disparity(disparity: ImageArray, px_m: float) -> FloatArray:
    """Return depth, m, of disparity, px: z = f B / d; 0 where d is not positive."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(disparity > 0, px_m / disparity.astype(np.float64), 0.0)


def _readings(depth: Float32Array) -> Float32Array:
    """Depth, mm, with 0 in the place of what is no reading: arithmetic on it would overflow."""
    with np.errstate(invalid="ignore"):
        readable = (depth >= limits.NEAREST_MM) & (depth <= limits.FARTHEST_MM)
    depth[~readable] = 0.0
    return depth


def _describe_compressed(image_format: str, data: bytes) -> ImageDescription:
    offset = _png_offset(data)
    if (
        offset is None
        and RVL_FORMAT in image_format
        and len(data) >= COMPRESSED_DEPTH_HEADER.size + RVL_SIZE.size
    ):
        width, height = RVL_SIZE.unpack_from(data, COMPRESSED_DEPTH_HEADER.size)
        stored = image_format.split(";")[0].strip()
        return ImageDescription(f"{stored} compressedDepth, rvl", width, height, RAW_DEPTH.get(stored))
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


def _decode_compressed(decoded: Any, where: str) -> ImageArray:
    data = bytes(decoded.data)
    description = _describe_compressed(str(decoded.format), data)
    if description.depth is None:
        raise UnreadableImageError(f"format {description.encoding or 'unknown'} is no depth")
    offset = _png_offset(data)
    if offset is None:
        from posetrack_cli.recording.rvl import decode_rvl  # loads numba

        codes = decode_rvl(
            data[COMPRESSED_DEPTH_HEADER.size + RVL_SIZE.size :], description.width, description.height
        )
    else:
        codes = decode_codes(data[offset:], where)
    if description.depth == "16UC1":
        return codes
    return depth_from_inverse(codes, *COMPRESSED_DEPTH_HEADER.unpack_from(data)[1:])
