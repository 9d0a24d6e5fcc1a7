"""Depth frames from an MCAP file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.decoding import (
    CALIBRATION,
    MessageDecoder,
    UndecodableMessageError,
    frame_id_of,
    stamp_of,
)
from posetrack_cli.mcap.stream import McapItem, check_mcap, read_messages
from posetrack_cli.recording.base import TRUTH_PREFIX, TruthMessage
from posetrack_cli.recording.camera_file import CameraFile, load_camera_file
from posetrack_cli.recording.depth import Window
from posetrack_cli.recording.identity import file_digest, shown_name
from posetrack_cli.recording.mcap_calibration import camera_from_message, choose_calibration
from posetrack_cli.recording.mcap_images import decode_depth, describe_image, millimetre_png
from posetrack_cli.recording.mcap_topics import Topic, choose_depth_topic, frame_id_of_topic, scan_topics
from posetrack_cli.recording.mcap_truth import read_truth
from posetrack_cli.recording.single_camera import SingleCameraRecording
from posetrack_cli.recording.stored import StoredFrame


class McapRecording(SingleCameraRecording):
    """Depth frames of one topic of an MCAP file, Foxglove or ROS; a ``Recording``.

    Stamps are the messages' own, or log times where those are 0. A truncated or damaged file is read as
    far as it goes, which ends the frames with a loss, not an error.

    Args:
        path: the file.
        topic: of the depth images; None finds the only one.
        camera_topic: of the calibration; None finds the one that belongs to the images.
        camera_file: camera.toml that replaces the calibration; its crop and mirror apply.
        mirror: flip left to right; replaces the camera file's value.

    Raises:
        RecordingError: if the file is no MCAP, if there is not exactly one topic or calibration that
            fits, or if the calibration is of another image size. A later image of another size or
            encoding raises it while it is read.
    """

    def __init__(
        self,
        path: Path,
        *,
        topic: str | None = None,
        camera_topic: str | None = None,
        camera_file: Path | None = None,
        mirror: bool | None = None,
    ) -> None:
        check_mcap(path)
        topics = scan_topics(path)
        self._topic = choose_depth_topic(path, topics, topic)
        self._truth = [name for name in topics if name.startswith(TRUTH_PREFIX)]
        settings = _intrinsics_only(camera_file) if camera_file is not None else None
        self._camera_topic = "" if settings else _calibration_topic(self._topic, topics, camera_topic)
        stored_camera = self._stored_camera(path, settings, topics)
        flip = mirror if mirror is not None else bool(settings and settings.mirror)
        self._window = Window(settings.crop if settings else None, flip)
        super().__init__(path, self._window.camera(stored_camera))

    @property
    def frame_count(self) -> int | None:
        """The number of messages on the topic; of a truncated file, those that can be read."""
        return self._topic.count

    def identity(self) -> Mapping[str, str]:
        """Name, kind, size and SHA-256 of the file, the topics in use, and whether it is mirrored."""
        size, digest = file_digest(self._path)
        return {
            "name": shown_name(self._path.resolve()),
            "kind": "mcap",
            "bytes": str(size),
            "sha256": digest,
            "topic": self._topic.name,
            "camera_topic": self._camera_topic,
            "frames": str(self._topic.count),
            "mirror": str(self._window.mirror).lower(),
        }

    def truth(self) -> Iterator[TruthMessage]:
        """Yield the messages on ``/truth/...`` topics undecoded, in order of log time where indexed.

        Nothing if the images are mirrored: the truth is not about the mirrored scene.
        """
        return iter(()) if self._window.mirror else read_truth(self._path, self._truth)

    def _stored_camera(self, path: Path, settings: CameraFile | None, topics: Mapping[str, Topic]) -> Camera:
        """Return the camera of the images as they are stored, named by their frame id."""
        image = self._topic.image
        width, height = (image.width, image.height) if image is not None else (0, 0)
        name = frame_id_of_topic(self._topic) or "camera"
        if settings is not None:
            return settings.stored_camera(width, height, name)
        calibration = topics[self._camera_topic].first
        camera = camera_from_message(calibration, name, self._camera_topic)
        if (camera.width, camera.height) != (width, height):
            raise RecordingError(
                "calibration and images differ in size",
                where=f"{path}, {self._camera_topic}",
                found=f"{camera.width}x{camera.height}",
                expected=f"{width}x{height} as on {self._topic.name}",
                hint="choose another with --camera-topic, or pass --camera",
            )
        return replace(camera, name=name)

    def _stored(self, losses: LossLog) -> Iterator[StoredFrame | None]:
        """Yield every image of the topic; None for a message that does not decode."""
        decoder = MessageDecoder()
        for number, item in enumerate(read_messages(self._path, losses, [self._topic.name])):
            try:
                decoded = decoder.decode(*item)
            except UndecodableMessageError as error:
                losses.add(f"message skipped, {error}", f"frame {number} at {item[2].log_time} ns")
                yield None
                continue
            yield self._stored_frame(decoded, item)

    def _stored_frame(self, decoded: Any, item: McapItem) -> StoredFrame:
        stamp = stamp_of(decoded, item[2])
        kind = str(self._topic.kind)
        where = f"{self._topic.name} at {stamp} ns"
        keeps = self._window.keeps_pixels
        image = self._topic.image
        return StoredFrame(
            stamp_ns=stamp,
            where=where,
            encoding=image.depth if image is not None and image.depth is not None else "16UC1",
            decode=lambda: self._depth(decoded, kind, where),
            png=lambda: millimetre_png(decoded, kind) if keeps else None,
        )

    def _depth(self, decoded: Any, kind: str, where: str) -> ImageArray:
        first, here = self._topic.image, describe_image(decoded, kind)
        if first is not None and here.width and here != first:
            raise RecordingError(
                "images differ in size or encoding",
                where=f"{self._path}, {where}",
                found=f"{here.width}x{here.height} {here.encoding}",
                expected=f"{first.width}x{first.height} {first.encoding} as at the beginning",
            )
        return self._window.apply(decode_depth(decoded, kind, where))


def _calibration_topic(image: Topic, topics: Mapping[str, Topic], wanted: str | None) -> str:
    calibrations = {
        name: frame_id_of(topic.first)
        for name, topic in topics.items()
        if topic.kind == CALIBRATION and topic.first is not None
    }
    return choose_calibration(image.name, frame_id_of_topic(image), calibrations, wanted)


def _intrinsics_only(path: Path) -> CameraFile:
    """Load a camera file for images whose depth format the messages tell themselves."""
    settings = load_camera_file(path)
    for key in ("depth_unit_mm", "missing"):
        if getattr(settings, key) != CameraFile.model_fields[key].default:
            raise UsageError(
                f"key '{key}' does not apply to MCAP",
                where=path,
                hint="its encoding tells the unit: 16UC1 mm, 32FC1 m",
            )
    return settings
