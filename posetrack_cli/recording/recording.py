"""Recordings: frames in order, decoded in a background thread."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import islice, takewhile
from pathlib import Path
from typing import Generic, TypedDict, TypeVar

from posetrack_cli.errors import RecordingError, UsageError, read_from
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.recording.base import Frame, StoredFrame, StoredImage, TruthMessage, decode_frames
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.matching import (
    NS_PER_MS,
    check_range,
    match_images,
    select_frames,
    single_camera_frames,
)
from posetrack_cli.recording.pixels import Pixels

DEFAULT_TOLERANCE_MS, LONGEST_TOLERANCE_MS = 10.0, 1000.0


class ReadingOptions(TypedDict, total=False):
    """Options for reading a recording; missing or None means the recording's own value.

    Attributes:
        topic, camera_topic: topics of depth images and their calibration in an MCAP file or bag.
        cameras: names of the cameras to use (of messages also topics); None for all.
        camera_file: replaces the recording's own calibration.
        fps: frame rate, Hz; replaces timestamps.csv or a video's own stamps.
        depth_unit_mm, missing: mm per stored depth unit; code for no reading.
        mirror: flip images left to right.
        tolerance_ms: maximum stamp difference within a frame; 10 if None.
        in_colour: keep colour, uint8 blue green red, for drawing; not for tracking.
        guess: intrinsics to assume for a single uncalibrated camera; with a guess several cameras are
            refused.
    """

    topic: str | None
    camera_topic: str | None
    cameras: Sequence[str] | None
    camera_file: Path | None
    fps: float | None
    depth_unit_mm: float | None
    missing: int | None
    mirror: bool | None
    tolerance_ms: float | None
    guess: Guess | None
    in_colour: bool | None


def tolerance_ns(options: ReadingOptions) -> int:
    """Return the maximum stamp difference within a frame, ns.

    Raises:
        UsageError: the option is out of range.
    """
    given = options.get("tolerance_ms")
    tolerance = DEFAULT_TOLERANCE_MS if given is None else given
    if not 0.0 <= tolerance <= LONGEST_TOLERANCE_MS:
        expected = f"milliseconds from 0 to {LONGEST_TOLERANCE_MS:g}"
        raise UsageError("--tolerance-ms out of range", found=f"{tolerance:g}", expected=expected)
    return round(tolerance * NS_PER_MS)


@dataclass(frozen=True)
class CameraStream:
    """The image stream of one camera.

    Attributes:
        camera: model of the frames' images, after crop and mirror.
        pixels: content of the images and how to decode it.
        images: yields all stored images, None for an unusable one; counts losses.
    """

    camera: Camera
    pixels: Pixels
    images: Callable[[LossLog], Iterator[StoredImage | None]]


def no_truth() -> Iterator[TruthMessage]:
    """Yield nothing."""
    return iter(())


class Recording:
    """A recorded sequence that can be read from the start any number of times.

    Args:
        path: the file or folder.
        streams: the cameras, reference first.
        identity: returns name, kind, size and SHA-256 of the input and the reading options, for a run
            record.
        frame_count: number of frames before reading; None if unknown (a truncated file).
        truth: yields the messages on ``/truth/...`` topics undecoded, in log-time order if indexed.
        tolerance_ns: maximum stamp difference within a frame.
        is_guessed: True if the intrinsics are a ``Guess``.
        stated_focal: focal length over the longer image side according to the files of a guessed camera.
        why: source of each camera's model, as text.
        remarks: detections, choices and conversions made on opening, one line each.
    """

    def __init__(
        self,
        path: Path,
        streams: Sequence[CameraStream],
        *,
        identity: Callable[[], Mapping[str, str]],
        frame_count: int | None,
        truth: Callable[[], Iterator[TruthMessage]] = no_truth,
        tolerance_ns: int = 0,
        is_guessed: bool = False,
        stated_focal: float | None = None,
        why: Sequence[str] = (),
        remarks: Sequence[str] = (),
    ) -> None:
        self.path, self.frame_count, self.is_guessed = path, frame_count, is_guessed
        self.stated_focal = stated_focal
        self.why, self.remarks = tuple(why), tuple(remarks)
        self.identity, self._truth = identity, truth
        self.cameras: tuple[Camera, ...] = tuple(stream.camera for stream in streams)
        self.pixels: tuple[Pixels, ...] = tuple(stream.pixels for stream in streams)
        self._streams, self._tolerance_ns = tuple(streams), tolerance_ns
        self._log = LossLog()

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Data skipped by the last pass over the frames; empty if none."""
        return self._log.losses

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the last pass over the frames, one line each."""
        return self._log.notes

    def frames(self, *, start: int = 0, end: int | None = None, stride: int = 1) -> Iterator[Frame]:
        """Yield the frames start, start + stride, ... below end, stamps strictly increasing."""
        check_range(start, end, stride)
        log = self._log = LossLog()
        selected = select_frames(self.matched(log), log, start=start, end=end, stride=stride)
        return read_ahead(self._decoded(selected, log))

    def sample(self, count: int, *, start: int = 0, stride: int = 1, frames: int) -> Iterator[Frame]:
        """Yield about ``count`` of the frames start, start + stride, ...; losses are not recorded.

        Args:
            count: number of frames to yield, at most twice as many.
            start, stride: frames to choose from.
            frames: number of frames to choose from.
        """
        every, log = stride * max(1, frames // count), LossLog()
        selected = select_frames(
            self.matched(log), log, start=start, end=start + frames * stride, stride=every
        )
        return islice(self._decoded(selected, log), 2 * count)

    def pick(self, indices: Sequence[int]) -> Iterator[Frame]:
        """Yield the frames with these indices, in ascending order; losses are not recorded."""
        wanted, last, log = frozenset(indices), max(indices, default=-1), LossLog()
        upto = takewhile(lambda one: one[0] <= last, self.stored_frames(log))
        return self._decoded((one for one in upto if one[0] in wanted), log)

    def with_camera(self, camera: Camera) -> Recording:
        """Return the recording with another model of its only camera."""
        (stream,) = self._streams
        other = copy(self)
        other.cameras, other._streams = (camera,), (replace(stream, camera=camera),)
        return other

    def stored_frames(self, losses: LossLog) -> Iterator[tuple[int, StoredFrame]]:
        """Yield (index, undecoded frame) for every frame that ``frames`` yields."""
        return select_frames(self.matched(losses), losses)

    def matched(self, losses: LossLog) -> Iterator[StoredFrame | None]:
        """Yield all frames undecoded; None for an unusable frame, which keeps its index."""
        return read_from(self.path, match_streams(self._streams, self._tolerance_ns, losses), "frame")

    def truth(self) -> Iterator[TruthMessage]:
        """Yield the messages on ``/truth/...`` topics undecoded, in log-time order if indexed."""
        return read_from(self.path, self._truth(), "message")

    def _decoded(self, stored: Iterator[tuple[int, StoredFrame]], losses: LossLog) -> Iterator[Frame]:
        try:
            yield from read_from(self.path, decode_frames(stored, losses), "frame")
        except RecordingError as error:
            raise _with_path(self.path, error) from error


def match_streams(
    streams: Sequence[CameraStream], tolerance_ns: int, losses: LossLog
) -> Iterator[StoredFrame | None]:
    """Match the cameras' images by time; images numbered as stored become frames one to one."""
    names = [stream.camera.name for stream in streams]
    images = [stream.images(losses) for stream in streams]
    if streams[0].pixels.is_numbered_as_stored:
        return single_camera_frames(names[0], images[0])
    return match_images(names, images, tolerance_ns, losses)


