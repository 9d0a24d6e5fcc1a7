"""Pixel formats: the interface between stored images and the pixels of frames."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Protocol

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import Encoded, UnreadableImageError

PixelKind = Literal["depth", "grey"]  # float32 depth, mm, 0 = no reading; or uint8 grey


class Pixels(Protocol):
    """Content of one camera's images.

    All decoding raises UnreadableImageError for data that are not an image, damaged or incomplete, or an
    image of another size or format than the first.

    Attributes:
        is_numbered_as_stored: True if every stored image is a frame, even an unusable one; else unusable
            images are dropped before images are matched across cameras.
    """

    is_numbered_as_stored: ClassVar[bool]

    @property
    def width(self) -> int:
        """Width of the stored images, pixels."""

    @property
    def height(self) -> int:
        """Height of the stored images, pixels."""

    def from_file(self, data: bytes, where: object) -> ImageArray:
        """Return the (height, width) pixels of an image file."""

    def from_stored(self, image: ImageArray) -> ImageArray:
        """Return the (height, width) pixels of a decoded image."""

    def from_message(self, decoded: Any, kind: str, where: str) -> ImageArray:
        """Return the (height, width) pixels of a message of kind RAW_IMAGE or COMPRESSED_IMAGE."""

    def encoded_message(self, decoded: Any, kind: str) -> Encoded | None:
        """Return the content of a message for a Foxglove message with the same pixels, None if it differs."""


@dataclass(frozen=True)
class Window:
    """The used part of the stored images: cropped, then flipped.

    Attributes:
        crop: x, y, width, height of the part, pixels of the stored image; None for all of it.
        mirror: flip left to right.
    """

    crop: tuple[int, int, int, int] | None = None
    mirror: bool = False

    @property
    def keeps_pixels(self) -> bool:
        """True if images pass through unchanged."""
        return self.crop is None and not self.mirror

    def apply(self, image: ImageArray) -> ImageArray:
        """Return the window of an image, contiguous."""
        if self.crop is not None:
            x, y, width, height = self.crop
            image = image[y : y + height, x : x + width]
        return np.ascontiguousarray(image[:, ::-1] if self.mirror else image)

    def camera(self, camera: Camera) -> Camera:
        """Return the camera of the window, given the camera of the stored images.

        Raises:
            RecordingError: the crop exceeds the image.
        """
        if self.crop is not None:
            camera = _cropped(camera, self.crop)
        return camera.mirrored() if self.mirror else camera


def _cropped(camera: Camera, crop: tuple[int, int, int, int]) -> Camera:
    x, y, width, height = crop
    inside = min(x, y) >= 0 and min(width, height) > 0
    if not inside or x + width > camera.width or y + height > camera.height:
        raise RecordingError(
            "crop exceeds the image",
            where="camera.toml",
            found=f"x {x}, y {y}, {width}x{height}",
            expected=f"a region within {camera.width}x{camera.height}",
        )
    return replace(camera, width=width, height=height, cx=camera.cx - x, cy=camera.cy - y)


def check_size(image: ImageArray, pixels: Pixels) -> None:
    """Raise UnreadableImageError if an image differs in size from the first."""
    if image.shape[:2] != (pixels.height, pixels.width):
        found, expected = f"{image.shape[1]}x{image.shape[0]}", f"{pixels.width}x{pixels.height}"
        raise UnreadableImageError(f"size is {found}, not {expected} like the first")


def raw_values(decoded: Any, value: str, channels: int = 1) -> ImageArray:
    """Return the (height, width) or (height, width, channels) values of a raw image message.

    Args:
        decoded: a foxglove.RawImage or ROS Image, whose rows may be padded to ``step`` bytes.
        value: dtype of one value, without byte order.
        channels: values per pixel.

    Raises:
        UnreadableImageError: the data are too short.
    """
    dtype = np.dtype((">" if getattr(decoded, "is_bigendian", 0) else "<") + value)
    width, height, data = int(decoded.width), int(decoded.height), bytes(decoded.data)
    pixel = dtype.itemsize * channels
    step = int(decoded.step) or width * pixel
    needed = step * (height - 1) + width * pixel
    if min(width, height) < 1 or step < width * pixel or len(data) < needed:
        raise UnreadableImageError(f"{len(data)} bytes are too few for {width}x{height} {decoded.encoding}")
    shape = (height, width, channels)
    strided: ImageArray = np.ndarray(shape, dtype, data, strides=(step, pixel, dtype.itemsize))
    whole = strided.astype(dtype.newbyteorder("="))
    return whole[..., 0] if channels == 1 else whole
