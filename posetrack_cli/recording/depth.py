"""Depth in millimetres of what a recording stores, and what its values look like."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from math import sqrt
from typing import Any, ClassVar, Literal, TypeVar

import cv2
import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.mcap.decoding import COMPRESSED_IMAGE, DISPARITY_IMAGE, RAW_IMAGE, VIDEO_IMAGE
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.image_files import PNG_SIGNATURE, PNG_SIZE_AT, decode_codes
from posetrack_cli.recording.pixels import check_size, raw_values

# Depth images: which stored values and messages hold depth, and how they become millimetres


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
"""Width and height, before the words of RVL (``compression``)."""
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
        from posetrack_cli.recording.compression import decode_rvl  # loads numba

        codes = decode_rvl(
            data[COMPRESSED_DEPTH_HEADER.size + RVL_SIZE.size :], description.width, description.height
        )
    else:
        codes = decode_codes(data[offset:], where)
    if description.depth == "16UC1":
        return codes
    return depth_from_inverse(codes, *COMPRESSED_DEPTH_HEADER.unpack_from(data)[1:])


# Whether stored images are depth, by their names, and of which unit, by what early images hold


Item = TypeVar("Item")

_NO_DEPTH = re.compile(
    r"(?<![a-z])(disparity|infrared|infra|n?ir|confidence|amplitude|intensity|brightness|reflectivity)(?![a-z])"
)
"""Words in names of 16-bit images and float images that are not depth."""
_PLAIN_PART = re.compile(r"(image|data|compressed)(_?(raw|rect|rect_raw|mono|16|depth))*")
"""Parts of a topic's name that say nothing of what its images are."""
EARLY_FRAMES = (0, 7, 15, 22, 30)
"""Numbers of the images that are looked at: of about the first second."""
MOST_PIXELS = 40_000
"""Of one image; of a larger one every second or third row and column is used."""
SEARCHED_MM = (120.0, 1500.0)
"""Depths at which hands are searched for, see ``hand.config``: a finer unit is considered only beyond."""
HAND_MM = (50.0, 350.0)
"""Square root of the area of a hand, with some of its forearm."""
_STEPS = {10: 0.1, 8: 0.125, 5: 0.2, 4: 0.25}
"""Unit by the common divisor of codes: whole millimetres of a sensor, stored in a finer unit."""
USUAL_UNITS_MM = (*_STEPS.values(), 1.0, 10.0, MM_PER_M)
"""In which depth is stored, millimetres."""
_DIVISIBLE = 0.999
"""Share of readings that a divisor must divide: some interpolate a few at edges."""
_LEAST_VALUES = 64
"""Different codes needed, or a flat scene would be a multiple of anything."""
_LABEL_BITS = 3
"""Of Kinect v1 images with the number of a player below the depth."""
_LABELS_ALIKE = 0.9
_LABELLED = 0.005
"""Neighbours whose labels are equal, and share of readings with a player, of such images."""
_FLOATS_IN_MM = (100.0, 200.0)
"""First percentile and median of floats in mm at least: no hand is recorded 100 m away."""
_TOO_FAR_MM = 10_000.0
"""Median depth that no camera for hands has."""
_TOUCHING_MM = 20.0
"""Everything within this is too near for any depth camera."""
_NEAREST_SHARES, _LEAST_SURFACE = (1.0, 2.0, 4.0, 8.0, 16.0), 0.008
"""Percentiles of readings at one of which the nearest surface begins, and its least share of the image:
nearer readings are specks."""
_SURFACE_REACH = 1.25
"""How far the nearest surface reaches in depth, a factor."""


@dataclass(frozen=True)
class DepthContent:
    """Statistics of stored depth values, in their own unit.

    Attributes:
        images: images looked at that have a reading.
        is_float: whether values are floats.
        share: of pixels that have a reading.
        near: where the nearest surface begins.
        middle, far: percentiles 50 and 99 of readings.
        surface: square root of the area of the nearest surface, in the unit of depth; 0 for none.
        values: different values, of integers.
        step: largest of 10, 8, 5 and 4 that divides the integers, else 1.
        labels_alike: share of neighbouring readings of different depth whose low three bits are equal.
        labelled: share of readings whose low three bits are not 0.
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
        """Say at which depths readings lie: ``4.8 to 6.6 m``."""
        return range_words(self.near * unit_mm, self.far * unit_mm)


@dataclass(frozen=True)
class Decision:
    """The unit of stored depth.

    Attributes:
        unit_mm: millimetres per stored unit.
        remark: why it is not the one by convention or the one given, one line; empty if it is.
    """

    unit_mm: float
    remark: str = ""

    @property
    def remarks(self) -> tuple[str, ...]:
        """The remark, if there is one."""
        return (self.remark,) if self.remark else ()


def other_content(name: str) -> str:
    """Return the word in the name of a topic or folder that says that its images are not depth; else ""."""
    parts = [part for part in name.lower().split("/") if part and not _PLAIN_PART.fullmatch(part)]
    found = _NO_DEPTH.search(parts[-1]) if parts and "depth" not in parts[-1] else None
    return "" if found is None else found.group(1)


def early(items: Iterable[Item]) -> Iterator[Item]:
    """Yield the items whose images are looked at."""
    wanted = frozenset(EARLY_FRAMES)
    return (item for number, item in enumerate(islice(items, max(wanted) + 1)) if number in wanted)


def content_of(images: Iterable[ImageArray], camera: Camera, missing: int = 0) -> DepthContent:
    """Return the statistics of depth images as they are stored.

    Args:
        images: (height, width) integers or floats.
        camera: of these images.
        missing: code of no reading.
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


