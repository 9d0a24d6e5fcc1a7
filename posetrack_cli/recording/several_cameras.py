"""What recordings of grey images have in common: cameras matched by time, decoded and read ahead."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.recording.base import Frame, TruthMessage
from posetrack_cli.recording.matching import StoredImage, StoredImages, match_images
from posetrack_cli.recording.ordering import check_range, select_frames
from posetrack_cli.recording.readahead import read_ahead
from posetrack_cli.recording.stored import UnreadableImageError

DEFAULT_TOLERANCE_MS = 10.0


class SeveralCamerasRecording(ABC):
    """Base of readers of grey images of one or more cameras; a ``Recording``.

    Args:
        path: the file or folder.
        cameras: of the images as they are given out, the reference first.
        tolerance_ns: largest difference of stamps within a frame.
        is_guessed: whether nothing told the intrinsics.
    """

    def __init__(
        self, path: Path, cameras: Sequence[Camera], tolerance_ns: int, *, is_guessed: bool = False
    ) -> None:
        self._path, self._cameras = path, tuple(cameras)
        self._tolerance_ns, self._is_guessed = tolerance_ns, is_guessed
        self._log = LossLog()

    @property
    def path(self) -> Path:
        """The file or folder."""
        return self._path

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras, the reference first, after crop and mirror."""
        return self._cameras

    @property
    def is_guessed(self) -> bool:
        """Whether the intrinsics are a ``Guess``."""
        return self._is_guessed

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What the last pass over the frames had to skip."""
        return self._log.losses

    @property
    @abstractmethod
    def frame_count(self) -> int | None:
        """How many frames there are before reading, None when unknown."""

    @abstractmethod
    def identity(self) -> Mapping[str, str]:
        """Name, kind, size and SHA-256 of the input, and how it was read."""

    def frames(self, *, start: int = 0, end: int | None = None, stride: int = 1) -> Iterator[Frame]:
        """Yield the frames start, start + stride, ... below end, stamps strictly increasing."""
        check_range(start, end, stride)
        log = self._log = LossLog()
        return read_ahead(self._decoded(log, start, end, stride))

    def truth(self) -> Iterator[TruthMessage]:
        """Yield nothing; readers whose recordings carry truth do otherwise."""
        return iter(())

    def _decoded(self, log: LossLog, start: int, end: int | None, stride: int) -> Iterator[Frame]:
        names = [camera.name for camera in self._cameras]
        try:
            matched = match_images(names, self._streams(log), self._tolerance_ns, log)
            selected = select_frames(matched, log, start=start, end=end, stride=stride)
            yield from decode_images(selected, names, log)
        except RecordingError as error:
            raise _at(self._path, error) from error

    @abstractmethod
    def _streams(self, losses: LossLog) -> Sequence[Iterator[StoredImage | None]]:
        """Return every camera's images in the order they are stored; None for one that cannot be used."""


def decode_images(
    stored: Iterable[tuple[int, StoredImages]], names: Sequence[str], losses: LossLog
) -> Iterator[Frame]:
    """Decode frames one by one; a camera's image that is missing or cannot be decoded is None and counted.

    A frame of which no image can be decoded is left out.
    """
    for index, frame in stored:
        images = tuple(
            _decoded_image(image, index, name, losses)
            for image, name in zip(frame.images, names, strict=True)
        )
        if any(image is not None for image in images):
            yield Frame(index, frame.stamp_ns, images)


def _decoded_image(stored: StoredImage | None, index: int, name: str, losses: LossLog) -> ImageArray | None:
    if stored is None:
        losses.add(f"no image of camera '{name}'", f"frame {index}")
        return None
    try:
        return stored.decode()
    except UnreadableImageError as error:
        losses.add(f"image skipped, {error}", f"frame {index}, {stored.where}")
        return None


def _at(path: Path, error: RecordingError) -> RecordingError:
    """Return the error with the recording's path, if it does not tell it."""
    text = str(error)
    return error if text.startswith(str(path)) else RecordingError(text, where=path)
