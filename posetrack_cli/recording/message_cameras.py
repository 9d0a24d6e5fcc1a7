"""Which topics of an MCAP file are its cameras' grey images, and the calibrated cameras of topics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import PosetrackError, RecordingError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import placed, relative_to, rotation_from_rows
from posetrack_cli.mcap.decoding import VIDEO_IMAGE, MessageDecoder, UndecodableMessageError, frame_id_of
from posetrack_cli.recording.base import TRUTH_PREFIX, NotCalibratedError, UnreadableImageError
from posetrack_cli.recording.camera_file import Rig, check_apart
from posetrack_cli.recording.camera_of import (
    ImageCamera,
    calibration_of,
    camera_of_message,
    is_empty,
    is_rectified,
    is_same_frame,
)
from posetrack_cli.recording.depth import DISPARITY
from posetrack_cli.recording.grey import Grey, grey_like, grey_like_message, holds_grey
from posetrack_cli.recording.message_calibration import choose_calibration
from posetrack_cli.recording.message_extrinsics import camera_places, is_placed, place_of_calibration
from posetrack_cli.recording.message_topics import TRIES, FileTopics, Topic
from posetrack_cli.recording.message_video import first_picture
from posetrack_cli.recording.pixels import Pixels

COMPRESSED = "/compressed"
SIDES = {"left": 0, "right": 1}


P = TypeVar("P", bound=Pixels, covariant=True)


@dataclass(frozen=True)
class CameraTopic(Generic[P]):
    """One camera's topic.

    Attributes:
        topic: of the images.
        name: the camera's.
        pixels: what the images hold.
    """

    topic: Topic
    name: str
    pixels: P

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        return self.pixels.width, self.pixels.height


GreyTopic = CameraTopic[Grey]


def find_sources(topics: FileTopics, wanted: Sequence[str] | None = None) -> list[GreyTopic]:
    """Return the topics to use: those asked for, in that order, else all that are images of cameras.

    Images of 8 bits come before those of 16, which may be depth; of a topic that is there raw and compressed
    the raw one counts. Left comes before right.

    Args:
        topics: of the file.
        wanted: names of topics, or of cameras.

    Raises:
        RecordingError: listing the candidates, if there is none or none of a name.
    """
    images = [topic for topic in topics.by_name.values() if topic.image is not None and topic.count]
    images = [topic for topic in images if not topic.name.startswith(TRUTH_PREFIX)]
    grey = [topic for topic in images if holds_grey(topic.first, topic.kind)]
    if wanted is not None:
        return [_asked_for(topics, name, grey) for name in wanted]
    sources = [_source(topics, topic) for topic in sorted(grey, key=_order)]
    eight = [source for source in sources if source.pixels.bits == 8] or sources
    names = {source.topic.name for source in eight}
    kept = [s for s in eight if s.topic.name.removesuffix(COMPRESSED) not in names - {s.topic.name}]
    if not kept:
        found = ", ".join(topic.label for topic in images) or "no image topics"
        hint = "posetrack hand run tracks hands in depth" if topics.depth_topics else ""
        raise RecordingError(
            "no topic holds grey or colour images", where=topics.path, found=found, hint=hint
        )
    return distinct_names(kept)


def sources_of_rig(topics: FileTopics, rig: Rig) -> list[GreyTopic]:
    """Return the topic of each camera of a camera file, by topic, frame id or a part of the topic's name.

    Raises:
        RecordingError: if none fits a camera.
        UsageError: if several do.
    """
    every = find_sources(topics)
    if len(rig.cameras) == 1 and len(every) == 1:
        return [replace(every[0], name=next(iter(rig.cameras)))]
    found = []
    for name in rig.cameras:
        fitting = [source for source in every if _is_called(source.topic, name)]
        if len(fitting) != 1:
            raise (UsageError if fitting else RecordingError)(
                f"{'several topics fit' if fitting else 'no topic of'} camera '{name}' of {rig.path.name}",
                where=topics.path,
                found=", ".join(source.topic.label for source in fitting or every),
                hint="name cameras in it by topic, frame id or a part of the topic's name",
            )
        found.append(replace(fitting[0], name=name))
    return found


def cameras_of_messages(topics: FileTopics, sources: Sequence[GreyTopic]) -> list[ImageCamera]:
    """Return the cameras of stored images from the file's calibrations and transforms, relative to the first.

    Raises:
        RecordingError: if one is not calibrated, sizes differ, or nothing tells where the cameras are.
    """
    calibrations = _calibrations(topics, sources)
    found = [camera_of_topic(topics, s, name) for s, name in zip(sources, calibrations, strict=True)]
    cameras = [each.camera for each in found]
    if len(cameras) == 1:
        return found
    known: Sequence[FloatArray | None] = [
        _place(topics.by_name[name], source) for source, name in zip(sources, calibrations, strict=True)
    ]
    if not is_placed(known):
        known = camera_places(topics, [source.topic.frame_id for source in sources])
    if not is_placed(known):
        raise RecordingError(
            f"places of cameras {', '.join(camera.name for camera in cameras)} are not known",
            where=topics.path,
            found="no baseline in P of their calibrations and no transforms between their frames",
            hint="pass --camera; posetrack calibrate stereo writes such a file",
        )
    rebased = relative_to(*_placed(cameras, known, topics.path))
    check_apart(rebased, topics.path)
    return [replace(each, camera=camera) for each, camera in zip(found, rebased, strict=True)]


def distinct_names(sources: Sequence[GreyTopic]) -> list[GreyTopic]:
    """Return the sources named by frame id, or else by the part of the topic in which they differ."""
    names = [source.topic.frame_id for source in sources]
    if "" in names or len(set(names)) < len(names):
        parts = [source.topic.name.strip("/").split("/") for source in sources]
        columns = list(zip(*parts, strict=False))
        distinct = [column for column in columns if len(set(column)) == len(column)]
        names = list(distinct[0]) if distinct else [source.topic.name for source in sources]
    if len(sources) == 1 and not sources[0].topic.frame_id:
        names = ["camera"]
    return [replace(source, name=name) for source, name in zip(sources, names, strict=True)]


def _placed(
    cameras: Sequence[Camera], places: Sequence[FloatArray | None], path: Path
) -> tuple[Camera, list[Camera]]:
    moved = []
    for camera, place in zip(cameras, places, strict=True):
        matrix = np.eye(3, 4) if place is None else place
        try:
            rotation = rotation_from_rows(matrix[:, :3].ravel().tolist(), f"{path}, R of {camera.name}")
        except PosetrackError as error:
            raise RecordingError(str(error)) from error
        moved.append(placed(camera, np.column_stack([rotation, matrix[:, 3]])))
    return moved[0], moved


def _calibrations(topics: FileTopics, sources: Sequence[GreyTopic]) -> list[str]:
    """Return the topic of each camera's calibration; no two cameras share one."""
    known = topics.calibration_frames
    chosen = [choose_calibration(s.topic.name, s.topic.frame_id, known) for s in sources]
    for name in set(chosen):
        sharing = [s.topic.name for s, c in zip(sources, chosen, strict=True) if c == name]
        if len(sharing) > 1:
            raise RecordingError(
                f"{', '.join(sharing)} have one calibration",
                where=topics.path,
                found=name,
                hint="choose the cameras with --cameras TOPIC,TOPIC, or pass --camera",
            )
    return chosen


