"""Stored depth: conversion to millimetres, and detection of its unit."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from math import sqrt
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.mcap.decoding import COMPRESSED_IMAGE, DISPARITY_IMAGE, RAW_IMAGE, VIDEO_IMAGE
from posetrack_cli.recording.base import Encoded, UnreadableImageError
from posetrack_cli.recording.image_files import PNG_SIGNATURE, PNG_SIZE_AT, decode_codes, encoded_file
from posetrack_cli.recording.pixels import check_size, raw_values

# Stored depth and its conversion to millimetres
DepthEncoding = Literal["16UC1", "32FC1"]

MM_PER_M = 1000.0
# Name of disparity (pixels) in topics, folders and encodings.
DISPARITY = "disparity"
RAW_DEPTH: dict[str, DepthEncoding] = {"16UC1": "16UC1", "mono16": "16UC1", "32FC1": "32FC1"}
DTYPES: dict[DepthEncoding, str] = {"16UC1": "u2", "32FC1": "f4"}
COMPRESSED_DEPTH_HEADER = struct.Struct("<iff")
PNG_SIZE_AND_TYPE = struct.Struct(">IIBB")
# Part of the format of compressedDepth messages with the RVL codec; the usual codec is PNG.
RVL_FORMAT = "compressedDepth rvl"
RVL_SIZE = struct.Struct("<II")  # width and height, before the RVL words (``compression``)
PNG_COLOUR_TYPES = {0: "grey", 2: "colour", 3: "palette", 4: "grey with alpha", 6: "colour with alpha"}


@dataclass(frozen=True)
class Depth:
    """Depth as 16-bit codes or floats of some unit; implements ``Pixels``.

    Attributes:
        width, height: size of the stored images, pixels.
        encoding: ``16UC1`` if every depth is a whole number of millimetres, else ``32FC1``.
        unit_mm: millimetres per stored unit, also of floats.
        missing: stored code for no reading, in addition to 0.
        stored: name of the stored format in messages: ``16UC1``, ``png 16-bit grey``...
        disparity_px_m: focal length times baseline, px m, if images hold disparity; else None.
        is_float: True if image files hold floats.
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
        """Return the (height, width) depth, mm, of an image file."""
        try:
            values = decode_codes(data, str(where))
        except RecordingError as error:  # names the file; a first image of this kind ends the pass instead
            raise UnreadableImageError(str(error).removeprefix(f"{where}: ")) from error
        if (values.dtype.kind == "f") != self.is_float:
            kinds = "16-bit integers", "32-bit floats"
            found, expected = kinds[not self.is_float], kinds[self.is_float]
            raise UnreadableImageError(f"values are {found}, not {expected} like the first")
        return self.from_stored(values)

    def from_stored(self, codes: ImageArray) -> Float32Array:
        """Return the (height, width) depth, mm, of stored values."""
        check_size(codes, self)
        return depth_from_stored(codes, self.unit_mm, self.missing)

    def from_message(self, decoded: Any, kind: str, where: str) -> Float32Array:
        """Return the (height, width) depth, mm, of an image message."""
        here = describe_image(decoded, kind)
        first = ImageDescription(self.stored, self.width, self.height, here.depth)
        if here.width and here != first:
            found = f"{here.width}x{here.height} {here.encoding}"
            expected = f"{first.width}x{first.height} {first.encoding}"
            raise UnreadableImageError(f"format is {found}, not {expected} like the first")
        values = stored_depth(decoded, kind, where, self.disparity_px_m)
        return depth_from_stored(values, self.unit_mm, self.missing)

    def encoded_message(self, decoded: Any, kind: str) -> Encoded | None:
        """Return the 16-bit PNG of depth in mm in a message, None if there is none."""
        if kind != COMPRESSED_IMAGE or self.unit_mm != 1.0 or self.missing:
            return None
        data = bytes(decoded.data)
        offset = _png_offset(data)
        if offset is None or _describe_compressed(str(decoded.format), data).depth != "16UC1":
            return None
        return encoded_file(data[offset:])


@dataclass(frozen=True)
class ImageDescription:
    """Content of an image message, determined without decoding its pixels.

    Attributes:
        encoding: name of the format: ``16UC1``, ``png 16-bit grey``, ``jpeg``...
        width, height: pixels; 0 if unknown.
        depth: how it stores depth, None if it does not.
    """

    encoding: str
    width: int
    height: int
    depth: DepthEncoding | None


