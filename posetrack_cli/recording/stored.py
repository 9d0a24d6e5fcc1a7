"""Images and frames as they lie in a recording, before their pixels are decoded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from posetrack_cli.arrays import ImageArray
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import Frame


class UnreadableImageError(Exception):
    """One image cannot be decoded; readers skip it and count a loss."""


def no_png() -> None:
    """Tell that no PNG of depth is stored."""


@dataclass(frozen=True)
class StoredImage:
    """One camera's image, decoded on demand.

    Attributes:
        stamp_ns: when it was taken, integer nanoseconds.
        where: file name, or topic and time.
        decode: returns (height, width) pixels as frames have them; raises UnreadableImageError to leave the
            image out, RecordingError to end the pass.
        png: returns the stored 16-bit PNG where its pixels are the decoded depth in mm already, else None.
    """

    stamp_ns: int
    where: str
    decode: Callable[[], ImageArray]
    png: Callable[[], bytes | None] = no_png


@dataclass(frozen=True)
class StoredFrame:
    """What the cameras saw at one instant.

    Attributes:
        stamp_ns: the reference camera's stamp, or the earliest where it has no image.
        where: of the first image there is.
        images: one per camera, None where it has none.
        cameras: their names.
    """

    stamp_ns: int
    where: str
    images: tuple[StoredImage | None, ...]
    cameras: tuple[str, ...] = ("camera",)


def decode_frames(stored: Iterable[tuple[int, StoredFrame]], losses: LossLog) -> Iterator[Frame]:
    """Decode frames one by one; a camera's image that is missing or cannot be decoded is None and counted.

    A frame of which no image can be decoded is left out.
    """
    for index, frame in stored:
        images = tuple(
            _decoded(image, name, index, losses)
            for image, name in zip(frame.images, frame.cameras, strict=True)
        )
        if any(image is not None for image in images):
            yield Frame(index, frame.stamp_ns, images)


def _decoded(stored: StoredImage | None, camera: str, index: int, losses: LossLog) -> ImageArray | None:
    if stored is None:
        losses.add(f"no image of camera '{camera}'", f"frame {index}")
        return None
    try:
        return stored.decode()
    except UnreadableImageError as error:
        losses.add(f"image skipped, {error}", f"frame {index}, {stored.where}")
        return None
