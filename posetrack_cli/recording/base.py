"""What recordings give: frames and truth; and the names by which results refer to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.mcap.stream import McapItem

TRUTH_PREFIX = "/truth/"
"""Topics of ground truth begin so, in recordings and in results."""
RUN_RECORD = "posetrack.run"
"""Name of the metadata that says how a result was made."""
RECORDING_KEY = "input.sha256"
"""What it calls the identity of the recording."""
CAMERA_FILE_NAME = "camera.toml"
CAMERA_EXAMPLE = "fx = 365.0, fy = 365.0, cx = 255.5, cy = 211.5, depth_unit_mm = 1.0, each on its own line"


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


def no_intrinsics(where: object) -> NotCalibratedError:
    """Return the error for a recording without any camera, with what to write."""
    return NotCalibratedError(
        "no intrinsics",
        where=where,
        hint=f"write them to a {CAMERA_FILE_NAME} and pass --camera: {CAMERA_EXAMPLE}",
    )