def _with_path(path: Path, error: RecordingError) -> RecordingError:
    """Return the error prefixed with the recording's path unless it already is."""
    text = str(error)
    return error if text.startswith(str(path)) else RecordingError(text, where=path)


# Read-ahead in a thread

T = TypeVar("T")

FRAMES_AHEAD = 4
JOIN_SECONDS = 5.0


@dataclass(frozen=True)
class _End:
    """The last item in the queue: end of the iterator, or its error."""

    error: BaseException | None


class _Reader(Generic[T]):
    """A thread that moves items from an iterator into a bounded queue."""

    def __init__(self, items: Iterator[T], ahead: int) -> None:
        self.queue: queue.Queue[T | _End] = queue.Queue(maxsize=ahead)
        self._items = items
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="read-ahead", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread after the current item.

        The queue is emptied first, so the thread can put its last item without blocking.
        """
        self._stopped.set()
        self._make_room()
        self._thread.join(JOIN_SECONDS)

    def _make_room(self) -> None:
        """Empty the queue, so that a thread blocked on a full one sees the stop flag."""
        while True:
            try:
                self.queue.get_nowait()
            except queue.Empty:
                return

    def _run(self) -> None:
        error: BaseException | None = None
        try:
            for item in self._items:
                self.queue.put(item)
                if self._stopped.is_set():
                    break
        except BaseException as caught:  # re-raised in the consumer
            error = caught
        finally:
            self._close_items()
        if not self._stopped.is_set():
            self.queue.put(_End(error))

    def _close_items(self) -> None:
        close = getattr(self._items, "close", None)
        if close is not None:
            close()  # in the thread that ran the generator, so its files are closed now


def read_ahead(items: Iterator[T], ahead: int = FRAMES_AHEAD) -> Generator[T]:
    """Yield the items of an iterator that runs in a thread, at most ``ahead`` + 1 items ahead.

    Exceptions of the iterator are raised here, after the items before them. Closing the generator, or an
    exception such as KeyboardInterrupt while it waits, stops the thread.
    """
    reader = _Reader(items, ahead)
    try:
        while True:
            item = reader.queue.get()
            if isinstance(item, _End):
                if item.error is not None:
                    raise item.error
                return
            yield item
    finally:
        reader.stop()
