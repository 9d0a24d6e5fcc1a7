"""8-bit grey images from whatever is stored: colour becomes luma, of more bits the upper eight are kept."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.recording.image_files import decode_any

BITS = (10, 12, 14, 16)
"""Significant bits that cameras deliver in 16-bit images."""
GREY_FLAGS = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
AS_STORED_FLAGS = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION


@dataclass(frozen=True)
class StoredKind:
    """What the images of one camera are like.

    Attributes:
        width, height: pixels.
        bits: significant bits of a value: 8, or what is cut to the upper 8.
        colour: whether they are converted.
    """

    width: int
    height: int
    bits: int = 8
    colour: bool = False

    @property
    def words(self) -> str:
        """For people and run records: ``8-bit grey``, ``12-bit grey``, ``8-bit colour``."""
        return f"{self.bits}-bit {'colour' if self.colour else 'grey'}"


def kind_of_image(image: ImageArray, where: object, bits: int | None = None) -> StoredKind:
    """Tell what images are like from the first of them, as stored.

    Args:
        image: (height, width) or (height, width, channels), uint8 or uint16.
        where: for the error.
        bits: significant bits if they are known; else 16-bit values get the fewest that hold the image.

    Raises:
        RecordingError: it is neither.
    """
    height, width = image.shape[:2]
    colour = image.ndim == 3 and image.shape[2] > 1
    if image.dtype == np.uint8:
        return StoredKind(width, height, 8, colour)
    if image.dtype != np.uint16:
        raise RecordingError("image cannot be used", where=where, found=image.dtype, expected="8 or 16 bits")
    found = next(b for b in BITS if image.max(initial=0) < 1 << b)
    return StoredKind(width, height, bits or found, colour)


def grey_of(image: ImageArray, bits: int) -> ImageArray:
    """Return uint8 grey values of an image (height, width) or (height, width, channels), channels B G R."""
    if image.ndim == 3:
        code = {3: cv2.COLOR_BGR2GRAY, 4: cv2.COLOR_BGRA2GRAY}.get(image.shape[2])
        image = image[..., 0] if code is None else cv2.cvtColor(image, code)
    if image.dtype == np.uint16:
        image = np.minimum(image >> max(bits - 8, 0), 255).astype(np.uint8)
    return image


def decode_grey(data: bytes, kind: StoredKind, where: object) -> ImageArray:
    """Decode an image file to (height, width) uint8 grey.

    Raises:
        UnreadableImageError: the bytes are no image or an incomplete one.
        RecordingError: it is of another size than the images before, or has values of another kind.
    """
    image = decode_any(data, GREY_FLAGS)
    if image.dtype not in (np.uint8, np.uint16):
        raise RecordingError("image cannot be used", where=where, found=image.dtype, expected="8 or 16 bits")
    check_size(image, kind, where)
    return grey_of(image, kind.bits)


def decode_as_stored(data: bytes) -> ImageArray:
    """Decode an image file with the channels and bits it has.

    Raises:
        UnreadableImageError: the bytes are no image or an incomplete one.
    """
    return decode_any(data, AS_STORED_FLAGS)


def check_size(image: ImageArray, kind: StoredKind, where: object) -> None:
    """Raise RecordingError if an image is not of the size of the first."""
    if image.shape[:2] != (kind.height, kind.width):
        raise RecordingError(
            "images differ in size",
            where=where,
            found=f"{image.shape[1]}x{image.shape[0]}",
            expected=f"{kind.width}x{kind.height} as in the images before",
        )
