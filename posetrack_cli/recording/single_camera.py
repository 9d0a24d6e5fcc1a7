"""What recordings of one camera have in common: a pass over stored frames, decoded and read ahead."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.ordering import check_range, select_frames
from posetrack_cli.recording.readahead import read_ahead
from posetrack_cli.recording.stored import StoredFrame, decode_frames


class SingleCameraRecording(ABC):
    """Base of readers of one camera's depth frames.

    Args:
        path: the file or folder.
        camera: of the frames as they are given out, after crop and mirror.
    """

    def __init__(self, path: Path, camera: Camera) -> None:
        self._path, self._camera = path, camera
        self._log = LossLog()

    @property
    def path(self) -> Path:
        """The file or folder."""
        return self._path

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The one camera, after crop and mirror."""
        return (self._camera,)

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What the last pass over the frames had to skip."""
        return self._log.losses

    def frames(self, *, start: int = 0, end: int | None = None, stride: int = 1) -> Iterator[Frame]:
        """Yield the frames start, start + stride, ... below end, stamps strictly increasing."""
        check_range(start, end, stride)
        log = self._log = LossLog()
        return read_ahead(decode_frames(self.stored_frames(log, start=start, end=end, stride=stride), log))

    def stored_frames(
        self, losses: LossLog, *, start: int = 0, end: int | None = None, stride: int = 1
    ) -> Iterator[tuple[int, StoredFrame]]:
        """Yield index and undecoded frame, selected and ordered as ``frames`` does."""
        return select_frames(self._stored(losses), losses, start=start, end=end, stride=stride)

    @abstractmethod
    def _stored(self, losses: LossLog) -> Iterator[StoredFrame | None]:
        """Yield every frame in the order it is stored, None for one that cannot be used."""
