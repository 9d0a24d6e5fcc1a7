"""Video files, read by FFmpeg as PyAV brings it: which are opened, and their frames one by one."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import cv2
import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.files import open_input
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.orientation import UPRIGHT, Orientation, orientation_of_matrix

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

SUFFIXES = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv", ".gif")
BEGIN_BYTES = 189
MATROSKA = b"\x1a\x45\xdf\xa3"
CONTAINERS = (
    (4, (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")),  # MP4 and QuickTime
    (8, (b"AVI ",)),
    (
        0,
        (
            MATROSKA,  # and WebM
            b"\x00\x00\x01\xba",  # MPEG program stream
            b"\x00\x00\x01\xb3",  # MPEG video alone
            b"\x30\x26\xb2\x75",  # ASF, of .wmv
            b"OggS",
            b"FLV\x01",
            b"GIF8",
        ),
    ),
    (188, (b"G",)),  # MPEG transport stream: its second packet, as its first byte is no sign
)
"""How videos begin: from this byte on, one of these."""
FORMATS = "mov,mp4,m4a,3gp,3g2,mj2,avi,matroska,webm,mpeg,mpegvideo,mpegts,asf,ogg,flv,gif"
"""What FFmpeg may take a file for."""
CODECS = (
    *("h264", "hevc", "vp8", "vp9", "av1", "mpeg4", "mjpeg", "mpeg1video", "mpeg2video", "h263", "flv1"),
    *("wmv1", "wmv2", "wmv3", "vc1", "theora", "gif", "ffv1", "png", "rawvideo", "prores", "dnxhd"),
)
"""Codecs of recordings, by FFmpeg's names; b16g of an Azure Kinect is one of rawvideo's."""
DECODERS = ",".join((*CODECS, "flv", "libdav1d"))
"""FFmpeg's decoders of these, of which only those of flv1 and av1 have other names."""
OPTIONS = {"format_whitelist": FORMATS, "protocol_whitelist": "none", "codec_whitelist": DECODERS}
"""FFmpeg also decodes to find out what a file holds. It is handed an open file, so that a protocol would only
be for what the file refers to."""
SENSOR_FORMAT = "gray16be"
DEPTH_TITLE, INFRARED_TITLE = "DEPTH", "IR"
"""Of the streams of an Azure Kinect, whose codec Matroska calls b16g."""
DISPLAY_MATRIX = "DISPLAYMATRIX"
MOST_ASPECT = 8.0
"""Of pixels: anamorphic film has 2."""
PQ_TRANSFER = 16
"""H.273's number of the brightness curve of HDR10 and Dolby Vision; HLG looks like ordinary video."""
MICROSECONDS = 1_000_000
"""FFmpeg's unit of durations."""
FFMPEG_LOGGER = "libav"
BUFFER_BYTES = 1 << 20
MOST_FAILURES = 300
"""Frames in a row at the beginning that cannot be decoded; after more of them it is no video."""
NO_INDEX = "moov atom not found"
"""What FFmpeg says of MP4 without its index, which recorders write last."""


@contextmanager
def opened_container(path: Path) -> Iterator[InputContainer]:
    """Yield an open container of video.

    FFmpeg also takes text for a video, which names other files, or hosts, to read. So it is asked only for
    files that begin as videos do, told which kinds to take them for, and handed the open file.

    Raises:
        RecordingError: it cannot be read, or is none.
    """
    try:
        file = open_input(path)
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    with file, _container(file, path) as container:
        yield container


@dataclass(frozen=True)
class OpenVideo:
    """One stream of images of an open container.

    Attributes:
        container: that it is in.
        stream: of FFmpeg.
    """

    container: InputContainer
    stream: VideoStream

    @property
    def rate_hz(self) -> float:
        """The rate that it states; 0 if it does not."""
        return float(self.stream.average_rate or self.stream.guessed_rate or 0)

    @property
    def pixel_aspect(self) -> float:
        """Width over height of a pixel; 1 if it does not state it."""
        aspect = float(self.stream.sample_aspect_ratio or 1)
        return aspect if 1.0 / MOST_ASPECT <= aspect <= MOST_ASPECT else 1.0

    @property
    def is_pq(self) -> bool:
        """Whether it states that brightness is coded by PQ, as HDR10 is."""
        return bool(self.stream.codec_context.color_trc == PQ_TRANSFER)

    @property
    def frame_count(self) -> int | None:
        """How many frames it says that it has, or its duration does; None if neither."""
        if self.stream.frames > 0:
            return int(self.stream.frames)
        duration = self.container.duration
        count = round(duration / MICROSECONDS * self.rate_hz) if duration else 0
        return count if count > 0 else None

    def frames(self) -> Iterator[VideoFrame | None]:
        """Yield the frames, None for each packet that cannot be decoded."""
        packets = self.container.demux(self.stream)
        while True:
            try:
                packet = next(packets, None)
            except damage():
                return  # the container is damaged from here on
            if packet is None:
                return
            try:
                frames = self.stream.codec_context.decode(packet)
            except damage():
                yield None
                continue
            yield from frames


@contextmanager
def opened_video(path: Path) -> Iterator[OpenVideo]:
    """Yield the images of a video: those of colour or grey where a Kinect's file has depth, too.

    No frame is decoded that is larger than any of a recording, also where the size changes later.

    Raises:
        RecordingError: it cannot be read, is none, or has larger frames than any that are read.
    """
    with opened_container(path) as container:
        stream = _image_stream(container)
        if stream is None and depth_stream(container) is not None:
            hint = "posetrack hand run tracks hands in it"
            raise RecordingError("holds depth, and no images of colour or grey", where=path, hint=hint)
        yield opened_stream(container, stream, path)


