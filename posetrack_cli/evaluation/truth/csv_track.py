"""A trajectory from a CSV file: poses, points, shape and velocities, whichever it has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import shorten

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import TruthError
from posetrack_cli.evaluation.track import Track
from posetrack_cli.evaluation.truth.checks import check_point_names, unit_quaternions
from posetrack_cli.evaluation.truth.csv_table import NS_PER_UNIT, CsvHeader, CsvTable, read_header, read_table
from posetrack_cli.geometry.rigid import in_camera
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.export.table import (
    ANGULAR_VELOCITY,
    LINEAR_VELOCITY,
    POSITION,
    QUATERNION,
    point_columns,
    rate_columns,
    shape_columns,
)
from posetrack_cli.results.subject_kind import kind_of


def load_csv_track(path: Path, subject: Subject) -> Track:
    """Read a trajectory from a CSV file with a header row; lines that begin with ``#`` are comments.

    Columns, in any order, all but the stamps optional, unknown ones ignored:

    - ``stamp_ns`` (integer), or ``t_s`` or ``time_s`` (seconds, rounded to ns);
    - ``x_mm y_mm z_mm``: the object's origin in camera axes; ``qx qy qz qw``: ``camera_T_object``'s rotation;
    - ``<point>_x_mm <point>_y_mm <point>_z_mm``: all of the subject's points or none; of a hand its joints in
      camera axes, of a head its points **in the model frame**, which the pose takes to camera axes;
    - ``<angle>_rad`` of a hand, ``<coefficient>`` of a head: all of the subject's or none;
    - ``vx_mm_s vy_mm_s vz_mm_s`` in camera axes, ``wx_rad_s wy_rad_s wz_rad_s`` in the body's,
      ``<angle>_rad_s`` or ``<coefficient>_per_s``: velocities; a cell that is empty or nan is unknown;
    - ``status``: rows where it is ``lost`` are no truth and are left out.

    An export of a result as CSV is such a file; as JSON or TUM's trajectory it has the same columns, the
    latter those of the pose alone (``formats``).

    Args:
        path: the file.
        subject: of the result, whose names the columns have.

    Returns:
        A track without status; quaternions normalised; ``shape_names`` is empty if the file has no shape, and
        an entry of ``twist`` that the file does not have is NaN.

    Raises:
        TruthError: names file, line and column of what cannot be used.
    """
    header = read_header(path)
    layout = _Layout.of(header, subject)
    table = read_table(header, layout.columns, layout.velocities)
    name = f"{path.name} without its {table.lost} lost frames" if table.lost else path.name
    position = table.of(POSITION) if layout.position else None
    quaternion = _quaternions(table) if layout.quaternion else None
    return Track(
        name,
        subject.name,
        shape_names=subject.shape_names if layout.shape else (),
        point_names=layout.points,
        point_parents=subject.point_parents if layout.points else (),
        stamp_ns=table.stamp_ns,
        position=position,
        quaternion=quaternion,
        shape=table.of(shape_columns(subject)) if layout.shape else None,
        twist=_twist(table, subject, layout),
        points=_points(table, layout, position, quaternion) if layout.points else None,
    )


@dataclass(frozen=True)
class _Layout:
    """What a file has.

    Attributes:
        subject: name of the subject.
        position, quaternion: whether it has them.
        points: names of the points, () for none.
        shape, velocities: columns.
    """

    subject: str
    position: bool
    quaternion: bool
    points: tuple[str, ...]
    shape: tuple[str, ...]
    velocities: tuple[str, ...]

    @classmethod
    def of(cls, header: CsvHeader, subject: Subject) -> _Layout:
        """Find the subject's columns in a header row."""
        groups = (LINEAR_VELOCITY, ANGULAR_VELOCITY, rate_columns(subject))
        layout = cls(
            subject.name,
            position=_has_all(header, POSITION),
            quaternion=_has_all(header, QUATERNION),
            points=_point_names(header, subject),
            shape=shape_columns(subject) if _has_all(header, shape_columns(subject)) else (),
            velocities=tuple(name for group in groups if _has_all(header, group) for name in group),
        )
        _check(header, subject, layout)
        return layout

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns to read."""
        pose = (POSITION if self.position else ()) + (QUATERNION if self.quaternion else ())
        return pose + point_columns(self.points) + self.shape + self.velocities


def _check(header: CsvHeader, subject: Subject, layout: _Layout) -> None:
    """Raise unless there are stamps and something to compare."""
    if not layout.columns:
        raise TruthError(
            "no column is known",
            where=header.path,
            found=shorten(", ".join(header.columns), 100, placeholder=" ..."),
            expected=_known(subject),
        )
    if header.stamp_column is None:
        expected = " or ".join(NS_PER_UNIT)
        raise TruthError("has no column of stamps", where=header.path, expected=expected)
    if kind_of(subject.name).rigid and layout.points and not (layout.position and layout.quaternion):
        raise TruthError(
            f"points of a {subject.name} are in its model frame and need its pose",
            where=header.path,
            expected=", ".join((*POSITION, *QUATERNION)),
        )


def _has_all(header: CsvHeader, group: Sequence[str]) -> bool:
    """Whether the file has the columns of a group.

    Raises:
        TruthError: it has only some of them.
    """
    missing = [name for name in group if name not in header.columns]
    if missing and len(missing) < len(group):
        expected = f"all or none of {', '.join(group)}"
        raise TruthError(f"lacks {', '.join(missing)}", where=header.path, expected=expected)
    return bool(group) and not missing


def _point_names(header: CsvHeader, subject: Subject) -> tuple[str, ...]:
    """Return the subject's point names if the file has its points, none if it has no points at all."""
    begun = [name for name in subject.point_names if set(point_columns([name])) & set(header.columns)]
    found = {name.removesuffix("_x_mm") for name in header.columns if name.endswith("_x_mm")}
    if not (begun or found) or not subject.point_names:
        return ()
    check_point_names(subject.point_names, sorted({*begun, *found}), header.path)
    for name in subject.point_names:
        _has_all(header, point_columns([name]))
    return subject.point_names


