"""Drawing primitives: colours, viewports, lines and captions."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import pairwise
from typing import Protocol, TypeAlias

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera, in_camera_axes

# Colours (BGR, as in OpenCV), depth in false colour, shading


Colour = tuple[int, int, int]

SKIN: Colour = (150, 200, 235)
SECOND: Colour = (235, 190, 120)
TRUTH: Colour = (120, 255, 120)
LOST: Colour = (60, 60, 255)
FOUND_ANEW: Colour = (60, 190, 255)
TEXT: Colour = (235, 235, 235)
TONES = (SKIN, SECOND)
TOGETHER: tuple[Colour, ...] = (
    (140, 200, 255),
    (255, 170, 90),
    (200, 120, 255),
    (120, 230, 120),
    (90, 220, 240),
    (235, 120, 180),
)
"""Colours of subjects in one picture."""

# Most colours are used for the hand and its surroundings; a body further back is dark blue.
_IN_FRONT_MM, _BEHIND_MM = 90.0, 330.0
_USUAL_MM = (450.0, 1100.0)
_BLUEST = 14.0  # of 255; lower values of the colour map look like missing readings, which are black
_STEEPEST = 2.0  # mm per pixel at scale 1; the shading saturates on steeper surfaces
_AMBIENT, _SLOPE_LIGHT = 0.75, 0.25


@dataclass(frozen=True)
class DepthRange:
    """Range of depths in false colour, mm: ``near`` is red, ``far`` is blue."""

    near: float
    far: float

    @classmethod
    def of_points(cls, z: FloatArray) -> DepthRange:
        """Return the range around the depths of tracked points (any shape), mm, without outliers."""
        good = z[np.isfinite(z) & (z > 0)]
        if not good.size:
            return cls(*_USUAL_MM)
        low, high = np.percentile(good, [1.0, 99.0])  # single bad frames must not compress the colours
        return cls(max(0.0, float(low) - _IN_FRONT_MM), float(high) + _BEHIND_MM)


def false_colour(depth: Float32Array, depths: DepthRange) -> ImageArray:
    """Return depth (h, w), mm, in false colour (h, w, 3): near is red, far is blue, no reading is black."""
    gain = (255.0 - _BLUEST) / (depths.far - depths.near)
    value = (depths.far - depth) * gain
    value += _BLUEST
    shade = np.clip(value, _BLUEST, 255.0, out=value).astype(np.uint8)
    shade *= depth > 0
    picture: ImageArray = cv2.applyColorMap(shade, _colours())
    return picture


@cache
def _colours() -> ImageArray:
    """Return the colour map (256, 1, 3), with black for 0."""
    colours: ImageArray = cv2.applyColorMap(np.arange(256, dtype=np.uint8), cv2.COLORMAP_TURBO)
    colours[0] = 0
    return colours


def lit(depth: Float32Array, mm_per_pixel: float) -> FloatArray:
    """Return the brightness (h, w), 0 to 1, of a surface lit from the upper left.

    Args:
        depth: (h, w) depth, mm; 0 for no surface.
        mm_per_pixel: distance of neighbouring pixels at the depth of the surface, mm.
    """
    down, right = np.gradient(np.where(depth > 0, depth, np.nan))
    slope = np.clip((down + right) / max(mm_per_pixel, 1e-3), -_STEEPEST, _STEEPEST)
    light = _AMBIENT - _SLOPE_LIGHT * slope
    return np.asarray(np.clip(np.nan_to_num(light, nan=0.5), 0.15, 1.0), dtype=np.float64)


def shaded(colours: ImageArray, light: FloatArray) -> ImageArray:
    """Return colours (h, w, 3) or (3,) multiplied by a brightness (h, w)."""
    return np.asarray(light[..., None] * colours, dtype=np.uint8)


# Viewports


MARGIN_MM = 45.0
"""Margin around the joints for the skin."""
LEAST_ROWS = 300
"""Minimum height of a picture, which is enlarged by an integer factor if no scale is given."""


@dataclass(frozen=True)
class Viewport:
    """A part of an image, drawn at a scale.

    Attributes:
        left, top, width, height: the part of the image, px.
        scale: picture pixels per image pixel.
    """

    left: int
    top: int
    width: int
    height: int
    scale: float = 1.0

    @classmethod
    def whole(cls, camera: Camera, scale: float = 1.0) -> Viewport:
        """Return the viewport of the whole image."""
        return cls(0, 0, camera.width, camera.height, scale)

    def scaled(self, scale: float | None, shrunk: float = 1.0) -> Viewport:
        """Return the viewport at a scale; defaults to an integer for ``LEAST_ROWS``, times ``shrunk``."""
        return replace(self, scale=scale or shrunk * -(-LEAST_ROWS // self.height))

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the picture, px."""
        return max(1, round(self.width * self.scale)), max(1, round(self.height * self.scale))

    def camera(self, camera: Camera) -> Camera:
        """Return the pinhole camera of the picture."""
        across, down = self.size[0] / self.width, self.size[1] / self.height
        # The half-pixel shifts are needed because scaling preserves the edges of pixels, not their centres.
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
        """Return the picture of an image; pixels are repeated, or averaged if the picture is smaller."""
        part = image[self.top : self.top + self.height, self.left : self.left + self.width]
        way = cv2.INTER_AREA if self.scale < 1.0 else cv2.INTER_NEAREST
        return cv2.resize(part, self.size, interpolation=way) if self.scale != 1.0 else part


