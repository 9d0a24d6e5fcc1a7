"""Which part of an image a picture shows, and how large."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import in_camera_axes

MARGIN_MM = 45.0
"""How far skin reaches beyond the outermost joints, and some room around it."""
LEAST_ROWS = 300
"""A picture is enlarged by whole numbers until it is at least so high, unless a scale is asked for."""


@dataclass(frozen=True)
class Viewport:
    """A part of an image, drawn ``scale`` times as large.

    Attributes:
        left, top, width, height: of the part, pixels of the image.
        scale: picture pixels per image pixel; the picture has at least one pixel.
    """

    left: int
    top: int
    width: int
    height: int
    scale: float = 1.0

    @classmethod
    def whole(cls, camera: Camera, scale: float = 1.0) -> Viewport:
        """All of a camera's image."""
        return cls(0, 0, camera.width, camera.height, scale)

    def scaled(self, scale: float | None, shrunk: float = 1.0) -> Viewport:
        """The same part at a scale; by default the whole number that makes it ``LEAST_ROWS`` high, shrunk."""
        return replace(self, scale=scale or shrunk * -(-LEAST_ROWS // self.height))

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the picture, pixels."""
        return max(1, round(self.width * self.scale)), max(1, round(self.height * self.scale))

    def camera(self, camera: Camera) -> Camera:
        """The pinhole camera that sees the picture: a pixel's edges, not its centre, are scaled."""
        across, down = self.size[0] / self.width, self.size[1] / self.height
        return replace(
            camera,
            width=self.size[0],
            height=self.size[1],
            fx=camera.fx * across,
            fy=camera.fy * down,
            cx=(camera.cx - self.left + 0.5) * across - 0.5,
            cy=(camera.cy - self.top + 0.5) * down - 0.5,
            distortion=(),
        )

    def cut(self, image: ImageArray) -> ImageArray:
        """The picture of an image: its pixels are repeated, or averaged where the picture is smaller."""
        part = image[self.top : self.top + self.height, self.left : self.left + self.width]
        way = cv2.INTER_AREA if self.scale < 1.0 else cv2.INTER_NEAREST
        return cv2.resize(part, self.size, interpolation=way) if self.scale != 1.0 else part


class Framing:
    """Chooses which part of a camera's image pictures show; all pictures are of one size.

    Args:
        camera: of the image.
        points: (N, P, 3) mm, in the axes of the reference camera, that pictures are cut out around; None for
            all of the image.
        scale: picture pixels per image pixel; None enlarges small pictures.
        still: whether all pictures show the same part, or each is centred on its own points.
        shrunk: factor on the size of pictures whose scale is not told.
    """

    def __init__(
        self,
        camera: Camera,
        points: FloatArray | None,
        scale: float | None = None,
        *,
        still: bool = True,
        shrunk: float = 1.0,
    ) -> None:
        self._camera, self._moves = camera, points is not None and not still
        common = Viewport.whole(camera)
        if points is not None:
            common = (around_points if still else largest_viewport)(in_camera_axes(camera, points), camera)
        self._common = common.scaled(scale, shrunk)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of every picture, pixels."""
        return self._common.size

    def viewport(self, points: FloatArray | None) -> Viewport:
        """Return the part to show where points (P, 3) mm are, in the axes of the reference camera."""
        if not self._moves or points is None:
            return self._common
        return moved_to(self._common, in_camera_axes(self._camera, points), self._camera)


def around_points(points: FloatArray, camera: Camera) -> Viewport:
    """The part of the image in which all points can be seen, with a margin for skin.

    Args:
        points: (..., 3) mm; those behind the camera do not count.
        camera: of the image.
    """
    flat = points.reshape(-1, 3)
    flat = flat[flat[:, 2] > 0.0]
    if not flat.size:
        return Viewport.whole(camera)
    pixels, _ = camera.pixels_from_points(flat)
    margin = MARGIN_MM * np.array([camera.fx, camera.fy]) / flat[:, 2:]
    size = np.array([camera.width, camera.height])
    low = np.clip((pixels - margin).min(axis=0), 0, size - 1)
    high = np.clip((pixels + margin).max(axis=0), low + 1, size)
    (left, top), (right, bottom) = np.floor(low).astype(int).tolist(), np.ceil(high).astype(int).tolist()
    return Viewport(left, top, right - left, bottom - top)


def largest_viewport(points: FloatArray, camera: Camera) -> Viewport:
    """A viewport as large as that of the largest of several subjects.

    Args:
        points: (N, P, 3) of each, mm.
        camera: of the image.
    """
    each = [around_points(subject, camera) for subject in points]
    if not each:
        return Viewport.whole(camera)
    return Viewport(0, 0, max(one.width for one in each), max(one.height for one in each))


def moved_to(viewport: Viewport, points: FloatArray, camera: Camera) -> Viewport:
    """A viewport of the same size, centred on points (..., 3), mm, as far as the image reaches."""
    flat = points.reshape(-1, 3)
    flat = flat[flat[:, 2] > 0.0]
    if not flat.size:
        return viewport
    pixels, _ = camera.pixels_from_points(flat)
    middle = 0.5 * (pixels.min(axis=0) + pixels.max(axis=0))
    left = int(np.clip(round(middle[0] - 0.5 * viewport.width), 0, camera.width - viewport.width))
    top = int(np.clip(round(middle[1] - 0.5 * viewport.height), 0, camera.height - viewport.height))
    return replace(viewport, left=left, top=top)
