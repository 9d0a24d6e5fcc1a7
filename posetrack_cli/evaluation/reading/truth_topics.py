"""Ground truth on ``/truth`` topics of MCAP files: Foxglove Odometry and JointStates, or points."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import TruthError
from posetrack_cli.evaluation.reading.tracks import Track, check_stamps
from posetrack_cli.evaluation.reading.truth_tables import unit_quaternions
from posetrack_cli.geometry.rotations import rotate
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.decoding import MessageDecoder, UndecodableMessageError, stamp_of
from posetrack_cli.mcap.protobuf_twin import json_of, twin_of
from posetrack_cli.mcap.stream import McapFile, McapItem
from posetrack_cli.recording.base import TRUTH_PREFIX, TruthMessage
from posetrack_cli.results.estimate import Subject
from posetrack_cli.strict_json import COUNT, LENGTH_MM, NAME, list_of, object_of, reader_of

ODOMETRY_SCHEMA = "foxglove.Odometry"
JOINT_STATES_SCHEMA = "foxglove.JointStates"
WITHOUT_JOINT_STATES = "true pose without joint states at its stamp, skipped"
MM_PER_METRE = 1e3


def odometry_topic(subject: str) -> str:
    """Return the topic of the true pose and velocity of a subject."""
    return f"{TRUTH_PREFIX}{subject}/odometry"


def joint_states_topic(subject: str) -> str:
    """Return the topic of the true shape entries of a subject."""
    return f"{TRUTH_PREFIX}{subject}/joint_states"


def odometry_track(file: McapFile, subject: Subject, schemas: Mapping[str, str], name: str) -> Track:
    """Return the ground truth on a topic of Odometry and, if available, of JointStates; it has no points.

    Odometry states the linear velocity in body axes: v = R v_body with R the rotation of ``camera_T_object``.
    Metres are converted to millimetres. Missing velocities are NaN. A pose without joint states at the same
    stamp is skipped and recorded as a loss.

    Args:
        file: file with a topic ``/truth/<subject>/odometry``.
        subject: subject of the result.
        schemas: schema names by topic.
        name: name of the track in tables and errors.

    Raises:
        TruthError: a quaternion is not a rotation, or joint states change their names.
        ResultError: stamps do not increase strictly.
    """
    poses, joints = _Rows(), _Rows()
    has_joints = schemas.get(joint_states_topic(subject.topic)) == JOINT_STATES_SCHEMA
    topics = {odometry_topic(subject.topic), *([joint_states_topic(subject.topic)] if has_joints else [])}
    for topic, stamp_ns, message in _decoded(file, topics):
        if topic == odometry_topic(subject.topic):
            poses.add(stamp_ns, _POSE, _pose_row(message))
        else:
            joints.add(stamp_ns, tuple(joint.name for joint in message.joints), _joint_row(message))
    check_stamps(poses.stamps, f"{name}, {odometry_topic(subject.topic)}")
    check_stamps(joints.stamps, f"{name}, {joint_states_topic(subject.topic)}")
    if has_joints:
        poses, joints = _together(poses, joints, file.losses)
    return _track(poses, joints, subject.name, name)


_POSE = ("pose",)


@dataclass
class _Rows:
    """Rows of numbers with stamps and column names."""

    names: tuple[str, ...] = ()
    stamp_ns: list[int] = field(default_factory=list)
    rows: list[list[float]] = field(default_factory=list)

    def add(self, stamp_ns: int, names: tuple[str, ...], row: list[float]) -> None:
        """Add a row; raise TruthError if its names differ from those of the previous rows."""
        if self.rows and names != self.names:
            raise TruthError(
                "joint names change within the topic",
                where=f"at {stamp_ns} ns",
                found=", ".join(names),
                expected=", ".join(self.names),
            )
        self.names = names  # of the first row; equal for all others
        self.stamp_ns.append(stamp_ns)
        self.rows.append(row)

    @property
    def stamps(self) -> IntArray:
        """Stamps (N,), ns."""
        return np.array(self.stamp_ns, dtype=np.int64)

    def values(self, columns: int) -> FloatArray:
        """Return the values (N, columns)."""
        return np.array(self.rows, dtype=np.float64).reshape(len(self.rows), columns)

    def of(self, chosen: IntArray) -> _Rows:
        """Return some of the rows."""
        kept = chosen.tolist()
        return _Rows(self.names, [self.stamp_ns[i] for i in kept], [self.rows[i] for i in kept])


def _decoded(file: McapFile, topics: set[str]) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, stamp and message; undecodable messages are recorded as losses."""
    decoder = MessageDecoder()
    for schema, channel, message in file.messages(topics):
        try:
            decoded = decoder.decode(schema, channel, message)
        except UndecodableMessageError as error:
            file.losses.add(str(error), f"at {message.log_time} ns")
            continue
        yield channel.topic, stamp_of(decoded, message), decoded


