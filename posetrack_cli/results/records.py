"""Metadata records of a result."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from pydantic_core import core_schema as schemas

from posetrack_cli import limits
from posetrack_cli.errors import ResultError
from posetrack_cli.recording.base import RUN_RECORD
from posetrack_cli.results.estimate import MOST_SUBJECTS, Subject
from posetrack_cli.strict_json import NAME, integer_from, list_of, number_from, reader_of, text_of

SUBJECT_RECORD = "posetrack.subject"
SUMMARY_RECORD = "posetrack.summary"


def subject_to_record(subject: Subject) -> dict[str, str]:
    """Return the subject as metadata, each value as JSON; lines and number names only if there are any."""
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
    if subject.label:
        values["label"] = subject.label
    return {key: json.dumps(value, separators=(",", ":")) for key, value in values.items()}


def subject_from_record(record: Mapping[str, str]) -> Subject:
    """Parse the output of ``subject_to_record``.

    Raises:
        ResultError: a field is missing or invalid.
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
            label=values.get("label", ""),
        )
    except KeyError as error:
        raise ResultError(f"metadata {SUBJECT_RECORD} lacks {error}") from error
    except ValueError as error:
        raise ResultError(f"invalid metadata {SUBJECT_RECORD}", found=error) from error


def subjects_to_records(subjects: Sequence[Subject]) -> dict[str, dict[str, str]]:
    """Return a metadata record per subject, by name.

    Raises:
        ResultError: there is none, or labels are missing or not unique.
    """
    labels = [subject.label for subject in subjects]
    if not labels or len(set(labels)) < len(labels) or (len(labels) > 1 and not all(labels)):
        raise ResultError("subjects of a result need unique labels", found=", ".join(map(repr, labels)))
    return {_record_name(subject.label): subject_to_record(subject) for subject in subjects}


def subjects_from_records(metadata: Mapping[str, Mapping[str, str]]) -> tuple[Subject, ...]:
    """Parse the output of ``subjects_to_records`` among other records; () if there is none.

    Raises:
        ResultError: see ``subject_from_record``; or there are too many, or a record has another label.
    """
    names = [name for name in metadata if name == SUBJECT_RECORD or name.startswith(f"{SUBJECT_RECORD}.")]
    if len(names) > MOST_SUBJECTS:
        raise ResultError("too many subjects", found=len(names), expected=f"at most {MOST_SUBJECTS}")
    subjects = tuple(subject_from_record(metadata[name]) for name in names)
    for name, subject in zip(names, subjects, strict=True):
        if name != _record_name(subject.label):
            raise ResultError(f"invalid metadata {name}", found=f"label {subject.label!r}")
    return subjects


def _record_name(label: str) -> str:
    return f"{SUBJECT_RECORD}.{label}" if label else SUBJECT_RECORD


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
_OPTIONAL = {
    "lines": reader_of(list_of(list_of(_INDEX, 2))),
    "number_names": reader_of(list_of(NAME)),
    "label": reader_of(NAME),
}
_NAMES = {"point_names", "shape_names", "number_names"}


def _value(record: Mapping[str, str], key: str) -> Any:
    """Return the value of a key; lists of names must not have duplicates."""
    try:
        value = (_REQUIRED | _OPTIONAL)[key](record[key])
    except ValueError as error:
        raise ValueError(f"in '{key}' {error}") from None
    if key in _NAMES:
        twice = next((name for name, count in Counter(value).items() if count > 1), None)
        if twice is not None:
            raise ValueError(f"'{key}' has a duplicate, {twice!r}")
    return value


def check_run_record(run: Mapping[str, str]) -> None:
    """Check the values of a run record; missing keys are allowed.

    Raises:
        ResultError: names the key.
    """
    for key, check in _CHECKS.items():
        try:
            if key in run:
                check(run[key])
        except ValueError as error:
            raise ResultError(f"metadata {RUN_RECORD}: invalid '{key}'", found=error) from error


def _whole(text: str) -> None:
    if not text.isascii() or not text.isdigit() or int(text) > limits.INTEGER:
        raise ValueError(f"{text[:60]!r}, not a whole number >= 0")


def _whole_or_none(text: str) -> None:
    if text:
        _whole(text)


def _positive(text: str) -> None:
    if text and not 0.0 < float(text) <= limits.NUMBER:
        raise ValueError(f"{text[:60]!r}, not a number > 0")


def _not_negative(text: str) -> None:
    if text and (not math.isfinite(value := float(text)) or not 0.0 <= value <= limits.NUMBER):
        raise ValueError(f"{text[:60]!r}, not a number >= 0")


_OBJECT = reader_of(schemas.dict_schema(schemas.str_schema(), schemas.any_schema()))
_CHECKS: Mapping[str, Callable[[str], object]] = {
    "configuration": _OBJECT,
    "camera": _OBJECT,
    **dict.fromkeys(("start", "stride"), _whole),
    **dict.fromkeys(("seed", "end", "input.bytes"), _whole_or_none),
    **dict.fromkeys(("input.fps", "input.depth_unit_mm"), _positive),
    "input.tolerance_ms": _not_negative,
    "input.missing": _whole_or_none,
}
