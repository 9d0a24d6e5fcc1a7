"""The metadata record ``posetrack.cameras`` of a result from several cameras: what and where they are."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from posetrack_cli.errors import PosetrackError, ResultError
from posetrack_cli.geometry.camera import Camera

CAMERAS_RECORD = "posetrack.cameras"
_PLACE = "camera_T_reference"


def cameras_to_record(cameras: Sequence[Camera]) -> dict[str, str]:
    """Return the cameras as metadata, the reference first; exact to the last bit.

    Raises:
        ResultError: two have one name, which topics and frames are called by.
    """
    names = [camera.name for camera in cameras]
    if len(set(names)) < len(names):
        raise ResultError("two cameras have one name", found=", ".join(names))
    values = [camera.values() | {_PLACE: camera.camera_T_reference} for camera in cameras]
    return {"cameras": json.dumps(values, separators=(",", ":"))}


def cameras_from_record(record: Mapping[str, str]) -> tuple[Camera, ...]:
    """Return the cameras that ``cameras_to_record`` wrote.

    Raises:
        ResultError: the record holds something else.
    """
    try:
        return tuple(_camera(values) for values in json.loads(record["cameras"]))
    except (KeyError, ValueError, TypeError, PosetrackError) as error:
        raise ResultError(f"metadata {CAMERAS_RECORD} cannot be read", found=error) from error


def _camera(values: dict[str, Any]) -> Camera:
    place = tuple(tuple(float(entry) for entry in row) for row in values.pop(_PLACE))
    return Camera(**{**values, "distortion": tuple(values["distortion"])}, camera_T_reference=place)