def describe_image(decoded: Any, kind: str) -> ImageDescription:
    """Return the content of an image message of any kind."""
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
    """Return the (height, width) values of a depth message: codes or floats, in its own unit.

    Args:
        decoded, kind: the message.
        where: location, for errors.
        disparity_px_m: focal length times baseline if the values are disparities; depth in m is returned.

    Raises:
        UnreadableImageError: the data are too short, damaged, or not depth.
    """
    if kind == COMPRESSED_IMAGE:
        return _decode_compressed(decoded, where)
    if kind == DISPARITY_IMAGE:
        baseline = decoded.T if hasattr(decoded, "T") else decoded.t  # in ROS 1 and in ROS 2
        decoded, disparity_px_m = decoded.image, float(decoded.f) * float(baseline)
    if decoded.encoding not in RAW_DEPTH:
        raise UnreadableImageError(f"encoding {decoded.encoding} is not depth")
    values = raw_values(decoded, DTYPES[RAW_DEPTH[decoded.encoding]])
    return values if disparity_px_m is None else depth_from_disparity(values, disparity_px_m)


def depth_from_stored(values: ImageArray, unit_mm: float, missing: int = 0) -> Float32Array:
    """Return depth, mm, from stored integer codes or floats of ``unit_mm`` each; 0 = no reading."""
    if values.dtype.kind == "f":
        return depth_from_floats(values, unit_mm)
    return depth_from_codes(values, unit_mm, missing)


def depth_from_codes(codes: ImageArray, unit_mm: float = 1.0, missing: int = 0) -> Float32Array:
    """Return depth, mm, from unsigned integer codes of ``unit_mm`` each.

    0, ``missing`` and depths outside any camera's range (``limits``) become 0.
    """
    depth = (codes * np.float64(unit_mm)).astype(np.float32) if unit_mm != 1.0 else codes.astype(np.float32)
    if missing:
        depth[codes == missing] = 0.0
    usual = codes.dtype.itemsize <= 2 and limits.NEAREST_MM <= unit_mm <= limits.FARTHEST_MM / 65535
    return depth if usual else _readings(depth)


def depth_from_floats(values: ImageArray, unit_mm: float = MM_PER_M) -> Float32Array:
    """Return depth, mm, from floats of ``unit_mm`` each; NaN, inf and implausible depths become 0."""
    with np.errstate(over="ignore", invalid="ignore"):
        depth = (values.astype(np.float64) * unit_mm).astype(np.float32)
    return _readings(depth)


def depth_from_inverse(codes: ImageArray, a: float, b: float) -> FloatArray:
    """Return depth, m, of quantised inverse depth (compressedDepth): z = a / (v - b), v = 0 none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(codes > 0, a / (codes.astype(np.float64) - b), 0.0)


def depth_from_disparity(disparity: ImageArray, px_m: float) -> FloatArray:
    """Return depth, m, from disparity, px: z = f B / d; 0 where d is not positive."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(disparity > 0, px_m / disparity.astype(np.float64), 0.0)


def _readings(depth: Float32Array) -> Float32Array:
    """Set depths, mm, outside ``limits`` to 0; arithmetic on them would overflow."""
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
    """Return where the PNG begins: 0, or after compressedDepth's header; None without a PNG."""
    for offset in (0, COMPRESSED_DEPTH_HEADER.size):
        header_end = offset + PNG_SIZE_AT + PNG_SIZE_AND_TYPE.size
        if data.startswith(PNG_SIGNATURE, offset) and len(data) >= header_end:
            return offset
    return None


def _decode_compressed(decoded: Any, where: str) -> ImageArray:
    data = bytes(decoded.data)
    description = _describe_compressed(str(decoded.format), data)
    if description.depth is None:
        raise UnreadableImageError(f"format {description.encoding or 'unknown'} is not depth")
    offset = _png_offset(data)
    if offset is None:
        from posetrack_cli.recording.compression import decode_rvl  # imports numba: only when needed

        codes = decode_rvl(
            data[COMPRESSED_DEPTH_HEADER.size + RVL_SIZE.size :], description.width, description.height
        )
    else:
        codes = decode_codes(data[offset:], where)
    if description.depth == "16UC1":
        return codes
    return depth_from_inverse(codes, *COMPRESSED_DEPTH_HEADER.unpack_from(data)[1:])


