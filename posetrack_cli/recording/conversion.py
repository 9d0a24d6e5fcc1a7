"""Write a recording as Foxglove MCAP, lossless in depth."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError, read_from
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.mcap.sink import McapSink, SchemaText, serialised
from posetrack_cli.outputs import check_output, whole_or_nothing
from posetrack_cli.recording.base import StoredFrame, StoredImage, TruthMessage, UnreadableImageError
from posetrack_cli.recording.depth import MM_PER_M, Depth, DepthEncoding
from posetrack_cli.recording.image_files import encode_png
from posetrack_cli.recording.message_cameras import calibration_message
from posetrack_cli.recording.recording import Recording, read_ahead

IMAGE_TOPIC = "/camera/depth/image"
CALIBRATION_TOPIC = "/camera/depth/calibration"
SOURCE_RECORD = "posetrack.source"
CHUNK_BYTES = 1024 * 1024


@dataclass(frozen=True)
class Conversion:
    """Result of a conversion: number of frames written, and losses."""

    frames: int
    losses: tuple[Loss, ...]


@dataclass(frozen=True)
class _Image:
    """A frame's serialised message."""

    stamp_ns: int
    data: bytes


def convert_recording(
    recording: Recording, out: Path, *, overwrite: bool = False, truth: Iterable[TruthMessage] = ()
) -> Conversion:
    """Write a recording's frames, camera and truth to an MCAP file; equal input gives equal bytes.

    Depth in whole millimetres is written as 16-bit PNG (foxglove.CompressedImage), copied unchanged if
    stored that way; other depth as 32FC1 metres (foxglove.RawImage) in zstd chunks. The file is written as
    ``out`` + ``.part`` and renamed when complete.

    Args:
        recording: recording to write.
        out: output file.
        overwrite: replace an existing file.
        truth: messages to add to the recording's own, in log-time order.

    Raises:
        UsageError: ``out`` exists without ``overwrite``, or is the recording itself.
        RecordingError: the recording cannot be read or has no frames.
        ResultError: the file cannot be written.
    """
    check_output(out, overwrite=overwrite, source=recording.path)
    with whole_or_nothing(out) as part:
        return _write(recording, part, truth)


def _write(recording: Recording, part: Path, truth: Iterable[TruthMessage]) -> Conversion:
    losses = LossLog()
    stored = recording.stored_frames(losses)
    first = next(stored, None)
    if first is None:
        raise RecordingError("no frames to convert", where=recording.path)
    writer = _Writer(recording, _encoding(recording))
    compression: Literal["none", "zstd"] = "none" if writer.encoding == "16UC1" else "zstd"
    with McapSink(part, compression=compression, chunk_bytes=CHUNK_BYTES) as sink:
        read = read_from(recording.path, writer.images(chain([first], stored), losses), "image")
        with closing(read_ahead(read)) as images:
            for entry in heapq.merge(images, recording.truth(), truth, key=_time):
                writer.write(sink, entry)
        if not writer.frames:
            raise RecordingError("no frame can be decoded", where=recording.path)
        sink.finish()
    return Conversion(writer.frames, losses.losses)


@dataclass
class _Writer:
    """Writes images and truth to their channels; the calibration precedes the first image."""

    recording: Recording
    encoding: DepthEncoding
    frames: int = 0
    _image_channel: int = 0
    _truth_channels: dict[str, int] = field(default_factory=dict)

    def images(
        self, frames: Iterable[tuple[int, StoredFrame]], losses: LossLog
    ) -> Iterator[_Image | TruthMessage]:
        """Yield the serialised messages; an undecodable image is skipped and counted."""
        for index, frame in frames:
            for image in filter(None, frame.images):
                try:
                    yield _Image(frame.stamp_ns, self._serialised(image))
                except UnreadableImageError as error:
                    losses.add(f"image skipped, {error}", f"frame {index}, {image.where}")

    def write(self, sink: McapSink, entry: _Image | TruthMessage) -> None:
        """Write one message."""
        if isinstance(entry, TruthMessage):
            sink.write(self._truth_channel(sink, entry), entry.log_time_ns, entry.data)
            return
        if not self.frames:
            self._begin(sink, entry.stamp_ns)
        sink.write(self._image_channel, entry.stamp_ns, entry.data)
        self.frames += 1

    def _begin(self, sink: McapSink, stamp_ns: int) -> None:
        camera = self.recording.cameras[0]
        calibration = calibration_message(camera, stamp_ns, camera.name)
        channel = sink.channel(CALIBRATION_TOPIC, type(calibration))
        self._image_channel = sink.channel(IMAGE_TOPIC, _message_class(self.encoding))
        sink.metadata(SOURCE_RECORD, self.recording.identity())
        sink.write(channel, stamp_ns, serialised(calibration))

    def _truth_channel(self, sink: McapSink, message: TruthMessage) -> int:
        if message.topic not in self._truth_channels:
            self._truth_channels[message.topic] = sink.raw_channel(
                message.topic,
                SchemaText(message.schema_name, message.schema_encoding, message.schema_data),
                message.message_encoding,
                message.channel_metadata,
            )
        return self._truth_channels[message.topic]

    def _serialised(self, stored: StoredImage) -> bytes:
        # Decode even if the PNG is copied, so that a damaged image is not passed on.
        depth = stored.decode()
        message = _message_class(self.encoding)(
            frame_id=self.recording.cameras[0].name, **_content(stored, depth, self.encoding)
        )
        message.timestamp.FromNanoseconds(stored.stamp_ns)
        return serialised(message)


def _encoding(recording: Recording) -> DepthEncoding:
    pixels = recording.pixels[0]
    if not isinstance(pixels, Depth):
        raise RecordingError("only depth recordings can be converted", where=recording.path)
    return pixels.encoding


def _content(stored: StoredImage, depth: ImageArray, encoding: DepthEncoding) -> dict[str, Any]:
    if encoding == "16UC1":
        return {"format": "png", "data": stored.png() or encode_png(depth.astype(np.uint16))}
    height, width = depth.shape
    metres = (depth.astype(np.float64) / MM_PER_M).astype("<f4")
    return {
        "width": width,
        "height": height,
        "encoding": "32FC1",
        "step": 4 * width,
        "data": metres.tobytes(),
    }


def _message_class(encoding: DepthEncoding) -> Any:
    if encoding == "16UC1":
        from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

        return CompressedImage
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    return RawImage


def _time(entry: _Image | TruthMessage) -> int:
    return entry.log_time_ns if isinstance(entry, TruthMessage) else entry.stamp_ns
