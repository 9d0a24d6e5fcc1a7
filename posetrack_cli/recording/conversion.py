"""Write a recording as Foxglove MCAP, without loss except for some videos."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError, read_from
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.mcap.decoding import COMPRESSED_IMAGE, RAW_IMAGE, VIDEO_IMAGE
from posetrack_cli.mcap.sink import McapSink, SchemaText, serialised
from posetrack_cli.outputs import check_output, whole_or_nothing
from posetrack_cli.phases import Advance
from posetrack_cli.recording.base import Encoded, StoredFrame, StoredImage, TruthMessage, UnreadableImageError
from posetrack_cli.recording.camera_record import CAMERAS_RECORD, cameras_to_record
from posetrack_cli.recording.depth import MM_PER_M, Depth, DepthEncoding
from posetrack_cli.recording.grey import PLAIN_BITS, Grey
from posetrack_cli.recording.image_files import encode_png
from posetrack_cli.recording.message_cameras import calibration_message, camera_transforms
from posetrack_cli.recording.pixels import Pixels
from posetrack_cli.recording.recording import Recording, read_ahead
from posetrack_cli.recording.topics import CALIBRATION, IMAGE, PLACES_TOPIC, camera_topic

IMAGE_TOPIC = "/camera/depth/image"
CALIBRATION_TOPIC = "/camera/depth/calibration"
SOURCE_RECORD = "posetrack.source"
CHUNK_BYTES = 1024 * 1024
# Foxglove's message by kind of image.
MESSAGES = {RAW_IMAGE: "RawImage", COMPRESSED_IMAGE: "CompressedImage", VIDEO_IMAGE: "CompressedVideo"}
# Camera noise hardly compresses: higher levels are ten times slower for a few per cent.
GREY_PNG_LEVEL = 1
DEEPEST_MM = 65535  # of 16-bit codes


@dataclass(frozen=True)
class Conversion:
    """Result of a conversion: number of frames written, losses, and notes on images that were changed."""

    frames: int
    losses: tuple[Loss, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Image:
    """A serialised image.

    Attributes:
        frame: number of its frame.
        stamp_ns: stamp of its frame.
        camera: number of its camera.
        kind: its kind of message.
        data: the message.
    """

    frame: int
    stamp_ns: int
    camera: int
    kind: str
    data: bytes


def convert_recording(
    recording: Recording,
    out: Path,
    *,
    overwrite: bool = False,
    raw: bool = False,
    truth: Iterable[TruthMessage] = (),
    advance: Advance = lambda count: None,
) -> Conversion:
    """Write a recording's frames, cameras and truth to an MCAP file; equal input gives equal bytes.

    Depth in whole millimetres is written as 16-bit PNG (foxglove.CompressedImage), other depth as 32FC1
    metres (foxglove.RawImage). Other images are copied as stored if a message can hold them: JPEG, PNG and
    WebP, raw images of messages, H.264 and H.265 without B-frames. Else they are written as tracked, 8-bit
    grey PNG; videos as colour JPEG, the only lossy case. All images of a frame get its stamp. The file is
    written as ``out`` + ``.part`` and renamed when complete.

    Args:
        recording: recording to write; without calibration if that is only guessed.
        out: output file.
        overwrite: replace an existing file.
        raw: write depth in whole millimetres as 16UC1 (foxglove.RawImage), as viewers keep 8 bits of a PNG.
        truth: messages to add to the recording's own, in log-time order.
        advance: called with the number of frames begun by each message.

    Raises:
        UsageError: ``out`` exists without ``overwrite``, or is the recording itself.
        RecordingError: the recording cannot be read or has no frames.
        ResultError: the file cannot be written.
    """
    check_output(out, overwrite=overwrite, source=recording.path)
    with whole_or_nothing(out) as part:
        return _write(recording, part, truth, advance, raw=raw)


def _write(
    recording: Recording, part: Path, truth: Iterable[TruthMessage], advance: Advance, *, raw: bool
) -> Conversion:
    losses = LossLog()
    read = _images(recording, recording.stored_frames(losses), losses, raw=raw)
    with closing(read_ahead(read_from(recording.path, read, "image"))) as images:
        first = next(images, None)
        if first is None:
            raise RecordingError("no frame can be decoded", where=recording.path)
        compression: Literal["none", "zstd"] = "zstd" if first.kind == RAW_IMAGE else "none"
        with McapSink(part, compression=compression, chunk_bytes=CHUNK_BYTES) as sink:
            writer = _Writer(sink, recording)
            writer.begin(first)
            every: Iterable[_Image | TruthMessage] = chain([first], images)
            for entry in heapq.merge(every, recording.truth(), truth, key=_time):
                advance(writer.write(entry))
            sink.finish()
    return Conversion(writer.frames, losses.losses, losses.notes)


def _images(
    recording: Recording, frames: Iterable[tuple[int, StoredFrame]], losses: LossLog, *, raw: bool
) -> Iterator[_Image]:
    """Yield the serialised images; an undecodable one is skipped and counted."""
    kinds: dict[int, str] = {}
    for index, frame in frames:
        for number, image in enumerate(frame.images):
            if image is None:
                continue
            pixels, camera = recording.pixels[number], recording.cameras[number]
            try:
                found = _encoded(image, pixels, losses, raw=raw)
                if kinds.setdefault(number, found.kind) != found.kind:
                    raise UnreadableImageError(f"is a {found.kind}, unlike the first")
            except UnreadableImageError as error:
                losses.add(f"image skipped, {error}", f"frame {index}, {image.where}")
                continue
            message = image_message(found, frame.stamp_ns, camera.name)
            yield _Image(index, frame.stamp_ns, number, found.kind, message)


class _Writer:
    """Writer of images and truth to their channels; calibration and metadata precede the first image."""

    def __init__(self, sink: McapSink, recording: Recording) -> None:
        self._sink, self._recording = sink, recording
        self._image_channels: dict[int, int] = {}
        self._truth_channels: dict[str, int] = {}
        self._latest = -1
        self.frames = 0

    def begin(self, first: _Image) -> None:
        """Write everything that is constant, at the first image's stamp."""
        cameras, is_calibrated = self._recording.cameras, not self._recording.is_guessed
        static = {
            self._topic(number, CALIBRATION): calibration_message(camera, first.stamp_ns, camera.name)
            for number, camera in enumerate(cameras if is_calibrated else ())
        }
        if len(cameras) > 1:
            static[PLACES_TOPIC] = camera_transforms(cameras, cameras[0].name, first.stamp_ns)
        channels = {topic: self._sink.channel(topic, type(message)) for topic, message in static.items()}
        self._image_channel(first)
        self._sink.metadata(SOURCE_RECORD, self._recording.identity())
        if is_calibrated and not self._is_depth:
            self._sink.metadata(CAMERAS_RECORD, cameras_to_record(cameras))
        for topic, message in static.items():
            self._sink.write(channels[topic], first.stamp_ns, serialised(message))

    def write(self, entry: _Image | TruthMessage) -> int:
        """Write one message; return the number of frames that it begins, 0 or 1."""
        if isinstance(entry, TruthMessage):
            self._sink.write(self._truth_channel(entry), entry.log_time_ns, entry.data)
            return 0
        self._sink.write(self._image_channel(entry), entry.stamp_ns, entry.data)
        is_new, self._latest = entry.frame != self._latest, entry.frame
        self.frames += is_new
        return int(is_new)

    @property
    def _is_depth(self) -> bool:
        return isinstance(self._recording.pixels[0], Depth)

    def _topic(self, camera: int, what: str) -> str:
        if self._is_depth:
            return IMAGE_TOPIC if what == IMAGE else CALIBRATION_TOPIC
        cameras = self._recording.cameras
        return camera_topic(cameras[camera], what, len(cameras))

    def _image_channel(self, image: _Image) -> int:
        if image.camera not in self._image_channels:
            topic = self._topic(image.camera, IMAGE)
            self._image_channels[image.camera] = self._sink.channel(topic, message_class(image.kind))
        return self._image_channels[image.camera]

    def _truth_channel(self, message: TruthMessage) -> int:
        if message.topic not in self._truth_channels:
            self._truth_channels[message.topic] = self._sink.raw_channel(
                message.topic,
                SchemaText(message.schema_name, message.schema_encoding, message.schema_data),
                message.message_encoding,
                message.channel_metadata,
            )
        return self._truth_channels[message.topic]


