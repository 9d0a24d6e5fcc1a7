"""Copies of a video's packets as messages, without decoding and encoding.

A ``foxglove.CompressedVideo`` message holds one picture, in the order in which they are shown (no B-frames).
H.264 and H.265 are Annex B with parameter sets at each keyframe.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, closing, suppress
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from posetrack_cli.mcap.decoding import VIDEO_IMAGE
from posetrack_cli.recording.base import Encoded, UnreadableImageError
from posetrack_cli.recording.message_video import DECODERS, open_decoder
from posetrack_cli.recording.video_file import OpenVideo, decode_errors, frame_pixels

if TYPE_CHECKING:
    from av.video.frame import VideoFrame

Open: TypeAlias = Callable[[], AbstractContextManager[OpenVideo]]

# Format of messages and FFmpeg's conversion to Annex B by codec.
FORMATS = {"h264": ("h264", "h264_mp4toannexb"), "hevc": ("h265", "hevc_mp4toannexb")}
# First byte of parameter sets in MP4 and Matroska; other containers may repeat them too rarely.
PARAMETER_SETS = b"\x01"


class VideoCopy:
    """The packets of a video's frames, as far as messages can hold them.

    Args:
        opened: opens the video.
        fault: why the packets cannot be copied; empty if unknown.

    Attributes:
        fault: why the packets cannot be copied; complete after the first frame.
    """

    def __init__(self, opened: Open, fault: str = "") -> None:
        self._opened, self.fault = opened, fault
        self._format = ""
        self._packets: Iterator[tuple[int, bytes]] | None = None

    def encoded(self, frame: VideoFrame) -> Encoded | None:
        """Return the message content of a frame, given the frames in order; None if packets cannot be copied.

        Raises:
            UnreadableImageError: the frame has no packet of its own.
        """
        if self._packets is None and not self.fault:
            self._packets = self._begun(frame)
        if self._packets is None or frame.pts is None:
            return None
        for pts, data in self._packets:
            if pts == frame.pts:
                return Encoded(VIDEO_IMAGE, {"format": self._format, "data": data})
            if pts > frame.pts:
                break
        raise UnreadableImageError("video packet not found")

    def _begun(self, first: VideoFrame) -> Iterator[tuple[int, bytes]] | None:
        """Return an iterator over pts and Annex B of all packets; None, with a fault, if they do not fit."""
        with self._opened() as video:
            self.fault, codec = _fault_of(video), video.codec
        if self.fault:
            return None
        self._format, _ = FORMATS[codec]
        with closing(_annex_b(self._opened)) as packets:
            start = next((data for pts, data in packets if pts == first.pts), b"")
        if not _shows_the_same(first, start, self._format):
            self.fault = "its first packet alone shows another picture"
            return None
        return _annex_b(self._opened)


def _fault_of(video: OpenVideo) -> str:
    """Return why the packets of a video do not fit into messages; empty if they do."""
    if video.codec not in FORMATS:
        return f"its codec is {video.codec}"
    if not (video.stream.codec_context.extradata or b"").startswith(PARAMETER_SETS):
        return "its container may lack parameter sets"
    latest: int | None = None
    for packet in _packets(video):
        if packet.is_discard:
            return "some of its packets are not shown"
        if packet.pts is None or (latest is not None and packet.pts <= latest):
            return "it has B-frames"
        latest = packet.pts
    return ""


def _packets(video: OpenVideo) -> Iterator[Any]:
    """Yield the packets up to the end or to unreadable data."""
    with suppress(*decode_errors()):
        yield from (packet for packet in video.container.demux(video.stream) if packet.size)


def _annex_b(opened: Open) -> Generator[tuple[int, bytes]]:
    """Yield pts and Annex B of all packets."""
    from av.bitstream import BitStreamFilterContext

    with opened() as video, suppress(*decode_errors()):
        convert = BitStreamFilterContext(FORMATS[video.codec][1], video.stream)
        for packet in _packets(video):
            for converted in convert.filter(packet):
                if converted.pts is not None:
                    yield converted.pts, bytes(converted)


def _shows_the_same(frame: VideoFrame, data: bytes, name: str) -> bool:
    """Return whether a packet alone gives the same picture: a container may state other colours."""
    import av

    decoder = open_decoder(DECODERS[name])
    try:
        frames = [*decoder.decode(av.Packet(data)), *decoder.decode(None)]
    except decode_errors():
        return False
    if len(frames) != 1 or _colours(frames[0]) != _colours(frame):
        return False
    return bool(np.array_equal(frame_pixels(frames[0], "bgr24"), frame_pixels(frame, "bgr24")))


def _colours(frame: VideoFrame) -> tuple[object, ...]:
    return frame.format.name, frame.width, frame.height, frame.colorspace, frame.color_range
