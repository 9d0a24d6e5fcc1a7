"""Cameras of message files: calibrations, extrinsics, and matching them to images."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import PosetrackError, RecordingError, UsageError, nearest_name
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import composed, inverse, placed, relative_to, rotation_from_rows
from posetrack_cli.geometry.rotations import (
    canonical,
    matrices_from_quaternions,
    quaternions_from_matrices,
)
from posetrack_cli.mcap.decoding import (
    TRANSFORM_TYPES,
    VIDEO_IMAGE,
    MessageDecoder,
    UndecodableMessageError,
    frame_id_of,
)
from posetrack_cli.mcap.stream import McapItem
from posetrack_cli.recording.base import TRUTH_PREFIX, NotCalibratedError, UnreadableImageError, no_intrinsics
from posetrack_cli.recording.camera_file import Rig, check_baselines
from posetrack_cli.recording.camera_of import (
    ImageCamera,
    calibration_of,
    camera_of_message,
    is_empty,
    is_rectified,
    is_same_frame,
    matrix_of,
    namespace_of,
    reprojected_to,
)
from posetrack_cli.recording.depth import DISPARITY, MM_PER_M
from posetrack_cli.recording.grey import Grey, grey_like, grey_like_message, holds_grey
from posetrack_cli.recording.message_topics import TRIES, FileTopics, Topic
from posetrack_cli.recording.message_video import first_picture
from posetrack_cli.recording.pixels import Pixels
from posetrack_cli.units import METRES_PER_MM

# Cameras from CameraCalibration and CameraInfo messages, and back


# Names of distortion models in messages, where they differ from OpenCV's.
MESSAGE_NAMES = {"equidistant": "kannala_brandt", "inverse_brown_conrady": "Inverse Brown Conrady"}


def camera_from_message(decoded: Any, name: str, topic: str) -> Camera:
    """Return the camera of the raw image of a foxglove.CameraCalibration or a ROS CameraInfo.

    Raises:
        NotCalibratedError: it is uncalibrated, marked by K[0] = 0.
        RecordingError: its values are invalid.
    """
    raw = calibration_of(decoded, topic).raw
    if raw is None:
        raise NotCalibratedError("camera is not calibrated", where=topic, found="K = 0")
    return replace(raw, name=name or "camera")


def calibration_message(camera: Camera, stamp_ns: int, frame_id: str) -> Any:
    """Return the foxglove.CameraCalibration of a camera."""
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

    message = CameraCalibration(
        frame_id=frame_id,
        width=camera.width,
        height=camera.height,
        distortion_model=MESSAGE_NAMES.get(camera.distortion_model, camera.distortion_model),
        D=camera.distortion or (0.0,) * 5,
        K=camera.matrix.ravel().tolist(),
        R=(1, 0, 0, 0, 1, 0, 0, 0, 1),
        P=(camera.fx, 0, camera.cx, 0, 0, camera.fy, camera.cy, 0, 0, 0, 1, 0),
    )
    message.timestamp.FromNanoseconds(stamp_ns)
    return message


def camera_transforms(cameras: Sequence[Camera], frame: str, stamp_ns: int) -> Any:
    """Return the poses of the other cameras relative to the first, whose frame id is ``frame``."""
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    message = FrameTransforms()
    for camera in cameras[1:]:
        pose = inverse(np.array(camera.camera_T_reference))
        child = message.transforms.add(parent_frame_id=frame, child_frame_id=camera.name)
        child.timestamp.FromNanoseconds(stamp_ns)
        x, y, z = (pose[:, 3] * METRES_PER_MM).tolist()
        child.translation.x, child.translation.y, child.translation.z = x, y, z
        x, y, z, w = quaternions_from_matrices(pose[:, :3]).tolist()
        child.rotation.x, child.rotation.y, child.rotation.z, child.rotation.w = x, y, z, w
    return message


def choose_calibration(
    image_topic: str,
    frame_id: str,
    calibrations: Mapping[str, str],
    wanted: str | None = None,
    otherwise: str = "",
) -> str:
    """Return the topic of the calibration that belongs to an image topic.

    That is the requested one; else the one with the image's frame id; else the one in the same namespace,
    nearest first. Depth reprojected to another camera uses that camera's calibration.

    Args:
        image_topic, frame_id: topic and frame id of the images.
        calibrations: frame id by topic.
        wanted: value of --camera-topic.
        otherwise: alternative for the error if there is no calibration.

    Raises:
        RecordingError: there is none, several fit equally well, or the only one has another frame and
            namespace.
    """
    if wanted is not None:
        return _requested_calibration(wanted, calibrations)
    if not calibrations:
        raise no_intrinsics(f"no camera calibration for {image_topic}", otherwise)
    candidates = _nearest_namespace(image_topic, _of_same_camera(image_topic, frame_id, calibrations))
    if len(candidates) > 1:
        listed = ", ".join(f"{topic} (frame '{calibrations[topic]}')" for topic in sorted(candidates))
        raise RecordingError(
            "several matching calibrations",
            where=image_topic,
            found=listed,
            hint="choose one with --camera-topic",
        )
    (topic,) = candidates
    if _is_elsewhere(image_topic, frame_id, topic, calibrations[topic]):
        raise RecordingError(
            "the only calibration belongs to another camera",
            where=image_topic,
            found=f"{topic} with frame '{calibrations[topic]}'",
            expected=f"frame '{frame_id}' or namespace {namespace_of(image_topic) or '/'}",
            hint=f"pass --camera-topic {topic} if it is right, or --camera",
        )
    return topic


def _of_same_camera(image_topic: str, frame_id: str, calibrations: Mapping[str, str]) -> list[str]:
    """Return the calibrations that may belong to the images' camera, judged by names."""
    words = reprojected_to(image_topic)
    if not words:
        same_frame = [topic for topic, frame in calibrations.items() if is_same_frame(frame, frame_id)]
        return same_frame or list(calibrations)
    own = [topic for topic in calibrations if namespace_of(topic) == namespace_of(image_topic)]
    named = [t for t, frame in calibrations.items() if any(word in f"{t} {frame}".lower() for word in words)]
    if own or named:
        return own or named
    raise RecordingError(
        "no calibration of the camera to which depth was reprojected",
        where=image_topic,
        found=", ".join(sorted(calibrations)),
        expected=f"a topic or frame named {' or '.join(words)}",
        hint="pass --camera-topic or --camera",
    )