# Detection of depth by names, and of its unit by the values of early images
Item = TypeVar("Item")

# Words in names of 16-bit and float images other than depth.
_NO_DEPTH = re.compile(
    r"(?<![a-z])(disparity|infrared|infra|n?ir|confidence|amplitude|intensity|brightness|reflectivity)(?![a-z])"
)
# Parts of a topic name that do not indicate the content.
_PLAIN_PART = re.compile(r"(image|data|compressed)(_?(raw|rect|rect_raw|mono|16|depth))*")
EARLY_FRAMES = (0, 7, 15, 22, 30)  # inspected images, within the first second
MOST_PIXELS = 40_000  # larger images are subsampled
# Depth range of the hand search (``hand.config``); a finer unit is considered only beyond it.
SEARCHED_MM = (120.0, 1500.0)
HAND_MM = (50.0, 350.0)  # square root of the area of a hand with some forearm
# Unit by common divisor of the codes: whole millimetres stored in a finer unit.
_STEPS = {10: 0.1, 8: 0.125, 5: 0.2, 4: 0.25}
USUAL_UNITS_MM = (*_STEPS.values(), 1.0, 10.0, MM_PER_M)  # common depth units, mm
_DIVISIBLE = 0.999  # required share of multiples; some cameras interpolate at edges
_LEAST_VALUES = 64  # distinct codes required, as a flat scene is a multiple of anything
_LABEL_BITS = 3  # Kinect v1 images with a player index in the low bits
_LABELS_ALIKE = 0.9  # minimum share of neighbours with equal index in such images
_LABELLED = 0.005  # minimum share of readings with a player
_FLOATS_IN_MM = (100.0, 200.0)  # least near and median depth of floats in mm: hands are not 100 m away
_TOO_FAR_MM = 10_000.0  # median depth out of range for hands
_TOUCHING_MM = 20.0  # closer than any depth camera measures
# The nearest surface starts at one of these percentiles and covers at least this share of the image.
_NEAREST_SHARES, _LEAST_SURFACE = (1.0, 2.0, 4.0, 8.0, 16.0), 0.008
_SURFACE_REACH = 1.25  # depth extent of the nearest surface, as a factor


@dataclass(frozen=True)
class DepthContent:
    """Statistics of stored depth values, in their own unit.

    Attributes:
        images: inspected images with readings.
        is_float: True for float values.
        share: share of pixels with a reading.
        near: depth at which the nearest surface begins.
        middle, far: percentiles 50 and 99 of readings.
        surface: square root of the area of the nearest surface, in the unit of depth; 0 if there is none.
        values: number of distinct integer values.
        step: largest of 10, 8, 5 and 4 that divides the integers, else 1.
        labels_alike: share of neighbouring readings at different depth with equal low three bits.
        labelled: share of readings with low three bits not 0.
    """

    images: int = 0
    is_float: bool = False
    share: float = 0.0
    near: float = 0.0
    middle: float = 0.0
    far: float = 0.0
    surface: float = 0.0
    values: int = 0
    step: int = 1
    labels_alike: float = 0.0
    labelled: float = 0.0

    @property
    def convention_mm(self) -> float:
        """Millimetres per stored unit by convention: integers are mm, floats m."""
        return MM_PER_M if self.is_float else 1.0

    def range_words(self, unit_mm: float) -> str:
        """Return the range of readings as text: ``4.8 to 6.6 m``."""
        return range_words(self.near * unit_mm, self.far * unit_mm)


@dataclass(frozen=True)
class UnitDecision:
    """The unit of stored depth.

    Attributes:
        unit_mm: millimetres per stored unit.
        remark: why it differs from the convention or the given unit, one line; empty if it does not.
    """

    unit_mm: float
    remark: str = ""

    @property
    def remarks(self) -> tuple[str, ...]:
        """The remark, if there is one."""
        return (self.remark,) if self.remark else ()


