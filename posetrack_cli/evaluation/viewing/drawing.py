"""What can be drawn of an estimate: the interface, and points, bones and axes, which every subject has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.evaluation.track import Track
from posetrack_cli.evaluation.viewing.colours import Colour
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera

AXIS_COLOURS: tuple[Colour, ...] = ((60, 60, 255), (60, 220, 60), (255, 120, 60))
"""Of x, y, z: red, green, blue."""
AXIS_MM = 60.0
NEAREST_MM = 1.0
_SUBPIXEL_BITS = 4
_FARTHEST_PX = 20_000.0
"""Lines are cut at the edges of the image; coordinates beyond this overflow in that."""


@dataclass(frozen=True, eq=False)
class Shown:
    """One estimate or truth as drawn; what its source does not know is None.

    Attributes:
        position: (3,) mm.
        quaternion: (4,) x y z w.
        shape: (K,).
        points: (P, 3) mm.
    """

    position: FloatArray | None = None
    quaternion: FloatArray | None = None
    shape: FloatArray | None = None
    points: FloatArray | None = None

    @classmethod
    def of_row(cls, track: Track, row: int) -> Shown:
        """One frame of a track."""
        parts = (track.position, track.quaternion, track.shape, track.points)
        return cls(*(None if part is None else part[row] for part in parts))


class Drawer(Protocol):
    """Draws one subject; every tracker's pictures come from one of these."""

    def draw(self, picture: ImageArray, camera: Camera, shown: Shown, colour: Colour) -> None:
        """Paint into a picture.

        Args:
            picture: (height, width, 3) blue green red, changed in place.
            camera: the pinhole camera that sees it, of its size.
            shown: what to draw.
            colour: of what has no colour of its own.
        """

    def outline(self, picture: ImageArray, camera: Camera, shown: Shown, colour: Colour) -> None:
        """Paint a line drawing that leaves what is below it visible."""


class Segments(Protocol):
    """Tells the pixels of a subject from others, around an estimate."""

    def paint(self, straight: ImageArray, depth: ImageArray, shown: Shown) -> None:
        """Paint over a picture (h, w, 3) of the whole image without lens distortion, in place."""


@dataclass(frozen=True)
class SkeletonDrawer:
    """Points, the bones between them and their parents, lines, and the axes of the pose.

    Attributes:
        parents: P indices, -1 for a root; empty draws no bones.
        axes: whether x, y, z of the pose are drawn, red, green and blue.
        lines: further pairs of points with a line between them.
    """

    parents: tuple[int, ...] = ()
    axes: bool = True
    lines: tuple[tuple[int, int], ...] = ()

    def draw(self, picture: ImageArray, camera: Camera, shown: Shown, colour: Colour) -> None:
        """Paint bones, points and axes; see ``Drawer``."""
        self.outline(picture, camera, shown, colour)
        if self.axes:
            _draw_axes(picture, camera, shown)

    def outline(self, picture: ImageArray, camera: Camera, shown: Shown, colour: Colour) -> None:
        """Paint bones, lines and points."""
        if shown.points is None:
            return
        thickness = _thickness(picture)
        for child, parent in enumerate(self.parents):
            if parent >= 0:
                _draw_line(picture, camera, shown.points[[parent, child]], colour, thickness)
        for line in self.lines:
            _draw_line(picture, camera, shown.points[list(line)], colour, thickness)
        for pixel in _pixels(camera, shown.points):
            _draw_dot(picture, pixel, colour, 2 * thickness)


def _draw_axes(picture: ImageArray, camera: Camera, shown: Shown) -> None:
    if shown.position is None or shown.quaternion is None:
        return
    ends = shown.position + AXIS_MM * rotations.matrices_from_quaternions(shown.quaternion).T
    for end, colour in zip(ends, AXIS_COLOURS, strict=True):
        _draw_line(picture, camera, np.stack([shown.position, end]), colour, 2 * _thickness(picture))


def _thickness(picture: ImageArray) -> int:
    height: int = picture.shape[0]
    return max(1, round(height / 400))


def _draw_line(
    picture: ImageArray, camera: Camera, points: FloatArray, colour: Colour, thickness: int
) -> None:
    """A polyline through points (P, 3), mm; pieces that reach behind the camera are left out."""
    valid = points[:, 2] >= NEAREST_MM
    pixels = _fixed_point(camera.pixels_from_points(points)[0])
    for (start, begins), (end, ends) in pairwise(zip(pixels, valid, strict=True)):
        if begins and ends:
            cv2.line(picture, start, end, colour, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)


def _draw_dot(picture: ImageArray, pixel: FloatArray, colour: Colour, radius: int) -> None:
    ((x, y),) = _fixed_point(pixel[None])
    cv2.circle(picture, (x, y), radius << _SUBPIXEL_BITS, colour, -1, cv2.LINE_AA, _SUBPIXEL_BITS)


def _pixels(camera: Camera, points: FloatArray) -> FloatArray:
    """Pixels (M, 2) of the points before the camera."""
    return camera.pixels_from_points(points[points[:, 2] >= NEAREST_MM])[0]


def _fixed_point(pixels: FloatArray) -> Sequence[tuple[int, int]]:
    """Pixels (N, 2) as OpenCV's line drawing takes them: integers of 1/16 pixel."""
    fixed = np.rint(np.clip(pixels, -_FARTHEST_PX, _FARTHEST_PX) * (1 << _SUBPIXEL_BITS))
    return [(int(x), int(y)) for x, y in fixed]
