"""JSON message ``posetrack.Estimate`` and its schema.

The schema is limited to what Foxglove supports: one type per field, no nulls (absent values are omitted)
and no nested arrays (points are objects). Numbers round-trip exactly; NaN and infinity never occur.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError
from posetrack_cli.mcap.protobuf_twin import NoTwinError, ProtobufTwin, json_of
from posetrack_cli.mcap.stream import McapItem
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
from posetrack_cli.strict_json import object_of, reader_of

ESTIMATE_SCHEMA_NAME = "posetrack.Estimate"

LENGTH_TOLERANCE = 1e-3
"""Tolerance of the quaternion norm; other writers round their values."""
_ARRAYS = tuple(f.name for f in FIELDS if f.shape is not None and f.name != "points")


def estimate_schema(number_names: Sequence[str] = ()) -> dict[str, Any]:
    """Return the JSON schema of a subject's estimates; additional numbers form an object."""
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
        "description": "Complete output of a tracker for one frame.",
        "type": "object",
        "properties": properties,
        "required": [field.name for field in FIELDS if field.required],
        "additionalProperties": False,
    }


ESTIMATE_SCHEMA: Mapping[str, Any] = estimate_schema()
"""Schema for subjects without additional numbers."""


def estimate_to_json(estimate: Estimate, number_names: Sequence[str] = ()) -> bytes:
    """Encode an estimate as one line of JSON, fields in the order of the schema.

    Optional values that are None, NaN or infinite are omitted.

    Args:
        estimate: estimate of one frame.
        number_names: names of its additional numbers.

    Raises:
        ResultError: a required field has NaN or infinity.
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
        # Foxglove's JSON schemas have no null, and JSON has no NaN: unknown values are omitted.
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
    """Decode the output of ``estimate_to_json``.

    Args:
        data: message.
        where: its location, for errors.
        number_names: names of the additional numbers to return.

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
        raise ResultError(f"message is not a {ESTIMATE_SCHEMA_NAME}", where=where, found=error) from error


@lru_cache(maxsize=16)
def _twins(number_names: tuple[str, ...]) -> tuple[ProtobufTwin, ...]:
    """Return the twins of messages with and without additional numbers."""
    schemas = (estimate_schema(names) for names in dict.fromkeys([number_names, ()]))
    return tuple(ProtobufTwin(ESTIMATE_SCHEMA_NAME, schema) for schema in schemas)


def json_of_estimate(item: McapItem, number_names: Sequence[str] = ()) -> bytes:
    """Return an estimate as JSON, also if its message is the protobuf twin of that.

    Raises:
        ResultError: the twin has another layout, or is damaged.
    """
    try:
        return json_of(item, lambda: _twins(tuple(number_names)))
    except NoTwinError as error:
        raise ResultError("estimate cannot be read", where=item[1].topic, found=error) from error


def parse_fields(data: bytes) -> dict[str, Any]:
    """Parse a message without rounding, in less than half the time of the standard library.

    Raises:
        ValueError: it is not a ``posetrack.Estimate``.
    """
    fields: dict[str, Any] = _read(data)
    x, y, z, w = fields["quaternion"]
    if abs(math.sqrt(x * x + y * y + z * z + w * w) - 1.0) > LENGTH_TOLERANCE:
        raise ValueError(f"'quaternion' is {fields['quaternion']}, not a unit quaternion")
    return fields


_read = reader_of(
    object_of(
        {field.name: field.strict for field in BY_NAME.values() if field.required},
        {field.name: field.strict for field in BY_NAME.values() if not field.required},
    ),
    limits.MESSAGE_BYTES,
)


def _further(values: Mapping[str, float] | None, names: Sequence[str]) -> FloatArray | None:
    """Return the additional numbers in the order of their names, NaN where missing."""
    if values is None or not names:
        return None
    return np.array([values.get(name, math.nan) for name in names])


def _array(values: Any) -> FloatArray | None:
    return None if values is None else np.array(values, dtype=np.float64)
