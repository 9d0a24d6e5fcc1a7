"""Describe a file of messages, intact or not, in one pass over its messages."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Metadata

from posetrack_cli.bags.message_file import message_file, required_container
from posetrack_cli.bags.ros2_folder import parts_of
from posetrack_cli.errors import PosetrackError
from posetrack_cli.files import placed_path
from posetrack_cli.losses import Loss
from posetrack_cli.mcap.decoding import (
    CALIBRATION,
    MessageDecoder,
    UndecodableMessageError,
    frame_id_of,
    stamp_of,
)
from posetrack_cli.mcap.stream import McapFile, McapItem
from posetrack_cli.recording.base import RUN_RECORD
from posetrack_cli.recording.description import (
    described_cameras,
    described_losses,
    described_use,
    opened,
)
from posetrack_cli.recording.grey import holds_grey
from posetrack_cli.recording.guess import Guess
from posetrack_cli.recording.identity import shown_name
from posetrack_cli.recording.message_calibration import camera_from_message
from posetrack_cli.recording.message_source import open_depth_messages, open_grey_messages
from posetrack_cli.recording.message_topics import Topic, TopicScan
from posetrack_cli.recording.timeline import Timeline

SHOWN_CHARACTERS = 60


class MessageSurvey:
    """Collects topics, stamps and losses from a file's messages.

    Stamps are those a reader uses: the message's own for images and calibrations, else the log time.
    """

    def __init__(self, path: Path) -> None:
        self._file = message_file(path)
        self._scan = TopicScan()
        self._decoder = MessageDecoder()
        self._timelines: dict[str, Timeline] = {}
        for schema, channel, _ in self._file.counts() or ():  # also of topics without any message
            self._scan.topic(schema, channel)
        for item in self._file.messages():
            self._add(item)

    def topics(self) -> list[dict[str, Any]]:
        """Return one description per topic, sorted by name."""
        return [self._topic(self._scan.topics[name]) for name in sorted(self._scan.topics)]

    def cameras(self) -> list[dict[str, Any]]:
        """Return the intrinsics of every calibration topic, or why they cannot be used."""
        topics = sorted(self._scan.topics.values(), key=lambda topic: topic.name)
        return [_camera(topic) for topic in topics if topic.kind == CALIBRATION and topic.first is not None]

    def has_several_cameras(self) -> bool:
        """Whether there are two topics of images that can be made grey, depth aside."""
        images = [topic for topic in self._scan.topics.values() if topic.image is not None]
        return sum(holds_grey(topic.first, topic.kind) and not topic.is_depth for topic in images) > 1

    def has_grey(self) -> bool:
        """Whether there is a topic of images that can be made grey, depth aside."""
        images = [topic for topic in self._scan.topics.values() if topic.image is not None]
        return any(holds_grey(topic.first, topic.kind) and not topic.is_depth for topic in images)

    def has_depth(self) -> bool:
        """Whether there is a topic of depth images."""
        return any(topic.is_depth for topic in self._scan.topics.values())

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What cannot be read."""
        return self._file.losses.losses

    def extras(self) -> list[tuple[str, dict[str, Any]]]:
        """Describe metadata and attachments, each with the word for what it is."""
        is_mcap = isinstance(self._file, McapFile)
        return [_extra(record) for record in McapFile(self._file.path).extras()] if is_mcap else []

    def _add(self, item: McapItem) -> None:
        topic = self._scan.inspect(item)
        stamp = item[2].log_time
        if topic.kind is not None:
            try:
                stamp = stamp_of(self._decoder.decode(*item), item[2])
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
    """Describe a file or folder of messages; what is cut off or damaged is in ``losses``."""
    container = required_container(path)
    survey = MessageSurvey(path)
    extras = survey.extras()
    is_result = any(values["name"] == RUN_RECORD for _, values in extras)
    several = survey.has_several_cameras() and not is_result
    rig, no_rig = opened(lambda: open_grey_messages(path, {})) if several else (None, None)
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


def _camera(topic: Topic) -> dict[str, Any]:
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
    """Return a record's name and number of entries; of a run record also the entries, shortened."""
    values: dict[str, Any] = {"name": record.name, "entries": len(record.metadata)}
    return values | {"values": _shortened(record.metadata)} if record.name == RUN_RECORD else values


def _shortened(entries: Mapping[str, str]) -> dict[str, str]:
    flat = {key: " ".join(value.split()) for key, value in entries.items()}
    return {
        key: value if len(value) <= SHOWN_CHARACTERS else value[: SHOWN_CHARACTERS - 1] + "…"
        for key, value in flat.items()
    }
