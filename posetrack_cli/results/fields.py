"""Field table of estimates, from which messages, columns, exports and checks are derived."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from pydantic_core import CoreSchema
from pydantic_core import core_schema as schemas

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.strict_json import (
    COUNT,
    LENGTH_MM,
    NOT_NEGATIVE,
    NUMBER,
    TRUTH_VALUE,
    list_of,
    object_of,
)

QUATERNION_NORM_TOLERANCE = 1e-6
"""Tolerance of |q| = 1: far above rounding errors, far below an unnormalised rotation."""
NUMBERS = "numbers"
"""Field of additional numbers, the only one that may contain NaN."""

Shape: TypeAlias = Callable[[int, int, int], tuple[int, ...]]
"""Array shape as a function of K shape parameters, P points and M additional numbers."""


@dataclass(frozen=True)
class Field:
    """One field of ``Estimate``.

    Attributes:
        name: attribute name.
        json_type: type in the JSON schema of the message.
        description: description in the JSON schema.
        strict: validation schema for reading.
        shape: array shape; None for scalars.
        required: whether every message has it; otherwise missing values are NaN in columns.
        column: numpy type of its column.
        unit: unit in exports; empty for none.
        meaning: description of its column in exported tables; arrays have one per part there.
    """

    name: str
    json_type: str
    description: str
    strict: CoreSchema
    shape: Shape | None = None
    required: bool = True
    column: Any = np.float64
    unit: str = ""
    meaning: str = ""

    @property
    def json_schema(self) -> dict[str, Any]:
        """Entry in the message's JSON schema."""
        stated: dict[str, Any] = {"type": self.json_type, "description": self.description}
        return stated | _JSON_DETAILS.get(self.name, {} if self.shape is None else _NUMBER_ITEMS)


_STATUSES = [status.value for status in Status]
_NUMBER_ITEMS: dict[str, Any] = {"items": {"type": "number"}}
_JSON_DETAILS: dict[str, dict[str, Any]] = {
    "status": {"enum": _STATUSES},
    "points": {
        "items": {
            "type": "object",
            "properties": {a: {"type": "number", "description": f"{a}, millimetres."} for a in "xyz"},
            "required": ["x", "y", "z"],
            "additionalProperties": False,
        }
    },
}


FIELDS = (
    Field(
        "frame_index",
        "integer",
        "Position of the frame in the recording, counted from 0.",
        COUNT,
        column=np.int64,
        meaning="position of the frame in the recording, counted from 0",
    ),
    Field(
        "stamp_ns",
        "integer",
        "Time of the frame, nanoseconds; equal to the log time.",
        COUNT,
        column=np.int64,
        unit="ns",
        meaning="time of the frame",
    ),
    Field(
        "status",
        "string",
        "tracking: supported by this frame; lost: no longer on the subject; reinitialised: detected again.",
        schemas.literal_schema(_STATUSES),
        column=np.array(_STATUSES).dtype,
        meaning="tracking, lost or reinitialised",
    ),
    Field(
        "confidence",
        "number",
        "0 (guess) to 1 (certain); for hands, the probability of a mean joint error below 20 mm.",
        NUMBER,
        meaning="0 (guess) to 1 (certain)",
    ),
    Field(
        "position",
        "array",
        "x, y, z of the object's origin in camera axes, millimetres.",
        list_of(LENGTH_MM, 3),
        lambda k, p, m: (3,),
        unit="mm, camera axes",
    ),
    Field(
        "quaternion",
        "array",
        "x, y, z, w (w >= 0) of the rotation from object to camera coordinates.",
        list_of(NUMBER, 4),
        lambda k, p, m: (4,),
        unit="x y z w, object to camera axes",
    ),
    Field(
        "shape",
        "array",
        "Hand: finger angles, radians. Head: shape coefficients. K entries.",
        list_of(NUMBER),
        lambda k, p, m: (k,),
        unit="hand: finger angles, rad; head: coefficients",
    ),
    Field(
        "pose_rate",
        "array",
        "Time derivative of (position, quaternion, shape), 7 + K entries: mm/s, 1/s, shape per second; "
        "omitted, like twist and twist_variance, if the velocity is unknown.",
        list_of(NUMBER),
        lambda k, p, m: (7 + k,),
        required=False,
        unit="rate of position, quaternion, shape: mm/s, 1/s, rad/s (head: 1/s)",
    ),
    Field(
        "twist",
        "array",
        "Velocity, 6 + K entries: in camera axes, mm/s; rotation in the body frame, rad/s; shape per second.",
        list_of(NUMBER),
        lambda k, p, m: (6 + k,),
        required=False,
        unit="mm/s in camera axes, rad/s in the object's own axes, shape per second",
    ),
    Field(
        "pose_variance",
        "array",
        "Variance of the pose, 6 + K entries: position mm^2, rotation vector in the body frame rad^2, shape; "
        "omitted if the tracker does not estimate it.",
        list_of(NOT_NEGATIVE),
        lambda k, p, m: (6 + k,),
        required=False,
        unit="mm^2, rad^2 (small rotation in the object's own axes), shape^2",
    ),
    Field(
        "twist_variance",
        "array",
        "Variance of twist, 6 + K entries: (mm/s)^2, (rad/s)^2, (shape per second)^2.",
        list_of(NOT_NEGATIVE),
        lambda k, p, m: (6 + k,),
        required=False,
        unit="(mm/s)^2, (rad/s)^2, (shape per second)^2",
    ),
    Field(
        "points",
        "array",
        "Joints or landmarks in camera axes.",
        list_of(object_of(dict.fromkeys("xyz", LENGTH_MM))),
        lambda k, p, m: (p, 3),
        unit="mm, camera axes",
    ),
    Field(
        "effective_sample_size",
        "number",
        "1 / sum of the squared weights before resampling, in particles; omitted without weights.",
        NUMBER,
        required=False,
        unit="particles",
        meaning="1 / sum of the squared weights, before resampling, empty without weights",
    ),
    Field(
        "resampled",
        "boolean",
        "Whether the particles were resampled after this estimate.",
        TRUTH_VALUE,
        column=np.bool_,
        meaning="1 if the particles were resampled after this frame, else 0",
    ),
    Field(
        "cost",
        "number",
        "Cost of the estimate against the image; omitted if not evaluated.",
        NUMBER,
        required=False,
        unit="mm",
        meaning="cost of the estimate against the image, empty where not evaluated",
    ),
    Field(
        "milliseconds",
        "number",
        "Processing time of the frame; omitted unless the run recorded timings.",
        NUMBER,
        required=False,
        unit="ms",
        meaning="processing time of the frame, empty if the run recorded none",
    ),
    Field(
        "evaluations",
        "integer",
        "Number of poses scored against the image; omitted if not counted.",
        COUNT,
        required=False,
        unit="poses",
        meaning="number of poses scored against the image, empty if not counted",
    ),
)
"""Fields of every subject's estimates, in the order used by every format."""

