"""A result with the images of its frames in one MCAP file, for viewers of messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Set
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from mcap.records import Channel, Schema

from posetrack_cli.evaluation.reading.recording_of import cameras_of
from posetrack_cli.evaluation.reading.tracks import matched_stored
from posetrack_cli.limits import MIB
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.mcap.decoding import VIDEO_IMAGE
from posetrack_cli.mcap.protobuf_twin import NoTwinError
from posetrack_cli.mcap.sink import McapSink, serialised
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
from posetrack_cli.results.export.protobuf import as_protobuf
from posetrack_cli.results.reader import Result
from posetrack_cli.results.scene import point_cloud
from posetrack_cli.results.topics import topics_prefix


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

    JSON messages become protobuf, and points of the estimates are added as foxglove.PointCloud, as rerun
    reads no JSON and draws no scenes.
    Depth is written in whole millimetres, ``16UC1`` (foxglove.RawImage), which viewers show in colour. Other
    images are copied as stored if a message can hold them, else encoded as JPEG.

    Args:
        result: the result; images and points of an earlier call are replaced.
        recording: its recording, in colour.
        out: output file, written atomically.
        overwrite: replace an existing file.
        advance: called with the number of frames written.

    Returns:
        The number of frames, and what is missing: images of estimates, and damaged messages.

    Raises:
        UsageError: ``out`` exists without ``overwrite``, or images and result differ in size.
        ResultError: the file cannot be written.
    """
    check_output(out, overwrite=overwrite, source=result.path, source_name="result")
    losses = LossLog()
    points = {
        f"{topics_prefix(part.subject.topic, track)}/points": (part, track)
        for part in result.parts
        for track in part.tracks
    }
    images = _Images(result, recording, losses)
    replaced = {*points, *images.topics}
    with (
        whole_or_nothing(out) as part,
        McapSink(part, chunk_bytes=MIB) as sink,
        copied_result(McapFile(result.path), sink, partial(_copied, replaced, losses)),
    ):
        for topic, (of_one, track) in points.items():
            _write_points(sink, sink.channel(topic, PointCloud), of_one, track)
        count = images.write(sink, advance)
    return count, losses.losses


def _copied(replaced: Set[str], losses: LossLog, schema: Schema | None, channel: Channel) -> Copied | None:
    if channel.topic in replaced:
        return None
    try:
        return as_protobuf(schema, channel, losses)
    except NoTwinError:
        return unchanged(schema, channel)


def _write_points(sink: McapSink, channel: int, result: Result, track: str) -> None:
    for estimate in result.estimates(result.topic_of_track(track)):
        sink.write(channel, estimate.stamp_ns, serialised(point_cloud(estimate, result.subject)))
    sink.flush()


class _Images:
    """Images of the frames of a result.

    Args:
        result: the result.
        recording: its recording.
        losses: receives missing and undecodable images.

    Attributes:
        topics: topic of each camera.

    Raises:
        UsageError: images and result differ in size.
    """

    def __init__(self, result: Result, recording: Recording, losses: LossLog) -> None:
        self._recording, self._losses = recording, losses
        cameras = cameras_of(result, recording)
        self._is_depth = isinstance(recording.pixels[0], Depth)
        self.topics = [
            IMAGE_TOPIC if self._is_depth else camera_topic(camera, IMAGE, len(cameras)) for camera in cameras
        ]
        self._frames = [result.subjects[0].camera_frame, *(camera.name for camera in cameras[1:])]
        estimates = result.parts[0].columns(fields=("frame_index", "stamp_ns"))
        self._stamps, self._numbers = estimates["stamp_ns"], estimates["frame_index"]
        # Pictures of a video need all earlier ones to be decoded.
        self._is_whole = bool(np.array_equal(self._numbers, np.arange(len(self._numbers))))

    def write(self, sink: McapSink, advance: Advance) -> int:
        """Write the images at the stamps of the estimates; return the number of frames with any."""
        channels: dict[tuple[str, str], int] = {}
        count = 0
        matched = matched_stored(self._recording, self._stamps, self._numbers, self._losses, self._encoded)
        for position, frame in matched:
            stamp_ns = int(self._stamps[position])
            for image, topic, frame_id in zip(frame.images, self.topics, self._frames, strict=True):
                if image is not None:
                    key = topic, image.kind
                    if key not in channels:
                        channels[key] = sink.channel(topic, message_class(image.kind))
                    sink.write(channels[key], stamp_ns, image_message(image, stamp_ns, frame_id))
            count += any(image is not None for image in frame.images)
            advance(1)
        return count

    def _encoded(self, frames: Iterable[tuple[int, StoredFrame]], losses: LossLog) -> Iterator[_EncodedFrame]:
        for index, frame in frames:
            images = tuple(self._image(image, index, losses) for image in frame.images)
            yield _EncodedFrame(index, frame.stamp_ns, images)

    def _image(self, image: StoredImage | None, index: int, losses: LossLog) -> Encoded | None:
        """Return the message content of an image; None if it is missing or cannot be decoded."""
        if image is None:
            return None
        try:
            pixels = image.decode()
            if self._is_depth:
                return encode_depth(pixels, "16UC1")
            stored = image.encoded()
        except UnreadableImageError as error:
            losses.add(f"image skipped, {error}", f"frame {index}, {image.where}")
            return None
        is_kept = stored is not None and (self._is_whole or stored.kind != VIDEO_IMAGE)
        return stored if is_kept else encoded_file(encode_jpeg(pixels))
