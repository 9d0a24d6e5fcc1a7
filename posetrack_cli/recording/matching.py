"""Frames of several cameras from images that each have a stamp of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.ordering import LATEST_NS, NOT_LATER, OUT_OF_RANGE

NS_PER_MS = 1_000_000
ALONE_LIMIT = 600
"""So many frames from the beginning without one that two cameras saw: the stamps do not match."""


@dataclass(frozen=True)
class StoredImage:
    """One camera's image, not decoded yet.

    Attributes:
        stamp_ns: when it was taken, integer nanoseconds.
        where: file name, or topic and time.
        decode: returns (height, width) uint8; raises UnreadableImageError to leave it out, RecordingError to
            end the pass.
    """

    stamp_ns: int
    where: str
    decode: Callable[[], ImageArray]


@dataclass(frozen=True)
class StoredImages:
    """What the cameras saw at one instant.

    Attributes:
        stamp_ns: the reference camera's stamp, or the earliest where it has no image.
        where: of the first image there is.
        images: one per camera, None where it has none.
    """

    stamp_ns: int
    where: str
    images: tuple[StoredImage | None, ...]


class _Stream:
    """One camera's images in order of time, with a look at the one after the next."""

    def __init__(self, name: str, images: Iterator[StoredImage | None], losses: LossLog) -> None:
        self.name, self.losses = name, losses
        self._images = images
        self._latest = -1
        self.head = self._next()
        self.after = self._next()

    def take(self) -> StoredImage | None:
        """Return the next image and move on."""
        taken, self.head = self.head, self.after
        self.after = self._next()
        return taken

    def _next(self) -> StoredImage | None:
        for image in self._images:
            if image is None:
                continue
            fault = self._fault(image.stamp_ns)
            if fault is None:
                self._latest = image.stamp_ns
                return image
            self.losses.add(fault, f"{image.where} at {image.stamp_ns} ns")
        return None

    def _fault(self, stamp_ns: int) -> str | None:
        if not 0 <= stamp_ns <= LATEST_NS:
            return OUT_OF_RANGE
        return NOT_LATER if stamp_ns <= self._latest else None


def match_images(
    names: Sequence[str],
    streams: Sequence[Iterator[StoredImage | None]],
    tolerance_ns: int,
    losses: LossLog,
) -> Iterator[StoredImages]:
    """Put together what cameras took at the same time.

    The earliest image waiting begins a frame. Another camera's image belongs to it if it is at most the
    tolerance later and the first camera's following image is not nearer to it. Cameras without such an image
    have None.

    Args:
        names: of the cameras, the reference first.
        streams: their images; None for one that cannot be used.
        tolerance_ns: largest difference of stamps within a frame.
        losses: gets images whose stamps go back.

    Raises:
        RecordingError: no frame has images of two cameras, at the end or after ``ALONE_LIMIT`` frames.
    """
    waiting = [_Stream(name, iter(stream), losses) for name, stream in zip(names, streams, strict=True)]
    is_shared, frames, nearest = False, 0, LATEST_NS
    while any(stream.head for stream in waiting):
        nearest = min(nearest, _spread(waiting))
        frame = _next_frame(waiting, tolerance_ns)
        is_shared, frames = is_shared or _is_shared(frame), frames + 1
        if frames >= ALONE_LIMIT and not is_shared:
            break
        yield frame
    if frames and not is_shared:
        raise _never_together(names, nearest, tolerance_ns)


def _next_frame(waiting: Sequence[_Stream], tolerance_ns: int) -> StoredImages:
    first = min((stream for stream in waiting if stream.head), key=_head_stamp)
    begin, following = _head_stamp(first), first.after
    images: list[StoredImage | None] = []
    for stream in waiting:
        stamp = _head_stamp(stream) if stream.head else None
        belongs = stamp is not None and stamp - begin <= tolerance_ns
        if belongs and stream is not first and following is not None and stamp is not None:
            belongs = stamp - begin <= abs(following.stamp_ns - stamp)
        images.append(stream.take() if belongs else None)
    present = [image for image in images if image is not None]
    return StoredImages((images[0] or present[0]).stamp_ns, present[0].where, tuple(images))


def _is_shared(frame: StoredImages) -> bool:
    """Whether two cameras have an image, or the only one."""
    return sum(image is not None for image in frame.images) >= min(2, len(frame.images))


def _head_stamp(stream: _Stream) -> int:
    return stream.head.stamp_ns if stream.head is not None else LATEST_NS


def _spread(waiting: Sequence[_Stream]) -> int:
    """The time between the first and the last image that wait; how far apart cameras are at best."""
    stamps = [_head_stamp(stream) for stream in waiting]
    return max(stamps) - min(stamps)


def _never_together(names: Sequence[str], nearest: int, tolerance_ns: int) -> RecordingError:
    return RecordingError(
        f"cameras {', '.join(names)} have no frame in common",
        found=f"stamps {nearest / NS_PER_MS:g} ms apart at best",
        expected=f"within {tolerance_ns / NS_PER_MS:g} ms",
        hint="pass a larger --tolerance-ms, or stamps of one clock",
    )
