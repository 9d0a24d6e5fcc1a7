"""Image files: listing a folder; decoding and encoding 16-bit depth."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.files import read_input
from posetrack_cli.mcap.decoding import COMPRESSED_IMAGE
from posetrack_cli.recording.base import Encoded, UnreadableImageError
from posetrack_cli.recording.exif import TIFF_BEGIN
from posetrack_cli.recording.stamps import order_of_names, order_remark
from posetrack_cli.recording.tiff import Page, find_pages, page_bytes

Decoded = TypeVar("Decoded")

DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".pgm")
GREY_SUFFIXES = (*DEPTH_SUFFIXES, ".jpg", ".jpeg", ".bmp", ".ppm", ".webp")
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_BEGIN, JPEG_END = b"\xff\xd8", b"\xff\xd9"
WEBP_BEGIN = b"RIFF"
TIFF_ENTRY_BYTES, TIFF_SHORT, TIFF_TILE_TAGS = 12, 3, (322, 323)
# First bytes of the decoded file types.
SIGNATURES = (
    *(PNG_SIGNATURE, JPEG_BEGIN, WEBP_BEGIN, *TIFF_BEGIN, b"BM"),
    *(b"P%d" % kind for kind in range(1, 7)),
)
# Formats of foxglove.CompressedImage by signature.
MESSAGE_FORMATS = {PNG_SIGNATURE: "png", JPEG_BEGIN: "jpeg", WEBP_BEGIN: "webp"}
TIFF_SUFFIXES = (".tif", ".tiff")
# If every file has the same small number of pages, they are channels of one image (depth, confidence,
# infrared).
MOST_CHANNELS = 4
JPEG_SCAN = b"\xff\xda"
PNG_SIZE, PNG_SIZE_AT = struct.Struct(">II"), 16
# Part of OpenCV's error for images beyond ``limits.IMAGE_PIXELS``, which the package passes to it on
# import.
TOO_LARGE = "CV_IO_MAX_IMAGE"
PNG_LEVEL = 9
JPEG_QUALITY = 95
PNG_CHUNK = struct.Struct(">I4s")  # length of the content, type; content and checksum follow


@dataclass(frozen=True)
class ImageFile:
    """An image file, or one page of a TIFF.

    Attributes:
        path: the file.
        page: page of a multi-page TIFF, else None.
    """

    path: Path
    page: Page | None = None

    @property
    def name(self) -> str:
        """File name, with the page counted from 1."""
        return self.path.name if self.page is None else f"{self.path.name} page {self.page.number + 1}"

    @property
    def stem(self) -> str:
        """File name without its suffix."""
        return self.path.stem

    @property
    def suffix(self) -> str:
        """Suffix of the file name."""
        return self.path.suffix

    @property
    def parent(self) -> Path:
        """Folder of the file."""
        return self.path.parent

    def __str__(self) -> str:
        return str(self.parent / self.name)


@dataclass(frozen=True)
class ListedImages:
    """The images of a folder, in order.

    Attributes:
        images: at least one.
        remarks: remarks on order and TIFF pages.
    """

    images: list[ImageFile]
    remarks: tuple[str, ...] = ()


def list_images(folder: Path, suffixes: tuple[str, ...] = DEPTH_SUFFIXES) -> list[ImageFile]:
    """Return the images of ``listed_images``."""
    return listed_images(folder, suffixes).images


def listed_images(folder: Path, suffixes: tuple[str, ...] = DEPTH_SUFFIXES) -> ListedImages:
    """Return the images of a folder, including all pages of TIFFs; hidden files are skipped.

    Sorted by the stamps in their names, else in natural order: 2 before 10.

    Args:
        folder: folder to list.
        suffixes: image suffixes, lower case.

    Raises:
        RecordingError: the folder cannot be listed or has no images.
    """
    try:
        entries = list(folder.iterdir())
    except OSError as error:
        raise RecordingError("cannot be read", where=folder, found=error.strerror or error) from error
    files = [e for e in entries if e.suffix.lower() in suffixes and not e.name.startswith(".")]
    if not files:
        found = f"{len(entries)} other files" if entries else "empty folder"
        raise RecordingError(
            "no images", where=folder, found=found, expected=f"files named *{', *'.join(suffixes)}"
        )
    order = order_of_names([file.name for file in files], [file.stem for file in files])
    files = [files[i] for i in order]
    images, remarks = _with_pages(files)
    return ListedImages(images, order_remark([file.name for file in files]) + remarks)


def _with_pages(files: Sequence[Path]) -> tuple[list[ImageFile], tuple[str, ...]]:
    """Return the images of files, with every TIFF page as a frame, and remarks.

    If all files have the same few pages, each first page is the image and the others are channels.
    """
    pages = {file: find_pages(file) for file in files if file.suffix.lower() in TIFF_SUFFIXES}
    stacks = {file: found for file, found in pages.items() if found is not None and len(found.images) > 1}
    each = {len(found.images) for found in stacks.values()}
    if len(stacks) == len(files) > 1 and len(each) == 1 and max(each) <= MOST_CHANNELS:
        remark = f"each of {len(files)} files has {max(each)} pages: only the first is read"
        return [ImageFile(file) for file in files], (remark,)
    images: list[ImageFile] = []
    for file in files:
        found = pages.get(file)
        if found is None or (len(found.images) == 1 and found.images[0].number == 0):
            images.append(ImageFile(file))
        else:
            images += [ImageFile(file, page) for page in found.images]
    remarks = []
    if stacks:
        total, more = sum(len(found.images) for found in stacks.values()), _more(stacks)
        remarks.append(f"{total} pages of {next(iter(stacks)).name}{more} are read as frames")
    others = {file: found.others for file, found in pages.items() if found is not None and found.others}
    if others:
        name = next(iter(others)).name
        remarks.append(
            f"skipped {sum(others.values())} pages of another size or kind in {name}{_more(others)}"
        )
    return images, tuple(remarks)


def _more(files: Mapping[Path, object]) -> str:
    return f" and {len(files) - 1} more files" if len(files) > 1 else ""


def files_of(images: Iterable[ImageFile]) -> list[Path]:
    """Return the files that hold images, each once."""
    return list(dict.fromkeys(image.path for image in images))


def read_image(image: ImageFile) -> bytes:
    """Return an image file's bytes, or a TIFF of one page only.

    Raises:
        UnreadableImageError: it cannot be read.
    """
    try:
        if image.page is None:
            return read_input(image.path, limits.IMAGE_BYTES)
        data = page_bytes(image.path, image.page)
    except OSError as error:
        raise UnreadableImageError("file cannot be read") from error
    if not data:
        raise UnreadableImageError("page is damaged")
    return data


def first_decoded(images: Sequence[ImageFile], decode: Callable[[ImageFile], Decoded]) -> Decoded:
    """Return the result of the first image that can be decoded.

    Args:
        images: images of one folder, at least one.
        decode: raises UnreadableImageError on failure.

    Raises:
        RecordingError: no image can be decoded.
    """
    reason = ""
    for image in images:
        try:
            return decode(image)
        except UnreadableImageError as error:
            reason = reason or str(error)
    found = f"{len(images)} files (first one: {reason})"
    raise RecordingError("no image can be decoded", where=images[0].parent, found=found)


def decode_codes(data: bytes, where: str) -> ImageArray:
    """Decode a single-channel image to (height, width) uint16 codes, or float32 values of a TIFF.

    Raises:
        UnreadableImageError: the bytes are not an image, or incomplete.
        RecordingError: the image has colour or another data type.
    """
    image = decode_any(data)
    if image.ndim != 2:
        raise RecordingError(
            "colour image given as depth",
            where=where,
            found=f"{image.shape[2]} channels",
            expected="1",
            hint="depth packed in colour is supported for NYU hand pose folders only",
        )
    if image.dtype not in (np.uint16, np.float32):
        raise RecordingError(
            f"{8 * image.dtype.itemsize}-bit image given as depth",
            where=where,
            found=image.dtype,
            expected="16-bit unsigned integers or 32-bit floats",
        )
    return image


def decode_any(data: bytes, flags: int = cv2.IMREAD_UNCHANGED) -> ImageArray:
    """Decode an image file of a type in ``SIGNATURES``, by default with stored bits and channels.

    Raises:
        UnreadableImageError: the bytes are not such an image, are incomplete, or exceed ``limits``.
    """
    if not data:
        raise UnreadableImageError("file is empty")
    if not data.startswith(SIGNATURES):  # keep OpenCV from trying its many other decoders on foreign data
        raise UnreadableImageError("unsupported image format")
    if _is_truncated(data):
        raise UnreadableImageError("image is incomplete")
    _check_bounds(data)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        if TOO_LARGE in str(error):
            raise UnreadableImageError(f"image has more than {limits.IMAGE_PIXELS} pixels") from error
        raise UnreadableImageError("image cannot be decoded") from error
    if image is None:  # cv2.imdecode returns None on most failures
        raise UnreadableImageError("image cannot be decoded")
    return image


def _check_bounds(data: bytes) -> None:
    """Refuse images that would keep a decoder busy; OpenCV itself refuses other oversized images."""
    if data.startswith(PNG_SIGNATURE):
        if data[PNG_SIZE_AT - 4 : PNG_SIZE_AT] != b"IHDR":
            raise UnreadableImageError("image cannot be decoded")
        width, height = PNG_SIZE.unpack_from(data, PNG_SIZE_AT)
        if width * height > limits.IMAGE_PIXELS:
            raise UnreadableImageError(f"image has more than {limits.IMAGE_PIXELS} pixels")
    if data.startswith(JPEG_BEGIN) and data.count(JPEG_SCAN) > limits.JPEG_SCANS:
        raise UnreadableImageError(f"image has more than {limits.JPEG_SCANS} scans")
    if data.startswith(TIFF_BEGIN) and _tile_pixels(data) > limits.TILE_PIXELS:
        raise UnreadableImageError(f"image has tiles of more than {limits.TILE_PIXELS} pixels")


def _tile_pixels(data: bytes) -> int:
    """Return the pixels of a TIFF's tiles, 0 without tiles (TIFF 6.0, sections 2 and 15)."""
    order = "<" if data.startswith(b"II") else ">"
    entry, sides = struct.Struct(f"{order}HHI"), {}
    try:
        (start,) = struct.unpack_from(f"{order}I", data, 4)
        (count,) = struct.unpack_from(f"{order}H", data, start)
        for at in range(start + 2, start + 2 + TIFF_ENTRY_BYTES * count, TIFF_ENTRY_BYTES):
            tag, kind, _ = entry.unpack_from(data, at)
            value = "H" if kind == TIFF_SHORT else "I"
            (sides[tag],) = struct.unpack_from(order + value, data, at + entry.size)
    except struct.error:
        pass  # truncated directory: the decoder reports it
    width, length = (sides.get(tag, 0) for tag in TIFF_TILE_TAGS)
    return int(width * length)


