"""True points without poses, such as annotated joints, on a topic of an MCAP file."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import TruthError
from posetrack_cli.evaluation.association import check_stamps
from posetrack_cli.evaluation.track import Track
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.base import TRUTH_PREFIX, TruthMessage
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.strict_json import COUNT, LENGTH_MM, NAME, list_of, object_of, reader_of

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


_POINT = object_of({"name": NAME, **dict.fromkeys("xyz", LENGTH_MM)})
_read = reader_of(object_of({"stamp_ns": COUNT, "points": list_of(_POINT)}), limits.MESSAGE_BYTES)


def points_topic(subject: str) -> str:
    """Return the topic of a subject's true points."""
    return f"{TRUTH_PREFIX}{subject}/points"


def points_messages(track: Track) -> Iterator[TruthMessage]:
    """Yield the points of a track as messages of truth, a message per frame.

    Raises:
        TruthError: it has none, or a stamp before 1970.
    """
    if track.points is None:
        raise TruthError("has no points", where=track.name)
    if len(track) and track.stamp_ns[0] < 0:
        raise TruthError("stamp cannot be stored", where=track.name, found=f"{track.stamp_ns[0]} ns")
    schema = json.dumps(POINTS_SCHEMA, separators=(",", ":")).encode()
    for stamp_ns, points in zip(track.stamp_ns.tolist(), track.points.tolist(), strict=True):
        named = [
            {"name": name, "x": x, "y": y, "z": z}
            for name, (x, y, z) in zip(track.point_names, points, strict=True)
        ]
        data = json.dumps({"stamp_ns": stamp_ns, "points": named}, separators=(",", ":")).encode()
        topic = points_topic(track.subject)
        yield TruthMessage(topic, POINTS_SCHEMA_NAME, "jsonschema", schema, "json", stamp_ns, data)


def points_track(file: McapFile, subject: Subject, name: str) -> Track:
    """Return the truth of a topic of ``posetrack.Points``: points, no poses.

    Args:
        file: has the topic ``/truth/<subject>/points``.
        subject: of the result.
        name: what tables and errors call the track.

    Raises:
        TruthError: a message cannot be used, or the points change their names.
        ResultError: stamps do not increase strictly.
    """
    topic = points_topic(subject.name)
    names: tuple[str, ...] = ()
    stamps: list[int] = []
    rows: list[FloatArray] = []
    for _, _, message in file.messages([topic]):
        where = f"{name}, {topic} at {message.log_time} ns"
        own, stamp, points = _parsed(message.data, where)
        if stamps and own != names:
            raise TruthError("points change their names", where=where, found=", ".join(own))
        names = own
        stamps.append(stamp)
        rows.append(points)
    stamp_ns = np.array(stamps, dtype=np.int64)
    check_stamps(stamp_ns, f"{name}, {topic}")
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


def _parsed(data: bytes, where: str) -> tuple[tuple[str, ...], int, FloatArray]:
    """Names, stamp and points (P, 3) of a message."""
    try:
        fields = _read(data)
        points = fields["points"]
        values = np.array([(p["x"], p["y"], p["z"]) for p in points], dtype=np.float64).reshape(-1, 3)
        return tuple(p["name"] for p in points), fields["stamp_ns"], values
    except ValueError as error:
        raise TruthError(f"message is no {POINTS_SCHEMA_NAME}", where=where, found=error) from error
