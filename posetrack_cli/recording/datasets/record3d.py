"""Recordings of Record3D, an app for iPhones and iPads with LiDAR or TrueDepth.

Its own format (.r3d, a zip archive, or a folder of the same files) has JSON metadata, rgbd/N.jpg,
rgbd/N.depth (32-bit floats, m) and rgbd/N.conf (bytes 0, 1 or 2), the last two LZFSE-compressed. In the
metadata, w and h are the colour size, dw and dh the depth size, K is the 3x3 matrix in column order, and
perFrameIntrinsicCoeffs has fx, fy, cx, cy per image. Exports have metadata.json, rgb/N.jpg and depth/N.exr;
only their colour is supported.
"""

from __future__ import annotations

import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, Field, ValidationError

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.files import begins_with, open_input, read_input
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.datasets.layout import (
    Dataset,
    DatasetImage,
    camera_of,
    describe_dataset,
    open_depth,
    open_grey,
)
from posetrack_cli.recording.depth import MM_PER_M
from posetrack_cli.recording.grey import decode_as_stored
from posetrack_cli.recording.matching import LATEST_NS
from posetrack_cli.recording.recording import ReadingOptions, Recording
from posetrack_cli.recording.stamps import stamp_at_rate, stamps_at_rate
from posetrack_cli.units import NS_PER_S

WORDS = "Record3D recording"
SUFFIX, ZIP_BEGIN = ".r3d", b"PK\x03\x04"
METADATA, IMAGES = "metadata", "rgbd"
EXPORTED_METADATA, EXPORTED_IMAGES, EXPORTED_DEPTH, EXR = "metadata.json", "rgb", "depth", ".exr"
IMAGE = re.compile(r"rgbd?/([0-9]{1,9})\.(jpg|png|depth|conf)")
COLOUR, DEPTH, CONFIDENCE = ("jpg", "png"), "depth", "conf"
# ARKit's lowest confidence: edges, dark and shiny surfaces.
UNTRUSTED = 0
# Local header of a zip entry: lengths of the name and of the extra field, which precede the data.
LOCAL_HEADER = struct.Struct("<26xHH")
ENCRYPTED = 0x1  # flag bit of a zip entry
Size = Annotated[int, Field(ge=1, le=limits.IMAGE_PIXELS)]
Number = Annotated[float, Field(ge=-limits.NUMBER, le=limits.NUMBER)]


class _Metadata(BaseModel):
    w: Size
    h: Size
    dw: Size | None = None
    dh: Size | None = None
    K: Annotated[list[Number], Field(min_length=9, max_length=9)]
    fps: Number | None = None
    frameTimestamps: list[Number] = []
    perFrameIntrinsicCoeffs: list[list[Number]] = []


@dataclass(frozen=True)
class _Member:
    """A file of the recording.

    Attributes:
        path: the file, or the archive that holds it.
        entry: entry of the archive; None for a plain file.
    """

    path: Path
    entry: zipfile.ZipInfo | None = None

    def read(self) -> bytes:
        """Return its bytes.

        Raises:
            UnreadableImageError: it cannot be read, or is too large.
        """
        try:
            if self.entry is None:
                return read_input(self.path, limits.IMAGE_BYTES)
            return _unzipped(self.path, self.entry)
        except (OSError, ValueError, struct.error, zlib.error) as error:
            raise UnreadableImageError("file cannot be read") from error


@dataclass(frozen=True)
class _Contents:
    """Files of a recording.

    Attributes:
        metadata: metadata of all images.
        members: files by kind, then by number.
        files: (name, path) of the files that identify the recording.
    """

    metadata: _Metadata
    members: dict[str, dict[int, _Member]]
    files: Sequence[tuple[str, Path]]


def is_record3d(path: Path) -> bool:
    """Return whether a path is a Record3D recording or export."""
    if path.is_dir():
        return ((path / METADATA).is_file() and (path / IMAGES).is_dir()) or _is_exported(path)
    return path.suffix.lower() == SUFFIX and path.is_file() and begins_with(path, ZIP_BEGIN)