class Framing:
    """Selects the viewport of each picture; all viewports have the same size.

    Args:
        camera: camera of the image.
        points: (N, P, 3) points to crop around, mm, in the axes of the reference camera; None for the whole
            image.
        scale: picture pixels per image pixel; None enlarges small pictures.
        still: True for one viewport for all pictures, False to centre each on its own points.
        shrunk: additional factor on the size if ``scale`` is None.
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
        """(width, height) of all pictures, px."""
        return self._common.size

    def viewport(self, points: FloatArray | None) -> Viewport:
        """Return the viewport for points (P, 3), mm, in the axes of the reference camera."""
        if not self._moves or points is None:
            return self._common
        return moved_to(self._common, in_camera_axes(self._camera, points), self._camera)


def around_points(points: FloatArray, camera: Camera) -> Viewport:
    """Return the viewport that contains all points, with a margin for the skin.

    Args:
        points: (..., 3) points, mm; those behind the camera are ignored.
        camera: camera of the image.
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
    """Return a viewport that is large enough for each of several frames.

    Args:
        points: (N, P, 3) points of each frame, mm.
        camera: camera of the image.
    """
    each = [around_points(subject, camera) for subject in points]
    if not each:
        return Viewport.whole(camera)
    return Viewport(0, 0, max(one.width for one in each), max(one.height for one in each))


def moved_to(viewport: Viewport, points: FloatArray, camera: Camera) -> Viewport:
    """Return the viewport centred on points (..., 3), mm, but inside the image."""
    flat = points.reshape(-1, 3)
    flat = flat[flat[:, 2] > 0.0]
    if not flat.size:
        return viewport
    pixels, _ = camera.pixels_from_points(flat)
    middle = 0.5 * (pixels.min(axis=0) + pixels.max(axis=0))
    left = int(np.clip(round(middle[0] - 0.5 * viewport.width), 0, camera.width - viewport.width))
    top = int(np.clip(round(middle[1] - 0.5 * viewport.height), 0, camera.height - viewport.height))
    return replace(viewport, left=left, top=top)


# Drawing of estimates: points, bones, axes


AXIS_COLOURS: tuple[Colour, ...] = ((60, 60, 255), (60, 220, 60), (255, 120, 60))
"""Colours of x, y, z: red, green, blue."""
AXIS_MM = 60.0
NEAREST_MM = 1.0
_SUBPIXEL_BITS = 4
_BORDER_PX = 4
# Larger coordinates overflow when OpenCV clips a line to the image.
_FARTHEST_PX = 20_000.0


@dataclass(frozen=True, eq=False)
class Shown:
    """An estimate or ground truth to draw; None for unknown quantities.

    Attributes:
        position: (3,) mm.
        quaternion: (4,) x y z w.
        shape: (K,) shape entries.
        points: (P, 3) mm.
        numbers: (M,) further numbers of the tracker.
    """

    position: FloatArray | None = None
    quaternion: FloatArray | None = None
    shape: FloatArray | None = None
    points: FloatArray | None = None
    numbers: FloatArray | None = None

    @classmethod
    def of_row(cls, track: Track, row: int) -> Shown:
        """Return a frame of a track."""
        parts = (track.position, track.quaternion, track.shape, track.points, track.numbers)
        return cls(*(None if part is None else part[row] for part in parts))


