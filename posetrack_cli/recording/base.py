"""The interface that every reader of recordings fulfils."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import Loss

TRUTH_PREFIX = "/truth/"
"""Topics of ground truth begin so, in recordings and in results."""
RUN_RECORD = "posetrack.run"
"""Name of the metadata that says how a result was made."""
RECORDING_KEY = "input.sha256"
"""What it calls the identity of the recording."""


@dataclass(frozen=True)
class Frame:
    """One instant of a recording.

    Attributes:
        index: position in the recording, counted from 0 over all frames, also those left out.
        stamp_ns: when it was taken, integer nanoseconds.
        images: one (height, width) array per camera, in the order of ``Recording.cameras``; None at the
            place of a camera that has no image of this instant. Depth is float32 millimetres, 0 = no
            reading (never NaN, inf or negative), grey is uint8.
    """

    index: int
    stamp_ns: int
    images: tuple[ImageArray | None, ...]

    @property
    def depth(self) -> ImageArray:
        """The image of a recording of one camera, whose frames always have one."""
        image = self.images[0]
        if image is None:
            raise RecordingError("frame has no image of the first camera", found=f"frame {self.index}")
        return image


@runtime_checkable
class Recording(Protocol):
    """A recorded sequence that can be read from the start any number of times."""

    @property
    def path(self) -> Path:
        """The file or folder."""

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras, in the order of every frame's images."""

    @property
    def frame_count(self) -> int | None:
        """How many frames there are before reading, None when unknown (a truncated file)."""

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What the last pass over the frames had to skip; empty when nothing was lost."""

    def identity(self) -> Mapping[str, str]:
        """Name, kind, size and SHA-256 of the input, topics used, how it was read: for a result's record."""

    def frames(self, *, start: int = 0, end: int | None = None, stride: int = 1) -> Iterator[Frame]:
        """Yield the frames start, start + stride, ... below end, stamps strictly increasing."""

    def truth(self) -> Iterator[TruthMessage]:
        """Yield the messages on ``/truth/...`` topics undecoded, in file order, if there are any."""


@dataclass(frozen=True)
class TruthMessage:
    """An undecoded message on a ``/truth/...`` topic, with all that is needed to write it again."""

    topic: str
    schema_name: str
    schema_encoding: str
    schema_data: bytes
    message_encoding: str
    log_time_ns: int
    data: bytes
    channel_metadata: Mapping[str, str] = field(default_factory=dict)