def decide_unit(content: DepthContent, given_mm: float | None = None) -> Decision:
    """Decide the unit of stored depth.

    Args:
        content: of early images.
        given_mm: mm per stored unit, where somebody has stated it.
    """
    usual = content.convention_mm
    if not content.images:
        return Decision(usual if given_mm is None else given_mm)
    if given_mm is not None:
        return _given(content, given_mm)
    if content.is_float:
        low, middle = _FLOATS_IN_MM
        if content.near >= low and content.middle >= middle and content.far < _TOO_FAR_MM * 2:
            return _found(content, 1.0, "floats are millimetres, not metres")
        return Decision(usual)
    if _has_players(content):
        return _found(content, 0.125, "Kinect v1 player numbers below the depth")
    unit = _STEPS.get(content.step, usual)
    if unit != usual and content.values >= _LEAST_VALUES and _is_finer(content, unit):
        return _found(content, unit, f"all values are multiples of {content.step}")
    return Decision(usual)


def likely_units(content: DepthContent, unit_mm: float = 1.0) -> tuple[float, ...]:
    """Return the usual units in which the nearest surface is as far away as a hand, and as large as one.

    Args:
        content: of images, whose values are multiples of ``unit_mm``.
        unit_mm: the unit that they were read in, mm; 1 of stored values.
    """
    low, high = SEARCHED_MM
    return tuple(
        unit
        for unit in USUAL_UNITS_MM
        if low <= content.near * unit / unit_mm <= high
        and HAND_MM[0] <= content.surface * unit / unit_mm <= HAND_MM[1]
    )


def range_words(low_mm: float, high_mm: float) -> str:
    """Return a range of lengths for people: ``4.8 to 6.6 m``."""
    low, high = length_words(low_mm), length_words(high_mm)
    unit = high.rpartition(" ")[2]
    return f"{low.removesuffix(f' {unit}')} to {high}"


def length_words(mm: float) -> str:
    """Return a length for people: ``0.6 mm``, ``35 mm``, ``4.8 m``, ``600 m``."""
    if mm < 99.5:
        return f"{mm:.2g} mm"
    metres = mm / MM_PER_M
    return f"{metres:.2f} m" if metres < 1.0 else f"{metres:.3g} m" if metres >= 100.0 else f"{metres:.1f} m"


def _found(content: DepthContent, unit_mm: float, why: str) -> Decision:
    taken = f"depth is taken as {unit_mm:g} mm per stored unit"
    where = f"readings then lie at {content.range_words(unit_mm)}"
    return Decision(unit_mm, f"{taken}: {why}; {where}; --depth-unit-mm overrides")


def _given(content: DepthContent, given_mm: float) -> Decision:
    """The unit given; one that only makes sense in metres per stored unit is taken as such."""
    metres = given_mm * MM_PER_M
    if content.far * given_mm >= _TOUCHING_MM or not (
        SEARCHED_MM[0] <= content.middle * metres <= 2 * _TOO_FAR_MM
    ):
        return Decision(given_mm)
    within = (
        f"a depth unit of {given_mm:g} mm places everything within {length_words(content.far * given_mm)}"
    )
    return Decision(metres, f"{within}: taken as {given_mm:g} m, which is {metres:g} mm per stored unit")


def _has_players(content: DepthContent) -> bool:
    """Whether codes are depth << 3 | player: low bits that stay where the depth changes are no depth."""
    return (
        content.values >= _LEAST_VALUES
        and content.labelled >= _LABELLED
        and content.labels_alike >= _LABELS_ALIKE
        and content.near >= SEARCHED_MM[1]
    )


def _is_finer(content: DepthContent, unit_mm: float) -> bool:
    """Whether values are of a finer unit than mm: too far for mm, or the nearest surface a hand's size."""
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
    """Where the nearest surface of some extent begins, and the square root of its area; both in its unit."""
    near, area = 0.0, 0
    for near in np.percentile(image[mask], _NEAREST_SHARES):
        surface = (mask & (image >= near) & (image <= _SURFACE_REACH * near)).astype(np.uint8)
        _, _, stats, _ = cv2.connectedComponentsWithStats(surface, connectivity=4)
        area = int(stats[1:, cv2.CC_STAT_AREA].max(initial=0))
        if area >= _LEAST_SURFACE * image.size:
            break
    return float(near), sqrt(area) * float(near) * 0.5 * (1.0 + _SURFACE_REACH) / focal


def _labels(image: ImageArray, mask: ImageArray) -> tuple[int, int]:
    """How many neighbours of different depth have equal low bits, and how many there are."""
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
