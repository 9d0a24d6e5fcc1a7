"""Video files read with FFmpeg (PyAV): accepted containers and codecs, streams, frames."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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
# Signatures of videos: at this byte offset, one of these.
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
    (188, (b"G",)),  # MPEG transport stream: sync byte of its second packet, the first one proves little
)
# Formats that FFmpeg may detect.
FORMATS = "mov,mp4,m4a,3gp,3g2,mj2,avi,matroska,webm,mpeg,mpegvideo,mpegts,asf,ogg,flv,gif"
# Accepted codecs, by FFmpeg's names; b16g of an Azure Kinect is a kind of rawvideo.
CODECS = (
    *("h264", "hevc", "vp8", "vp9", "av1", "mpeg4", "mjpeg", "mpeg1video", "mpeg2video", "h263", "flv1"),
    *("wmv1", "wmv2", "wmv3", "vc1", "theora", "gif", "ffv1", "png", "rawvideo", "prores", "dnxhd"),
)
# FFmpeg's decoders of these codecs; only flv1 and av1 have other names.
DECODERS = ",".join((*CODECS, "flv", "libdav1d"))
# FFmpeg also decodes while probing, hence the codec list. It gets an open file, so a protocol would only
# serve references to other files.
OPTIONS = {"format_whitelist": FORMATS, "protocol_whitelist": "none", "codec_whitelist": DECODERS}
SENSOR_FORMAT = "gray16be"
# Stream titles of an Azure Kinect; Matroska names their codec b16g.
DEPTH_TITLE, INFRARED_TITLE = "DEPTH", "IR"
DISPLAY_MATRIX = "DISPLAYMATRIX"
MOST_ASPECT = 8.0  # of pixels; anamorphic film has 2
# H.273's code for PQ (HDR10, Dolby Vision); HLG looks like ordinary video.
PQ_TRANSFER = 16
FOCAL_35_MM = "com.apple.quicktime.camera.focal_length.35mm_equivalent"
MICROSECONDS = 1_000_000  # FFmpeg's unit of durations
FFMPEG_LOGGER = "libav"
BUFFER_BYTES = 1 << 20
# If more initial frames cannot be decoded, the file is rejected.
MOST_FAILURES = 300
# FFmpeg's message for an MP4 file without index, which recorders write last.
NO_INDEX = "moov atom not found"


@contextmanager
def opened_container(path: Path) -> Iterator[InputContainer]:
    """Yield an open video container.

    FFmpeg also accepts text files that name other files or hosts to read. So it only gets files that begin
    like videos, as an open file, with a list of allowed formats.

    Raises:
        RecordingError: the file cannot be read, or is not a video.
    """
    try:
        file = open_input(path)
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    with file, _container(file, path) as container:
        yield container


@dataclass(frozen=True)
class OpenVideo:
    """An image stream of an open container.

    Attributes:
        container: the container.
        stream: FFmpeg's stream.
    """

    container: InputContainer
    stream: VideoStream

    @property
    def codec(self) -> str:
        """FFmpeg's name of the codec."""
        return str(self.stream.codec_context.codec.canonical_name)

    @property
    def rate_hz(self) -> float:
        """The stated frame rate; 0 if unknown."""
        return float(self.stream.average_rate or self.stream.guessed_rate or 0)

    @property
    def pixel_aspect(self) -> float:
        """Width over height of a pixel; 1 if not stated."""
        aspect = float(self.stream.sample_aspect_ratio or 1)
        return aspect if 1.0 / MOST_ASPECT <= aspect <= MOST_ASPECT else 1.0

    @property
    def focal_35_mm(self) -> float:
        """Focal length that gives 35 mm film the same field of view, mm, as phones store it; 0 if unknown."""
        for stored in (self.stream.metadata, self.container.metadata):
            text = stored.get(FOCAL_35_MM, "")
            with suppress(ValueError):
                return float(text) if 0.0 < float(text) < math.inf else 0.0
        return 0.0

    @property
    def is_pq(self) -> bool:
        """True if brightness is coded by PQ, as in HDR10."""
        return bool(self.stream.codec_context.color_trc == PQ_TRANSFER)

    @property
    def frame_count(self) -> int | None:
        """Number of frames by the container's count or duration; None if neither is stated."""
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
            except decode_errors():
                return  # the container is unreadable from here on
            if packet is None:
                return
            try:
                frames = self.stream.codec_context.decode(packet)
            except decode_errors():
                yield None
                continue
            yield from frames


@contextmanager
def opened_video(path: Path) -> Iterator[OpenVideo]:
    """Yield the image stream of a video, for a Kinect file colour or grey rather than depth.

    No frame larger than ``limits`` is decoded, even if the size changes later.

    Raises:
        RecordingError: the file cannot be read, is not a video, or its frames are too large.
    """
    with opened_container(path) as container:
        stream = _image_stream(container)
        if stream is None and depth_stream(container) is not None:
            hint = "to track hands in it use posetrack hand run"
            raise RecordingError("only depth, no colour or grey images", where=path, hint=hint)
        yield opened_stream(container, stream, path)


@contextmanager
def opened_depth(path: Path) -> Iterator[OpenVideo]:
    """Yield the depth stream of an Azure Kinect recording.

    Raises:
        RecordingError: the file cannot be read, or has no depth.
    """
    with opened_container(path) as container:
        stream = depth_stream(container)
        if stream is None:
            raise RecordingError(
                "video has no depth stream",
                where=path,
                expected="an Azure Kinect recording (.mkv) or another depth recording",
                hint="to track heads in videos use posetrack head mono",
            )
        yield opened_stream(container, stream, path)


