"""Where drawn frames go: a video, a folder of pictures, or one picture of them all."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

import cv2
import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError, ResultError, UsageError
from posetrack_cli.files import open_output as open_output_file
from posetrack_cli.files import utf8_name, write_output
from posetrack_cli.outputs import (
    check_not_written,
    check_place,
    is_taken,
    link_refused,
    lock,
    whole_or_nothing,
)
from posetrack_cli.recording.video_file import opened_video

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import OutputContainer
    from av.video.stream import VideoStream

STANDARD_OUTPUT = Path("-")
VIDEO_SUFFIX, PICTURE_SUFFIX = ".mp4", ".png"
CODEC: Final = "libx264"
PIXELS = "yuv420p"
"""H.264 with halved colour, which is what browsers, phones and chats play."""
CODEC_OPTIONS = {"preset": "veryfast", "crf": "20"}
INDEX_FIRST = {"movflags": "+faststart"}
"""So that a player begins before it has the whole file."""
BT709 = 1
"""FFmpeg's number for the colours of HD video: primaries, curve and matrix; untold, players guess."""
HUNDREDTHS = 100
SLOWEST_HZ, FASTEST_HZ = 0.1, 240.0
FAST = 1
SHEET_PX = 3000, 2000
"""Width and height that a sheet has at most, unless there are so many pictures that none could be read."""
LEAST_PICTURE_PX = 160
"""Rows that a picture of a sheet keeps."""
_SHEET_GAP, _CAPTION_ROOM_PX = 6, 36
_EMPTY_WEIGHT = 1.5  # four square pictures are two by two, not three and one
_ROUNDED_PX = 3  # a picture of several panels may be larger by so much than the factor says
_NUMBERED = re.compile(r"frame_\d{6,}\.png", re.ASCII)


class Output(Protocol):
    """Takes pictures one after the other."""

    def add(self, frame_index: int, picture: ImageArray) -> None:
        """Take the picture (height, width, 3), blue green red, of a frame."""

    def close(self) -> None:
        """Finish: what was added can be read afterwards, also after an interruption."""

    def discard(self) -> None:
        """Leave nothing unfinished behind after a failure."""


class VideoFile:
    """An MP4 file, written as NAME.part.mp4 and renamed.

    Args:
        path: the file.
        rate_hz: pictures per second.

    Raises:
        ResultError: it cannot be written.
    """

    def __init__(self, path: Path, rate_hz: float) -> None:
        self._path, self._rate = path, playable_rate(rate_hz)
        self._part = _video_part(path)
        check_not_written(self._part)
        self._writer: OutputContainer | None = None
        self._stream: VideoStream | None = None
        self._held = ExitStack()  # lock and name, as long as FFmpeg needs them
        self._size, self._count = (0, 0), 0

    def add(self, frame_index: int, picture: ImageArray) -> None:
        """Take the next picture; all are of one size."""
        from av import VideoFrame

        even = _even(picture)
        if self._writer is None:
            self._size = (even.shape[1], even.shape[0])
            self._open()
        with self._failures_told():
            self._mux(VideoFrame.from_ndarray(even, format="bgr24"))
        self._count += 1

    def _open(self) -> None:
        import av

        try:
            lock(self._held.enter_context(open_output_file(self._part)))  # FFmpeg would follow a link
        except OSError as error:
            raise ResultError("cannot be written", where=self._path, found=error.strerror or error) from error
        with self._failures_told():
            name = self._held.enter_context(utf8_name(self._part))
            self._writer = av.open(name, "w", format="mp4", options=INDEX_FIRST)
            stream = self._writer.add_stream(CODEC, rate=self._rate, options=CODEC_OPTIONS)
            stream.width, stream.height = self._size
            stream.pix_fmt = PIXELS
            context = stream.codec_context
            context.colorspace = context.color_primaries = context.color_trc = BT709
            self._stream = stream
            self._writer.start_encoding()  # the codec says now what it does not take

    def _mux(self, frame: VideoFrame | None) -> None:
        """Write a picture; None for those that the codec still holds."""
        if self._writer is not None and self._stream is not None:
            straight = None if frame is None else frame.reformat(format=PIXELS, dst_colorspace=BT709)
            self._writer.mux(self._stream.encode(straight))

    @contextmanager
    def _failures_told(self) -> Iterator[None]:
        from av.error import FFmpegError

        try:
            yield
        except FFmpegError as error:
            self.discard()
            width, height = self._size
            raise ResultError(
                "video cannot be written",
                where=self._path,
                found=f"{width}x{height}, {error.strerror}",
                hint="is the disk full? If not, try a smaller --zoom",
            ) from error

    def close(self) -> None:
        """Finish the file and give it its name, once it is sure that it plays."""
        if self._writer is None:
            return
        with self._failures_told():
            self._mux(None)
            self._release()
        if not _plays(self._part, self._size, self._count):
            self.discard()
            raise ResultError("video does not play back", where=self._path, hint="is the disk full?")
        self._part.replace(self._path)

    def discard(self) -> None:
        """Delete what was written."""
        with suppress(Exception):  # what cannot be finished is not wanted
            self._release()
        self._part.unlink(missing_ok=True)

    def _release(self) -> None:
        writer, self._writer, self._stream = self._writer, None, None
        with self._held:
            if writer is not None:
                writer.close()


