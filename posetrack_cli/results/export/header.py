"""What every exported file says about itself."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from posetrack_cli.geometry.euler import EULER_ORDER
from posetrack_cli.losses import loss_line
from posetrack_cli.results.export.column_names import HEAD
from posetrack_cli.results.export.source import ExportSource
from posetrack_cli.results.export.table import table_of

CAMERA_AXES = "x right, y down, z forward"
_ANGLES_OF_HEADS = (
    "all 0 for a head that looks at the camera (half a turn about x is taken off), positive where it tilts "
    "to its own left shoulder, lowers its face, turns to its own right"
)
_SHORT_RECORDS = ("tracker", "version", "seed", "input.name", "input.sha256")


def euler_order(subject: str) -> str:
    """Return what roll, pitch and yaw mean for a subject."""
    if subject == HEAD:
        return f"{EULER_ORDER}; {_ANGLES_OF_HEADS}"
    return EULER_ORDER


def point_axes(subject: str) -> str:
    """Return the axes that a subject's points are tabulated in."""
    return "head axes" if subject == HEAD else "camera axes"


def header_lines(source: ExportSource) -> Iterator[str]:
    """Yield what a text file says above its table, line by line, without the columns."""
    result = source.result
    yield f"posetrack export of {result.path.name}, topic {source.topic}"
    yield (
        f"subject: {result.subject.name}, {len(result.subject.shape_names)} shape entries, "
        f"{len(result.subject.point_names)} points; camera frame {result.subject.camera_frame}"
    )
    records = {key: result.run[key] for key in _SHORT_RECORDS if key in result.run}
    yield f"run: {json.dumps(records, ensure_ascii=False)}{'' if result.finished else ', unfinished'}"
    yield f"lost frames: {'in the table, with status lost' if source.lost else 'left out'}"
    if result.losses:
        yield f"data that is missing: {loss_line(result.losses)}"
    yield f"camera axes: {CAMERA_AXES}"


def header_values(source: ExportSource) -> dict[str, Any]:
    """Return what the header of JSON and npz holds, as plain values.

    ``columns`` describes the columns of the table; ``losses`` is what is known when the file is opened.
    """
    result = source.result
    groups = table_of(result.subject)
    return {
        "format": "posetrack.export",
        "version": 1,
        "result": result.path.name,
        "topic": source.topic,
        "finished": result.finished,
        "lost_frames": "in" if source.lost else "out",
        "subject": result.subject.name,
        "camera_frame": result.subject.camera_frame,
        "camera_axes": CAMERA_AXES,
        "euler_order": euler_order(result.subject.name),
        "shape_names": list(result.subject.shape_names),
        "point_names": list(result.subject.point_names),
        "point_parents": list(result.subject.point_parents),
        "units": {name: group.unit for group in groups for name in group.names},
        "meanings": {name: group.meaning for group in groups for name in group.names},
        "run": dict(result.run),
        "summary": dict(result.summary),
        "losses": loss_line(result.losses),
    }
