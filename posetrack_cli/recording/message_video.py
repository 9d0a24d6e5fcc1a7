"""Video in messages: ``foxglove.CompressedVideo``, a stream of which each message is one picture.

By Foxglove's convention a message holds one picture in decoding order, without B-frames; H.264 and H.265 are
Annex B with parameter sets at each keyframe. A decoder needs all pictures since a keyframe, so messages are
decoded one after the other as they are read.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any, TypeVar

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.stamps import MOST_BEHIND
from posetrack_cli.recording.video_file import damage, frame_pixels

if TYPE_CHECKING:
    from av.video.codeccontext import VideoCodecContext

Item = TypeVar("Item")

DECODERS = {
    "h264": "h264",
    "h265": "hevc",
    "hevc": "hevc",
    "vp9": "vp9",
    "av1": "libdav1d",
}
"""FFmpeg's decoder by a message's format."""
MOST_WITHOUT = 300
"""Messages from the beginning in which a keyframe is looked for."""


def is_video_format(name: str) -> bool:
    """Return whether messages of a format can be decoded."""
    return name in DECODERS


def decoded_video(messages: Iterable[tuple[Item, Any]]) -> Iterator[tuple[Item, ImageArray | None]]:
    """Yield each item with its picture (height, width, 3), blue green red; None where none is decoded.

    Args:
        messages: in order of the stream, each an item of the caller and its message, or None for none.
    """
    waiting: deque[tuple[int, Item]] = deque()
    context: VideoCodecContext | None = None
    for number, (item, message) in enumerate(messages):
        waiting.append((number, item))
        if len(waiting) > MOST_BEHIND:
            yield waiting.popleft()[1], None
        decoder = None if message is None else DECODERS.get(str(message.format))
        if decoder is None:
            continue
        context = context or _context(decoder)
        for shown, picture in _pictures(context, bytes(message.data), number):
            yield from _until(waiting, shown, picture)
    if context is not None:
        for shown, picture in _pictures(context, None, 0):
            yield from _until(waiting, shown, picture)
    yield from ((item, None) for _, item in waiting)


def first_picture(messages: Iterable[Any]) -> ImageArray | None:
    """Return the first picture that messages give; None if none of the first ones does."""
    limited = ((None, message) for message, _ in zip(messages, range(MOST_WITHOUT), strict=False))
    return next((picture for _, picture in decoded_video(limited) if picture is not None), None)


def _until(
    waiting: deque[tuple[int, Item]], shown: int, picture: ImageArray
) -> Iterator[tuple[Item, ImageArray | None]]:
    """Yield the items up to the one that a picture is of; those before it have none."""
    while waiting and waiting[0][0] <= shown:
        number, item = waiting.popleft()
        yield item, picture if number == shown else None


def _context(decoder: str) -> VideoCodecContext:
    import av
    from av.video.codeccontext import VideoCodecContext

    context = av.CodecContext.create(decoder, "r")
    assert isinstance(context, VideoCodecContext)
    context.options = {"max_pixels": str(limits.IMAGE_PIXELS)}
    context.thread_count = 1  # threads would hold pictures back
    return context


def _pictures(
    context: VideoCodecContext, data: bytes | None, number: int
) -> Iterator[tuple[int, ImageArray]]:
    """Yield the pictures that a message, or the end, brings out of a decoder, with their numbers."""
    import av

    packet = None
    if data is not None:
        packet = av.Packet(data)
        packet.pts = packet.dts = number
    try:
        frames = context.decode(packet)
    except damage():
        return
    for frame in frames:
        if frame.pts is not None:
            with suppress(UnreadableImageError):
                yield int(frame.pts), frame_pixels(frame, "bgr24")