def _is_truncated(data: bytes) -> bool:
    """Return whether a PNG or JPEG ends early; their decoders would fill the rest with grey."""
    if data.startswith(PNG_SIGNATURE):
        return not is_complete_png(data)
    return data.startswith(JPEG_BEGIN) and data.rfind(JPEG_END) < len(data) // 2


def is_complete_png(data: bytes) -> bool:
    """Return whether all chunks are present with valid checksums; libpng would print a warning."""
    view, position = memoryview(data), len(PNG_SIGNATURE)
    while position + PNG_CHUNK.size + 4 <= len(data):
        length, kind = PNG_CHUNK.unpack_from(data, position)
        end = position + PNG_CHUNK.size + length
        if zlib.crc32(view[position + 4 : end]) != int.from_bytes(view[end : end + 4], "big"):
            return False
        if kind == b"IEND":
            return True
        position = end + 4
    return False


def encode_png(codes: ImageArray, level: int = PNG_LEVEL) -> bytes:
    """Encode (height, width) uint8 or uint16 codes as a PNG; level 0 is fast, 9 is small."""
    _, data = cv2.imencode(".png", codes, [cv2.IMWRITE_PNG_COMPRESSION, level])
    return data.tobytes()


def encode_jpeg(image: ImageArray) -> bytes:
    """Encode (height, width) uint8 grey, or (height, width, 3) blue green red, as a JPEG."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return data.tobytes()


def encoded_file(data: bytes) -> Encoded | None:
    """Return the content of an image file for a message; None if no message has its format."""
    found = next((name for sign, name in MESSAGE_FORMATS.items() if data.startswith(sign)), None)
    return None if found is None else Encoded(COMPRESSED_IMAGE, {"format": found, "data": data})
