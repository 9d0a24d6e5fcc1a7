"""The columns of an exported table: their names, units and meanings, stated once for every format."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.euler import head_roll_pitch_yaw, roll_pitch_yaw
from posetrack_cli.geometry.poses import in_object
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.estimate import NUMBERS, Subject
from posetrack_cli.results.export.column_names import (
    ANGULAR_VELOCITY,
    HEAD,
    LINEAR_VELOCITY,
    POSITION,
    QUATERNION,
    point_columns,
    rate_columns,
    shape_columns,
    shape_unit,
)

Values: TypeAlias = np.ndarray[Any, Any]


@dataclass(frozen=True)
class ColumnGroup:
    """Columns that mean the same of different components.

    Attributes:
        names: of the columns.
        unit: of all of them, empty for none.
        meaning: of all of them.
        values: makes the (N, len(names)) values from columns of ``Result.columns``.
    """

    names: tuple[str, ...]
    unit: str
    meaning: str
    values: Callable[[Columns], Values]

    @property
    def description(self) -> str:
        """Names, meaning and unit on one line."""
        return f"{' '.join(self.names)}: {self.meaning}{', ' if self.unit else ''}{self.unit}"


def table_of(subject: Subject) -> tuple[ColumnGroup, ...]:
    """Return the columns of a subject's table, in order; groups without columns are left out."""
    groups = (
        *_frame_groups(),
        *_pose_groups(subject),
        *_velocity_groups(subject),
        *_deviation_groups(subject),
        _point_group(subject),
        *_filter_groups(),
        _further_group(subject),
    )
    return tuple(group for group in groups if group.names)


def euler_angles(subject: Subject) -> Callable[[FloatArray], FloatArray]:
    """Return what makes roll, pitch, yaw (N, 3), rad, from a subject's quaternions (N, 4)."""
    return head_roll_pitch_yaw if subject.name == HEAD else roll_pitch_yaw


def _frame_groups() -> Iterable[ColumnGroup]:
    yield _field("frame_index", "", "position of the frame in the recording, counted from 0")
    yield _field("stamp_ns", "ns", "when the frame was taken")
    yield _field("status", "", "tracking, lost or reinitialised")
    yield _field("confidence", "", "0 (guess) to 1 (certain)")


def _pose_groups(subject: Subject) -> Iterable[ColumnGroup]:
    angles = euler_angles(subject)
    yield _part(POSITION, "mm", f"origin of the {subject.name} in camera axes", "position")
    yield _part(
        QUATERNION,
        "",
        f"rotation from {subject.name} to camera axes, unit quaternion, qw >= 0",
        "quaternion",
    )
    yield ColumnGroup(
        ("roll_deg", "pitch_deg", "yaw_deg"),
        "deg",
        "the same rotation in Euler angles",
        lambda block: np.degrees(angles(block["quaternion"])),
    )
    unit = shape_unit(subject)
    meaning = "angles of the shape" if unit else "coefficients of the shape"
    yield _part(shape_columns(subject), unit, meaning, "shape")


def _velocity_groups(subject: Subject) -> Iterable[ColumnGroup]:
    yield _part(LINEAR_VELOCITY, "mm/s", "velocity of the origin in camera axes", "twist")
    yield _part(
        ANGULAR_VELOCITY,
        "rad/s",
        f"angular velocity in the {subject.name}'s own axes",
        "twist",
        3,
    )
    unit = f"{shape_unit(subject) or '1'}/s"
    yield _part(rate_columns(subject), unit, "rate of the shape", "twist", 6)


def _deviation_groups(subject: Subject) -> Iterable[ColumnGroup]:
    """Standard deviations: roots of the diagonals of the covariances."""
    unit = shape_unit(subject)
    yield _deviation(tuple(f"{axis}_sd_mm" for axis in "xyz"), "mm", "of the position", "pose_variance", 0)
    yield _deviation(
        tuple(f"r{axis}_sd_rad" for axis in "xyz"),
        "rad",
        f"of a small rotation about the {subject.name}'s own axes",
        "pose_variance",
        3,
    )
    yield _deviation(shape_columns(subject, "sd"), unit, "of the shape", "pose_variance", 6)
    yield _deviation(
        tuple(f"v{axis}_sd_mm_s" for axis in "xyz"), "mm/s", "of the velocity", "twist_variance", 0
    )
    yield _deviation(
        tuple(f"w{axis}_sd_rad_s" for axis in "xyz"), "rad/s", "of the angular velocity", "twist_variance", 3
    )
    rates = rate_columns(subject, "sd")
    yield _deviation(rates, f"{unit or '1'}/s", "of the rate of the shape", "twist_variance", 6)


def _point_group(subject: Subject) -> ColumnGroup:
    """Points in camera axes; of a head in its own, where a rigid one's stand still."""
    names = point_columns(subject.point_names)
    if subject.name != HEAD:
        return ColumnGroup(names, "mm", "points in camera axes", lambda block: _flat(block["points"]))
    return ColumnGroup(names, "mm", "points in the head's own axes", lambda block: _flat(_in_head(block)))


def _in_head(block: Columns) -> FloatArray:
    """The points (N, P, 3), mm, in the head's own axes."""
    return in_object(block["points"], block["position"][:, None], block["quaternion"][:, None])


def _filter_groups() -> Iterable[ColumnGroup]:
    yield _field(
        "effective_sample_size",
        "particles",
        "1 / sum of the squared weights, before resampling, empty without weights",
    )
    yield _field("resampled", "", "1 if the particles were resampled after this frame, else 0")
    yield ColumnGroup(
        ("cost_mm",), "mm", "cost of the estimate against the image, empty where not evaluated", _one("cost")
    )
    yield _field("milliseconds", "ms", "time that the frame took, empty if the run recorded none")
    yield _field("evaluations", "poses", "whose fit to the image was evaluated, empty where not counted")


def _further_group(subject: Subject) -> ColumnGroup:
    """What a tracker states beyond that; the names hold the units."""
    meaning = "further numbers of this tracker, empty where not known"
    return ColumnGroup(subject.number_names, "", meaning, lambda block: block[NUMBERS])


def _field(name: str, unit: str, meaning: str) -> ColumnGroup:
    return ColumnGroup((name,), unit, meaning, _one(name))


def _one(name: str) -> Callable[[Columns], Values]:
    return lambda block: block[name][:, None]


def _part(names: tuple[str, ...], unit: str, meaning: str, field: str, first: int = 0) -> ColumnGroup:
    """Columns ``first`` and so on of a field."""
    return ColumnGroup(names, unit, meaning, lambda block: block[field][:, first : first + len(names)])


def _deviation(names: tuple[str, ...], unit: str, of: str, field: str, first: int) -> ColumnGroup:
    part = slice(first, first + len(names))
    return ColumnGroup(names, unit, f"standard deviation {of}", lambda block: np.sqrt(block[field][:, part]))


def _flat(points: Values) -> Values:
    return points.reshape(len(points), 3 * points.shape[1])