def open_record3d_depth(path: Path, options: ReadingOptions) -> Recording:
    """Open the depth of a recording.

    Raises:
        RecordingError: the metadata are missing or damaged, or there is no depth.
    """
    if path.is_dir() and _is_exported(path):
        raise RecordingError(
            "EXR depth is not supported",
            where=path / EXPORTED_DEPTH,
            hint="export the recording as .r3d in Record3D",
        )
    contents = _contents(path)
    size = (contents.metadata.dw, contents.metadata.dh)
    if size[0] is None or size[1] is None or size[0] * size[1] > limits.IMAGE_PIXELS:
        raise RecordingError("invalid size of depth images", where=path, found=f"dw {size[0]} dh {size[1]}")
    levels = contents.members.get(CONFIDENCE, {})
    remarks = [f"depth with confidence {UNTRUSTED} is ignored"] if levels else []
    reading = {
        number: partial(_depth, member, levels.get(number), (size[0], size[1]))
        for number, member in contents.members.get(DEPTH, {}).items()
    }
    return open_depth(_dataset(path, contents, reading, remarks, MM_PER_M), options)


def open_record3d_colour(path: Path, options: ReadingOptions) -> Recording:
    """Open the colour images of a recording.

    Raises:
        RecordingError: the metadata are missing or damaged, or there are no images.
    """
    contents = _contents(path)
    reading = {
        number: partial(_colour, member)
        for kind in COLOUR
        for number, member in contents.members.get(kind, {}).items()
    }
    return open_grey(_dataset(path, contents, reading, [], 1.0), options)


def describe_record3d(path: Path) -> dict[str, Any]:
    """Describe a recording."""
    openers = {"hand run": open_record3d_depth, "head mono": open_record3d_colour}
    return describe_dataset(path, WORDS, openers)


def _dataset(
    path: Path,
    contents: _Contents,
    reading: Mapping[int, Callable[[], ImageArray]],
    remarks: Sequence[str],
    unit_mm: float,
) -> Dataset:
    metadata = contents.metadata
    numbers = sorted(reading)
    if not numbers:
        raise RecordingError("no images of this kind", where=path, expected="rgbd/0.depth, rgbd/0.jpg, ...")
    stamps, fps = _stamps(path, metadata, numbers)
    cameras = _cameras(path, metadata, numbers)
    images = [
        DatasetImage(stamp, f"frame {number}", reading[number], camera)
        for number, stamp, camera in zip(numbers, stamps, cameras, strict=True)
    ]
    said = list(remarks)
    if len(set(cameras)) > 1:
        said.append("intrinsics change during the recording: applied image by image")
    if fps is not None:
        said.append(f"no stamps: assuming {fps:g} frames/s, as stated in the metadata")
    why = f"{METADATA} of the recording"
    return Dataset(path, WORDS, images, cameras[0], why, contents.files, unit_mm, tuple(said), fps)


def _cameras(path: Path, metadata: _Metadata, numbers: Sequence[int]) -> list[Camera]:
    """Return the camera of each image: its own intrinsics if all have them, else the common ones."""
    k, own = metadata.K, metadata.perFrameIntrinsicCoeffs
    if own and numbers[-1] < len(own) and all(len(values) == 4 for values in own):
        coefficients = [tuple(own[number]) for number in numbers]
    else:
        coefficients = [(k[0], k[4], k[6], k[7])] * len(numbers)
    known = {
        one: camera_of(metadata.w, metadata.h, one[0], one[1], one[2], one[3], path)
        for one in dict.fromkeys(coefficients)
    }
    return [known[one] for one in coefficients]


def _stamps(path: Path, metadata: _Metadata, numbers: Sequence[int]) -> tuple[list[int], float | None]:
    """Return the stamps of images, ns, and their rate if stamps are not stored."""
    times = metadata.frameTimestamps
    if len(times) > numbers[-1]:
        stamps = [round(times[number] * NS_PER_S) for number in numbers]
        if not all(0 <= stamp <= LATEST_NS for stamp in stamps):
            raise RecordingError("frameTimestamps are negative or too late", where=path)
        return stamps, None
    if metadata.fps is None or metadata.fps <= 0:
        found = f"{len(times)} stamps for {len(numbers)} images"
        raise RecordingError(
            "no stamps and no frame rate", where=path, found=found, expected="frameTimestamps or fps"
        )
    stamps_at_rate(0, metadata.fps)  # validates the rate
    return [stamp_at_rate(number, metadata.fps) for number in numbers], metadata.fps