def _video_part(path: Path) -> Path:
    return path.with_name(f"{path.stem}.part{path.suffix}")


def playable_rate(rate_hz: float) -> Fraction:
    """A rate that a file can state exactly: hundredths, within what players play."""
    return Fraction(round(min(max(rate_hz, SLOWEST_HZ), FASTEST_HZ) * HUNDREDTHS), HUNDREDTHS)


def _even(picture: ImageArray) -> ImageArray:
    """The picture with black at its right and lower edge where its size is odd: the codec wants pairs."""
    down, right = picture.shape[0] % 2, picture.shape[1] % 2
    if not (down or right):
        return picture
    return cv2.copyMakeBorder(picture, 0, down, 0, right, cv2.BORDER_CONSTANT)


def _plays(path: Path, size: tuple[int, int], count: int) -> bool:
    """Whether a video states so many pictures of this size, and the first can be read."""
    try:
        with opened_video(path) as video:
            frame = next(video.frames(), None)
            stated = video.stream.frames
            return frame is not None and (frame.width, frame.height) == size and stated == count
    except RecordingError:
        return False


class PictureFolder:
    """A folder of frame_000123.png; pictures of an earlier view in it are deleted first.

    Args:
        path: the folder; made if it does not exist.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        path.mkdir(exist_ok=True)
        for old in numbered_pictures(path):
            old.unlink()

    def add(self, frame_index: int, picture: ImageArray) -> None:
        """Write the picture of a frame; raises ResultError where it cannot."""
        path = self._path / f"frame_{frame_index:06d}{PICTURE_SUFFIX}"
        try:
            write_output(path, png_of(picture, FAST))
        except OSError as error:  # a full disk leaves half a picture, and its error no name
            path.unlink(missing_ok=True)
            raise ResultError("cannot be written", where=path, found=error.strerror or error) from error

    def close(self) -> None:
        """Nothing is left to do."""

    def discard(self) -> None:
        """Every picture is whole as soon as it is there; they stay."""


def numbered_pictures(folder: Path) -> list[Path]:
    """The pictures that an earlier view wrote into a folder."""
    return [path for path in folder.iterdir() if _NUMBERED.fullmatch(path.name)]


class Sheet:
    """One PNG of all pictures beside each other, row by row.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._pictures: list[ImageArray] = []

    def add(self, frame_index: int, picture: ImageArray) -> None:
        """Put the picture beside the ones before."""
        self._pictures.append(picture)

    def close(self) -> None:
        """Write the file."""
        if self._pictures:
            with whole_or_nothing(self._path) as part:
                write_output(part, png_of(sheet_of(self._pictures)))

    def discard(self) -> None:
        """Nothing was written."""