def _is_elsewhere(image_topic: str, frame_id: str, calibration: str, frame: str) -> bool:
    """Return whether a calibration differs from the images in frame id and namespace."""
    differs = bool(frame_id and frame) and not is_same_frame(frame, frame_id)
    return (
        differs
        and not reprojected_to(image_topic)
        and not calibration.startswith(namespace_of(image_topic) + "/")
    )


def _requested_calibration(wanted: str, calibrations: Mapping[str, str]) -> str:
    if wanted in calibrations:
        return wanted
    raise RecordingError(
        "no such calibration topic",
        where=wanted,
        found=", ".join(sorted(calibrations)) or "no calibrations",
        hint=nearest_name(wanted, calibrations) if calibrations else "pass --camera",
    )


def _nearest_namespace(image_topic: str, topics: list[str]) -> list[str]:
    """Return the topics in the innermost namespace of the image topic that has any, else all.

    Direct members come before nested ones: RealSense has both .../image/data and .../info/camera_info.
    """
    namespace = image_topic
    while len(topics) > 1 and "/" in namespace.strip("/"):
        namespace = namespace.rpartition("/")[0]
        inside = [topic for topic in topics if topic.startswith(f"{namespace}/")]
        directly = [topic for topic in inside if topic.rpartition("/")[0] == namespace]
        if inside:
            return directly or inside
    return topics


# Extrinsics of cameras: from calibration messages, or from transforms between frames


# Transform messages read: static ones come first, others repeat.
MESSAGES = 1000
# Transform (3, 4), mm, from the axes of the second frame to those of the first.
Edges = dict[tuple[str, str], FloatArray]


