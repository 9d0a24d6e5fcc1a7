"""The metadata record ``posetrack.subject``: what was tracked, so that a result explains itself."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic_core import core_schema as schemas

from posetrack_cli import limits
from posetrack_cli.errors import ResultError
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.strict_json import NAME, integer_from, list_of, number_from, reader_of, text_of

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
        values = {key: _value(record, key) for key in (*_REQUIRED, *(_OPTIONAL.keys() & record.keys()))}
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
            lines=tuple((a, b) for a, b in values.get("lines", ())),
            number_names=tuple(values.get("number_names", ())),
        )
    except KeyError as error:
        raise ResultError(f"metadata {SUBJECT_RECORD} lacks {error}") from error
    except ValueError as error:
        raise ResultError(f"metadata {SUBJECT_RECORD} cannot be read", found=error) from error


_INDEX = integer_from(-1, limits.TRIANGLES)
_REQUIRED = {
    key: reader_of(schema)
    for key, schema in {
        "camera_frame": text_of(0),
        "colour": list_of(number_from(0.0, 1.0), 4),
        "name": NAME,
        "point_names": list_of(NAME),
        "point_parents": list_of(_INDEX),
        "shape_names": list_of(NAME),
        "triangles": schemas.nullable_schema(
            list_of(list_of(integer_from(0, limits.TRIANGLES), 3), most=limits.TRIANGLES)
        ),
    }.items()
}
_OPTIONAL = {"lines": reader_of(list_of(list_of(_INDEX, 2))), "number_names": reader_of(list_of(NAME))}
_NAMES = {"point_names", "shape_names", "number_names"}


def _value(record: Mapping[str, str], key: str) -> Any:
    """What a key of the record holds; names are different from each other."""
    try:
        value = (_REQUIRED | _OPTIONAL)[key](record[key])
    except ValueError as error:
        raise ValueError(f"in '{key}' {error}") from None
    if key in _NAMES:
        twice = next((name for name, count in Counter(value).items() if count > 1), None)
        if twice is not None:
            raise ValueError(f"'{key}' has {twice!r} twice")
    return value