def _pose_row(message: Any) -> list[float]:
    """Return position (mm), quaternion, velocities (mm/s and rad/s, body axes), 13 numbers."""
    p, q = message.pose.position, message.pose.orientation
    row = [MM_PER_METRE * p.x, MM_PER_METRE * p.y, MM_PER_METRE * p.z, q.x, q.y, q.z, q.w]
    for name, unit in (("linear_velocity", MM_PER_METRE), ("angular_velocity", 1.0)):
        velocity = getattr(message, name)
        row += (
            [unit * velocity.x, unit * velocity.y, unit * velocity.z]
            if message.HasField(name)
            else [math.nan] * 3
        )
    return row


def _joint_row(message: Any) -> list[float]:
    """Return the positions of the joints, then their velocities; NaN where missing."""
    fields = ("position", "velocity")
    return [
        getattr(joint, name) if joint.HasField(name) else math.nan
        for name in fields
        for joint in message.joints
    ]


def _together(poses: _Rows, joints: _Rows, losses: LossLog) -> tuple[_Rows, _Rows]:
    """Return the rows with common stamps; poses without joint states are recorded as losses."""
    _, mine, theirs = np.intersect1d(poses.stamps, joints.stamps, return_indices=True)
    for stamp_ns in np.setdiff1d(poses.stamps, joints.stamps).tolist():
        losses.add(WITHOUT_JOINT_STATES, f"at {stamp_ns} ns")
    return poses.of(mine), joints.of(theirs)


def _track(poses: _Rows, joints: _Rows, subject: str, name: str) -> Track:
    values = poses.values(13)
    quaternion = unit_quaternions(values[:, 3:7], lambda row: f"{name}, pose at {poses.stamp_ns[row]} ns")
    # Odometry has the linear velocity in body axes, tracks have it in camera axes.
    twist = np.hstack([rotate(quaternion, values[:, 7:10]), values[:, 10:]])
    shape = None
    if joints.names:
        shape, rates = np.split(joints.values(2 * len(joints.names)), 2, axis=1)
        twist = np.hstack([twist, rates])
    return Track(
        name,
        subject,
        shape_names=joints.names,
        point_names=(),
        point_parents=(),
        stamp_ns=poses.stamps,
        position=values[:, :3],
        quaternion=quaternion,
        shape=shape,
        twist=None if np.isnan(twist).all() else twist,
    )


POINTS_SCHEMA_NAME = "posetrack.Points"
_NUMBER = {"type": "number"}
POINTS_SCHEMA: Mapping[str, Any] = {
    "title": POINTS_SCHEMA_NAME,
    "description": "Named points of one instant, such as annotated joints.",
    "type": "object",
    "properties": {
        "stamp_ns": {"type": "integer", "description": "When, nanoseconds; equal to the log time."},
        "points": {
            "type": "array",
            "description": "Points in camera axes, millimetres.",
            "items": {
                "type": "object",
                "properties": {"name": {"type": "string"}, "x": _NUMBER, "y": _NUMBER, "z": _NUMBER},
                "required": ["name", "x", "y", "z"],
                "additionalProperties": False,
            },
        },
    },
    "required": ["stamp_ns", "points"],
    "additionalProperties": False,
}