def extrinsics_of_calibration(decoded: Any, *, rectified: bool) -> FloatArray | None:
    """Return camera_T_common (3, 4), mm, from P and R of a calibration.

    The common axes are the rectified ones of the stereo set; P = K' [I | t], so a point X there is R^T (X +
    t) in the camera's own axes, and X + t in its rectified axes. t is 0 for the first camera.

    Args:
        decoded: a foxglove.CameraCalibration or ROS CameraInfo.
        rectified: True if the image was rectified.

    Returns:
        None without P.
    """
    projection, turn = matrix_of(decoded, "P", (3, 4)), matrix_of(decoded, "R", (3, 3))
    if projection is None or projection[0, 0] == 0.0 or projection[1, 1] == 0.0:
        return None
    intrinsics = projection[:, :3]
    t = np.linalg.solve(intrinsics, projection[:, 3]) * MM_PER_M
    rotation = np.eye(3) if rectified or turn is None else turn.T
    if rectified:
        return np.column_stack([rotation, t])
    return np.column_stack([rotation, rotation @ t])


def have_baselines(places: Sequence[FloatArray | None]) -> bool:
    """Return whether extrinsics of all cameras are known and not all at one position."""
    known = [place for place in places if place is not None]
    return len(known) == len(places) and any(not np.allclose(p[:, 3], known[0][:, 3]) for p in known)


def extrinsics_of_transforms(topics: FileTopics, frames: Sequence[str]) -> Sequence[FloatArray | None]:
    """Return camera_T_first (3, 4), mm, of each camera's frame from the file's transforms.

    The first transform between two frames is used: a rig is rigid.

    Returns:
        None for a frame that no transforms connect with the first.
    """
    names = [name for name, topic in topics.by_name.items() if topic.type_name in TRANSFORM_TYPES]
    reached = _connected(_edges(topics.file.messages(names)) if names else {}, frames[0])
    return [reached.get(frame.lstrip("/")) for frame in frames]


def _edges(messages: Iterator[McapItem]) -> Edges:
    """Return the transforms in the first messages, in both directions."""
    edges: Edges = {}
    decoder, left, left_bytes = MessageDecoder(), limits.TRANSFORMS, limits.TRANSFORM_BYTES
    for item in islice(messages, MESSAGES):
        left_bytes -= len(item[2].data)
        if left_bytes < 0:
            break
        try:
            transforms = _transforms(decoder.decode(*item))
        except UndecodableMessageError:
            continue
        for transform in islice(transforms, left):
            _add_edge(edges, transform)
        left -= min(left, len(transforms))
    return edges


def _transforms(decoded: Any) -> Sequence[Any]:
    transforms: Sequence[Any] = getattr(decoded, "transforms", (decoded,))
    return transforms


def _add_edge(edges: Edges, transform: Any) -> None:
    """Store a transform unless one between its frames is known."""
    header = getattr(transform, "header", None)
    parent = str(header.frame_id if header is not None else transform.parent_frame_id).lstrip("/")
    child = str(transform.child_frame_id).lstrip("/")
    body = getattr(transform, "transform", transform)
    if (parent, child) not in edges and parent != child:
        matrix = _rigid(body.translation, body.rotation)
        if matrix is not None:
            edges[parent, child], edges[child, parent] = matrix, inverse(matrix)


def _rigid(translation: Any, rotation: Any) -> FloatArray | None:
    quaternion = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    t = np.array([translation.x, translation.y, translation.z]) * MM_PER_M
    if not (np.isfinite(t).all() and np.isfinite(quaternion).all() and np.any(quaternion)):
        return None
    return np.column_stack([matrices_from_quaternions(canonical(quaternion)), t])


def _connected(edges: Edges, start: str) -> dict[str, FloatArray]:
    """Return frame_T_start of every frame connected to ``start``, breadth first."""
    leading: dict[str, list[str]] = {}
    for to, source in edges:
        leading.setdefault(source, []).append(to)
    start = start.lstrip("/")
    reached = {start: np.eye(3, 4)}
    waiting = deque([start])
    while waiting:
        here = waiting.popleft()
        for to in leading.get(here, ()):
            if to not in reached:
                reached[to] = composed(edges[to, here], reached[here])
                waiting.append(to)
    return reached


