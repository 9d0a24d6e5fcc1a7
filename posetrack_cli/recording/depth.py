"""From stored pixel values to depth in millimetres, and the window cut out of an image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import Float32Array, ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera

MM_PER_M = 1000.0


def depth_from_codes(codes: ImageArray, unit_mm: float = 1.0, missing: int = 0) -> Float32Array:
    """Return depth, mm, of unsigned integer codes of ``unit_mm`` each; 0 and ``missing`` become 0.

    So do depths that no camera reads (``limits``).
    """
    depth = (codes * np.float64(unit_mm)).astype(np.float32) if unit_mm != 1.0 else codes.astype(np.float32)
    if missing:
        depth[codes == missing] = 0.0
    usual = codes.dtype.itemsize <= 2 and limits.NEAREST_MM <= unit_mm <= limits.FARTHEST_MM / 65535
    return depth if usual else _readings(depth)


def depth_from_metres(metres: ImageArray) -> Float32Array:
    """Return depth, mm, of floating-point metres; NaN, inf and what no camera reads (``limits``) become 0."""
    with np.errstate(over="ignore", invalid="ignore"):
        depth = (metres.astype(np.float64) * MM_PER_M).astype(np.float32)
    return _readings(depth)


def _readings(depth: Float32Array) -> Float32Array:
    """Depth, mm, with 0 in the place of what is no reading: arithmetic on it would overflow."""
    with np.errstate(invalid="ignore"):
        readable = (depth >= limits.NEAREST_MM) & (depth <= limits.FARTHEST_MM)
    depth[~readable] = 0.0
    return depth


@dataclass(frozen=True)
class Window:
    """The part of the stored images that is used: first cut out, then flipped.

    Attributes:
        crop: x, y, width, height of the part, pixels of the stored image; None for all of it.
        mirror: flip left to right.
    """

    crop: tuple[int, int, int, int] | None = None
    mirror: bool = False

    @property
    def keeps_pixels(self) -> bool:
        """Whether images pass through unchanged."""
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
            RecordingError: if the crop does not lie in the image.
        """
        if self.crop is not None:
            camera = _cropped(camera, self.crop)
        return camera.mirrored() if self.mirror else camera


def _cropped(camera: Camera, crop: tuple[int, int, int, int]) -> Camera:
    x, y, width, height = crop
    inside = min(x, y) >= 0 and min(width, height) > 0
    if not inside or x + width > camera.width or y + height > camera.height:
        raise RecordingError(
            "crop does not lie in the image",
            where="camera.toml",
            found=f"x {x}, y {y}, {width}x{height}",
            expected=f"a part of {camera.width}x{camera.height}",
        )
    return replace(camera, width=width, height=height, cx=camera.cx - x, cy=camera.cy - y)
