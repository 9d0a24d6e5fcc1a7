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

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.results.fields import (
    BY_NAME,
    FIELD_NAMES,
    FIELDS,
    NUMBERS,
    NUMBERS_FIELD,
    UNKNOWN_ARRAYS,
    UNKNOWN_NUMBERS,
)
from posetrack_cli.results.records import object_of, reader_of

ESTIMATE_SCHEMA_NAME = "posetrack.Estimate"

_LENGTH_TOLERANCE = 1e-3
"""How far a quaternion that is read may be from length 1: those of other writers are rounded."""
_ARRAYS = tuple(f.name for f in FIELDS if f.shape is not None and f.name != "points")


def estimate_schema(number_names: Sequence[str] = ()) -> dict[str, Any]:
    """Return the JSON schema of a subject's estimates; further numbers are a table with a key for each."""
    properties = {field.name: field.json_schema for field in FIELDS}
    if number_names:
        properties[NUMBERS] = {
            "type": NUMBERS_FIELD.json_type,
            "description": NUMBERS_FIELD.description,
            "properties": {name: {"type": "number"} for name in number_names},
            "additionalProperties": False,
        }
    return {
        "title": ESTIMATE_SCHEMA_NAME,
        "description": "Everything that a tracker says about one frame.",
        "type": "object",
        "properties": properties,
        "required": [field.name for field in FIELDS if field.required],
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
    in_order = {name: fields[name] for name in FIELD_NAMES if name in fields}
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
        {field.name: field.strict for field in BY_NAME.values() if field.required},
        {field.name: field.strict for field in BY_NAME.values() if not field.required},
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
