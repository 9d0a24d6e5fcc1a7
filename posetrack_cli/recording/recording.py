"""A recording: its frames in order, read ahead."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Generic, TypedDict, TypeVar

from posetrack_cli.errors import RecordingError, UsageError, read_from
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.recording.base import Frame, StoredFrame, StoredImage, TruthMessage, decode_frames
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.matching import NS_PER_MS, check_range, match_images, select_frames, unmatched
from posetrack_cli.recording.pixels import Pixels

# A recording: the images of its cameras, put together to frames, selected and decoded


DEFAULT_TOLERANCE_MS, LONGEST_TOLERANCE_MS = 10.0, 1000.0


class ReadingOptions(TypedDict, total=False):
    """How a recording is read; what is missing or None is as the recording itself says.

    Attributes:
        topic, camera_topic: of an MCAP file's depth images and their calibration.
        cameras: names (MCAP: or topics) of those to use; None for all.
        camera_file: in place of the recording's own calibration.
        fps: frame rate, Hz, in place of timestamps.csv or a video's own stamps.
        depth_unit_mm, missing: of depth: mm per stored unit, code for no reading.
        mirror: flip images left to right.
        tolerance_ms: largest difference of stamps within a frame; 10 if None.
        in_colour: colour stays so, uint8 blue green red: to draw on, not to track in.
        guess: what the only camera is taken for where nothing tells its intrinsics; with a guess several
            cameras are refused.
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
    """Return the largest difference of stamps within a frame.

    Raises:
        UsageError: the option has a value that cannot be used.
    """
    given = options.get("tolerance_ms")
    tolerance = DEFAULT_TOLERANCE_MS if given is None else given
    if not 0.0 <= tolerance <= LONGEST_TOLERANCE_MS:
        expected = f"milliseconds from 0 to {LONGEST_TOLERANCE_MS:g}"
        raise UsageError("--tolerance-ms cannot be used", found=f"{tolerance:g}", expected=expected)
    return round(tolerance * NS_PER_MS)


@dataclass(frozen=True)
class CameraStream:
    """One camera of a recording.

    Attributes:
        camera: of the images as frames have them, after crop and mirror.
        pixels: what its images hold, and how they are decoded.
        images: yields all images as they are stored, None for one that cannot be used; counts what is lost.
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
        streams: the cameras, the reference first.
        identity: tells name, kind, size and SHA-256 of the input, and how it was read, for a result's record.
        frame_count: how many frames there are before reading; None when unknown (a truncated file).
        truth: yields the messages on ``/truth/...`` topics undecoded, in order of log time where indexed.
        tolerance_ns: largest difference of stamps within a frame.
        is_guessed: whether the intrinsics are a ``Guess``.
        why: where each camera's model comes from, for people.
        remarks: what was recognised, chosen or converted when it was opened, one line each.
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
        why: Sequence[str] = (),
        remarks: Sequence[str] = (),
    ) -> None:
        self.path, self.frame_count, self.is_guessed = path, frame_count, is_guessed
        self.why, self.remarks = tuple(why), tuple(remarks)
        self.identity, self._truth = identity, truth
        self.cameras: tuple[Camera, ...] = tuple(stream.camera for stream in streams)
        self.pixels: tuple[Pixels, ...] = tuple(stream.pixels for stream in streams)
        self._streams, self._tolerance_ns = tuple(streams), tolerance_ns
        self._log = LossLog()

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What the last pass over the frames had to skip; empty when nothing was lost."""
        return self._log.losses

    @property
    def notes(self) -> tuple[str, ...]:
        """What the last pass over the frames noted, one line each."""
        return self._log.notes

    def frames(self, *, start: int = 0, end: int | None = None, stride: int = 1) -> Iterator[Frame]:
        """Yield the frames start, start + stride, ... below end, stamps strictly increasing."""
        check_range(start, end, stride)
        log = self._log = LossLog()
        selected = select_frames(self.matched(log), log, start=start, end=end, stride=stride)
        return read_ahead(self._decoded(selected, log))

    def sample(self, count: int, *, start: int = 0, stride: int = 1, frames: int) -> Iterator[Frame]:
        """Yield about ``count`` of the frames start, start + stride, ...; what is lost in it is not kept.

        Args:
            count: frames to yield, at most twice as many.
            start, stride: of the frames to choose from.
            frames: how many there are.
        """
        every, log = stride * max(1, frames // count), LossLog()
        selected = select_frames(
            self.matched(log), log, start=start, end=start + frames * stride, stride=every
        )
        return islice(self._decoded(selected, log), 2 * count)

    def stored_frames(self, losses: LossLog) -> Iterator[tuple[int, StoredFrame]]:
        """Yield index and undecoded frame of all that ``frames`` gives."""
        return select_frames(self.matched(losses), losses)

    def matched(self, losses: LossLog) -> Iterator[StoredFrame | None]:
        """Yield all frames undecoded; None for one that cannot be used and keeps its number all the same."""
        return read_from(self.path, match_streams(self._streams, self._tolerance_ns, losses), "frame")

    def truth(self) -> Iterator[TruthMessage]:
        """Yield the messages on ``/truth/...`` topics undecoded, in order of log time where indexed."""
        return read_from(self.path, self._truth(), "message")

    def _decoded(self, stored: Iterator[tuple[int, StoredFrame]], losses: LossLog) -> Iterator[Frame]:
        try:
            yield from read_from(self.path, decode_frames(stored, losses), "frame")
        except RecordingError as error:
            raise _at(self.path, error) from error


def match_streams(
    streams: Sequence[CameraStream], tolerance_ns: int, losses: LossLog
) -> Iterator[StoredFrame | None]:
    """Put together what cameras took at the same time; images numbered as stored are frames by themselves."""
    names = [stream.camera.name for stream in streams]
    images = [stream.images(losses) for stream in streams]
    if streams[0].pixels.is_numbered_as_stored:
        return unmatched(names[0], images[0])
    return match_images(names, images, tolerance_ns, losses)


def _at(path: Path, error: RecordingError) -> RecordingError:
    """Return the error with the recording's path, if it does not tell it."""
    text = str(error)
    return error if text.startswith(str(path)) else RecordingError(text, where=path)


# Read frames in a thread, a few ahead of whoever uses them


T = TypeVar("T")

FRAMES_AHEAD = 4
JOIN_SECONDS = 5.0


@dataclass(frozen=True)
class _End:
    """The last item in the queue: how reading ended."""

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
        """End the thread: it finishes the item at hand at most.

        After the queue is emptied the thread puts at most one more item, so it cannot block again.
        """
        self._stopped.set()
        self._make_room()
        self._thread.join(JOIN_SECONDS)

    def _make_room(self) -> None:
        """Empty the queue, so that a thread blocked on a full one goes on and sees that it is to stop."""
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
        except BaseException as caught:  # handed to the consumer, whatever it is
            error = caught
        finally:
            self._close_items()
        if not self._stopped.is_set():
            self.queue.put(_End(error))

    def _close_items(self) -> None:
        close = getattr(self._items, "close", None)
        if close is not None:
            close()  # in this thread: a generator that holds files closes them now


def read_ahead(items: Iterator[T], ahead: int = FRAMES_AHEAD) -> Generator[T]:
    """Yield the items of an iterator that runs in a thread, at most ``ahead`` + 1 items in front.

    An exception of the iterator is raised here, after the items before it. Closing the generator, or
    an exception such as KeyboardInterrupt while it waits, stops the thread.
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
