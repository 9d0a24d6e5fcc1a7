"""Video in messages: ``foxglove.CompressedVideo``, one picture per message.

By Foxglove's convention a message holds one picture in decoding order, without B-frames; H.264 and H.265
are Annex B with parameter sets at each keyframe. A decoder needs all pictures since a keyframe, so messages
are decoded in sequence.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any, TypeVar

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.mcap.decoding import VIDEO_IMAGE
from posetrack_cli.recording.base import Encoded, UnreadableImageError
from posetrack_cli.recording.stamps import MAX_REORDERED
from posetrack_cli.recording.video_file import decode_errors, frame_pixels

if TYPE_CHECKING:
    from av.video.codeccontext import VideoCodecContext

Item = TypeVar("Item")

# FFmpeg's decoder by message format.
DECODERS = {
    "h264": "h264",
    "h265": "hevc",
    "hevc": "hevc",
    "vp9": "vp9",
    "av1": "libdav1d",
}
OTHER_NAMES = {"hevc": "h265"}  # Foxglove's name of a format, where messages may have another
KEYFRAME_SEARCH = 300  # first messages searched for a keyframe


def encoded_video(message: Any) -> Encoded:
    """Return the content of a video message, whose format may have a name that only other tools use."""
    name = str(message.format)
    return Encoded(VIDEO_IMAGE, {"format": OTHER_NAMES.get(name, name), "data": bytes(message.data)})


def is_video_format(name: str) -> bool:
    """Return whether messages of a format can be decoded."""
    return name in DECODERS


def decoded_video(messages: Iterable[tuple[Item, Any]]) -> Iterator[tuple[Item, ImageArray | None]]:
    """Yield each item with its picture (height, width, 3), blue green red, or None if not decoded.

    Args:
        messages: in stream order, pairs of a caller's item and its message, or None.
    """
    waiting: deque[tuple[int, Item]] = deque()
    context: VideoCodecContext | None = None
    for number, (item, message) in enumerate(messages):
        waiting.append((number, item))
        if len(waiting) > MAX_REORDERED:
            yield waiting.popleft()[1], None
        decoder = None if message is None else DECODERS.get(str(message.format))
        if decoder is None:
            continue
        context = context or open_decoder(decoder)
        for shown, picture in _pictures(context, bytes(message.data), number):
            yield from _until(waiting, shown, picture)
    if context is not None:
        for shown, picture in _pictures(context, None, 0):
            yield from _until(waiting, shown, picture)
    yield from ((item, None) for _, item in waiting)


def first_picture(messages: Iterable[Any]) -> ImageArray | None:
    """Return the first decodable picture of the first messages; None if there is none."""
    limited = ((None, message) for message, _ in zip(messages, range(KEYFRAME_SEARCH), strict=False))
    return next((picture for _, picture in decoded_video(limited) if picture is not None), None)


def _until(
    waiting: deque[tuple[int, Item]], shown: int, picture: ImageArray
) -> Iterator[tuple[Item, ImageArray | None]]:
    """Yield the items up to a picture's own; earlier ones have no picture."""
    while waiting and waiting[0][0] <= shown:
        number, item = waiting.popleft()
        yield item, picture if number == shown else None


def open_decoder(decoder: str) -> VideoCodecContext:
    """Return one of FFmpeg's decoders, for packets without a container."""
    import av
    from av.video.codeccontext import VideoCodecContext

    context = av.CodecContext.create(decoder, "r")
    assert isinstance(context, VideoCodecContext)
    context.options = {"max_pixels": str(limits.IMAGE_PIXELS)}
    context.thread_count = 1  # frame threads would delay pictures by several packets
    return context


def _pictures(
    context: VideoCodecContext, data: bytes | None, number: int
) -> Iterator[tuple[int, ImageArray]]:
    """Yield (number, picture) for what a message, or the end of the stream, makes a decoder output."""
    import av

    packet = None
    if data is not None:
        packet = av.Packet(data)
        packet.pts = packet.dts = number
    try:
        frames = context.decode(packet)
    except decode_errors():
        return
    for frame in frames:
        if frame.pts is not None:
            with suppress(UnreadableImageError):
                yield int(frame.pts), frame_pixels(frame, "bgr24")
