"""Ground truth in tables: CSV, JSON and TUM files, with checks of their content."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from itertools import islice
from operator import itemgetter
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import TruthError
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry.rigid import in_camera
from posetrack_cli.geometry.rotations import canonical
from posetrack_cli.mcap.stream import is_mcap
from posetrack_cli.recording.base import RECORDING_KEY
from posetrack_cli.recording.matching import LATEST_NS
from posetrack_cli.results.estimate import Subject, kind_of
from posetrack_cli.results.export.table import (
    ANGULAR_VELOCITY,
    LINEAR_VELOCITY,
    POSITION,
    QUATERNION,
    point_columns,
    rate_columns,
    shape_columns,
)
from posetrack_cli.results.reader import Result, is_result, read_result
from posetrack_cli.tables import (
    COMMENT,
    LOST,
    NS_PER_UNIT,
    STATUS,
    Row,
    Table,
    TextFile,
    first_of,
    number_of,
    whole_of,
)

# Checks of ground truth


LENGTH_TOLERANCE = 1e-3
"""Tolerance of |q| = 1: rounding to four decimals causes up to 1e-4."""


LIKE_METRES = (500.0, 2000.0)
"""Ratio of distances in estimate and ground truth that indicates ground truth in metres."""


def unit_quaternions(quaternions: FloatArray, where: Callable[[int], str]) -> FloatArray:
    """Return quaternions (N, 4) normalised to unit length and w >= 0.

    Args:
        quaternions: x y z w, possibly rounded.
        where: returns the location of a row, for errors.

    Raises:
        TruthError: a length differs from 1 by more than ``LENGTH_TOLERANCE``.
    """
    lengths = np.linalg.norm(quaternions, axis=1)
    bad = np.flatnonzero(~(np.abs(lengths - 1.0) <= LENGTH_TOLERANCE))
    if bad.size:
        raise TruthError(
            "quaternion is not normalised",
            where=where(int(bad[0])),
            found=f"length {lengths[bad[0]]:.6g}",
            expected="1",
        )
    return canonical(quaternions)


def check_point_names(names: Sequence[str], found: Sequence[str], where: object) -> None:
    """Check that ground truth has all points of the estimate; additional points are allowed.

    Args:
        names: point names of the estimate.
        found: point names of the ground truth.
        where: location for errors.

    Raises:
        TruthError: points are missing.
    """
    missing = [name for name in names if name not in found]
    others = [name for name in found if name not in names]
    if missing:
        raise TruthError(
            "ground truth has other points than the result",
            where=where,
            found=", ".join(others) if others else f"{len(found)} points",
            expected=f"also {', '.join(missing)}",
        )


def truth_warnings(result: Result, track: Track, truth: Track, path: Path | None) -> Iterator[str]:
    """Yield notes on limitations of the ground truth and on signs that it does not fit the result.

    Args:
        result: evaluated result.
        track: its estimates.
        truth: ground truth.
        path: ground-truth file; None for ground truth in the result.
    """
    if truth.pixels is not None:
        yield f"the ground truth has only image points: {truth.name}"
    if path is not None and _of_another_recording(result, path):
        yield f"the ground truth {path.name} is of another recording than the result"
    distance, true_distance = _distance_mm(track), _distance_mm(truth)
    if LIKE_METRES[0] < distance / true_distance < LIKE_METRES[1]:
        yield (
            f"the ground truth may be in metres: it is {true_distance:.3g} mm from the camera, the estimate "
            f"{distance:.3g} mm"
        )


def _of_another_recording(result: Result, path: Path) -> bool:
    """Whether the ground truth is a result, and the recordings in both run records differ."""
    if path.is_dir() or not (is_mcap(path) and is_result(path)):
        return False
    mine, its = result.run.get(RECORDING_KEY), read_result(path).run.get(RECORDING_KEY)
    return bool(mine and its and mine != its)


def _distance_mm(track: Track) -> float:
    """Return the median distance from the camera; NaN if unknown."""
    places = track.position if track.position is not None else _first_point(track)
    if places is None or not len(places):
        return float("nan")
    return float(np.median(np.linalg.norm(places, axis=1))) or float("nan")


def _first_point(track: Track) -> FloatArray | None:
    return None if track.points is None else track.points[:, 0]


# Table rows in the text formats of ``export``: CSV, JSON and TUM


EXPECTED = "ground truth as MCAP, or as CSV, JSON or TUM in UTF-8, as written by posetrack export"
TUM_COLUMNS = ("t_s", *POSITION, *QUATERNION)
"""Columns of the TUM format, after conversion of positions from m to mm."""


def open_table(path: Path) -> Table:
    """Open a table and read its header.

    Raises:
        TruthError: the file cannot be read, is empty, or has an invalid format or header.
    """
    if path.suffix.lower() == ".json":
        file = TextFile(path, TruthError, EXPECTED, limits.REPORT_BYTES)
        rows = _json_rows(file)
    else:
        file = TextFile(path, TruthError, EXPECTED, most=None)
        rows = _tum_rows(file) if is_tum(file) else file.rows()
    return Table.of(file, rows, "a CSV file with a header row")


def is_tum(file: TextFile) -> bool:
    """Whether the first line that is not a comment has the eight numbers of the TUM format."""
    lines = (line for _, line in file.lines())
    first = next((line for line in lines if line.strip() and not line.startswith(COMMENT)), "")
    cells = first.split()
    return len(cells) == len(TUM_COLUMNS) and "," not in first and all(map(_is_number, cells))


def _tum_rows(file: TextFile) -> Iterator[Row]:
    """Yield TUM rows with positions in mm; cells that are not numbers are checked by the column reader."""
    yield 0, list(TUM_COLUMNS)
    for number, line in file.lines():
        cells = line.split()
        if cells and not line.startswith(COMMENT):
            yield number, [_in_mm(cell) if 0 < k <= len(POSITION) else cell for k, cell in enumerate(cells)]


def _in_mm(metres: str) -> str:
    return str(Decimal(metres) * 1000) if _is_number(metres) else metres


def _is_number(cell: str) -> bool:
    try:
        return Decimal(cell).is_finite()
    except InvalidOperation:
        return False


def _json_rows(file: TextFile) -> Iterator[Row]:
    value = file.json(nan=True)
    columns = value.get("columns") if isinstance(value, dict) else None
    if not isinstance(columns, dict):
        expected = "an object with columns, as written by posetrack export --format json"
        found = (
            ", ".join(map(str, islice(value, 5)))[:80] if isinstance(value, dict) else type(value).__name__
        )
        raise TruthError("no table in the JSON file", where=file.path, found=found, expected=expected)
    return file.json_rows(columns)


# Columns of numbers


STAMPS = ("stamp_ns", "t_s", "time_s")
"""Names of stamp columns, by precedence."""
BLOCK_ROWS = 4096  # text takes ten times the memory of the numbers


@dataclass(frozen=True, eq=False)
class Columns:
    """Numeric columns of a table.

    Attributes:
        path: the file.
        names: names of the C columns.
        values: (N, C) values.
        stamp_ns: (N,) stamps, ns, strictly increasing.
        lines: (N,) line numbers in the file, from 1.
        lost: number of skipped rows with status lost.
    """

    path: Path
    names: tuple[str, ...]
    values: FloatArray
    stamp_ns: IntArray
    lines: IntArray
    lost: int

    def of(self, names: Sequence[str]) -> FloatArray:
        """Return the values of these columns, (N, len(names))."""
        return self.values[:, [self.names.index(name) for name in names]]

    def where(self, row: int) -> str:
        """Return the location of a row, for errors."""
        return f"{self.path} line {int(self.lines[row])}"


def read_columns(table: Table, names: Sequence[str], optional: Collection[str] = ()) -> Columns:
    """Read the stamps and some columns of a table, skipping rows with ``status`` ``lost``.

    Args:
        table: table with a stamp column.
        names: names of the C columns.
        optional: columns whose cells may be empty or nan (read as NaN).

    Raises:
        TruthError: a cell is not a number, a row has the wrong length, stamps do not increase strictly, or
            the table has no rows; states file, line and column.
    """
    column = str(first_of(STAMPS, table.names))
    place, unit = table.names.index(column), NS_PER_UNIT[column]
    status = table.names.index(STATUS) if STATUS in table.names else None
    stamps: list[int] = []
    lines: list[int] = []
    blocks = []
    lost = 0
    rows = iter(table)
    while block := list(islice(rows, BLOCK_ROWS)):
        kept = [(line, row) for line, row in block if status is None or row[status].strip().lower() != LOST]
        lost += len(block) - len(kept)
        for line, row in kept:
            where = f"{table.file.where(line)}, column {column}"
            stamps.append(whole_of(row[place], where, TruthError, unit, least=-LATEST_NS))
            lines.append(line)
        blocks.append(_numbers(table, kept, names, optional))
    if not lines:
        found = f"{lost} rows, all lost" if lost else "no row after the header"
        raise TruthError("no ground truth", where=table.file.path, found=found, expected="a row per frame")
    read = Columns(table.file.path, tuple(names), np.vstack(blocks), np.array(stamps), np.array(lines), lost)
    _check_order(read, column)
    return read


def _numbers(table: Table, block: list[Row], names: Sequence[str], optional: Collection[str]) -> FloatArray:
    """Return the cells of some columns of a block of rows as numbers."""
    if not (names and block):
        return np.empty((len(block), len(names)))
    places = [table.names.index(name) for name in names]
    pick = itemgetter(*places, places[0])  # a repeated index, as itemgetter of one index returns no tuple
    try:
        values = np.array([list(map(float, pick(row))) for _, row in block])[:, :-1]
        required = [name not in optional for name in names]
        if np.isfinite(values[:, required]).all() and not (np.abs(values) > limits.NUMBER).any():
            return values
    except ValueError:
        pass
    return np.array(  # slow path: empty cells, or an error that must state its location
        [
            [
                number_of(
                    row[k], f"{table.file.where(line)}, column {name}", TruthError, optional=name in optional
                )
                for k, name in zip(places, names, strict=True)
            ]
            for line, row in block
        ]
    )


def _check_order(columns: Columns, column: str) -> None:
    back = np.flatnonzero(np.diff(columns.stamp_ns) <= 0)
    if back.size:
        row = int(back[0]) + 1
        stamp, before = int(columns.stamp_ns[row]), int(columns.stamp_ns[row - 1])
        raise TruthError(
            "duplicate stamp" if stamp == before else "stamps are not sorted",
            where=f"{columns.where(row)}, column {column}",
            found=f"{stamp} ns after {before} ns",
            expected="strictly increasing stamps",
        )


# Tracks from tables


def load_csv_track(path: Path, subject: Subject) -> Track:
    """Read a track from a CSV file with a header row; lines starting with ``#`` are comments.

    Columns in any order; all but the stamps are optional, and unknown columns are ignored:

    - ``stamp_ns`` (integer), or ``t_s`` or ``time_s`` (seconds, rounded to ns);
    - ``x_mm y_mm z_mm``: object origin in camera axes; ``qx qy qz qw``: rotation of ``camera_T_object``;
    - ``<point>_x_mm <point>_y_mm <point>_z_mm``: all points of the subject or none; joints of a hand in
      camera axes, points of a head **in the model frame**, which the pose transforms to camera axes;
    - ``<angle>_rad`` of a hand, ``<coefficient>`` of a head: all of the subject or none;
    - ``vx_mm_s vy_mm_s vz_mm_s`` in camera axes, ``wx_rad_s wy_rad_s wz_rad_s`` in body axes,
      ``<angle>_rad_s`` or ``<coefficient>_per_s``: velocities; empty or nan cells are unknown;
    - ``status``: rows with ``lost`` are skipped.

    CSV exports of results have this format. JSON exports have the same columns, TUM exports only the pose.

    Args:
        path: the file.
        subject: subject of the result, which determines the column names.

    Returns:
        A track without status, with normalised quaternions. ``shape_names`` is empty if the file has no
        shape; missing entries of ``twist`` are NaN.

    Raises:
        TruthError: the file is invalid; states file, line and column.
    """
    table = open_table(path)
    layout = _Layout.of(table, subject)
    read = read_columns(table, layout.columns, layout.velocities)
    name = f"{path.name} without its {read.lost} lost frames" if read.lost else path.name
    position = read.of(POSITION) if layout.position else None
    quaternion = None
    if layout.quaternion:
        columns = f"columns {' '.join(QUATERNION)}"
        quaternion = unit_quaternions(read.of(QUATERNION), lambda row: f"{read.where(row)}, {columns}")
    return Track(
        name,
        subject.name,
        shape_names=subject.shape_names if layout.shape else (),
        point_names=layout.points,
        point_parents=subject.point_parents if layout.points else (),
        stamp_ns=read.stamp_ns,
        position=position,
        quaternion=quaternion,
        shape=read.of(shape_columns(subject)) if layout.shape else None,
        twist=_twist(read, subject, layout),
        points=_points(read, layout, position, quaternion) if layout.points else None,
    )


@dataclass(frozen=True)
class _Layout:
    """Columns of a file.

    Attributes:
        subject: name of the subject.
        position, quaternion: whether the file has them.
        points: names of the points, () for none.
        shape, velocities: names of their columns, () for none.
    """

    subject: str
    position: bool
    quaternion: bool
    points: tuple[str, ...]
    shape: tuple[str, ...]
    velocities: tuple[str, ...]

    @classmethod
    def of(cls, table: Table, subject: Subject) -> _Layout:
        """Return the columns of the subject in a header row."""
        groups = (LINEAR_VELOCITY, ANGULAR_VELOCITY, rate_columns(subject))
        layout = cls(
            subject.name,
            position=_has_all(table, POSITION),
            quaternion=_has_all(table, QUATERNION),
            points=_point_names(table, subject),
            shape=shape_columns(subject) if _has_all(table, shape_columns(subject)) else (),
            velocities=tuple(name for group in groups if _has_all(table, group) for name in group),
        )
        _check(table, subject, layout)
        return layout

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns to read."""
        pose = (POSITION if self.position else ()) + (QUATERNION if self.quaternion else ())
        return pose + point_columns(self.points) + self.shape + self.velocities


