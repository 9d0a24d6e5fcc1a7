"""A result with the images of its frames in one MCAP file, for viewers of messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema

from posetrack_cli.evaluation.reading.recording_of import cameras_of
from posetrack_cli.evaluation.reading.tracks import matched_stored
from posetrack_cli.limits import MIB
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.mcap.decoding import VIDEO_IMAGE
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.outputs import check_output, whole_or_nothing
from posetrack_cli.phases import Advance
from posetrack_cli.recording.base import Encoded, StoredFrame, StoredImage, UnreadableImageError
from posetrack_cli.recording.conversion import IMAGE_TOPIC, encode_depth, image_message, message_class
from posetrack_cli.recording.depth import Depth
from posetrack_cli.recording.image_files import encode_jpeg, encoded_file
from posetrack_cli.recording.recording import Recording
from posetrack_cli.recording.topics import IMAGE, camera_topic
from posetrack_cli.results.copying import Copied, copied_result, unchanged
from posetrack_cli.results.reader import Result


@dataclass(frozen=True)
class _EncodedFrame:
    """A frame whose images are message contents, None for missing ones."""

    index: int
    stamp_ns: int
    images: tuple[Encoded | None, ...]


def write_with_images(
    result: Result,
    recording: Recording,
    out: Path,
    *,
    overwrite: bool = False,
    advance: Advance = lambda count: None,
) -> tuple[int, tuple[Loss, ...]]:
    """Write a copy of a result with the images of its frames, at the stamps of its estimates.

    Depth is written in whole millimetres, ``16UC1`` (foxglove.RawImage), which viewers show in colour. Other
    images are copied as stored if a message can hold them, else encoded as JPEG.

    Args:
        result: the result; images from an earlier call are replaced.
        recording: its recording, in colour.
        out: output file, written atomically.
        overwrite: replace an existing file.
        advance: called with the number of frames written.

    Returns:
        The number of frames, and estimates without an image.

    Raises:
        UsageError: ``out`` exists without ``overwrite``, or images and result differ in size.
        ResultError: the file cannot be written.
    """
    check_output(out, overwrite=overwrite, source=result.path, source_name="result")
    cameras, losses, count = cameras_of(result, recording), LossLog(), 0
    is_depth = isinstance(recording.pixels[0], Depth)
    topics = [IMAGE_TOPIC if is_depth else camera_topic(one, IMAGE, len(cameras)) for one in cameras]
    frames = [result.subject.camera_frame, *(camera.name for camera in cameras[1:])]
    estimates = result.columns(fields=("frame_index", "stamp_ns"))
    stamps, numbers = estimates["stamp_ns"], estimates["frame_index"]
    # Pictures of a video need all earlier ones to be decoded.
    is_whole = bool(np.array_equal(numbers, np.arange(len(numbers))))

    def choice(schema: Schema | None, channel: Channel) -> Copied | None:
        return None if channel.topic in topics else unchanged(schema, channel)

    def read(stored: Iterable[tuple[int, StoredFrame]], log: LossLog) -> Iterator[_EncodedFrame]:
        for index, frame in stored:
            images = (_encoded(one, index, log, is_depth=is_depth, is_whole=is_whole) for one in frame.images)
            yield _EncodedFrame(index, frame.stamp_ns, tuple(images))

    channels: dict[tuple[str, str], int] = {}
    with (
        whole_or_nothing(out) as part,
        McapSink(part, chunk_bytes=MIB) as sink,
        copied_result(McapFile(result.path), sink, choice),
    ):
        for position, found in matched_stored(recording, stamps, numbers, losses, read):
            for image, topic, frame_id in zip(found.images, topics, frames, strict=True):
                if image is None:
                    continue
                key = topic, image.kind
                if key not in channels:
                    channels[key] = sink.channel(topic, message_class(image.kind))
                stamp = int(stamps[position])
                sink.write(channels[key], stamp, image_message(image, stamp, frame_id))
            count += any(image is not None for image in found.images)
            advance(1)
    return count, losses.losses


def _encoded(
    image: StoredImage | None, index: int, losses: LossLog, *, is_depth: bool, is_whole: bool
) -> Encoded | None:
    """Return the message content of an image; None if it is missing or cannot be decoded."""
    if image is None:
        return None
    try:
        pixels = image.decode()
        if is_depth:
            return encode_depth(pixels, "16UC1")
        stored = image.encoded()
        is_kept = stored is not None and (is_whole or stored.kind != VIDEO_IMAGE)
        return stored if is_kept else encoded_file(encode_jpeg(pixels))
    except UnreadableImageError as error:
        losses.add(f"image skipped, {error}", f"frame {index}, {image.where}")
        return None