def other_content(name: str) -> str:
    """Return the word in a topic or folder name that indicates images other than depth; else ""."""
    parts = [part for part in name.lower().split("/") if part and not _PLAIN_PART.fullmatch(part)]
    found = _NO_DEPTH.search(parts[-1]) if parts and "depth" not in parts[-1] else None
    return "" if found is None else found.group(1)


def early(items: Iterable[Item]) -> Iterator[Item]:
    """Yield the items of the inspected frames."""
    wanted = frozenset(EARLY_FRAMES)
    return (item for number, item in enumerate(islice(items, max(wanted) + 1)) if number in wanted)


def content_of(images: Iterable[ImageArray], camera: Camera, missing: int = 0) -> DepthContent:
    """Return the statistics of stored depth images.

    Args:
        images: (height, width) integers or floats.
        camera: camera of these images.
        missing: code for no reading.
    """
    shown = [image for image in map(_thinned, images) if _are_readings(image, missing).any()]
    shown = [image for image in shown if (image.shape, image.dtype) == (shown[0].shape, shown[0].dtype)]
    if not shown:
        return DepthContent()
    masks = [_are_readings(image, missing) for image in shown]
    values = np.concatenate([image[mask] for image, mask in zip(shown, masks, strict=True)])
    middle, far = (float(value) for value in np.percentile(values, (50.0, 99.0)))
    focal = sqrt(camera.fx * camera.fy) * shown[0].shape[0] / camera.height
    nearest = [_nearest(image, mask, focal) for image, mask in zip(shown, masks, strict=True)]
    near, surface = (float(value) for value in np.median(nearest, axis=0))
    share = len(values) / sum(image.size for image in shown)
    found = DepthContent(len(shown), True, share, near, middle, far, surface)
    if values.dtype.kind == "f":
        return found
    pairs = [_labels(image, mask) for image, mask in zip(shown, masks, strict=True)]
    alike, compared = (sum(counts) for counts in zip(*pairs, strict=True))
    return DepthContent(
        found.images,
        False,
        share,
        near,
        middle,
        far,
        surface,
        values=len(np.unique(values)),
        step=next((k for k in _STEPS if np.mean(values % k == 0) >= _DIVISIBLE), 1),
        labels_alike=alike / compared if compared else 0.0,
        labelled=float(np.mean(values & 7 != 0)),
    )


def decide_unit(content: DepthContent, given_mm: float | None = None) -> UnitDecision:
    """Return the unit of stored depth.

    Args:
        content: statistics of early images.
        given_mm: mm per stored unit if stated by the user or a camera file.
    """
    usual = content.convention_mm
    if not content.images:
        return UnitDecision(usual if given_mm is None else given_mm)
    if given_mm is not None:
        return _checked(content, given_mm)
    if content.is_float:
        low, middle = _FLOATS_IN_MM
        if content.near >= low and content.middle >= middle and content.far < _TOO_FAR_MM * 2:
            return _detected(content, 1.0, "floats are in millimetres, not metres")
        return UnitDecision(usual)
    if _has_players(content):
        return _detected(content, 0.125, "low bits are Kinect v1 player indices")
    unit = _STEPS.get(content.step, usual)
    if unit != usual and content.values >= _LEAST_VALUES and _is_finer(content, unit):
        return _detected(content, unit, f"all values are multiples of {content.step}")
    return UnitDecision(usual)


def likely_units(content: DepthContent, unit_mm: float = 1.0) -> tuple[float, ...]:
    """Return the common units, mm, in which the nearest surface could be a hand.

    Args:
        content: statistics of images whose values are multiples of ``unit_mm``.
        unit_mm: unit of the values, mm; 1 for stored values.
    """
    low, high = SEARCHED_MM
    return tuple(
        unit
        for unit in USUAL_UNITS_MM
        if low <= content.near * unit / unit_mm <= high
        and HAND_MM[0] <= content.surface * unit / unit_mm <= HAND_MM[1]
    )


def unit_mm_of(pixels: object) -> float:
    """Return the millimetres per stored unit of a stream's pixels; 1 if they are not depth."""
    return pixels.unit_mm if isinstance(pixels, Depth) else 1.0


