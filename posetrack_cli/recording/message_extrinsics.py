"""Where cameras of an MCAP file are: from their calibration messages, or from transforms between frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rigid import composed, inverse
from posetrack_cli.geometry.rotations import canonical, matrices_from_quaternions
from posetrack_cli.mcap.decoding import TRANSFORM_TYPES, MessageDecoder, UndecodableMessageError
from posetrack_cli.mcap.stream import McapItem
from posetrack_cli.recording.camera_of import matrix_of
from posetrack_cli.recording.depth import MM_PER_M
from posetrack_cli.recording.message_topics import FileTopics

MESSAGES = 1000
"""How many messages of transforms are looked at; static ones come first or again and again."""
Edges = dict[tuple[str, str], FloatArray]
"""Transform (3, 4), mm, from the axes of the second frame to those of the first."""


def place_of_calibration(decoded: Any, *, rectified: bool) -> FloatArray | None:
    """Return camera_T_common (3, 4), mm, by P and R of a calibration.

    Common are the rectified axes of all cameras of a stereo set; P = K' [I | t], so that a point X there is
    at R^T (X + t) in the camera's own axes, and at X + t in its rectified image. t is 0 for the first camera.

    Args:
        decoded: a foxglove.CameraCalibration or ROS CameraInfo.
        rectified: whether the image was rectified.

    Returns:
        None if it has no P.
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


def is_placed(places: Sequence[FloatArray | None]) -> bool:
    """Whether calibrations tell where the cameras are: all have a place, and not all the same."""
    known = [place for place in places if place is not None]
    return len(known) == len(places) and any(not np.allclose(p[:, 3], known[0][:, 3]) for p in known)


def camera_places(topics: FileTopics, frames: Sequence[str]) -> Sequence[FloatArray | None]:
    """Return camera_T_first (3, 4), mm, of each camera's frame from the file's transforms.

    The first transform between two frames counts: cameras do not move against each other.

    Returns:
        None for a frame that no transforms connect with the first.
    """
    names = [name for name, topic in topics.by_name.items() if topic.type_name in TRANSFORM_TYPES]
    reached = _reached(_edges(topics.file.messages(names)) if names else {}, frames[0])
    return [reached.get(frame.lstrip("/")) for frame in frames]


def _edges(messages: Iterator[McapItem]) -> Edges:
    """Return the transforms of the first messages, both ways."""
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
            _learn(edges, transform)
        left -= min(left, len(transforms))
    return edges


def _transforms(decoded: Any) -> Sequence[Any]:
    transforms: Sequence[Any] = getattr(decoded, "transforms", (decoded,))
    return transforms


def _learn(edges: Edges, transform: Any) -> None:
    """Keep a transform if none is known between its frames."""
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


def _reached(edges: Edges, start: str) -> dict[str, FloatArray]:
    """Return frame_T_start of every frame that transforms connect with one, breadth first."""
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