def camera_of_topic(topics: FileTopics, source: CameraTopic[Pixels], calibration: str) -> ImageCamera:
    """Return the camera of a topic's images by a calibration topic of the file.

    Raises:
        NotCalibratedError: the calibration is empty.
        RecordingError: it does not fit the images.
    """
    message = _message_of(topics, source.topic, calibration)
    found = camera_by(message, topics.path, source, calibration)
    return replace(found, frame=frame_id_of(message))


def _message_of(topics: FileTopics, images: Topic, calibration: str) -> Any:
    """Return the first message of a calibration topic that is of the frame of images, else the first."""
    first = topics.by_name[calibration].first
    if not images.frame_id or is_same_frame(frame_id_of(first), images.frame_id):
        return first
    decoder = MessageDecoder()
    for item in islice(topics.file.messages([calibration]), TRIES):
        with suppress(UndecodableMessageError):
            decoded = decoder.decode(*item)
            if is_same_frame(frame_id_of(decoded), images.frame_id) and not is_empty(decoded):
                return decoded
    return first


def camera_by(message: Any, path: Path, source: CameraTopic[Pixels], calibration: str) -> ImageCamera:
    """Return the camera of a topic's images by one message of a calibration topic.

    Raises:
        NotCalibratedError: the calibration is empty.
        RecordingError: it does not fit the images.
    """
    topic = source.topic
    try:
        return camera_of_message(
            calibration_of(message, calibration),
            source.size,
            rectified=is_rectified(topic.name, topic.frame_id) or topic.other_content == DISPARITY,
            name=source.name or "camera",
            topic=calibration,
            images=topic.name,
        )
    except NotCalibratedError:
        raise
    except RecordingError as error:
        raise RecordingError(str(error), where=path) from error


def _place(calibration: Topic, source: GreyTopic) -> FloatArray | None:
    topic = source.topic
    return place_of_calibration(calibration.first, rectified=is_rectified(topic.name, topic.frame_id))


def _asked_for(topics: FileTopics, name: str, grey: Sequence[Topic]) -> GreyTopic:
    exact = [topic for topic in grey if topic.name == name]
    fitting = exact or [topic for topic in grey if _is_called(topic, name)]
    if len(fitting) == 1:
        return replace(_source(topics, fitting[0]), name=fitting[0].frame_id if exact else name)
    raise (UsageError if fitting else RecordingError)(
        f"{'several topics' if fitting else 'no topic'} of camera '{name}'",
        where=topics.path,
        found=", ".join(topic.label for topic in fitting or grey) or "no topic with grey or colour images",
        hint="name topics with --cameras TOPIC,TOPIC",
    )


def _is_called(topic: Topic, name: str) -> bool:
    return name in (topic.name, topic.frame_id, *topic.name.split("/"))


def _source(topics: FileTopics, topic: Topic) -> GreyTopic:
    try:
        if topic.kind == VIDEO_IMAGE:
            pixels = _first_of_video(topics, topic)
        else:
            pixels = grey_like_message(topic.first, str(topic.kind), topic.name)
    except UnreadableImageError as error:
        raise RecordingError(f"first image cannot be used, {error}", where=topic.name) from error
    return CameraTopic(topic, topic.frame_id, pixels)


def _first_of_video(topics: FileTopics, topic: Topic) -> Grey:
    """Return what a topic of video holds, by its first picture, which may come after some messages."""
    decoder = MessageDecoder()

    def messages() -> Iterator[Any]:
        for item in topics.file.messages([topic.name]):
            with suppress(UndecodableMessageError):
                yield decoder.decode(*item)

    picture = first_picture(messages())
    if picture is None:
        raise UnreadableImageError("no picture can be decoded")
    return grey_like(picture, topic.name)


def _order(topic: Topic) -> tuple[int, str]:
    """Left, right, then by name."""
    sides = [SIDES[side] for side in SIDES if side in topic.name or side in topic.frame_id]
    return (sides[0] if len(sides) == 1 else len(SIDES), topic.name)