def fitting_sheet(count: int, size: tuple[int, int]) -> float:
    """Return the factor, 1 at most, that makes pictures small enough for a sheet, but not too small to read.

    Args:
        count: how many there are.
        size: (width, height) of each without its caption, pixels.
    """
    width, height = size
    most_wide, most_high = SHEET_PX
    factors = []
    for columns in range(1, count + 1):
        rows = math.ceil(count / columns)
        across = (most_wide - (columns - 1) * _SHEET_GAP) / columns
        down = (most_high - (rows - 1) * _SHEET_GAP) / rows - _CAPTION_ROOM_PX
        factors.append(min(1.0, across / width, down / height))
    return max(*factors, min(1.0, LEAST_PICTURE_PX / height, most_wide / width))


def sheet_columns(count: int, size: tuple[int, int]) -> int:
    """Return how many pictures stand in a row: no sheet is too wide or high that need not be.

    Of what remains that is chosen whose shape is near to a sheet's and that has few empty places.

    Args:
        count: how many there are.
        size: (width, height) of each, pixels.
    """
    width, height = size
    most_wide, most_high = SHEET_PX

    def badness(columns: int) -> tuple[float, ...]:
        rows = math.ceil(count / columns)
        wide = columns * (width + _SHEET_GAP) - _SHEET_GAP
        high = rows * (height + _SHEET_GAP) - _SHEET_GAP
        shape = abs(math.log(wide * most_high / (high * most_wide)))
        empty = math.log(columns * rows / count)
        over = wide - most_wide - _ROUNDED_PX * columns, high - most_high - _ROUNDED_PX * rows
        return max(0.0, over[0]), max(0.0, over[1]), shape + _EMPTY_WEIGHT * empty

    return min(range(1, count + 1), key=badness)


def sheet_of(pictures: list[ImageArray]) -> ImageArray:
    """Pictures of one size in rows that are equally long as far as can be."""
    height, width = pictures[0].shape[:2]
    columns = sheet_columns(len(pictures), (width, height))
    rows = math.ceil(len(pictures) / columns)
    step_down, step_right = height + _SHEET_GAP, width + _SHEET_GAP
    sheet = np.zeros((rows * step_down - _SHEET_GAP, columns * step_right - _SHEET_GAP, 3), dtype=np.uint8)
    for number, picture in enumerate(pictures):
        top, left = (number // columns) * step_down, (number % columns) * step_right
        sheet[top : top + height, left : left + width] = picture
    return sheet


def png_of(picture: ImageArray, level: int = 9) -> bytes:
    """A picture as PNG; level 9 is small, 1 fast."""
    return cv2.imencode(PICTURE_SUFFIX, picture, [cv2.IMWRITE_PNG_COMPRESSION, level])[1].tobytes()


def is_sheet(path: Path) -> bool:
    """Whether all pictures go onto one."""
    return path.suffix.lower() == PICTURE_SUFFIX


def open_output(path: Path, rate_hz: float) -> Output:
    """A video, a picture or a folder, by what the name ends in."""
    if path.suffix.lower() == VIDEO_SUFFIX:
        return VideoFile(path, rate_hz)
    return Sheet(path) if is_sheet(path) else PictureFolder(path)


def check_view_output(path: Path, *, overwrite: bool) -> None:
    """Refuse an output before anything is drawn.

    Raises:
        UsageError: the name ends in something else than .mp4, .png or nothing, or something would be replaced
            or written through a link.
        ResultError: its folder does not exist.
    """
    if path == STANDARD_OUTPUT:
        raise UsageError("pictures cannot go to standard output", expected="FILE.mp4, FILE.png or a folder")
    is_file = path.suffix.lower() in (VIDEO_SUFFIX, PICTURE_SUFFIX)
    if path.is_dir() == is_file and path.exists():
        found = "a folder" if path.is_dir() else "a file"
        raise UsageError("output is something else already", where=path, found=found)
    if not is_file and path.suffix and not path.is_dir():
        raise UsageError(
            "output cannot be written",
            where=path,
            found=f"a name that ends in {path.suffix}",
            expected="FILE.mp4, FILE.png or a folder",
        )
    check_place(path)
    if path.suffix.lower() == VIDEO_SUFFIX and _video_part(path).is_symlink():
        raise link_refused(_video_part(path))
    there = numbered_pictures(path) if path.is_dir() else is_taken(path)
    if there and not overwrite:
        raise UsageError("exists already", where=path, hint="use --overwrite to replace it")