def opened_stream(container: InputContainer, stream: VideoStream | None, path: Path) -> OpenVideo:
    """Return a stream to be decoded within ``limits``.

    Raises:
        RecordingError: there is no stream, its codec is not supported, or its frames are too large.
    """
    if stream is None:
        raise RecordingError("not a readable video", where=path, found="no image stream")
    codec = stream.codec_context.codec.canonical_name
    if codec not in CODECS:
        raise RecordingError(
            "unsupported video codec",
            where=path,
            found=codec,
            expected=", ".join(CODECS),
            hint="convert it first, for example with: ffmpeg -i VIDEO -c:v ffv1 OUT.mkv",
        )
    if stream.width * stream.height > limits.IMAGE_PIXELS:
        raise RecordingError(
            "video frames are too large",
            where=path,
            found=f"{stream.width}x{stream.height}",
            expected=f"at most {limits.IMAGE_PIXELS} pixels",
        )
    stream.codec_context.options = {"max_pixels": str(limits.IMAGE_PIXELS)}
    return OpenVideo(container, stream)


def decode_errors() -> tuple[type[Exception], ...]:
    """Return the exceptions that damaged video raises."""
    from av.error import FFmpegError

    return FFmpegError, ValueError


def frame_pixels(frame: VideoFrame, form: str | None = None) -> ImageArray:
    """Return the pixels of a frame in one of FFmpeg's formats, by default its own.

    Raises:
        UnreadableImageError: the conversion fails.
    """
    try:
        pixels: ImageArray = frame.to_ndarray(format=form)
    except decode_errors() as error:
        raise UnreadableImageError(f"unreadable pixel format {frame.format.name}") from error
    return pixels


def shown_image(frame: VideoFrame, pixel_aspect: float = 1.0) -> ImageArray:
    """Return a frame (height, width, 3), blue green red, oriented as the container states.

    Args:
        frame: frame of the video.
        pixel_aspect: width over height of a stored pixel; others than 1 are upsampled to square pixels.

    Raises:
        UnreadableImageError: the frame cannot be converted.
    """
    image = frame_pixels(frame, "bgr24")
    if pixel_aspect != 1.0:
        height, width = image.shape[:2]
        size = (max(round(width * pixel_aspect), width), max(round(height / pixel_aspect), height))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR))
    return orientation_of_frame(frame).apply(image)


def orientation_of_frame(frame: VideoFrame) -> Orientation:
    """Return the orientation in a frame's display matrix."""
    from av.sidedata import sidedata

    # ``frame.side_data`` would refer to the frame from the frame, so that its pixels wait for the garbage
    # collector; PyAV's stubs do not declare the argument.
    container: Any = sidedata.SideDataContainer
    sides = container(frame)
    matrix = next((side for side in sides if side.type.name == DISPLAY_MATRIX), None)
    return UPRIGHT if matrix is None else orientation_of_matrix(bytes(matrix))


def is_video(path: Path) -> bool:
    """Return whether a file is named like a video or begins like one."""
    if path.suffix.lower() in SUFFIXES:
        return True
    with open_input(path) as file:
        return _begins_as_video(file)


def _begins_as_video(file: IO[bytes]) -> bool:
    begin = file.read(BEGIN_BYTES)
    file.seek(0)
    return any(begin.startswith(sign, at) for at, signs in CONTAINERS for sign in signs)


def _container(file: IO[bytes], path: Path) -> InputContainer:
    """Open a container, collecting FFmpeg's messages instead of printing them."""
    import av

    if not _begins_as_video(file):
        raise RecordingError("not a readable video", where=path)
    logging.getLogger(FFMPEG_LOGGER).addHandler(logging.NullHandler())
    logging.getLogger(FFMPEG_LOGGER).propagate = False
    av.logging.set_level(av.logging.ERROR)
    try:
        return av.open(file, "r", options=OPTIONS, buffer_size=BUFFER_BYTES, metadata_errors="replace")
    except decode_errors() as error:
        found = "an MP4 file without its index (interrupted recording)" if NO_INDEX in str(error) else ""
        raise RecordingError("not a readable video", where=path, found=found) from error
    finally:
        av.logging.set_level(None)


def depth_stream(container: InputContainer) -> VideoStream | None:
    """Return the depth stream of an Azure Kinect, next to which infrared has the same format."""
    titled = (s for s in _decodable(container) if s.metadata.get("title") == DEPTH_TITLE)
    return next(filter(_is_of_sensor, titled), None)


def _image_stream(container: InputContainer) -> VideoStream | None:
    """Return the main picture stream, not depth and not cover art."""
    streams = [stream for stream in _decodable(container) if not _is_of_sensor(stream)]
    best = container.streams.best("video")
    return best if best in streams else next(iter(streams), None)


def _decodable(container: InputContainer) -> list[VideoStream]:
    """Return the streams whose codec FFmpeg supports."""
    return [s for s in container.streams.video if getattr(s, "codec_context", None) is not None]


def _is_of_sensor(stream: VideoStream) -> bool:
    """Return whether a stream is an Azure Kinect's depth or infrared, by format and title."""
    return stream.pix_fmt == SENSOR_FORMAT and stream.metadata.get("title") in (DEPTH_TITLE, INFRARED_TITLE)
