"""What recordings give: stored images, frames, truth; and the names by which results refer to them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.losses import LossLog

if TYPE_CHECKING:
    from posetrack_cli.mcap.stream import McapItem

TRUTH_PREFIX = "/truth/"
"""Topics of ground truth begin so, in recordings and in results."""
TRUTH_FILE_NAME = "truth.mcap"
"""The file of a folder of images that has the topics of truth."""
RUN_RECORD = "posetrack.run"
"""Name of the metadata that says how a result was made."""
RECORDING_KEY = "input.sha256"
"""What it calls the identity of the recording."""
PATH_KEY = "input.path"
"""What it calls the recording's path, as it was typed: the same command states the same."""
CAMERA_FILE_NAME = "camera.toml"
CAMERA_FILE_KEY = "camera_file"
"""What a run record calls the text of a camera file that is not the recording's own, below ``input``."""
CAMERA_EXAMPLE = "fx = 365.0, fy = 365.0, cx = 255.5, cy = 211.5, each on its own line"


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


def truth_message(item: McapItem) -> TruthMessage:
    """Return a message of truth as a file holds it."""
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
    """Nothing tells a camera's intrinsics."""


def not_calibrated(where: object) -> NotCalibratedError:
    """Return the error for images without any camera file, with what to do."""
    return NotCalibratedError(
        "cameras are not calibrated",
        where=where,
        expected=f"a {CAMERA_FILE_NAME} beside the images, or --camera",
        hint="posetrack calibrate stereo measures cameras and writes it; for one fx, fy, cx, cy will do",
    )


def no_intrinsics(where: object, more: str = "") -> NotCalibratedError:
    """Return the error for a recording without any camera, with what to write, and what else would do."""
    return NotCalibratedError(
        "no intrinsics",
        where=where,
        hint=f"write them to a {CAMERA_FILE_NAME} and pass --camera: {CAMERA_EXAMPLE}{more}",
    )


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
