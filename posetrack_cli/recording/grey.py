"""8-bit grey from stored images: colour becomes luma, deeper values keep their upper 8 bits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import cv2
import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.mcap.decoding import COMPRESSED_IMAGE, RAW_IMAGE, VIDEO_IMAGE
from posetrack_cli.recording.base import Encoded, UnreadableImageError
from posetrack_cli.recording.image_files import MESSAGE_FORMATS, decode_any, encoded_file
from posetrack_cli.recording.message_video import is_video_format
from posetrack_cli.recording.orientation import UPRIGHT, Orientation, orientation_after_decoding
from posetrack_cli.recording.pixels import check_size, raw_values

PLAIN_BITS = 8  # ordinary pictures; more bits mean machine vision or depth
BITS = (10, 12, 14, 16)  # significant bits that cameras deliver in 16-bit images
GREY_FLAGS = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
AS_STORED_FLAGS = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION


@dataclass(frozen=True)
class RawEncoding:
    """Pixel layout of a raw image.

    Attributes:
        dtype: of a value, without byte order.
        channels: values per pixel.
        conversion: OpenCV's code to grey; None if it is grey.
        to_colour: OpenCV's code to blue green red; None if it is that, or grey.
    """

    dtype: str
    channels: int
    conversion: int | None = None
    to_colour: int | None = None


RAW_GREY = {
    "mono8": RawEncoding("u1", 1),
    "8UC1": RawEncoding("u1", 1),
    "mono16": RawEncoding("u2", 1),
    "16UC1": RawEncoding("u2", 1),
    "rgb8": RawEncoding("u1", 3, cv2.COLOR_RGB2GRAY, cv2.COLOR_RGB2BGR),
    "bgr8": RawEncoding("u1", 3, cv2.COLOR_BGR2GRAY),
    "8UC3": RawEncoding("u1", 3, cv2.COLOR_BGR2GRAY),
    "rgba8": RawEncoding("u1", 4, cv2.COLOR_RGBA2GRAY, cv2.COLOR_RGBA2BGR),
    "bgra8": RawEncoding("u1", 4, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2BGR),
    "8UC4": RawEncoding("u1", 4, cv2.COLOR_BGRA2GRAY, cv2.COLOR_BGRA2BGR),
    "rgb16": RawEncoding("u2", 3, cv2.COLOR_RGB2GRAY, cv2.COLOR_RGB2BGR),
    "bgr16": RawEncoding("u2", 3, cv2.COLOR_BGR2GRAY),
    "uyvy": RawEncoding("u1", 2, cv2.COLOR_YUV2GRAY_UYVY, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422": RawEncoding("u1", 2, cv2.COLOR_YUV2GRAY_UYVY, cv2.COLOR_YUV2BGR_UYVY),
    "yuyv": RawEncoding("u1", 2, cv2.COLOR_YUV2GRAY_YUY2, cv2.COLOR_YUV2BGR_YUY2),
    "yuv422_yuy2": RawEncoding("u1", 2, cv2.COLOR_YUV2GRAY_YUY2, cv2.COLOR_YUV2BGR_YUY2),
    # OpenCV names a Bayer pattern by the second and third pixel of its second row
    "bayer_rggb8": RawEncoding("u1", 1, cv2.COLOR_BayerBG2GRAY, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": RawEncoding("u1", 1, cv2.COLOR_BayerRG2GRAY, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": RawEncoding("u1", 1, cv2.COLOR_BayerGR2GRAY, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": RawEncoding("u1", 1, cv2.COLOR_BayerGB2GRAY, cv2.COLOR_BayerGB2BGR),
}
NOT_FOXGLOVE = ("8UC4",)  # raw encodings that foxglove.RawImage does not have


@dataclass(frozen=True)
class Grey:
    """Grey or colour values that become 8-bit grey; implements ``Pixels``.

    Attributes:
        width, height: size of the stored images, pixels.
        bits: significant bits of a value; above 8 the upper 8 are kept.
        colour: True for colour images.
        keeps_colour: keep colour as (height, width, 3) blue green red.
    """

    width: int
    height: int
    bits: int = 8
    colour: bool = False
    keeps_colour: bool = False

    is_numbered_as_stored: ClassVar[bool] = False

    @property
    def words(self) -> str:
        """The format, as in run records: ``8-bit grey``, ``12-bit grey``, ``8-bit colour``."""
        return f"{self.bits}-bit {'colour' if self.colour else 'grey'}"

    def from_file(self, data: bytes, where: object) -> ImageArray:
        """Return the (height, width) uint8 grey, or colour, of an image file, oriented by its EXIF."""
        return self._from_encoded(data, orientation_after_decoding(data))

    def _from_encoded(self, data: bytes, orientation: Orientation = UPRIGHT) -> ImageArray:
        image = orientation.apply(decode_any(data, AS_STORED_FLAGS if self.keeps_colour else GREY_FLAGS))
        if image.dtype not in (np.uint8, np.uint16):
            raise UnreadableImageError(f"data type is {image.dtype}, not 8- or 16-bit")
        return self.from_stored(image)

    def from_stored(self, image: ImageArray) -> ImageArray:
        """Return the (height, width) uint8 grey, or colour, of a decoded image with channels B G R."""
        check_size(image, self)
        return self._shown(image)

    def from_message(self, decoded: Any, kind: str, where: str) -> ImageArray:
        """Return the (height, width) uint8 grey of an image message."""
        if kind == COMPRESSED_IMAGE:
            return self._from_encoded(bytes(decoded.data))  # the calibration describes the stored picture
        encoding = str(decoded.encoding)
        if encoding not in RAW_GREY:
            raise UnreadableImageError(f"unknown encoding {encoding}")
        values, stored = _raw_values(decoded), RAW_GREY[encoding]
        conversion = stored.to_colour if self.keeps_colour else stored.conversion
        check_size(values, self)
        try:
            return self._shown(values if conversion is None else cv2.cvtColor(values, conversion))
        except cv2.error as error:  # e.g. an odd width of YUV 4:2:2
            raise UnreadableImageError(f"{encoding} does not allow {self.width}x{self.height}") from error

    def _shown(self, image: ImageArray) -> ImageArray:
        is_deeper = self.bits == PLAIN_BITS and image.dtype == np.uint16  # a 16-bit image among 8-bit ones
        bits = bits_of(image) if is_deeper else self.bits
        if not self.keeps_colour or image.ndim == 2:
            return grey_of(image, bits)
        return eight_bits(image[..., :3], bits) if image.shape[2] > 2 else grey_of(image, bits)

    def encoded_message(self, decoded: Any, kind: str) -> Encoded | None:
        """Return the content of a message of 8-bit values; None for others, and if Foxglove lacks the format.

        Viewers would show deeper images nearly black.
        """
        if self.bits > PLAIN_BITS:
            return None
        if kind == COMPRESSED_IMAGE:
            return encoded_file(bytes(decoded.data))
        encoding = str(decoded.encoding)
        if RAW_GREY[encoding].dtype != "u1" or encoding in NOT_FOXGLOVE:
            return None
        sizes = {name: int(getattr(decoded, name)) for name in ("width", "height", "step")}
        return Encoded(RAW_IMAGE, {**sizes, "encoding": encoding, "data": bytes(decoded.data)})


def grey_like(image: ImageArray, where: object, bits: int | None = None) -> Grey:
    """Return the pixel format of a camera's images from the first stored one.

    Args:
        image: (height, width) or (height, width, channels), uint8 or uint16.
        where: location, for the error.
        bits: significant bits if known; else the fewest that hold a 16-bit image.

    Raises:
        RecordingError: the data type is another one.
    """
    height, width = image.shape[:2]
    colour = image.ndim == 3 and image.shape[2] > 1
    if image.dtype == np.uint8:
        return Grey(width, height, 8, colour)
    if image.dtype != np.uint16:
        raise _unusable(image, where)
    return Grey(width, height, bits or bits_of(image), colour)


def bits_of(image: ImageArray) -> int:
    """Return the fewest significant bits that hold a 16-bit image's values; 8 for an 8-bit image."""
    if image.dtype != np.uint16:
        return PLAIN_BITS
    return next(bits for bits in BITS if image.max(initial=0) < 1 << bits)