# Topics of grey images, and their calibrated cameras


COMPRESSED = "/compressed"
SIDES = {"left": 0, "right": 1}


P = TypeVar("P", bound=Pixels, covariant=True)


@dataclass(frozen=True)
class CameraTopic(Generic[P]):
    """One camera's topic.

    Attributes:
        topic: topic of the images.
        name: name of the camera.
        pixels: content of the images.
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
    """Return the requested topics in order, else all image topics of cameras.

    8-bit images are preferred to 16-bit ones, which may be depth, and raw topics to their compressed
    copies. Left comes before right.

    Args:
        topics: topics of the file.
        wanted: names of topics or cameras.

    Raises:
        RecordingError: no topic fits, or none of a name. Lists candidates.
    """
    images = [topic for topic in topics.by_name.values() if topic.image is not None and topic.count]
    images = [topic for topic in images if not topic.name.startswith(TRUTH_PREFIX)]
    grey = [topic for topic in images if holds_grey(topic.first, topic.kind)]
    if wanted is not None:
        return [_requested_source(topics, name, grey) for name in wanted]
    sources = [_source(topics, topic) for topic in sorted(grey, key=_order)]
    eight = [source for source in sources if source.pixels.bits == 8] or sources
    names = {source.topic.name for source in eight}
    kept = [s for s in eight if s.topic.name.removesuffix(COMPRESSED) not in names - {s.topic.name}]
    if not kept:
        found = ", ".join(topic.label for topic in images) or "no image topics"
        hint = "to track hands in depth use posetrack hand run" if topics.depth_topics else ""
        raise RecordingError("no grey or colour image topics", where=topics.path, found=found, hint=hint)
    return distinct_names(kept)


def sources_of_rig(topics: FileTopics, rig: Rig) -> list[GreyTopic]:
    """Return the topic of each camera of a camera file, by topic, frame id or part of the name.

    Raises:
        RecordingError: no topic fits a camera.
        UsageError: several topics fit a camera.
    """
    every = find_sources(topics)
    if len(rig.cameras) == 1 and len(every) == 1:
        return [replace(every[0], name=next(iter(rig.cameras)))]
    found = []
    for name in rig.cameras:
        fitting = [source for source in every if _has_name(source.topic, name)]
        if len(fitting) != 1:
            raise (UsageError if fitting else RecordingError)(
                f"{'several topics match' if fitting else 'no topic for'} camera '{name}' in {rig.path.name}",
                where=topics.path,
                found=", ".join(source.topic.label for source in fitting or every),
                hint="in the camera file, name cameras by topic, frame id or part of the topic name",
            )
        found.append(replace(fitting[0], name=name))
    return found


def cameras_of_messages(topics: FileTopics, sources: Sequence[GreyTopic]) -> list[ImageCamera]:
    """Return the cameras of stored images, relative to the first, from calibrations and transforms.

    Raises:
        RecordingError: a camera is not calibrated, sizes differ, or extrinsics are unknown.
    """
    calibrations = _calibrations(topics, sources)
    found = [camera_of_topic(topics, s, name) for s, name in zip(sources, calibrations, strict=True)]
    cameras = [each.camera for each in found]
    if len(cameras) == 1:
        return found
    known: Sequence[FloatArray | None] = [
        _extrinsics(topics.by_name[name], source) for source, name in zip(sources, calibrations, strict=True)
    ]
    if not have_baselines(known):
        known = extrinsics_of_transforms(topics, [source.topic.frame_id for source in sources])
    if not have_baselines(known):
        raise RecordingError(
            f"no extrinsics for cameras {', '.join(camera.name for camera in cameras)}",
            where=topics.path,
            found="no baseline in P of their calibrations and no transforms between their frames",
            hint="pass --camera with a file written by posetrack calibrate stereo",
        )
    rebased = relative_to(*_with_extrinsics(cameras, known, topics.path))
    check_baselines(rebased, topics.path)
    return [replace(each, camera=camera) for each, camera in zip(found, rebased, strict=True)]


def distinct_names(sources: Sequence[GreyTopic]) -> list[GreyTopic]:
    """Return the sources named by frame id, else by the topic part in which they differ."""
    names = [source.topic.frame_id for source in sources]
    if "" in names or len(set(names)) < len(names):
        parts = [source.topic.name.strip("/").split("/") for source in sources]
        columns = list(zip(*parts, strict=False))
        distinct = [column for column in columns if len(set(column)) == len(column)]
        names = list(distinct[0]) if distinct else [source.topic.name for source in sources]
    if len(sources) == 1 and not sources[0].topic.frame_id:
        names = ["camera"]
    return [replace(source, name=name) for source, name in zip(sources, names, strict=True)]


def _with_extrinsics(
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
    """Return the calibration topic of each camera; no two cameras share one."""
    known = topics.calibration_frames
    chosen = [choose_calibration(s.topic.name, s.topic.frame_id, known) for s in sources]
    for name in set(chosen):
        sharing = [s.topic.name for s, c in zip(sources, chosen, strict=True) if c == name]
        if len(sharing) > 1:
            raise RecordingError(
                f"{', '.join(sharing)} share one calibration",
                where=topics.path,
                found=name,
                hint="choose cameras with --cameras TOPIC,TOPIC, or pass --camera",
            )
    return chosen


def camera_of_topic(topics: FileTopics, source: CameraTopic[Pixels], calibration: str) -> ImageCamera:
    """Return the camera of a topic's images from a calibration topic of the file.

    Raises:
        NotCalibratedError: the calibration is empty.
        RecordingError: it does not fit the images.
    """
    message = _message_of(topics, source.topic, calibration)
    found = camera_by(message, topics.path, source, calibration)
    return replace(found, frame=frame_id_of(message))


def _message_of(topics: FileTopics, images: Topic, calibration: str) -> Any:
    """Return the first message of a calibration topic with the images' frame id, else the first."""
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
    """Return the camera of a topic's images from one calibration message.

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


def _extrinsics(calibration: Topic, source: GreyTopic) -> FloatArray | None:
    topic = source.topic
    return extrinsics_of_calibration(calibration.first, rectified=is_rectified(topic.name, topic.frame_id))


def _requested_source(topics: FileTopics, name: str, grey: Sequence[Topic]) -> GreyTopic:
    exact = [topic for topic in grey if topic.name == name]
    fitting = exact or [topic for topic in grey if _has_name(topic, name)]
    if len(fitting) == 1:
        return replace(_source(topics, fitting[0]), name=fitting[0].frame_id if exact else name)
    raise (UsageError if fitting else RecordingError)(
        f"{'several topics' if fitting else 'no topic'} for camera '{name}'",
        where=topics.path,
        found=", ".join(topic.label for topic in fitting or grey) or "no grey or colour image topics",
        hint="choose topics with --cameras TOPIC,TOPIC",
    )


def _has_name(topic: Topic, name: str) -> bool:
    return name in (topic.name, topic.frame_id, *topic.name.split("/"))


def _source(topics: FileTopics, topic: Topic) -> GreyTopic:
    try:
        if topic.kind == VIDEO_IMAGE:
            pixels = _first_of_video(topics, topic)
        else:
            pixels = grey_like_message(topic.first, str(topic.kind), topic.name)
    except UnreadableImageError as error:
        raise RecordingError(f"unusable first image, {error}", where=topic.name) from error
    return CameraTopic(topic, topic.frame_id, pixels)


def _first_of_video(topics: FileTopics, topic: Topic) -> Grey:
    """Return the pixel format of a video topic from its first decodable picture."""
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
    """Return a sort key: left, right, then by name."""
    sides = [SIDES[side] for side in SIDES if side in topic.name or side in topic.frame_id]
    return (sides[0] if len(sides) == 1 else len(SIDES), topic.name)
