"""The metadata record ``posetrack.subject``: what was tracked, so that a result explains itself."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from posetrack_cli.errors import ResultError
from posetrack_cli.results.estimate import Subject

SUBJECT_RECORD = "posetrack.subject"


def subject_to_record(subject: Subject) -> dict[str, str]:
    """Return the subject as metadata: every value a string of JSON; lines and numbers where it has some."""
    triangles = None if subject.triangles is None else subject.triangles.tolist()
    values: dict[str, Any] = {
        "camera_frame": subject.camera_frame,
        "colour": list(subject.colour),
        "name": subject.name,
        "point_names": list(subject.point_names),
        "point_parents": list(subject.point_parents),
        "shape_names": list(subject.shape_names),
        "triangles": triangles,
    }
    if subject.lines:
        values["lines"] = [list(line) for line in subject.lines]
    if subject.number_names:
        values["number_names"] = list(subject.number_names)
    return {key: json.dumps(value, separators=(",", ":")) for key, value in values.items()}


def subject_from_record(record: Mapping[str, str]) -> Subject:
    """Return the subject that ``subject_to_record`` wrote.

    Raises:
        ResultError: the record lacks a field or holds something else.
    """
    try:
        values = {key: json.loads(value) for key, value in record.items()}
        triangles = values["triangles"]
        red, green, blue, alpha = values["colour"]
        return Subject(
            name=values["name"],
            camera_frame=values["camera_frame"],
            shape_names=tuple(values["shape_names"]),
            point_names=tuple(values["point_names"]),
            point_parents=tuple(values["point_parents"]),
            triangles=None if triangles is None else np.array(triangles, dtype=np.int64).reshape(-1, 3),
            colour=(red, green, blue, alpha),
            lines=tuple((int(a), int(b)) for a, b in values.get("lines", ())),
            number_names=tuple(values.get("number_names", ())),
        )
    except (KeyError, ValueError, TypeError) as error:
        raise ResultError(f"metadata {SUBJECT_RECORD} cannot be read", found=error) from error