def _contents(path: Path) -> _Contents:
    metadata = METADATA
    if path.is_dir():
        is_exported = _is_exported(path)
        metadata, folder = (EXPORTED_METADATA, EXPORTED_IMAGES) if is_exported else (METADATA, IMAGES)
        files = [(f"{folder}/{file.name}", file) for file in _entries(path / folder)]
        files = [(name, file) for name, file in files if IMAGE.fullmatch(name)]
        files.append((metadata, path / metadata))
        found = {name: _Member(file) for name, file in files}
    else:
        files = [(path.name, path)]
        found = {entry.filename: _Member(path, entry) for entry in _index(path)}
    members: dict[str, dict[int, _Member]] = {}
    for name, member in found.items():
        if (match := IMAGE.fullmatch(name)) is not None:
            members.setdefault(match.group(2), {})[int(match.group(1))] = member
    if metadata not in found:
        raise RecordingError("not a Record3D recording", where=path, expected=f"a file {metadata}")
    return _Contents(_metadata(path, found[metadata]), members, sorted(files))


def _metadata(path: Path, member: _Member) -> _Metadata:
    try:
        data = member.read()
        if len(data) > limits.TEXT_BYTES:
            raise RecordingError(
                "metadata too long",
                where=path,
                found=f"{len(data)} bytes",
                expected=f"at most {limits.TEXT_BYTES}",
            )
        return _Metadata.model_validate_json(data)
    except UnreadableImageError as error:
        raise RecordingError("metadata cannot be read", where=path) from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        raise RecordingError("invalid metadata", where=path, found=f"{key}: {first['msg']}") from error


def _is_exported(path: Path) -> bool:
    """Return whether a folder is an EXR and RGB export."""
    folders = (path / EXPORTED_IMAGES, path / EXPORTED_DEPTH)
    if not (path / EXPORTED_METADATA).is_file() or not all(folder.is_dir() for folder in folders):
        return False
    return any(file.suffix.lower() == EXR for file in _entries(folders[1]))


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError as error:
        raise RecordingError("cannot be read", where=folder, found=error.strerror or error) from error


def _index(path: Path) -> list[zipfile.ZipInfo]:
    try:
        with open_input(path) as file, zipfile.ZipFile(file) as archive:
            return archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, RuntimeError, struct.error, OverflowError) as error:
        raise RecordingError("damaged zip archive", where=path, found="no readable index") from error


def _unzipped(path: Path, entry: zipfile.ZipInfo) -> bytes:
    """Return the bytes of an archive entry.

    Raises:
        ValueError: it is encrypted, uses another compression, or exceeds ``limits``.
        OSError, struct.error, zlib.error: it is truncated or damaged.
    """
    is_known = entry.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
    most = max(entry.compress_size, entry.file_size)
    if entry.flag_bits & ENCRYPTED or not is_known or most > limits.IMAGE_BYTES:
        raise ValueError("entry cannot be read")
    with open_input(path) as file:
        file.seek(entry.header_offset)
        lengths = LOCAL_HEADER.unpack(file.read(LOCAL_HEADER.size))
        file.seek(sum(lengths), 1)
        data = file.read(entry.compress_size)
    if entry.compress_type == zipfile.ZIP_DEFLATED:
        data = zlib.decompressobj(-zlib.MAX_WBITS).decompress(data, max(entry.file_size, 1))
    if len(data) != entry.file_size:
        raise ValueError("entry is incomplete")
    return data


def _depth(member: _Member, level: _Member | None, size: tuple[int, int]) -> ImageArray:
    """Return depth, m, without readings of the lowest confidence."""
    from posetrack_cli.recording.compression import decode_lzfse  # imports numba: only when needed

    width, height = size
    data = decode_lzfse(member.read(), 4 * width * height)
    depth = np.frombuffer(data, "<f4").reshape(height, width)
    if level is None:
        return depth
    levels = np.frombuffer(decode_lzfse(level.read(), width * height), np.uint8).reshape(height, width)
    return np.where(levels == UNTRUSTED, np.float32(0.0), depth)


def _colour(member: _Member) -> ImageArray:
    return decode_as_stored(member.read())
