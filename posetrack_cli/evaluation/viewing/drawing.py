"""Drawing on images: colours, the part that is shown, lines, text."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Protocol, TypeAlias

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera, in_camera_axes

# Colours of pictures, blue green red as OpenCV has them: depth in false colour, shaded surfaces


Colour = tuple[int, int, int]

SKIN: Colour = (150, 200, 235)
SECOND: Colour = (235, 190, 120)
TRUTH: Colour = (120, 255, 120)
LOST: Colour = (60, 60, 255)
FOUND_ANEW: Colour = (60, 190, 255)
TEXT: Colour = (235, 235, 235)
TONES = (SKIN, SECOND)

# A hand and what is near behind it get most colours; a body further back is dark blue.
_IN_FRONT_MM, _BEHIND_MM = 90.0, 330.0
_USUAL_MM = (450.0, 1100.0)
_BLUEST = 14.0  # of 255: the colour map's lowest end is nearly black, which means no reading
_STEEPEST = 2.0  # mm per pixel at scale 1: steeper surfaces are as dark
_AMBIENT, _SLOPE_LIGHT = 0.75, 0.25


@dataclass(frozen=True)
class DepthRange:
    """The depths that get colours, mm: ``near`` is red, ``far`` blue."""

    near: float
    far: float

    @classmethod
    def of_points(cls, z: FloatArray) -> DepthRange:
        """Around the depths of tracked points (any shape), mm; outliers do not count."""
        good = z[np.isfinite(z) & (z > 0)]
        if not good.size:
            return cls(*_USUAL_MM)
        low, high = np.percentile(good, [1.0, 99.0])
        return cls(max(0.0, float(low) - _IN_FRONT_MM), float(high) + _BEHIND_MM)


def false_colour(depth: Float32Array, depths: DepthRange) -> ImageArray:
    """Depth (h, w), mm, as a picture (h, w, 3): near is red, far is blue, no reading is black."""
    gain = (255.0 - _BLUEST) / (depths.far - depths.near)
    value = np.clip(_BLUEST + (depths.far - depth) * gain, _BLUEST, 255.0).astype(np.uint8)
    picture: ImageArray = cv2.applyColorMap(value, cv2.COLORMAP_TURBO)
    picture[depth <= 0] = 0
    return picture


def lit(depth: Float32Array, mm_per_pixel: float) -> FloatArray:
    """How bright a surface (h, w), mm, 0 where there is none, is under light from the upper left: 0 to 1.

    Args:
        depth: of the surface.
        mm_per_pixel: how far apart neighbouring pixels of a plain surface lie at its depth.
    """
    down, right = np.gradient(np.where(depth > 0, depth, np.nan))
    slope = np.clip((down + right) / max(mm_per_pixel, 1e-3), -_STEEPEST, _STEEPEST)
    light = _AMBIENT - _SLOPE_LIGHT * slope
    return np.asarray(np.clip(np.nan_to_num(light, nan=0.5), 0.15, 1.0), dtype=np.float64)


def shaded(colours: ImageArray, light: FloatArray) -> ImageArray:
    """Colours (h, w, 3) or (3,) under a light (h, w)."""
    return np.asarray(light[..., None] * colours, dtype=np.uint8)


# Which part of an image a picture shows, and how large


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


# What can be drawn of an estimate: the interface, what every subject has (points, bones, axes)


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


# Captions below pictures: never cut, and equally high below pictures that are equally wide


CaptionLine: TypeAlias = tuple[Sequence[str], Colour]
"""Words, one after the other with gaps between them, and their colour."""

USUAL_SIZE, SMALLEST_SIZE = 0.45, 0.38
"""Of letters, in OpenCV's units: below the smaller one they are hard to read."""
_TINY_SIZE = 0.1
_STEP = 0.01
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_ROW_PX, _BASE_PX, _LEFT_PX, _GAP_PX = 18, 13, 4, 11
_STROKE_PX = 3
"""By so much letters reach beyond the width that OpenCV tells."""
_GROUND: Colour = (24, 24, 24)


class Captions:
    """Writes captions below pictures of one width.

    Words that do not fit beside each other stand in several rows, as many as the longest caption needs: so
    pictures with captions are of one size, as a video wants it. A picture that is narrower than the longest
    word gets a margin on its right.

    Args:
        longest: for each line its words, each as long as it gets (digits may be any).
        width: of the pictures, pixels.

    Attributes:
        width: of pictures with captions, pixels.
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
        """Return a picture (height, width, 3) with lines below it, as many as were told of."""
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
    """The largest size, not above the usual one, at which words fit into so many rows of a width."""
    size = USUAL_SIZE
    while size > _TINY_SIZE and not _fits(words, size, rows, width):
        size = round(size - _STEP, 2)
    return size


def _fits(words: Sequence[str], size: float, rows: int, width: int) -> bool:
    longest = max((_length(word, size) for word in words), default=0)
    return longest <= width - 2 * _LEFT_PX and len(_broken(words, size, width)) <= rows


def _broken(words: Sequence[str], size: float, width: int) -> list[list[str]]:
    """Words in rows that are not wider than a width, each as full as it can be; at least one row."""
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
    """Width of a word, pixels."""
    (width, _), _ = cv2.getTextSize(word, _FONT, size, 1)
    return int(width) + _STROKE_PX


def widest(words: Sequence[str]) -> str:
    """Return the word that takes the most room."""
    return max(words, key=lambda word: _length(_plain(word), USUAL_SIZE))


def _plain(text: str) -> str:
    """The text in the letters that the font has: accents are left off, other letters are ``?``."""
    letters = (c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return "".join(letters).encode("ascii", "replace").decode()