def _check(table: Table, subject: Subject, layout: _Layout) -> None:
    """Raise an error unless there are stamps and something to compare."""
    if not layout.columns:
        raise TruthError(
            "no known column",
            where=table.file.path,
            found=table.shown,
            expected=_known(subject),
        )
    if first_of(STAMPS, table.names) is None:
        expected = " or ".join(STAMPS)
        raise TruthError("no stamp column", where=table.file.path, expected=expected)
    if kind_of(subject.name).rigid and layout.points and not (layout.position and layout.quaternion):
        raise TruthError(
            f"points of a {subject.name} are in its model frame and require the pose",
            where=table.file.path,
            expected=f"columns {', '.join((*POSITION, *QUATERNION))}",
        )


def _has_all(table: Table, group: Sequence[str]) -> bool:
    """Whether the file has the columns of a group.

    Raises:
        TruthError: the file has only some of them.
    """
    missing = [name for name in group if name not in table.names]
    if missing and len(missing) < len(group):
        expected = f"all or none of {', '.join(group)}"
        raise TruthError(f"missing columns {', '.join(missing)}", where=table.file.path, expected=expected)
    return bool(group) and not missing


def _point_names(table: Table, subject: Subject) -> tuple[str, ...]:
    """Return the point names of the subject if the file has its points; () if it has no points at all."""
    begun = [name for name in subject.point_names if set(point_columns([name])) & set(table.names)]
    found = {name.removesuffix("_x_mm") for name in table.names if name.endswith("_x_mm")}
    if not (begun or found) or not subject.point_names:
        return ()
    check_point_names(subject.point_names, sorted({*begun, *found}), table.file.path)
    for name in subject.point_names:
        _has_all(table, point_columns([name]))
    return subject.point_names