def encode_depth(depth: ImageArray, encoding: DepthEncoding) -> Encoded:
    """Return depth, mm, as a raw image: whole millimetres, or 32-bit metres."""
    if encoding == "16UC1":
        values = np.clip(np.rint(depth), 0, DEEPEST_MM).astype("<u2")
    else:
        values = (depth.astype(np.float64) / MM_PER_M).astype("<f4")
    height, width = values.shape
    sizes = {"width": width, "height": height, "step": values.strides[0]}
    return Encoded(RAW_IMAGE, {**sizes, "encoding": encoding, "data": values.tobytes()})


def _encoded(image: StoredImage, pixels: Pixels, losses: LossLog, *, raw: bool) -> Encoded:
    """Return an image as stored, else without loss."""
    values = image.decode()  # even if the image is copied, so that a damaged one is not passed on
    is_whole = isinstance(pixels, Depth) and pixels.encoding == "16UC1"
    if isinstance(pixels, Depth) and (raw or not is_whole):
        return encode_depth(values, pixels.encoding)
    stored = image.encoded()
    if stored is not None:
        return stored
    if isinstance(pixels, Grey) and (pixels.colour or pixels.bits > PLAIN_BITS):
        losses.note(f"images are stored as the 8-bit grey that is tracked, not as {pixels.words}")
    png = encode_png(values.astype(np.uint16)) if is_whole else encode_png(values, GREY_PNG_LEVEL)
    return Encoded(COMPRESSED_IMAGE, {"format": "png", "data": png})


def image_message(image: Encoded, stamp_ns: int, frame_id: str) -> bytes:
    """Return the serialised Foxglove message of an image."""
    message = message_class(image.kind)(frame_id=frame_id, **image.fields)
    message.timestamp.FromNanoseconds(stamp_ns)
    return serialised(message)


def message_class(kind: str) -> Any:
    """Return the class of Foxglove's message for a kind of image."""
    name = MESSAGES[kind]
    return getattr(import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)


def _time(entry: _Image | TruthMessage) -> int:
    return entry.log_time_ns if isinstance(entry, TruthMessage) else entry.stamp_ns
