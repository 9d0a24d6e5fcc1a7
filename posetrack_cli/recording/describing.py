"""Descriptions of recordings in image folders and message files, in plain values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Metadata

from posetrack_cli.arrays import ImageArray
from posetrack_cli.bags.message_file import message_file, required_container
from posetrack_cli.bags.ros2 import parts_of
from posetrack_cli.errors import PosetrackError, RecordingError
from posetrack_cli.files import placed_path
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.mcap.decoding import (
    CALIBRATION,
    MessageDecoder,
    UndecodableMessageError,
    frame_id_of,
    stamp_of,
)
from posetrack_cli.mcap.stream import McapFile, McapItem
from posetrack_cli.recording.base import RUN_RECORD
from posetrack_cli.recording.camera_file import load_depth_camera
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.depth import Depth
from posetrack_cli.recording.description import (
    described_cameras,
    described_losses,
    described_stamps,
    described_use,
    try_open,
)
from posetrack_cli.recording.folder import depth_camera_path, open_depth_folder, open_grey_folder
from posetrack_cli.recording.grey import decode_shown, grey_like, holds_grey
from posetrack_cli.recording.identity import shown_name
from posetrack_cli.recording.image_files import (
    DEPTH_SUFFIXES,
    ImageFile,
    decode_any,
    files_of,
    first_decoded,
    read_image,
)
from posetrack_cli.recording.image_folders import CameraFolders, Timing, depth_below, find_depth, find_folders
from posetrack_cli.recording.image_lists import DEPTH_WORD
from posetrack_cli.recording.message_cameras import camera_from_message
from posetrack_cli.recording.message_source import open_depth_messages, open_grey_messages
from posetrack_cli.recording.message_topics import Topic, TopicScan
from posetrack_cli.recording.timeline import Timeline

# Folders of images: depth, or grey images of one or more cameras


# For images without stamps: matching by name does not depend on the rate.
ANY_RATE_HZ = 30.0


def describe_folder(path: Path) -> dict[str, Any]:
    """Describe a folder of 16-bit depth or camera images; of depth only the first is read.

    If depth is in a subfolder, the description is that of depth, with camera images under ``colour``.
    """
    if (depth := depth_below(path)) is not None:
        others = _others(path)
        return _describe_depth(depth) | ({} if others is None else {"colour": _describe_grey(others)})
    folders = find_folders(path)
    images = folders.by_name.get("")
    if images is not None:
        first = first_decoded(images, _as_stored)
        if (
            first.ndim == 2
            and first.dtype in (np.uint16, np.float32)
            and images[0].suffix.lower() in DEPTH_SUFFIXES
        ):
            return _describe_depth(find_depth(path))
    return _describe_grey(folders)


def _others(path: Path) -> CameraFolders | None:
    """Return the images in folders not named depth, None if there are none."""
    try:
        found = find_folders(path).without_depth()
    except RecordingError:
        return None
    return None if all(DEPTH_WORD in name.lower() for name in found.by_name) else found


def _describe_depth(found: CameraFolders) -> dict[str, Any]:
    """Return number, size, stamps and camera of depth images; each missing item has a reason."""
    path, (images,) = found.path, found.by_name.values()
    first = first_decoded(images, _as_stored)
    height, width = first.shape[:2]
    channels = 1 if first.ndim == 2 else first.shape[2]
    image = {"width": width, "height": height, "bits": 8 * first.dtype.itemsize, "channels": channels}
    timing, no_stamps = _timing(found)
    stamps = None if timing is None else described_stamps(stamp for stamp, _ in timing.stamped[""])
    fps = None if timing else ANY_RATE_HZ
    camera, no_camera = _or_reason(lambda: _folder_camera(path, images[0].parent, (width, height), fps))
    return {
        "name": shown_name(placed_path(path)),
        "kind": "folder",
        "bytes": sum(file.stat().st_size for file in files_of(images)),
        "images": len(images),
        "first": images[0].name,
        "last": images[-1].name,
        "image": image,
        "stamps": stamps,
        "no_stamps": no_stamps,
        "cameras": [camera] if camera else [],
        "no_camera": no_camera,
        "remarks": _remarks(found, timing),
        "losses": [],
    }


def _describe_grey(folders: CameraFolders) -> dict[str, Any]:
    """Return the images of each camera, the matched frames, and the rig."""
    path, by_name = folders.path, folders.by_name
    timing, no_stamps = _timing(folders)
    fps = None if timing else ANY_RATE_HZ
    recording, no_camera = try_open(lambda: open_grey_folder(path, {"fps": fps}))
    matched = () if recording is None else recording.matched(LossLog())
    frames = [frame for frame in matched if frame is not None]
    return {
        "name": shown_name(placed_path(path)),
        "kind": "images",
        "bytes": sum(file.stat().st_size for images in by_name.values() for file in files_of(images)),
        "folders": [_folder(name, images) for name, images in by_name.items()],
        "frames": len(frames),
        "incomplete_frames": sum(None in frame.images for frame in frames),
        "stamps": described_stamps(f.stamp_ns for f in frames) if not no_stamps and frames else None,
        "no_stamps": no_stamps,
        "cameras": described_cameras(recording),
        "no_camera": no_camera,
        "remarks": _remarks(folders, timing),
        "losses": [],
    }


def _or_reason(make: Callable[[], dict[str, Any]]) -> tuple[dict[str, Any] | None, str | None]:
    try:
        return make(), None
    except PosetrackError as error:
        return None, str(error)


def _folder_camera(path: Path, images: Path, size: tuple[int, int], fps: float | None) -> dict[str, Any]:
    settings = load_depth_camera(depth_camera_path(path, None, images, size))
    recording = open_depth_folder(path, {"fps": fps})
    (pixels,) = recording.pixels
    unit_mm = pixels.unit_mm if isinstance(pixels, Depth) else None
    depth = {"depth_unit_mm": unit_mm, "missing": settings.missing, "mirror": settings.mirror}
    return recording.cameras[0].values() | depth


def _as_stored(image: ImageFile) -> ImageArray:
    return decode_any(read_image(image))


def _timing(folders: CameraFolders) -> tuple[Timing | None, str | None]:
    """Return the stamps of images without a given rate, or the reason why there are none."""
    try:
        return folders.timing(None), None
    except PosetrackError as error:
        return None, str(error).removeprefix(f"{folders.path}: ")


def _remarks(folders: CameraFolders, timing: Timing | None) -> list[str]:
    return [*folders.every_remark, *(() if timing is None else timing.remarks)]


def _folder(name: str, images: Sequence[ImageFile]) -> dict[str, Any]:
    kind = first_decoded(images, lambda image: grey_like(decode_shown(read_image(image)), image))
    return {
        "name": name,
        "images": len(images),
        "first": images[0].name,
        "last": images[-1].name,
        "width": kind.width,
        "height": kind.height,
        "stored": kind.words,
    }


# Files of messages, intact or damaged, in one pass


SHOWN_CHARACTERS = 60  # longest metadata value shown


class MessageSurvey:
    """Topics, stamps and losses of a file of messages.

    Stamps are those a reader uses: the message's own for images and calibrations, else the log time.
    """

    def __init__(self, path: Path) -> None:
        self._file = message_file(path)
        self._scan = TopicScan()
        self._decoder = MessageDecoder()
        self._timelines: dict[str, Timeline] = {}
        for schema, channel, _ in self._file.counts() or ():  # includes topics without messages
            self._scan.topic(schema, channel)
        for item in self._file.messages():
            self._add(item)

    def topics(self) -> list[dict[str, Any]]:
        """Return one description per topic, sorted by name."""
        return [self._topic(self._scan.topics[name]) for name in sorted(self._scan.topics)]

    def cameras(self) -> list[dict[str, Any]]:
        """Return the intrinsics of every calibration topic, or why they are invalid."""
        topics = sorted(self._scan.topics.values(), key=lambda topic: topic.name)
        return [
            _message_camera(topic)
            for topic in topics
            if topic.kind == CALIBRATION and topic.first is not None
        ]

    def has_several_cameras(self) -> bool:
        """Return whether at least two topics hold grey or colour images, not depth."""
        images = [topic for topic in self._scan.topics.values() if topic.image is not None]
        return sum(holds_grey(topic.first, topic.kind) and not topic.is_depth for topic in images) > 1

    def has_grey(self) -> bool:
        """Return whether a topic holds grey or colour images, not depth."""
        images = [topic for topic in self._scan.topics.values() if topic.image is not None]
        return any(holds_grey(topic.first, topic.kind) and not topic.is_depth for topic in images)

    def has_depth(self) -> bool:
        """Return whether a topic holds depth images."""
        return any(topic.is_depth for topic in self._scan.topics.values())

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Unreadable data."""
        return self._file.losses.losses

    def extras(self) -> list[tuple[str, dict[str, Any]]]:
        """Return metadata and attachments, each as (``metadata`` or ``attachment``, values)."""
        is_mcap = isinstance(self._file, McapFile)
        return [_extra(record) for record in McapFile(self._file.path).extras()] if is_mcap else []

    def _add(self, item: McapItem) -> None:
        topic = self._scan.inspect(item)
        stamp = item[2].log_time
        if topic.kind is not None:
            try:
                stamp = stamp_of(self._decoder.decode(*item, topic.kind), item[2])
            except UndecodableMessageError as error:
                self._file.losses.add(str(error), f"at {stamp} ns")
        if topic.name not in self._timelines:
            self._timelines[topic.name] = Timeline()
        self._timelines[topic.name].add(stamp)

    def _topic(self, topic: Topic) -> dict[str, Any]:
        image, timeline = topic.image, self._timelines.get(topic.name, Timeline())
        return {
            "topic": topic.name,
            "type": topic.type_name,
            "message_encoding": topic.message_encoding,
            "encoding": image.encoding if image is not None else None,
            "width": image.width if image is not None else None,
            "height": image.height if image is not None else None,
            "depth": topic.is_depth and not topic.other_content,
            "frame_id": frame_id_of(topic.first) if topic.first is not None else None,
            **timeline.summary(),
            "remarks": [] if image is None else list(timeline.remarks),
        }


