"""Metadata records of a result, and strict parsing of their JSON."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from pydantic_core import CoreConfig, CoreSchema, SchemaValidator, ValidationError
from pydantic_core import core_schema as schemas

from posetrack_cli import limits
from posetrack_cli.errors import PosetrackError, ResultError
from posetrack_cli.geometry.camera import DISTORTION_LENGTHS, IN_PLACE, Camera
from posetrack_cli.recording.base import RUN_RECORD
from posetrack_cli.results.estimate import Subject

# Strict JSON: types, ranges and lengths checked in one pass

_CONFIG = CoreConfig(allow_inf_nan=False)
_SHOWN_CHARACTERS = 60


def number_from(least: float, most: float) -> schemas.FloatSchema:
    """Return the schema of a finite number in a range."""
    return schemas.float_schema(ge=least, le=most, strict=True)


def integer_from(least: int, most: int) -> schemas.IntSchema:
    """Return the schema of an integer in a range."""
    return schemas.int_schema(ge=least, le=most, strict=True)


def text_of(least: int, most: int = limits.NAME_CHARACTERS) -> schemas.StringSchema:
    """Return the schema of text with a range of lengths."""
    return schemas.str_schema(min_length=least, max_length=most, strict=True)


NAME = text_of(1)
LENGTH_MM = number_from(-limits.LENGTH_MM, limits.LENGTH_MM)
NUMBER = number_from(-limits.NUMBER, limits.NUMBER)
NOT_NEGATIVE = number_from(0.0, limits.NUMBER)
COUNT = integer_from(0, limits.INTEGER)
TRUTH_VALUE = schemas.bool_schema(strict=True)


def list_of(
    item: CoreSchema, length: int | None = None, most: int = limits.LIST_ENTRIES
) -> schemas.ListSchema:
    """Return the schema of a list with a fixed or maximum length."""
    return schemas.list_schema(item, min_length=length, max_length=most if length is None else length)


def object_of(
    required: Mapping[str, CoreSchema], optional: Mapping[str, CoreSchema] | None = None
) -> schemas.TypedDictSchema:
    """Return the schema of an object; optional keys may be missing or null, other keys are ignored."""
    fields = {name: schemas.typed_dict_field(schema) for name, schema in required.items()}
    for name, schema in (optional or {}).items():
        fields[name] = schemas.typed_dict_field(schemas.nullable_schema(schema), required=False)
    return schemas.typed_dict_schema(fields, extra_behavior="ignore")


def reader_of(schema: CoreSchema, most: int | None = None) -> Callable[[bytes | str], Any]:
    """Return a function that parses JSON of a schema without rounding, up to ``most`` bytes.

    It raises ValueError with a one-line message for anything else, including NaN, infinity, booleans or
    text as numbers, and deep nesting.
    """
    validate = SchemaValidator(schema, _CONFIG).validate_json

    def read(text: bytes | str) -> Any:
        if most is not None and len(text) > most:
            raise ValueError(f"{len(text)} bytes exceed the limit of {most}")
        try:
            return validate(text)
        except ValidationError as error:
            raise ValueError(_first_problem(error)) from None

    return read


def _first_problem(error: ValidationError) -> str:
    """Return the first problem as one line: place, found, expected."""
    from posetrack_cli.configuration import expected_words  # pydantic is slow to load

    problem = error.errors(include_url=False)[0]
    if problem["type"] == "json_invalid":
        return str(problem["msg"])
    where = ".".join(str(part) for part in problem["loc"]) or "value"
    if problem["type"] == "missing":
        return f"'{where}' is missing"
    found = repr(problem["input"])
    # The value may be arbitrarily long, as it comes from the file.
    found = found if len(found) <= _SHOWN_CHARACTERS else f"{found[:_SHOWN_CHARACTERS]}..."
    return f"'{where}' is {found}, expected {expected_words(problem)}"


# Metadata records: subject, cameras, run

SUBJECT_RECORD = "posetrack.subject"
SUMMARY_RECORD = "posetrack.summary"
CAMERAS_RECORD = "posetrack.cameras"


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
        )
    except KeyError as error:
        raise ResultError(f"metadata {SUBJECT_RECORD} lacks {error}") from error
    except ValueError as error:
        raise ResultError(f"invalid metadata {SUBJECT_RECORD}", found=error) from error


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


_PLACE = "camera_T_reference"


def cameras_to_record(cameras: Sequence[Camera]) -> dict[str, str]:
    """Return the cameras as metadata, the reference first, without rounding.

    Raises:
        ResultError: two cameras have the same name, which identifies their topics and frames.
    """
    names = [camera.name for camera in cameras]
    if len(set(names)) < len(names):
        raise ResultError("camera names are not unique", found=", ".join(names))
    values = [camera.values() | {_PLACE: camera.camera_T_reference} for camera in cameras]
    return {"cameras": json.dumps(values, separators=(",", ":"))}


def cameras_from_record(record: Mapping[str, str]) -> tuple[Camera, ...]:
    """Parse the output of ``cameras_to_record``.

    Raises:
        ResultError: the record is invalid.
    """
    try:
        return tuple(_camera(values) for values in _read_cameras(record.get("cameras", "")))
    except (ValueError, PosetrackError) as error:
        raise ResultError(f"invalid metadata {CAMERAS_RECORD}", found=error) from error


def camera_from_json(text: str) -> Camera:
    """Return the camera of a run record, ``Camera.values`` as JSON.

    Raises:
        ValueError, PosetrackError: it is invalid.
    """
    return _camera(_read_camera(text))


_VALUES: dict[str, CoreSchema] = {
    "name": text_of(0),
    **dict.fromkeys(("width", "height"), integer_from(1, limits.IMAGE_PIXELS)),
    **dict.fromkeys(("fx", "fy", "cx", "cy"), NUMBER),
    "distortion": list_of(NUMBER, most=max(max(lengths) for lengths in DISTORTION_LENGTHS.values())),
    "distortion_model": NAME,
}
_read_camera = reader_of(object_of(_VALUES))
_PLACED = object_of(_VALUES | {_PLACE: list_of(list_of(LENGTH_MM, 4), 3)})
_read_cameras = reader_of(schemas.list_schema(_PLACED, min_length=1, max_length=limits.CAMERAS))


def _camera(values: dict[str, Any]) -> Camera:
    if values["width"] * values["height"] > limits.IMAGE_PIXELS:
        raise ValueError(f"images of {values['width']}x{values['height']} are too large")
    place = values.pop(_PLACE, IN_PLACE)
    rows = tuple(tuple(float(entry) for entry in row) for row in place)
    return Camera(**{**values, "distortion": tuple(values["distortion"])}, camera_T_reference=rows)


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