@contextmanager
def opened_depth(path: Path) -> Iterator[OpenVideo]:
    """Yield the depth of an Azure Kinect's recording.

    Raises:
        RecordingError: it cannot be read, or holds none.
    """
    with opened_container(path) as container:
        stream = depth_stream(container)
        if stream is None:
            raise RecordingError(
                "is a video without depth",
                where=path,
                expected="the depth of an Azure Kinect, or another recording of depth",
                hint="posetrack head mono tracks heads in videos",
            )
        yield opened_stream(container, stream, path)


def opened_stream(container: InputContainer, stream: VideoStream | None, path: Path) -> OpenVideo:
    """Return a stream to be decoded within bounds.

    Raises:
        RecordingError: there is none, its codec is none of recordings', or it says that its frames are larger
            than any that are read.
    """
    if stream is None:
        raise RecordingError("is no video that can be read", where=path, found="no stream of images")
    codec = stream.codec_context.codec.canonical_name
    if codec not in CODECS:
        raise RecordingError(
            "is a video of a codec that is not read",
            where=path,
            found=codec,
            expected=", ".join(CODECS),
            hint="convert it first, for example with: ffmpeg -i VIDEO -c:v ffv1 OUT.mkv",
        )
    if stream.width * stream.height > limits.IMAGE_PIXELS:
        raise RecordingError(
            "video is larger than any that is read",
            where=path,
            found=f"{stream.width}x{stream.height}",
            expected=f"at most {limits.IMAGE_PIXELS} pixels",
        )
    stream.codec_context.options = {"max_pixels": str(limits.IMAGE_PIXELS)}
    return OpenVideo(container, stream)


def damage() -> tuple[type[Exception], ...]:
    """Return the errors of damaged video."""
    from av.error import FFmpegError

    return FFmpegError, ValueError


def frame_pixels(frame: VideoFrame, form: str | None = None) -> ImageArray:
    """Return the pixels of a frame in one of FFmpeg's formats, by default its own.

    Raises:
        UnreadableImageError: they cannot be had.
    """
    try:
        pixels: ImageArray = frame.to_ndarray(format=form)
    except damage() as error:
        raise UnreadableImageError(f"pixels of format {frame.format.name} cannot be read") from error
    return pixels


def shown_image(frame: VideoFrame, pixel_aspect: float = 1.0) -> ImageArray:
    """Return a frame (height, width, 3), blue green red, turned and mirrored as the container states.

    Args:
        frame: of the video.
        pixel_aspect: width over height of a stored pixel; of others than square ones as many more are made.

    Raises:
        UnreadableImageError: it has no such pixels.
    """
    image = frame_pixels(frame, "bgr24")
    if pixel_aspect != 1.0:
        height, width = image.shape[:2]
        size = (max(round(width * pixel_aspect), width), max(round(height / pixel_aspect), height))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR))
    return orientation_of_frame(frame).apply(image)


def orientation_of_frame(frame: VideoFrame) -> Orientation:
    """Return how a frame is shown, by its display matrix."""
    sides: Any = frame.side_data  # declared to be strings
    matrix = next((side for side in sides if side.type.name == DISPLAY_MATRIX), None)
    return UPRIGHT if matrix is None else orientation_of_matrix(bytes(matrix))


def is_video(path: Path) -> bool:
    """Whether a file is named as a video or begins as one."""
    if path.suffix.lower() in SUFFIXES:
        return True
    with open_input(path) as file:
        return _begins_as_video(file)


def _begins_as_video(file: IO[bytes]) -> bool:
    begin = file.read(BEGIN_BYTES)
    file.seek(0)
    return any(begin.startswith(sign, at) for at, signs in CONTAINERS for sign in signs)


def _container(file: IO[bytes], path: Path) -> InputContainer:
    """Open a container; what FFmpeg says of one that it cannot open is kept, not printed."""
    import av

    if not _begins_as_video(file):
        raise RecordingError("is no video that can be read", where=path)
    logging.getLogger(FFMPEG_LOGGER).addHandler(logging.NullHandler())
    logging.getLogger(FFMPEG_LOGGER).propagate = False
    av.logging.set_level(av.logging.ERROR)
    try:
        return av.open(file, "r", options=OPTIONS, buffer_size=BUFFER_BYTES, metadata_errors="replace")
    except damage() as error:
        found = "an MP4 file that ends before its index" if NO_INDEX in str(error) else ""
        raise RecordingError("is no video that can be read", where=path, found=found) from error
    finally:
        av.logging.set_level(None)


def depth_stream(container: InputContainer) -> VideoStream | None:
    """Return the stream of depth of an Azure Kinect, which has infrared of the same kind beside it."""
    titled = (s for s in _decodable(container) if s.metadata.get("title") == DEPTH_TITLE)
    return next(filter(_is_of_sensor, titled), None)


def _image_stream(container: InputContainer) -> VideoStream | None:
    """The stream that shows what people look at: not one of depth, and no picture of a cover."""
    streams = [stream for stream in _decodable(container) if not _is_of_sensor(stream)]
    best = container.streams.best("video")
    return best if best in streams else next(iter(streams), None)


def _decodable(container: InputContainer) -> list[VideoStream]:
    """The streams whose codec FFmpeg knows."""
    return [s for s in container.streams.video if getattr(s, "codec_context", None) is not None]


def _is_of_sensor(stream: VideoStream) -> bool:
    """Whether it is depth or infrared of an Azure Kinect, by its format and name."""
    return stream.pix_fmt == SENSOR_FORMAT and stream.metadata.get("title") in (DEPTH_TITLE, INFRARED_TITLE)