@dataclass(frozen=True, eq=False)
class Canvas:
    """A picture with its camera.

    Attributes:
        picture: (height, width, 3), BGR, modified in place.
        camera: pinhole camera of the picture, of the same size.
    """

    picture: ImageArray
    camera: Camera

    @property
    def thickness(self) -> int:
        """Thickness of lines, px."""
        height: int = self.picture.shape[0]
        return max(1, round(height / 400))

    def draw_line(self, points: FloatArray, colour: Colour, thickness: int) -> None:
        """Draw a polyline through points (P, 3), mm, without segments that reach behind the camera."""
        valid = points[:, 2] >= NEAREST_MM
        pixels = _fixed_point(self.camera.pixels_from_points(points)[0])
        for (start, begins), (end, ends) in pairwise(zip(pixels, valid, strict=True)):
            if begins and ends:
                cv2.line(self.picture, start, end, colour, thickness, cv2.LINE_AA, _SUBPIXEL_BITS)

    def draw_dots(self, points: FloatArray, colour: Colour, radius: int) -> None:
        """Draw a dot at each of the points (P, 3), mm, in front of the camera."""
        pixels = self.camera.pixels_from_points(points[points[:, 2] >= NEAREST_MM])[0]
        for x, y in _fixed_point(pixels):
            cv2.circle(
                self.picture, (x, y), radius << _SUBPIXEL_BITS, colour, -1, cv2.LINE_AA, _SUBPIXEL_BITS
            )


class Drawer(Protocol):
    """Draws estimates of one kind of subject."""

    def draw(self, canvas: Canvas, shown: Shown, colour: Colour) -> None:
        """Draw an estimate; ``colour`` is the default colour."""

    def outline(self, canvas: Canvas, shown: Shown, colour: Colour) -> None:
        """Draw lines in one colour, used for ground truth so that the estimate remains visible."""


class Segments(Protocol):
    """Draws the segmentation around an estimate."""

    def paint(self, straight: ImageArray, depth: ImageArray, shown: Shown) -> None:
        """Draw onto a picture (h, w, 3) of the whole undistorted image, in place."""


@dataclass(frozen=True)
class SkeletonDrawer:
    """Draws points, bones, lines, and the axes of the pose.

    Attributes:
        parents: P parent indices, -1 for a root; empty for no bones.
        axes: draw the axes of the pose in red, green and blue.
        lines: further pairs of points to connect by lines.
    """

    parents: tuple[int, ...] = ()
    axes: bool = True
    lines: tuple[tuple[int, int], ...] = ()

    def draw(self, canvas: Canvas, shown: Shown, colour: Colour) -> None:
        """Draw bones, points and axes; see ``Drawer``."""
        self._paint(canvas, shown, colour, AXIS_COLOURS, 0)

    def outline(self, canvas: Canvas, shown: Shown, colour: Colour) -> None:
        """Draw everything in one colour, wider than ``draw``, so that it is visible below an estimate."""
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
    """Return pixels (N, 2) in OpenCV's fixed-point format, integers of 1/16 px."""
    fixed = np.rint(np.clip(pixels, -_FARTHEST_PX, _FARTHEST_PX) * (1 << _SUBPIXEL_BITS))
    return [(int(x), int(y)) for x, y in fixed]


def marked(picture: ImageArray, mark: Colour | None) -> ImageArray:
    """Draw a border onto a picture, for frames that are lost or reinitialised."""
    if mark is not None:
        height, width = picture.shape[:2]
        cv2.rectangle(picture, (0, 0), (width - 1, height - 1), mark, 2 * _BORDER_PX - 1)
    return picture


# Captions


CaptionLine: TypeAlias = tuple[Sequence[str], Colour]
"""Words of a line and their colour."""