def describe_messages(path: Path) -> dict[str, Any]:
    """Describe a file or folder of messages; truncation and damage are in ``losses``."""
    container = required_container(path)
    survey = MessageSurvey(path)
    extras = survey.extras()
    is_result = any(values["name"] == RUN_RECORD for _, values in extras)
    several = survey.has_several_cameras() and not is_result
    rig, no_rig = try_open(lambda: open_grey_messages(path, {})) if several else (None, None)
    used = []
    if survey.has_depth() and not is_result:
        used = [described_use(lambda: open_depth_messages(path, {}), "hand run")]
    if survey.has_grey() and not several and not is_result:
        used.append(described_use(lambda: open_grey_messages(path, {"guess": Guess()}), "head mono"))
    return {
        "name": shown_name(placed_path(path)),
        "kind": container.kind,
        "container": container.words,
        "bytes": sum(part.stat().st_size for part in parts_of(path))
        if path.is_dir()
        else path.stat().st_size,
        "complete": not survey.losses,
        "topics": survey.topics(),
        "cameras": survey.cameras(),
        "used": used,
        "rig": described_cameras(rig),
        "no_rig": no_rig,
        "metadata": [values for kind, values in extras if kind == "metadata"],
        "attachments": [values for kind, values in extras if kind == "attachment"],
        "losses": described_losses(survey.losses),
    }


def _message_camera(topic: Topic) -> dict[str, Any]:
    try:
        camera = camera_from_message(topic.first, frame_id_of(topic.first), topic.name)
    except PosetrackError as error:
        return {"topic": topic.name, "problem": str(error)}
    return {"topic": topic.name, **camera.values()}


def _extra(record: Metadata | Attachment) -> tuple[str, dict[str, Any]]:
    if isinstance(record, Metadata):
        return "metadata", _metadata(record)
    described = {"name": record.name, "media_type": record.media_type, "bytes": len(record.data)}
    return "attachment", described


def _metadata(record: Metadata) -> dict[str, Any]:
    """Return name and number of entries; for a run record also the entries, shortened."""
    values: dict[str, Any] = {"name": record.name, "entries": len(record.metadata)}
    return values | {"values": _shortened(record.metadata)} if record.name == RUN_RECORD else values


def _shortened(entries: Mapping[str, str]) -> dict[str, str]:
    flat = {key: " ".join(value.split()) for key, value in entries.items()}
    return {
        key: value if len(value) <= SHOWN_CHARACTERS else value[: SHOWN_CHARACTERS - 1] + "…"
        for key, value in flat.items()
    }
