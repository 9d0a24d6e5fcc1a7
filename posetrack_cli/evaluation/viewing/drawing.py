"""What can be drawn of an estimate: the interface, what every subject has (points, bones, axes)."""

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
_BORDER_PX = 4
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
        numbers: (M,) further numbers of its tracker.
    """

    position: FloatArray | None = None
    quaternion: FloatArray | None = None
    shape: FloatArray | None = None
    points: FloatArray | None = None
    numbers: FloatArray | None = None

    @classmethod
    def of_row(cls, track: Track, row: int) -> Shown:
        """One frame of a track."""
        parts = (track.position, track.quaternion, track.shape, track.points, track.numbers)
        return cls(*(None if part is None else part[row] for part in parts))


@dataclass(frozen=True, eq=False)
class Canvas:
    """What is painted on.

    Attributes:
        picture: (height, width, 3) blue green red, changed in place.
        camera: the pinhole camera that sees it, of its size.
    """

    picture: ImageArray
    camera: Camera

    @property
    def thickness(self) -> int:
        """Of lines, pixels."""
        height: int = self.picture.shape[0]
        return max(1, round(height / 400))

    def draw_line(self, points: FloatArray, colour: Colour, thickness: int) -> None:
        """A polyline through points (P, 3), mm; pieces that reach behind the camera are left out."""
        valid = points[:, 2] >= NEAREST_MM
        pixels = _fixed_point(self.camera.pixels_from_points(points)[0])
        for (start, begins), (end, ends) in pairwise(zip(pixels, valid, strict=True)):
            if begins and ends:
                cv2.line(self.picture, start, end, colour, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)

    def draw_dots(self, points: FloatArray, colour: Colour, radius: int) -> None:
        """A dot at each of the points (P, 3), mm, before the camera."""
        pixels = self.camera.pixels_from_points(points[points[:, 2] >= NEAREST_MM])[0]
        for x, y in _fixed_point(pixels):
            cv2.circle(
                self.picture, (x, y), radius << _SUBPIXEL_BITS, colour, -1, cv2.LINE_AA, _SUBPIXEL_BITS
            )


class Drawer(Protocol):
    """Draws one subject; every tracker's pictures come from one of these."""

    def draw(self, canvas: Canvas, shown: Shown, colour: Colour) -> None:
        """Paint what is shown; ``colour`` is of what has none of its own."""

    def outline(self, canvas: Canvas, shown: Shown, colour: Colour) -> None:
        """Paint a line drawing in this colour, such as the truth's: an estimate is seen over or below it."""


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

    def draw(self, canvas: Canvas, shown: Shown, colour: Colour) -> None:
        """Paint bones, points and axes; see ``Drawer``."""
        self._paint(canvas, shown, colour, AXIS_COLOURS, 0)

    def outline(self, canvas: Canvas, shown: Shown, colour: Colour) -> None:
        """Paint the same in one colour and so wide that an estimate over it is seen with a rim."""
        self._paint(canvas, shown, colour, (colour,) * 3, 2 * canvas.thickness)

    def _paint(
        self, canvas: Canvas, shown: Shown, colour: Colour, of_axes: Sequence[Colour], wider: int
    ) -> None:
        if shown.points is not None:
            bones = [(parent, child) for child, parent in enumerate(self.parents) if parent >= 0]
            for line in (*bones, *self.lines):
                canvas.draw_line(shown.points[list(line)], colour, canvas.thickness + wider)
            canvas.draw_dots(shown.points, colour, 2 * canvas.thickness + wider // 2)
        if not self.axes or shown.position is None or shown.quaternion is None:
            return
        ends = shown.position + AXIS_MM * rotations.matrices_from_quaternions(shown.quaternion).T
        for end, axis_colour in zip(ends, of_axes, strict=True):
            canvas.draw_line(np.stack([shown.position, end]), axis_colour, 2 * canvas.thickness + wider)


def _fixed_point(pixels: FloatArray) -> Sequence[tuple[int, int]]:
    """Pixels (N, 2) as OpenCV's line drawing takes them: integers of 1/16 pixel."""
    fixed = np.rint(np.clip(pixels, -_FARTHEST_PX, _FARTHEST_PX) * (1 << _SUBPIXEL_BITS))
    return [(int(x), int(y)) for x, y in fixed]


def marked(picture: ImageArray, mark: Colour | None) -> ImageArray:
    """The picture in a frame of this colour, for frames that are lost or found anew."""
    if mark is not None:
        height, width = picture.shape[:2]
        cv2.rectangle(picture, (0, 0), (width - 1, height - 1), mark, 2 * _BORDER_PX - 1)
    return picture
