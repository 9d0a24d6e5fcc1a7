"""What topics a file of messages has, and which one holds the depth."""

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
TRANSPORTS = ("/compressed", "/compressedDepth")
"""What ROS adds to the name of a topic that is published compressed, too."""
REDRAWN = ("aligned_depth", "depth_registered", "depth_to_", "registered_depth")
"""How drivers name depth as another camera, that of colour, would see it."""
SAMPLES = 3
"""How many images of a topic are looked at: a first one that differs from the others does not count."""
TRIES = 50
"""How many messages of a topic are looked at until one decodes."""


@dataclass
class Topic:
    """One topic of a file.

    Attributes:
        name: the topic.
        type_name: name of its schema.
        message_encoding: ``protobuf``, ``ros1``, ``cdr``, ``json``...
        kind: ``kind_of`` its schema.
        count: number of messages that the file tells of, or that can be read from a truncated file.
        first: first decoded message, of images and calibrations only; None if none decodes.
        image: what the first image holds, None for other topics.
        tries: how many messages were tried.
        samples: first images with what they hold; the first that is like most of them counts.
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
        """Whether the topic holds depth images."""
        return self.image is not None and self.image.depth is not None

    @property
    def other_content(self) -> str:
        """The word in its name that says that its images are not depth, such as ``infrared``; else empty."""
        return other_content(self.name)

    @property
    def is_settled(self) -> bool:
        """Whether looking at more messages would tell nothing new about what the topic holds."""
        if self.kind == CALIBRATION:
            found = self.first is not None and not is_empty(self.first)
        else:
            found = len(self.samples) >= SAMPLES
        return self.kind is None or found or self.tries >= TRIES

    @property
    def frame_id(self) -> str:
        """The coordinate frame of its first message, empty if there is none."""
        return frame_id_of(self.first) if self.first is not None else ""

    @property
    def label(self) -> str:
        """Name, type and encoding, for lists of candidates."""
        encoding = self.image.encoding if self.image is not None else "does not decode"
        return f"{self.name} ({self.type_name}, {encoding})"


class TopicScan:
    """Collects topics from messages."""

    def __init__(self) -> None:
        self.topics: dict[str, Topic] = {}
        self._decoder = MessageDecoder()

    def topic(self, schema: Schema | None, channel: Channel) -> Topic:
        """Return the topic of a channel, new if it was not met before."""
        if channel.topic not in self.topics:
            type_name = schema.name if schema is not None else ""
            kind = kind_of(schema)
            self.topics[channel.topic] = Topic(channel.topic, type_name, channel.message_encoding, kind)
        return self.topics[channel.topic]

    def inspect(self, item: McapItem) -> Topic:
        """Decode a message if its topic is not settled yet, and return the topic; does not count it."""
        topic = self.topic(item[0], item[1])
        if topic.is_settled:
            return topic
        topic.tries += 1
        try:
            decoded = self._decoder.decode(*item)
            if topic.kind == CALIBRATION:
                topic.first = decoded
            else:
                topic.samples.append((decoded, describe_image(decoded, str(topic.kind))))
                topic.first, topic.image = _usual(topic.samples)
        except UndecodableMessageError:
            return topic
        return topic


@dataclass(frozen=True, eq=False)
class FileTopics:
    """The topics of one file.

    Attributes:
        file: the file.
        by_name: its topics.
    """

    file: MessageFile
    by_name: Mapping[str, Topic]

    @property
    def path(self) -> Path:
        """Of the file."""
        return self.file.path

    @property
    def images(self) -> list[Topic]:
        """The topics of images that have any."""
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
        """The topics of depth images, or what may be depth: infrared has 16 bits, too."""
        return [topic for topic in self.images if topic.is_depth]

    def depth_topic(self, wanted: str | None = None) -> Topic:
        """Return the topic that holds depth: the one asked for, else the one that most likely is meant.

        Raises:
            RecordingError: listing the candidates, if the topic asked for does not exist or holds no depth,
                or if there is none.
            UsageError: listing them, if there are several and none is asked for, or likeliest.
        """
        depth = self.depth_topics
        asked = None if wanted is None else self.by_name.get(wanted)
        if asked is not None and asked.is_depth:
            return asked
        if wanted is not None:
            names = [candidate.name for candidate in depth] or list(self.by_name)
            raise RecordingError(
                "no such topic" if asked is None else "topic holds no depth",
                where=self.path,
                found=f"'{wanted}'" if asked is None else asked.label,
                expected=_labels(depth) or "a topic with depth images, of which there is none",
                hint=nearest_name(wanted, names) if asked is None and names else "",
            )
        likeliest = _likeliest_depth(depth)
        if likeliest and all(topic.other_content not in ("", DISPARITY) for topic in likeliest):
            raise not_depth(self.path, likeliest)
        if len(likeliest) == 1:
            return likeliest[0]
        if depth:
            what, hint = "several topics hold depth", "choose one with --topic"
            raise UsageError(what, where=self.path, found=_labels(depth), hint=hint)
        among = f" among {', '.join(sorted(self.by_name))}" if self.by_name else ""
        raise RecordingError(
            "no topic holds depth",
            where=self.path,
            found=_labels(self.images) or f"no image topics{among}",
            expected="images of 16UC1, mono16, 32FC1 or 16-bit png",
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
    """Look at messages until all topics that have any are settled: one pass for however many topics."""
    waiting = {name for name, topic in scan.topics.items() if topic.count and not topic.is_settled}
    if not waiting:
        return
    for item in file.messages(waiting.__contains__):
        topic = scan.inspect(item)
        if topic.is_settled or topic.tries >= topic.count:
            waiting.discard(topic.name)
            if not waiting:
                return


def _usual(samples: Sequence[tuple[Any, ImageDescription]]) -> tuple[Any, ImageDescription]:
    """Return the first image, or the second where it is like the third and the first one is not."""
    first, *others = samples
    is_agreed = len(others) == SAMPLES - 1 and len({image for _, image in others}) == 1
    return others[0] if is_agreed and others[0][1] != first[1] else first


def _likeliest_depth(depth: Sequence[Topic]) -> Sequence[Topic]:
    """Leave out what is there twice, infrared, and depth that was drawn anew for another camera."""
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
    """Return the error for a file whose only candidates are called infrared or the like."""
    return RecordingError(
        "no topic holds depth",
        where=path,
        found=f"{_labels(list(topics))}, which is called {topics[0].other_content}",
        expected="a topic of depth images",
        hint=f"--topic {topics[0].name} takes it all the same",
    )


def _labels(topics: list[Topic]) -> str:
    return ", ".join(topic.label for topic in sorted(topics, key=lambda topic: topic.name))
