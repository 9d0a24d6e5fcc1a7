"""Frames as they lie in a recording, before their pixels are decoded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, Protocol

from posetrack_cli.arrays import ImageArray
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import Frame, Recording

DepthEncoding = Literal["16UC1", "32FC1"]


class UnreadableImageError(Exception):
    """One image cannot be decoded; readers skip it and count a loss."""


@dataclass(frozen=True)
class StoredFrame:
    """A frame whose stamp is known and whose pixels are decoded on demand.

    Attributes:
        stamp_ns: when it was taken, integer nanoseconds.
        where: file name, or topic and time, for messages.
        encoding: ``16UC1`` if every depth is a whole number of millimetres, else ``32FC1``.
        decode: returns (height, width) float32 depth, mm, 0 = no reading; raises
            UnreadableImageError to skip the frame, RecordingError to end the pass.
        png: returns the stored 16-bit PNG where its pixels are the decoded depth in mm already, else None.
    """

    stamp_ns: int
    where: str
    encoding: DepthEncoding
    decode: Callable[[], ImageArray]
    png: Callable[[], bytes | None]


class StoredRecording(Recording, Protocol):
    """A recording that also gives its frames undecoded, for lossless copies."""

    def stored_frames(
        self, losses: LossLog, *, start: int = 0, end: int | None = None, stride: int = 1
    ) -> Iterator[tuple[int, StoredFrame]]:
        """Yield index and undecoded frame, selected and ordered as ``Recording.frames`` does."""


def decode_frames(stored: Iterable[tuple[int, StoredFrame]], losses: LossLog) -> Iterator[Frame]:
    """Decode frames one by one; an image that cannot be decoded is skipped and counted."""
    for index, frame in stored:
        try:
            depth = frame.decode()
        except UnreadableImageError as error:
            losses.add(f"image skipped, {error}", f"frame {index}, {frame.where}")
            continue
        yield Frame(index, frame.stamp_ns, (depth,))
