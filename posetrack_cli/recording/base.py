"""Data types of recordings: stored images, frames, truth messages, and the keys of run records."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.losses import LossLog

if TYPE_CHECKING:
    from posetrack_cli.mcap.stream import McapItem

TRUTH_PREFIX = "/truth/"  # prefix of ground-truth topics, in recordings and in results
# Ground-truth topics of an image folder.
TRUTH_FILE_NAME = "truth.mcap"
# Metadata record of a result: how it was made.
RUN_RECORD = "posetrack.run"
# Key of the recording's SHA-256 in the run record.
RECORDING_KEY = "input.sha256"
# Key of the recording's path, as typed: equal commands then write equal records.
PATH_KEY = "input.path"
CAMERA_FILE_NAME = "camera.toml"
# Key, below ``input``, of the text of a camera file given with --camera.
CAMERA_FILE_KEY = "camera_file"
CAMERA_EXAMPLE = "fx = 365.0, fy = 365.0, cx = 255.5, cy = 211.5, each on its own line"


@dataclass(frozen=True)
class Frame:
    """One instant of a recording.

    Attributes:
        index: position in the recording, counted from 0 over all frames, including skipped ones.
        stamp_ns: time of capture, integer nanoseconds.
        images: one (height, width) array per camera, in the order of ``Recording.cameras``; None for a
            camera without an image at this instant. Depth is float32 millimetres, 0 = no reading (never
            NaN, inf or negative), grey is uint8.
    """

    index: int
    stamp_ns: int
    images: tuple[ImageArray | None, ...]

    @property
    def depth(self) -> ImageArray:
        """The image of a single-camera recording, whose frames always have one."""
        image = self.images[0]
        if image is None:
            raise RecordingError("no image of the first camera", where=f"frame {self.index}")
        return image


@dataclass(frozen=True)
class TruthMessage:
    """An undecoded message on a ``/truth/...`` topic, with everything needed to write it again."""

    topic: str
    schema_name: str
    schema_encoding: str
    schema_data: bytes
    message_encoding: str
    log_time_ns: int
    data: bytes
    channel_metadata: Mapping[str, str] = field(default_factory=dict)


def truth_message(item: McapItem) -> TruthMessage:
    """Return a message from a file as an undecoded truth message."""
    schema, channel, message = item
    return TruthMessage(
        topic=channel.topic,
        schema_name=schema.name if schema else "",
        schema_encoding=schema.encoding if schema else "",
        schema_data=schema.data if schema else b"",
        message_encoding=channel.message_encoding,
        log_time_ns=message.log_time,
        data=message.data,
        channel_metadata=dict(channel.metadata),
    )


class NotCalibratedError(RecordingError):
    """No source provides a camera's intrinsics."""


def not_calibrated(where: object) -> NotCalibratedError:
    """Return the error for images without a camera file, with instructions."""
    return NotCalibratedError(
        "cameras are not calibrated",
        where=where,
        expected=f"{CAMERA_FILE_NAME} next to the images, or --camera",
        hint="for one camera write fx, fy, cx, cy; for several run posetrack calibrate stereo",
    )


def no_intrinsics(where: object, more: str = "") -> NotCalibratedError:
    """Return the error for a recording without intrinsics, with instructions and an alternative."""
    return NotCalibratedError(
        "no intrinsics",
        where=where,
        hint=f"write them to a {CAMERA_FILE_NAME} and pass --camera: {CAMERA_EXAMPLE}{more}",
    )


class UnreadableImageError(Exception):
    """An image that cannot be decoded; readers skip it and count a loss."""


@dataclass(frozen=True)
class Encoded:
    """An image as a Foxglove message stores it.

    Attributes:
        kind: ``RAW_IMAGE``, ``COMPRESSED_IMAGE`` or ``VIDEO_IMAGE``.
        fields: fields of the message except stamp and frame id.
    """

    kind: str
    fields: Mapping[str, Any]


def not_encoded() -> None:
    """Return None: a message must encode the decoded pixels."""


@dataclass(frozen=True)
class StoredImage:
    """One camera's image, decoded on demand.

    Attributes:
        stamp_ns: time of capture, integer nanoseconds.
        where: file name, or topic and time.
        decode: returns the (height, width) pixels of a frame; raises UnreadableImageError to skip the
            image, RecordingError to end the pass.
        encoded: returns the image for a message, from which the same pixels are read, or for video nearly
            the same; None if it is not stored in such a form.
    """

    stamp_ns: int
    where: str
    decode: Callable[[], ImageArray]
    encoded: Callable[[], Encoded | None] = not_encoded


@dataclass(frozen=True)
class StoredFrame:
    """The undecoded images of all cameras at one instant.

    Attributes:
        stamp_ns: the reference camera's stamp, or the earliest if it has no image.
        where: location of the first image present.
        images: one per camera, None if missing.
        cameras: names of the cameras.
    """

    stamp_ns: int
    where: str
    images: tuple[StoredImage | None, ...]
    cameras: tuple[str, ...] = ("camera",)


def decode_frames(stored: Iterable[tuple[int, StoredFrame]], losses: LossLog) -> Iterator[Frame]:
    """Decode frames one by one; missing or undecodable images become None and count as losses.

    Frames without any decodable image are skipped.
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