_SCHEMA_TEXT = json.dumps(POINTS_SCHEMA, separators=(",", ":")).encode()
_POINT = object_of({"name": NAME, **dict.fromkeys("xyz", LENGTH_MM)})
_read = reader_of(object_of({"stamp_ns": COUNT, "points": list_of(_POINT)}), limits.MESSAGE_BYTES)


def points_topic(subject: str) -> str:
    """Return the topic of the true points of a subject."""
    return f"{TRUTH_PREFIX}{subject}/points"


def points_messages(track: Track, subject: str) -> Iterator[TruthMessage]:
    """Yield the points of a track as ground-truth messages of a subject (``Subject.topic``), one per frame.

    Raises:
        TruthError: the track has no points, or a negative stamp.
    """
    if track.points is None:
        raise TruthError("ground truth has no points", where=track.name)
    if len(track) and track.stamp_ns[0] < 0:
        raise TruthError("negative stamp cannot be stored", where=track.name, found=f"{track.stamp_ns[0]} ns")
    for stamp_ns, points in zip(track.stamp_ns.tolist(), track.points.tolist(), strict=True):
        named = [
            {"name": name, "x": x, "y": y, "z": z}
            for name, (x, y, z) in zip(track.point_names, points, strict=True)
        ]
        data = json.dumps({"stamp_ns": stamp_ns, "points": named}, separators=(",", ":")).encode()
        topic = points_topic(subject)
        yield TruthMessage(topic, POINTS_SCHEMA_NAME, "jsonschema", _SCHEMA_TEXT, "json", stamp_ns, data)


def points_track(file: McapFile, subject: Subject, name: str) -> Track:
    """Return the ground truth on a topic of ``posetrack.Points``, without poses.

    Args:
        file: file with the topic ``/truth/<subject>/points``.
        subject: subject of the result.
        name: name of the track in tables and errors.

    Raises:
        TruthError: a message is invalid, or the names of the points change.
        ResultError: stamps do not increase strictly.
    """
    topic = points_topic(subject.topic)
    names: tuple[str, ...] = ()
    stamps: list[int] = []
    rows: list[FloatArray] = []
    for item in file.messages([topic]):
        where = f"{name}, {topic} at {item[2].log_time} ns"
        own, stamp, points = _parsed(item, where)
        if stamps and own != names:
            raise TruthError("point names change within the topic", where=where, found=", ".join(own))
        names = own
        stamps.append(stamp)
        rows.append(points)
    stamp_ns = np.array(stamps, dtype=np.int64)
    check_stamps(stamp_ns, f"{name}, {topic}")
    # Parents are indices and only valid for the exact points of the subject.
    known = names == subject.point_names
    return Track(
        name,
        subject.name,
        shape_names=(),
        point_names=names,
        point_parents=subject.point_parents if known else (),
        stamp_ns=stamp_ns,
        points=np.array(rows).reshape(len(rows), len(names), 3),
    )


def _parsed(item: McapItem, where: str) -> tuple[tuple[str, ...], int, FloatArray]:
    """Return names, stamp and points (P, 3) of a message."""
    try:
        fields = _read(json_of(item, lambda: [twin_of(POINTS_SCHEMA_NAME, _SCHEMA_TEXT)]))
        points = fields["points"]
        values = np.array([(p["x"], p["y"], p["z"]) for p in points], dtype=np.float64).reshape(-1, 3)
        return tuple(p["name"] for p in points), fields["stamp_ns"], values
    except ValueError as error:
        raise TruthError(f"message is not a {POINTS_SCHEMA_NAME}", where=where, found=error) from error
