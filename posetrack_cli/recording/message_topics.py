"""Topics of a file of messages, and the choice of the depth topic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import Channel, Schema

from posetrack_cli.bags.message_file import MessageFile, message_file
from posetrack_cli.errors import RecordingError, UsageError, nearest_name
from posetrack_cli.mcap.decoding import (
    CALIBRATION,
    MessageDecoder,
    UndecodableMessageError,
    frame_id_of,
    kind_of,
)
from posetrack_cli.mcap.stream import McapItem
from posetrack_cli.recording.camera_of import is_empty
from posetrack_cli.recording.depth import DISPARITY, ImageDescription, describe_image, other_content

DEPTH = "depth"
# Suffixes of topics that image_transport adds for compressed copies.
TRANSPORTS = ("/compressed", "/compressedDepth")
# Driver names for depth reprojected to another camera, usually colour.
REDRAWN = ("aligned_depth", "depth_registered", "depth_to_", "registered_depth")
SAMPLES = 3  # images inspected per topic, so that an odd first one does not decide
TRIES = 50  # messages inspected per topic until one decodes


@dataclass
class Topic:
    """One topic of a file.

    Attributes:
        name: name of the topic.
        type_name: name of its schema.
        message_encoding: ``protobuf``, ``ros1``, ``cdr``, ``json``...
        kind: ``kind_of`` its schema.
        count: number of messages in the index, or readable ones in a truncated file.
        first: first decoded message of images and calibrations; None if none decodes.
        image: content of the first image, None for other topics.
        tries: number of messages tried.
        samples: first images with their content; the first one of the majority is used.
    """

    name: str
    type_name: str
    message_encoding: str
    kind: str | None
    count: int = 0
    first: Any = None
    image: ImageDescription | None = None
    tries: int = field(default=0, repr=False)
    samples: list[tuple[Any, ImageDescription]] = field(default_factory=list, repr=False)

    @property
    def is_depth(self) -> bool:
        """True if the topic holds depth images."""
        return self.image is not None and self.image.depth is not None

    @property
    def other_content(self) -> str:
        """The word in its name for images other than depth, such as ``infrared``; else empty."""
        return other_content(self.name)

    @property
    def is_settled(self) -> bool:
        """True if further messages would not change what is known of the topic."""
        if self.kind == CALIBRATION:
            found = self.first is not None and not is_empty(self.first)
        else:
            found = len(self.samples) >= SAMPLES
        return self.kind is None or found or self.tries >= TRIES

    @property
    def frame_id(self) -> str:
        """The coordinate frame of its first message, empty if unknown."""
        return frame_id_of(self.first) if self.first is not None else ""

    @property
    def label(self) -> str:
        """Name, type and encoding, for lists of candidates."""
        encoding = self.image.encoding if self.image is not None else "cannot be decoded"
        return f"{self.name} ({self.type_name}, {encoding})"


class TopicScan:
    """Topics collected from messages."""

    def __init__(self) -> None:
        self.topics: dict[str, Topic] = {}
        self._decoder = MessageDecoder()

    def topic(self, schema: Schema | None, channel: Channel) -> Topic:
        """Return the topic of a channel, creating it if new."""
        if channel.topic not in self.topics:
            type_name = schema.name if schema is not None else ""
            kind = kind_of(schema)
            self.topics[channel.topic] = Topic(channel.topic, type_name, channel.message_encoding, kind)
        return self.topics[channel.topic]

    def inspect(self, item: McapItem) -> Topic:
        """Decode a message unless its topic is settled, and return the topic; does not count it."""
        topic = self.topic(item[0], item[1])
        if topic.is_settled:
            return topic
        topic.tries += 1
        try:
            decoded = self._decoder.decode(*item, topic.kind)
            if topic.kind == CALIBRATION:
                topic.first = decoded
            else:
                topic.samples.append((decoded, describe_image(decoded, str(topic.kind))))
                topic.first, topic.image = _typical_sample(topic.samples)
        except UndecodableMessageError:
            return topic
        return topic


@dataclass(frozen=True, eq=False)
class FileTopics:
    """The topics of one file.

    Attributes:
        file: the file.
        by_name: topics by name.
    """

    file: MessageFile
    by_name: Mapping[str, Topic]

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.file.path

    @property
    def images(self) -> list[Topic]:
        """The image topics that have messages."""
        return [t for t in self.by_name.values() if t.kind not in (None, CALIBRATION) and t.count]

    @property
    def calibration_frames(self) -> dict[str, str]:
        """The coordinate frame of every calibration, by topic."""
        return {
            name: topic.frame_id
            for name, topic in self.by_name.items()
            if topic.kind == CALIBRATION and topic.first is not None
        }

    @property
    def depth_topics(self) -> list[Topic]:
        """The topics of depth images, or possibly depth: infrared also has 16 bits."""
        return [topic for topic in self.images if topic.is_depth]

    def depth_topic(self, wanted: str | None = None) -> Topic:
        """Return the requested depth topic, else the most likely one.

        Raises:
            RecordingError: the requested topic does not exist or holds no depth, or no topic does. Lists
                candidates.
            UsageError: several topics are equally likely and none is requested. Lists candidates.
        """
        depth = self.depth_topics
        requested = None if wanted is None else self.by_name.get(wanted)
        if requested is not None and requested.is_depth:
            return requested
        if wanted is not None:
            names = [candidate.name for candidate in depth] or list(self.by_name)
            raise RecordingError(
                "no such topic" if requested is None else "topic has no depth images",
                where=self.path,
                found=f"'{wanted}'" if requested is None else requested.label,
                expected=_labels(depth) or "a topic with depth images; this file has none",
                hint=nearest_name(wanted, names) if requested is None and names else "",
            )
        likeliest = _likeliest_depth(depth)
        if likeliest and all(topic.other_content not in ("", DISPARITY) for topic in likeliest):
            raise not_depth(self.path, likeliest)
        if len(likeliest) == 1:
            return likeliest[0]
        if depth:
            what, hint = "several depth topics", "choose one with --topic"
            raise UsageError(what, where=self.path, found=_labels(depth), hint=hint)
        among = f" among {', '.join(sorted(self.by_name))}" if self.by_name else ""
        raise RecordingError(
            "no depth topic",
            where=self.path,
            found=_labels(self.images) or f"no image topics{among}",
            expected="16UC1, mono16, 32FC1 or 16-bit PNG images",
        )


def scan_topics(path: Path) -> FileTopics:
    """Return the topics of a file: from its index, or by reading all of it if it has none."""
    file, scan = message_file(path), TopicScan()
    counts = file.counts()
    if counts is None:
        for item in file.messages():
            scan.inspect(item).count += 1
        return FileTopics(file, scan.topics)
    for schema, channel, count in counts:
        scan.topic(schema, channel).count += count
    _settle(file, scan)
    return FileTopics(file, scan.topics)


def _settle(file: MessageFile, scan: TopicScan) -> None:
    """Inspect messages until all topics that have any are settled, in one pass."""
    waiting = {name for name, topic in scan.topics.items() if topic.count and not topic.is_settled}
    if not waiting:
        return
    for item in file.messages(waiting.__contains__):
        topic = scan.inspect(item)
        if topic.is_settled or topic.tries >= topic.count:
            waiting.discard(topic.name)
            if not waiting:
                return


def _typical_sample(samples: Sequence[tuple[Any, ImageDescription]]) -> tuple[Any, ImageDescription]:
    """Return the first image, or the second if it agrees with the third but not with the first."""
    first, *others = samples
    is_agreed = len(others) == SAMPLES - 1 and len({image for _, image in others}) == 1
    return others[0] if is_agreed and others[0][1] != first[1] else first


def _likeliest_depth(depth: Sequence[Topic]) -> Sequence[Topic]:
    """Return depth topics without compressed copies, infrared, and reprojected depth."""
    depth = (
        [topic for topic in depth if not topic.other_content]
        or [topic for topic in depth if topic.other_content == DISPARITY]
        or depth
    )
    names = {topic.name for topic in depth}
    copies = {name for name in names if name.endswith(TRANSPORTS) and name.rpartition("/")[0] in names}
    raw = [topic for topic in depth if topic.name not in copies]
    called = [topic for topic in raw if DEPTH in f"{topic.name} {topic.frame_id}".lower()] or raw
    return [topic for topic in called if not any(word in topic.name.lower() for word in REDRAWN)] or called


def not_depth(path: Path, topics: Sequence[Topic]) -> RecordingError:
    """Return the error for a file whose only candidates are named infrared or similar."""
    return RecordingError(
        "no depth topic",
        where=path,
        found=f"{_labels(list(topics))}, named {topics[0].other_content}",
        expected="a topic of depth images",
        hint=f"if it is depth, pass --topic {topics[0].name}",
    )


def _labels(topics: list[Topic]) -> str:
    return ", ".join(topic.label for topic in sorted(topics, key=lambda topic: topic.name))
