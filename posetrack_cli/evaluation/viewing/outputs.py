"""Outputs of a view: video, folder of pictures, or one picture of all frames."""

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
VIDEO_SUFFIX, PICTURE_SUFFIX, MESSAGES_SUFFIX = ".mp4", ".png", ".mcap"
OUTPUTS = "FILE.mp4, FILE.png, FILE.mcap or a folder"
CODEC: Final = "libx264"
PIXELS = "yuv420p"
"""H.264 with 4:2:0 chroma subsampling, the format that browsers and phones support."""
CODEC_OPTIONS = {
    "preset": "ultrafast",
    "crf": "20",
    "x264-params": "cabac=1:aq-mode=1:scenecut=40:mbtree=1:rc-lookahead=10",
}
"""70 % of the time of ``superfast``; the additional parameters halve the size of ``ultrafast`` files."""
INDEX_FIRST = {"movflags": "+faststart"}
"""Index at the start of the file, so that playback starts before the file is fully loaded."""
BT709 = 1
"""FFmpeg's constant for HD primaries, transfer curve and matrix; without it, players guess the colours."""
HUNDREDTHS = 100
SLOWEST_HZ, FASTEST_HZ = 0.1, 240.0
FAST = 1
SHEET_PX = 3000, 2000
"""Maximum width and height of a sheet, unless its pictures would be smaller than ``LEAST_PICTURE_PX``."""
LEAST_PICTURE_PX = 160
"""Minimum height of a picture in a sheet."""
_SHEET_GAP, _CAPTION_ROOM_PX = 6, 36
_EMPTY_WEIGHT = 1.5  # prefers 2 x 2 for four square pictures over 3 x 2 with two empty places
_ROUNDED_PX = 3  # pictures of several panels can be this much larger than the factor, because of rounding
_NUMBERED = re.compile(r"frame_\d{6,}\.png", re.ASCII)


class Output(Protocol):
    """Writes a sequence of pictures."""

    def add(self, frame_index: int, picture: ImageArray) -> None:
        """Add the picture (height, width, 3), BGR, of a frame."""

    def close(self) -> None:
        """Finish the output; also called after an interruption, to keep the pictures added so far."""

    def discard(self) -> None:
        """Remove unfinished files after an error."""


class VideoFile:
    """An MP4 file, written as NAME.part.mp4 and then renamed.

    Args:
        path: the file.
        rate_hz: frame rate, Hz.

    Raises:
        ResultError: the file cannot be written.
    """

    def __init__(self, path: Path, rate_hz: float) -> None:
        self._path, self._rate = path, playable_rate(rate_hz)
        self._part = _video_part(path)
        check_not_written(self._part)
        self._writer: OutputContainer | None = None
        self._stream: VideoStream | None = None
        self._held = ExitStack()  # lock and name, until FFmpeg has closed the file
        self._size, self._count = (0, 0), 0

    def add(self, frame_index: int, picture: ImageArray) -> None:
        """Add the next picture; all pictures must have the same size."""
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
            self._writer.start_encoding()  # reports unsupported sizes now rather than at the first frame

    def _mux(self, frame: VideoFrame | None) -> None:
        """Write a picture; None flushes the encoder."""
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
                hint="check disk space, or try a smaller --zoom",
            ) from error

    def close(self) -> None:
        """Finish the file, check that it can be read back, and rename it."""
        if self._writer is None:
            return
        with self._failures_told():
            self._mux(None)
            self._release()
        # FFmpeg does not report all write errors, for example on a full disk.
        if not _plays(self._part, self._size, self._count):
            self.discard()
            raise ResultError("video cannot be read back", where=self._path, hint="check disk space")
        self._part.replace(self._path)

    def discard(self) -> None:
        """Delete the unfinished file."""
        with suppress(Exception):  # closing a broken file can fail in FFmpeg
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
    """Return the rate as a fraction of hundredths, limited to the range that players support."""
    return Fraction(round(min(max(rate_hz, SLOWEST_HZ), FASTEST_HZ) * HUNDREDTHS), HUNDREDTHS)


def _even(picture: ImageArray) -> ImageArray:
    """Pad a picture to even width and height, as 4:2:0 chroma subsampling requires."""
    down, right = picture.shape[0] % 2, picture.shape[1] % 2
    if not (down or right):
        return picture
    return cv2.copyMakeBorder(picture, 0, down, 0, right, cv2.BORDER_CONSTANT)


