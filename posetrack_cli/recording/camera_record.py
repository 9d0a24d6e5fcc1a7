"""Cameras in metadata records and run records: JSON without rounding."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic_core import CoreSchema
from pydantic_core import core_schema as schemas

from posetrack_cli import limits
from posetrack_cli.errors import PosetrackError, ResultError
from posetrack_cli.geometry.camera import DISTORTION_LENGTHS, IN_PLACE, Camera
from posetrack_cli.strict_json import (
    LENGTH_MM,
    NAME,
    NUMBER,
    integer_from,
    list_of,
    object_of,
    reader_of,
    text_of,
)

CAMERAS_RECORD = "posetrack.cameras"
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
