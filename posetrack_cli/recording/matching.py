"""Match the images of several cameras by time into numbered frames, and select a range of frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import StoredFrame, StoredImage

NS_PER_MS = 1_000_000
# Give up after this many initial frames without a match: the stamps do not correspond.
MAX_UNMATCHED_FRAMES = 600
NOT_LATER = "frame dropped, stamp not later than the previous frame's"
OUT_OF_RANGE = "frame dropped, stamp before 1970 or after 2262"
LATEST_NS = 2**63 - 1  # stamps are stored in int64 arrays


class _Stream:
    """One camera's images in time order, with one image of look-ahead."""

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
            fault = stamp_fault(image.stamp_ns, self._latest)
            if fault is None:
                self._latest = image.stamp_ns
                return image
            self.losses.add(fault, f"{image.where} at {image.stamp_ns} ns")
        return None


def single_camera_frames(camera: str, images: Iterable[StoredImage | None]) -> Iterator[StoredFrame | None]:
    """Yield a frame for every image of one camera; None for an unusable one, which keeps its index."""
    for image in images:
        yield None if image is None else StoredFrame(image.stamp_ns, image.where, (image,), (camera,))


def match_images(
    names: Sequence[str],
    streams: Sequence[Iterator[StoredImage | None]],
    tolerance_ns: int,
    losses: LossLog,
) -> Iterator[StoredFrame]:
    """Match images that cameras took at the same time.

    The earliest pending image starts a frame. Another camera's image belongs to it if it is at most the
    tolerance later and not nearer to the first camera's next image. Cameras without such an image have
    None.

    Args:
        names: names of the cameras, reference first.
        streams: their images; None for an unusable one.
        tolerance_ns: maximum stamp difference within a frame.
        losses: receives images whose stamps go back.

    Raises:
        RecordingError: no frame has images of two cameras, at the end or after ``MAX_UNMATCHED_FRAMES``.
    """
    waiting = [_Stream(name, iter(stream), losses) for name, stream in zip(names, streams, strict=True)]
    is_matched, frames, nearest = False, 0, LATEST_NS
    while any(stream.head for stream in waiting):
        nearest = min(nearest, _spread(waiting))
        frame = _next_frame(waiting, tolerance_ns)
        is_matched, frames = is_matched or _is_matched(frame), frames + 1
        if frames >= MAX_UNMATCHED_FRAMES and not is_matched:
            break
        yield frame
    if frames and not is_matched:
        raise _no_common_frame(names, nearest, tolerance_ns)


def _next_frame(waiting: Sequence[_Stream], tolerance_ns: int) -> StoredFrame:
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
    names = tuple(stream.name for stream in waiting)
    return StoredFrame((images[0] or present[0]).stamp_ns, present[0].where, tuple(images), names)


def _is_matched(frame: StoredFrame) -> bool:
    """Return whether at least two cameras (or the only one) have an image."""
    return sum(image is not None for image in frame.images) >= min(2, len(frame.images))


def _head_stamp(stream: _Stream) -> int:
    return stream.head.stamp_ns if stream.head is not None else LATEST_NS


def _spread(waiting: Sequence[_Stream]) -> int:
    """Return the time span of the pending images, a lower bound on how far cameras are apart."""
    stamps = [_head_stamp(stream) for stream in waiting]
    return max(stamps) - min(stamps)


def _no_common_frame(names: Sequence[str], nearest: int, tolerance_ns: int) -> RecordingError:
    return RecordingError(
        f"no matching stamps for cameras {', '.join(names)}",
        found=f"at least {nearest / NS_PER_MS:g} ms apart",
        expected=f"within {tolerance_ns / NS_PER_MS:g} ms",
        hint="increase --tolerance-ms, or provide stamps of a common clock",
    )


def select_frames(
    stored: Iterable[StoredFrame | None],
    losses: LossLog,
    *,
    start: int = 0,
    end: int | None = None,
    stride: int = 1,
) -> Iterator[tuple[int, StoredFrame]]:
    """Yield (index, frame) for the indices start, start + stride, ... below end.

    The order check does not depend on the range: every frame is compared with the latest stamp before it,
    selected or not. Frames with stamps beyond int64 are dropped and do not affect later ones. Reading stops
    at ``end``.

    Args:
        stored: all frames of the recording; None for an unreadable one, which keeps its index.
        losses: receives the dropped frames of the range.
        start: first index.
        end: index to stop before, None for all.
        stride: distance between indices.

    Raises:
        UsageError: start or end is negative, or stride is below 1.
    """
    check_range(start, end, stride)
    latest = -1
    for index, frame in enumerate(stored):
        if end is not None and index >= end:
            return
        wanted = index >= start and (index - start) % stride == 0
        if frame is None:
            continue
        fault = stamp_fault(frame.stamp_ns, latest)
        if fault is not None:
            if wanted:
                losses.add(fault, f"frame {index} at {frame.stamp_ns} ns, {frame.where}")
            continue
        latest = frame.stamp_ns
        if wanted:
            yield index, frame


def stamp_fault(stamp_ns: int, latest: int) -> str | None:
    """Return why a frame with this stamp is dropped after ``latest``; None if it is kept."""
    if not 0 <= stamp_ns <= LATEST_NS:
        return OUT_OF_RANGE
    return NOT_LATER if stamp_ns <= latest else None


def check_range(start: int, end: int | None, stride: int) -> None:
    """Raise UsageError unless 0 <= start, 0 <= end and 1 <= stride."""
    if start < 0 or (end is not None and end < 0) or stride < 1:
        raise UsageError(
            "invalid frame range",
            found=f"start {start}, end {end}, stride {stride}",
            expected="start and end >= 0, stride >= 1",
        )