USUAL_SIZE, SMALLEST_SIZE = 0.45, 0.38
"""Default font size and smallest legible one, in OpenCV units."""
_TINY_SIZE = 0.1
_STEP = 0.01
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_ROW_PX, _BASE_PX, _LEFT_PX, _GAP_PX = 18, 13, 4, 11
# OpenCV underestimates the width of a text by up to this much.
_STROKE_PX = 3
_GROUND: Colour = (24, 24, 24)


class Captions:
    """Writes captions below pictures of equal width.

    Long lines are wrapped. All captions have the height of the longest one, as the frames of a video must
    have the same size. Pictures that are narrower than the longest word are padded on the right.

    Args:
        longest: the widest words that each line can have (with any digits).
        width: width of the pictures, px.

    Attributes:
        width: width of the pictures with captions, px.
    """

    def __init__(self, longest: Sequence[Sequence[str]], width: int) -> None:
        widest = [[re.sub(r"\d", "8", _plain(word)) for word in words] for words in longest]
        needed = max((_length(word, SMALLEST_SIZE) for words in widest for word in words), default=0)
        self.width = max(width, needed + 2 * _LEFT_PX)
        self._rows = [len(_broken(words, SMALLEST_SIZE, self.width)) for words in widest]
        self._sizes = [
            _largest_size(words, rows, self.width) for words, rows in zip(widest, self._rows, strict=True)
        ]

    def below(self, body: ImageArray, lines: Sequence[CaptionLine]) -> ImageArray:
        """Return a picture (height, width, 3) with caption lines below it."""
        height, margin = sum(self._rows) * _ROW_PX, self.width - body.shape[1]
        caption = np.full((height, self.width, 3), _GROUND, dtype=np.uint8)
        top = 0
        for (words, colour), rows, size in zip(lines, self._rows, self._sizes, strict=True):
            plain = [_plain(word) for word in words]
            fitting = min(size, _largest_size(plain, rows, self.width))
            for place, row in enumerate(_broken(plain, fitting, self.width)):
                _write(caption, row, top + place * _ROW_PX + _BASE_PX, fitting, colour)
            top += rows * _ROW_PX
        shown = cv2.copyMakeBorder(body, 0, 0, 0, margin, cv2.BORDER_CONSTANT, value=_GROUND)
        return np.vstack([shown, caption])


def _largest_size(words: Sequence[str], rows: int, width: int) -> float:
    """Return the largest font size up to ``USUAL_SIZE`` at which the words fit into the rows."""
    size = USUAL_SIZE
    while size > _TINY_SIZE and not _fits(words, size, rows, width):
        size = round(size - _STEP, 2)
    return size


def _fits(words: Sequence[str], size: float, rows: int, width: int) -> bool:
    longest = max((_length(word, size) for word in words), default=0)
    return longest <= width - 2 * _LEFT_PX and len(_broken(words, size, width)) <= rows


def _broken(words: Sequence[str], size: float, width: int) -> list[list[str]]:
    """Wrap words into rows of at most a width; returns at least one row."""
    rows: list[list[str]] = [[]]
    left = float(_LEFT_PX)
    for word in words:
        end = left + _length(word, size)
        if rows[-1] and end > width - _LEFT_PX:
            rows.append([])
            end = _LEFT_PX + _length(word, size)
        rows[-1].append(word)
        left = end + _GAP_PX * size / USUAL_SIZE
    return rows


def _write(picture: ImageArray, words: Sequence[str], base: int, size: float, colour: Colour) -> None:
    left = float(_LEFT_PX)
    for word in words:
        cv2.putText(picture, word, (round(left), base), _FONT, size, colour, 1, cv2.LINE_AA)
        left += _length(word, size) + _GAP_PX * size / USUAL_SIZE


@lru_cache(maxsize=4096)
def _length(word: str, size: float) -> int:
    """Return the width of a word, px."""
    (width, _), _ = cv2.getTextSize(word, _FONT, size, 1)
    return int(width) + _STROKE_PX


def widest(words: Sequence[str]) -> str:
    """Return the widest word."""
    return max(words, key=lambda word: _length(_plain(word), USUAL_SIZE))


def _plain(text: str) -> str:
    """Return the text in ASCII, as the font has no other characters: no accents, others as ``?``."""
    letters = (c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return "".join(letters).encode("ascii", "replace").decode()