def _plays(path: Path, size: tuple[int, int], count: int) -> bool:
    """Whether a video has the expected size and number of frames, and the first can be decoded."""
    try:
        with opened_video(path) as video:
            frame = next(video.frames(), None)
            stated = video.stream.frames
            return frame is not None and (frame.width, frame.height) == size and stated == count
    except RecordingError:
        return False


class PictureFolder:
    """A folder of frame_000123.png; existing pictures with such names are deleted first.

    Args:
        path: the folder; created if missing.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        path.mkdir(exist_ok=True)
        for old in numbered_pictures(path):
            old.unlink()

    def add(self, frame_index: int, picture: ImageArray) -> None:
        """Write the picture of a frame; raise ResultError if that fails."""
        path = self._path / f"frame_{frame_index:06d}{PICTURE_SUFFIX}"
        try:
            write_output(path, png_of(picture, FAST))
        except OSError as error:  # on a full disk, a truncated file would remain
            path.unlink(missing_ok=True)
            raise ResultError("cannot be written", where=path, found=error.strerror or error) from error

    def close(self) -> None:
        """Do nothing."""

    def discard(self) -> None:
        """Keep the pictures written so far."""


def numbered_pictures(folder: Path) -> list[Path]:
    """Return the pictures of an earlier view in a folder."""
    return [path for path in folder.iterdir() if _NUMBERED.fullmatch(path.name)]


class Sheet:
    """A PNG with all pictures in rows.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._pictures: list[ImageArray] = []

    def add(self, frame_index: int, picture: ImageArray) -> None:
        """Add a picture to the sheet."""
        self._pictures.append(picture)

    def close(self) -> None:
        """Write the file."""
        if self._pictures:
            with whole_or_nothing(self._path) as part:
                write_output(part, png_of(sheet_of(self._pictures)))

    def discard(self) -> None:
        """Do nothing, as the file is only written by ``close``."""


def fitting_sheet(count: int, size: tuple[int, int]) -> float:
    """Return the factor, at most 1, by which pictures must be scaled to fit on a legible sheet.

    Args:
        count: number of pictures.
        size: (width, height) of a picture without caption, px.
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
    """Return the number of pictures per row: within ``SHEET_PX`` if possible, then by shape and empty places.

    Args:
        count: number of pictures.
        size: (width, height) of a picture, px.
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
    """Arrange pictures of equal size in rows."""
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
    """Encode a picture as PNG at a compression level, 1 (fast) to 9 (small)."""
    return cv2.imencode(PICTURE_SUFFIX, picture, [cv2.IMWRITE_PNG_COMPRESSION, level])[1].tobytes()


def is_messages(path: Path) -> bool:
    """Whether the output is a file of messages, not of pictures."""
    return path.suffix.lower() == MESSAGES_SUFFIX


def is_sheet(path: Path) -> bool:
    """Whether the output is a single picture."""
    return path.suffix.lower() == PICTURE_SUFFIX


def open_output(path: Path, rate_hz: float) -> Output:
    """Open a video, a sheet or a folder, depending on the extension."""
    if path.suffix.lower() == VIDEO_SUFFIX:
        return VideoFile(path, rate_hz)
    return Sheet(path) if is_sheet(path) else PictureFolder(path)


def check_view_output(path: Path, *, overwrite: bool) -> None:
    """Check that an output can be written, before anything is drawn.

    Raises:
        UsageError: unsupported extension, existing files without ``overwrite``, or a symbolic link.
        ResultError: the parent folder does not exist.
    """
    if path == STANDARD_OUTPUT:
        raise UsageError("pictures cannot be written to standard output", expected=OUTPUTS)
    is_file = path.suffix.lower() in (VIDEO_SUFFIX, PICTURE_SUFFIX, MESSAGES_SUFFIX)
    if path.is_dir() == is_file and path.exists():
        found = "a folder" if path.is_dir() else "a file"
        expected = "a file" if is_file else "a folder"
        raise UsageError("output exists and is of another kind", where=path, found=found, expected=expected)
    if not is_file and path.suffix and not path.is_dir():
        raise UsageError("unsupported output format", where=path, found=path.suffix, expected=OUTPUTS)
    check_place(path)
    if path.suffix.lower() == VIDEO_SUFFIX and _video_part(path).is_symlink():
        raise link_refused(_video_part(path))
    there = numbered_pictures(path) if path.is_dir() else is_taken(path)
    if there and not overwrite:
        raise UsageError("already exists", where=path, hint="use --overwrite to replace it")