def with_bits_of(kind: Grey, images: Iterable[ImageArray]) -> Grey:
    """Return a format with the significant bits of several images, as a dark first one may mislead."""
    return replace(kind, bits=max([kind.bits, *map(bits_of, images)]))


def grey_like_message(decoded: Any, kind: str, where: str) -> Grey:
    """Return the pixel format of a camera's images from its first message.

    Raises:
        UnreadableImageError: the data are damaged.
        RecordingError: the pixels have another data type.
    """
    return grey_like(stored_grey(decoded, kind), where)


def stored_grey(decoded: Any, kind: str) -> ImageArray:
    """Return the stored pixels of an image message.

    Raises:
        UnreadableImageError: the data are damaged.
    """
    return _raw_values(decoded) if kind == RAW_IMAGE else decode_as_stored(bytes(decoded.data))


def holds_grey(decoded: Any, kind: str | None) -> bool:
    """Return whether an image message can be converted to grey, judged by its header."""
    if kind == RAW_IMAGE:
        return str(decoded.encoding) in RAW_GREY
    if kind == VIDEO_IMAGE:
        return is_video_format(str(decoded.format))
    return kind == COMPRESSED_IMAGE and bytes(decoded.data).startswith(tuple(MESSAGE_FORMATS))


def grey_of(image: ImageArray, bits: int) -> ImageArray:
    """Return uint8 grey of an image (height, width) or (height, width, channels), channels B G R."""
    if image.ndim == 3:
        code = {3: cv2.COLOR_BGR2GRAY, 4: cv2.COLOR_BGRA2GRAY}.get(image.shape[2])
        image = image[..., 0] if code is None else cv2.cvtColor(image, code)
    return eight_bits(image, bits)


def eight_bits(image: ImageArray, bits: int) -> ImageArray:
    """Return the upper 8 of an image's significant bits."""
    if image.dtype == np.uint16:
        image = np.minimum(image >> max(bits - 8, 0), 255).astype(np.uint8)
    return image


def decode_as_stored(data: bytes) -> ImageArray:
    """Decode an image file with its stored channels and bits.

    Raises:
        UnreadableImageError: the bytes are not an image, or incomplete.
    """
    return decode_any(data, AS_STORED_FLAGS)


def decode_shown(data: bytes) -> ImageArray:
    """Decode an image file with its stored channels and bits, oriented by its EXIF.

    Raises:
        UnreadableImageError: the bytes are not an image, or incomplete.
    """
    return orientation_after_decoding(data).apply(decode_as_stored(data))


def _raw_values(decoded: Any) -> ImageArray:
    encoding = RAW_GREY[str(decoded.encoding)]
    return raw_values(decoded, encoding.dtype, encoding.channels)


def _unusable(image: ImageArray, where: object) -> RecordingError:
    return RecordingError("unsupported image", where=where, found=image.dtype, expected="8 or 16 bits")