def _known(subject: Subject) -> str:
    """Return a description of the columns for a subject."""
    point, shape = "<point>", replace(subject, shape_names=("<name>",))
    groups = [
        "/".join(STAMPS),
        *(" ".join(group) for group in (POSITION, QUATERNION, LINEAR_VELOCITY, ANGULAR_VELOCITY)),
        f"{' '.join(point_columns([point]))} for {point} {' '.join(subject.point_names)}",
    ]
    if subject.shape_names:
        columns = " ".join(shape_columns(shape) + rate_columns(shape))
        groups.append(f"{columns} for <name> {' '.join(subject.shape_names)}")
    return ", ".join(groups)


def _points(
    read: Columns, layout: _Layout, position: FloatArray | None, quaternion: FloatArray | None
) -> FloatArray:
    """Return the points (N, P, 3) in camera axes; files have those of rigid subjects in the model frame."""
    points = read.of(point_columns(layout.points)).reshape(len(read.values), -1, 3)
    if not kind_of(layout.subject).rigid or position is None or quaternion is None:
        return points
    return in_camera(points, position[:, None], quaternion[:, None])


def _twist(read: Columns, subject: Subject, layout: _Layout) -> FloatArray | None:
    """Return the velocities (N, 6 + K), NaN for missing entries; None if the file has none."""
    names = (*LINEAR_VELOCITY, *ANGULAR_VELOCITY, *(rate_columns(subject) if layout.shape else ()))
    twist = np.full((len(read.values), len(names)), np.nan)
    for column, name in enumerate(names):
        if name in read.names:
            twist[:, column] = read.values[:, read.names.index(name)]
    return None if np.isnan(twist).all() else twist