def range_words(low_mm: float, high_mm: float) -> str:
    """Return a range of lengths as text: ``4.8 to 6.6 m``."""
    low, high = length_words(low_mm), length_words(high_mm)
    unit = high.rpartition(" ")[2]
    return f"{low.removesuffix(f' {unit}')} to {high}"


def length_words(mm: float) -> str:
    """Return a length as text: ``0.6 mm``, ``35 mm``, ``4.8 m``, ``600 m``."""
    if mm < 99.5:
        return f"{mm:.2g} mm"
    metres = mm / MM_PER_M
    return f"{metres:.2f} m" if metres < 1.0 else f"{metres:.3g} m" if metres >= 100.0 else f"{metres:.1f} m"


def _detected(content: DepthContent, unit_mm: float, why: str) -> UnitDecision:
    taken = f"depth unit detected as {unit_mm:g} mm"
    where = f"readings from {content.range_words(unit_mm)}"
    return UnitDecision(unit_mm, f"{taken}: {why}, {where}; override with --depth-unit-mm")


def _checked(content: DepthContent, given_mm: float) -> UnitDecision:
    """Return the given unit, or the same number of metres if only that makes sense."""
    metres = given_mm * MM_PER_M
    if content.far * given_mm >= _TOUCHING_MM or not (
        SEARCHED_MM[0] <= content.middle * metres <= 2 * _TOO_FAR_MM
    ):
        return UnitDecision(given_mm)
    within = f"a depth unit of {given_mm:g} mm puts everything within {length_words(content.far * given_mm)}"
    return UnitDecision(metres, f"{within}: assuming {given_mm:g} m, i.e. {metres:g} mm per stored unit")


def _has_players(content: DepthContent) -> bool:
    """Return whether codes are depth << 3 | player: low bits that stay equal where depth changes."""
    return (
        content.values >= _LEAST_VALUES
        and content.labelled >= _LABELLED
        and content.labels_alike >= _LABELS_ALIKE
        and content.near >= SEARCHED_MM[1]
    )


def _is_finer(content: DepthContent, unit_mm: float) -> bool:
    """Return whether a finer unit fits: too far for mm, or the nearest surface has a hand's size."""
    low, high = SEARCHED_MM
    if content.near < high or not low <= content.near * unit_mm <= high:
        return False
    is_hand = HAND_MM[0] <= content.surface * unit_mm <= HAND_MM[1] < content.surface
    return is_hand or content.middle >= _TOO_FAR_MM


def _thinned(image: ImageArray) -> ImageArray:
    step = max(1, round(sqrt(image.size / MOST_PIXELS)))
    return image[::step, ::step]


def _are_readings(image: ImageArray, missing: int) -> ImageArray:
    if image.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            return np.asarray(np.isfinite(image) & (image > 0))
    return np.asarray((image > 0) & (image != missing) & (image != np.iinfo(image.dtype).max))


def _nearest(image: ImageArray, mask: ImageArray, focal: float) -> tuple[float, float]:
    """Return where the nearest large surface begins and the square root of its area, in its unit."""
    import cv2  # results are read without it

    near, area = 0.0, 0
    for near in np.percentile(image[mask], _NEAREST_SHARES):
        surface = (mask & (image >= near) & (image <= _SURFACE_REACH * near)).astype(np.uint8)
        _, _, stats, _ = cv2.connectedComponentsWithStats(surface, connectivity=4)
        area = int(stats[1:, cv2.CC_STAT_AREA].max(initial=0))
        if area >= _LEAST_SURFACE * image.size:
            break
    return float(near), sqrt(area) * float(near) * 0.5 * (1.0 + _SURFACE_REACH) / focal


def _labels(image: ImageArray, mask: ImageArray) -> tuple[int, int]:
    """Return the number of neighbours at different depth with equal low bits, and of all such."""
    alike = compared = 0
    codes = image.astype(np.int64)
    for one, other, both in (
        (codes[:, :-1], codes[:, 1:], mask[:, :-1] & mask[:, 1:]),
        (codes[:-1], codes[1:], mask[:-1] & mask[1:]),
    ):
        differs = both & (one >> _LABEL_BITS != other >> _LABEL_BITS)
        alike += int(np.count_nonzero(differs & ((one ^ other) & 7 == 0)))
        compared += int(np.count_nonzero(differs))
    return alike, compared
