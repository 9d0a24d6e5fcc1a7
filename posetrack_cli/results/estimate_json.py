"""The JSON message ``posetrack.Estimate``: every field of an Estimate, and its JSON schema.

The schema keeps to what Foxglove understands: one type per field, no nulls (an absent value is left
out) and no arrays of arrays (points are objects). Numbers are written so that reading them back gives
the same bits; NaN and infinity never occur.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic_core import core_schema as schemas

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError
from posetrack_cli.results.estimate import NUMBERS, UNKNOWN_ARRAYS, UNKNOWN_NUMBERS, Estimate, Status
from posetrack_cli.results.strict_json import (
    COUNT,
    LENGTH_MM,
    NOT_NEGATIVE,
    NUMBER,
    TRUTH_VALUE,
    list_of,
    object_of,
    reader_of,
)

ESTIMATE_SCHEMA_NAME = "posetrack.Estimate"

_LENGTH_TOLERANCE = 1e-3
"""How far a quaternion that is read may be from length 1: those of other writers are rounded."""
_OPTIONAL = (*UNKNOWN_ARRAYS, *UNKNOWN_NUMBERS)
_ARRAYS = ("position", "quaternion", "shape", "pose_rate", "twist", "pose_variance", "twist_variance")


def _field(kind: str, description: str, **more: Any) -> dict[str, Any]:
    return {"type": kind, "description": description, **more}


def _numbers(description: str) -> dict[str, Any]:
    return _field("array", description, items={"type": "number"})


_PROPERTIES: dict[str, Any] = {
    "frame_index": _field("integer", "Position of the frame in the recording, counted from 0."),
    "stamp_ns": _field("integer", "When the frame was taken, nanoseconds; equal to the log time."),
    "status": _field(
        "string",
        "tracking: rests on this frame; lost: no longer on the subject; reinitialised: found anew.",
        enum=[status.value for status in Status],
    ),
    "confidence": _field("number", "0 (guess) to 1 (certain)."),
    "position": _numbers("x, y, z of the object's origin in camera axes, millimetres."),
    "quaternion": _numbers("x, y, z, w (w >= 0) of the rotation from object to camera coordinates."),
    "shape": _numbers("Hand: finger angles, radians. Head: shape coefficients. K entries."),
    "pose_rate": _numbers(
        "Time derivative of (position, quaternion, shape), 7 + K entries: mm/s, 1/s, shape per second; "
        "this and the fields of twist are left out where no velocity is known."
    ),
    "twist": _numbers(
        "Velocity, 6 + K entries: in camera axes, mm/s; rotation in the body frame, rad/s; shape per second."
    ),
    "pose_variance": _numbers(
        "Variance of the pose, 6 + K entries: position mm^2, rotation vector in the body frame rad^2, shape; "
        "left out where the tracker knows none."
    ),
    "twist_variance": _numbers(
        "Variance of twist, 6 + K entries: (mm/s)^2, (rad/s)^2, (shape per second)^2."
    ),
    "points": _field(
        "array",
        "Joints or landmarks in camera axes.",
        items={
            "type": "object",
            "properties": {axis: _field("number", f"{axis}, millimetres.") for axis in "xyz"},
            "required": ["x", "y", "z"],
            "additionalProperties": False,
        },
    ),
    "effective_sample_size": _field(
        "number", "1 / sum of the squared weights, before resampling; particles; left out without weights."
    ),
    "resampled": _field("boolean", "Whether the particles were resampled after this estimate."),
    "cost": _field("number", "Cost of the estimate against the image; left out when it was not evaluated."),
    "milliseconds": _field("number", "Time the frame took; left out unless the run recorded timings."),
    "evaluations": _field(
        "integer", "Poses whose fit to the image was evaluated; left out where the tracker does not count."
    ),
}


def estimate_schema(number_names: Sequence[str] = ()) -> dict[str, Any]:
    """Return the JSON schema of a subject's estimates; further numbers are a table with a key for each."""
    numbers = _field(
        "object",
        "Further numbers of this tracker, by name; one that is not known is left out.",
        properties={name: {"type": "number"} for name in number_names},
        additionalProperties=False,
    )
    return {
        "title": ESTIMATE_SCHEMA_NAME,
        "description": "Everything that a tracker says about one frame.",
        "type": "object",
        "properties": _PROPERTIES | ({NUMBERS: numbers} if number_names else {}),
        "required": [name for name in _PROPERTIES if name not in _OPTIONAL],
        "additionalProperties": False,
    }


ESTIMATE_SCHEMA: Mapping[str, Any] = estimate_schema()
"""Of a subject without further numbers."""