def _known(subject: Subject) -> str:
    """Return what columns a file of this subject may have."""
    point, shape = "<point>", replace(subject, shape_names=("<name>",))
    groups = [
        "/".join(NS_PER_UNIT),
        *(" ".join(group) for group in (POSITION, QUATERNION, LINEAR_VELOCITY, ANGULAR_VELOCITY)),
        f"{' '.join(point_columns([point]))} for {point} {' '.join(subject.point_names)}",
    ]
    if subject.shape_names:
        columns = " ".join(shape_columns(shape) + rate_columns(shape))
        groups.append(f"{columns} for <name> {' '.join(subject.shape_names)}")
    return ", ".join(groups)


def _quaternions(table: CsvTable) -> FloatArray:
    quaternions = table.of(QUATERNION)
    return unit_quaternions(quaternions, lambda row: f"{table.where(row)}, columns {' '.join(QUATERNION)}")


def _points(
    table: CsvTable, layout: _Layout, position: FloatArray | None, quaternion: FloatArray | None
) -> FloatArray:
    """Return the points (N, P, 3) in camera axes; those of a rigid subject come in its own."""
    points = table.of(point_columns(layout.points)).reshape(len(table.values), -1, 3)
    if not kind_of(layout.subject).rigid or position is None or quaternion is None:
        return points
    return in_camera(points, position[:, None], quaternion[:, None])


def _twist(table: CsvTable, subject: Subject, layout: _Layout) -> FloatArray | None:
    """Return the velocities (N, 6 + K), NaN where the file has none; None if it has none at all."""
    names = (*LINEAR_VELOCITY, *ANGULAR_VELOCITY, *(rate_columns(subject) if layout.shape else ()))
    twist = np.full((len(table.values), len(names)), np.nan)
    for column, name in enumerate(names):
        if name in table.columns:
            twist[:, column] = table.values[:, table.columns.index(name)]
    return None if np.isnan(twist).all() else twist