NUMBERS_FIELD = Field(
    NUMBERS,
    "object",
    "Additional numbers of this tracker by name; unknown ones are omitted.",
    schemas.dict_schema(schemas.str_schema(), NUMBER),
    lambda k, p, m: (m,),
    required=False,
    unit="as number_names say",
)
"""Additional numbers, for subjects that have some."""

BY_NAME: Mapping[str, Field] = {field.name: field for field in (*FIELDS, NUMBERS_FIELD)}
FIELD_NAMES = tuple(field.name for field in FIELDS)
UNKNOWN_ARRAYS = tuple(field.name for field in FIELDS if not field.required and field.shape is not None)
"""Arrays that may be None."""
UNKNOWN_NUMBERS = tuple(field.name for field in FIELDS if not field.required and field.shape is None)
"""Numbers that may be None."""
VELOCITY_FIELDS = ("pose_rate", "twist", "twist_variance")
"""Fields that are all None if the velocity is unknown."""


class Sizes(NamedTuple):
    """Array sizes of estimates.

    Attributes:
        shape: K, number of shape parameters.
        points: P, number of points.
        numbers: M, number of additional numbers.
    """

    shape: int
    points: int
    numbers: int = 0

    @classmethod
    def of(cls, subject: Subject) -> Sizes:
        """Return the sizes for a subject."""
        return cls(len(subject.shape_names), len(subject.point_names), len(subject.number_names))


def array_shapes(sizes: Sizes) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array field."""
    return {name: field.shape(*sizes) for name, field in BY_NAME.items() if field.shape is not None}


def check_estimate(estimate: Estimate, subject: Subject) -> None:
    """Check that an estimate's arrays fit the subject and are finite.

    Raises:
        ResultError: names the frame and the field.
    """
    where = f"{subject.name}, frame {estimate.frame_index}"
    _check_arrays(estimate, subject, where)
    _check_quaternion(estimate.quaternion, where)
    if not 0.0 <= estimate.confidence <= 1.0:
        raise ResultError("invalid confidence", where=where, found=estimate.confidence, expected="0 to 1")
    if estimate.effective_sample_size is not None and not np.isfinite(estimate.effective_sample_size):
        raise ResultError("effective sample size is not finite", where=where)


def _check_arrays(estimate: Estimate, subject: Subject, where: str) -> None:
    # The three velocity fields come from one estimator; a partial set would be a bug of the tracker.
    unknown = [name for name in VELOCITY_FIELDS if getattr(estimate, name) is None]
    if unknown and len(unknown) < len(VELOCITY_FIELDS):
        raise ResultError(
            f"{' and '.join(unknown)} missing", where=where, expected="all velocity fields or none"
        )
    for name, shape in array_shapes(Sizes.of(subject)).items():
        array = getattr(estimate, name)
        if array is None and not BY_NAME[name].required:
            continue
        check_array(array, shape, name, where, missing=name == NUMBERS)


def check_array(
    array: FloatArray, shape: tuple[int, ...], name: str, where: str, *, missing: bool = False
) -> None:
    """Raise ResultError unless the array has this shape and, unless ``missing`` is allowed, is finite."""
    if array.shape != shape:
        raise ResultError(f"{name} has the wrong shape", where=where, found=array.shape, expected=shape)
    if not missing and not np.isfinite(array).all():
        found = f"{int((~np.isfinite(array)).sum())} NaN or infinite"
        raise ResultError(f"{name} is not finite", where=where, found=found)


def _check_quaternion(quaternion: FloatArray, where: str) -> None:
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > QUATERNION_NORM_TOLERANCE or quaternion[3] < 0.0:
        found = f"norm {norm:.9g}, w {quaternion[3]:.9g}"
        raise ResultError("invalid quaternion", where=where, found=found, expected="norm 1, w >= 0")