def estimate_to_json(estimate: Estimate, number_names: Sequence[str] = ()) -> bytes:
    """Encode an estimate as one line of JSON, fields in the order of the schema.

    A velocity or variance that is None is left out; so is a number that may be None, if it is None, NaN or
    infinite.

    Args:
        estimate: of one frame.
        number_names: of its further numbers.

    Raises:
        ResultError: another field holds NaN or infinity.
    """
    fields: dict[str, Any] = {
        "frame_index": int(estimate.frame_index),
        "stamp_ns": int(estimate.stamp_ns),
        "status": estimate.status.value,
        "confidence": float(estimate.confidence),
    }
    arrays = {name: getattr(estimate, name) for name in _ARRAYS}
    fields |= {name: array.tolist() for name, array in arrays.items() if array is not None}
    fields["points"] = [{"x": x, "y": y, "z": z} for x, y, z in estimate.points.tolist()]
    fields["resampled"] = bool(estimate.resampled)
    for name in UNKNOWN_NUMBERS:
        value = getattr(estimate, name)
        if value is not None and math.isfinite(value):
            fields[name] = int(value) if name == "evaluations" else float(value)
    in_order = {name: fields[name] for name in _PROPERTIES if name in fields}
    if estimate.numbers is not None:
        further = zip(number_names, estimate.numbers.tolist(), strict=True)
        in_order[NUMBERS] = {name: value for name, value in further if math.isfinite(value)}
    try:
        return json.dumps(in_order, separators=(",", ":"), allow_nan=False).encode()
    except ValueError as error:
        raise ResultError("estimate is not finite", where=f"frame {estimate.frame_index}") from error


def estimate_from_json(data: bytes, where: object = "", number_names: Sequence[str] = ()) -> Estimate:
    """Decode what ``estimate_to_json`` wrote.

    Args:
        data: the message.
        where: it lies, for errors.
        number_names: of the further numbers that are wanted.

    Raises:
        ResultError: the bytes are not a ``posetrack.Estimate``.
    """
    try:
        fields = parse_fields(data)
        arrays: dict[str, Any] = {name: _array(fields.get(name)) for name in UNKNOWN_ARRAYS}
        arrays |= {name: _array(fields[name]) for name in _ARRAYS if name not in arrays}
        numbers: dict[str, Any] = {name: fields.get(name) for name in UNKNOWN_NUMBERS}
        points = [(point["x"], point["y"], point["z"]) for point in fields["points"]]
        return Estimate(
            frame_index=fields["frame_index"],
            stamp_ns=fields["stamp_ns"],
            status=Status(fields["status"]),
            confidence=fields["confidence"],
            **arrays,
            points=np.array(points, dtype=np.float64).reshape(-1, 3),
            resampled=fields["resampled"],
            **numbers,
            numbers=_further(fields.get(NUMBERS), number_names),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise ResultError(f"message is no {ESTIMATE_SCHEMA_NAME}", where=where, found=error) from error


def parse_fields(data: bytes) -> dict[str, Any]:
    """Parse a message, exact to the last bit, in less than half of the standard library's time.

    Raises:
        ValueError: it is no ``posetrack.Estimate``.
    """
    fields: dict[str, Any] = _read(data)
    x, y, z, w = fields["quaternion"]
    if abs(math.sqrt(x * x + y * y + z * z + w * w) - 1.0) > _LENGTH_TOLERANCE:
        raise ValueError(f"'quaternion' is {fields['quaternion']}, not of length 1")
    return fields


_read = reader_of(
    object_of(
        {
            "frame_index": COUNT,
            "stamp_ns": COUNT,
            "status": schemas.literal_schema([status.value for status in Status]),
            "confidence": NUMBER,
            "position": list_of(LENGTH_MM, 3),
            "quaternion": list_of(NUMBER, 4),
            "shape": list_of(NUMBER),
            "points": list_of(object_of(dict.fromkeys("xyz", LENGTH_MM))),
            "resampled": TRUTH_VALUE,
        },
        {
            **dict.fromkeys(("pose_rate", "twist"), list_of(NUMBER)),
            **dict.fromkeys(("pose_variance", "twist_variance"), list_of(NOT_NEGATIVE)),
            **dict.fromkeys(("effective_sample_size", "cost", "milliseconds"), NUMBER),
            "evaluations": COUNT,
            NUMBERS: schemas.dict_schema(schemas.str_schema(), NUMBER),
        },
    ),
    limits.MESSAGE_BYTES,
)


def _further(values: Mapping[str, float] | None, names: Sequence[str]) -> FloatArray | None:
    """Further numbers in the order of their names, NaN for one that is left out."""
    if values is None or not names:
        return None
    return np.array([values.get(name, math.nan) for name in names])


def _array(values: Any) -> FloatArray | None:
    return None if values is None else np.array(values, dtype=np.float64)
