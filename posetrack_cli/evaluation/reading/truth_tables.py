"""Truth in tables (CSV, JSON, TUM): rows, columns, the track that they give, and what is checked of it."""

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

# What every truth must fulfil, and what makes one look like that of something else


LENGTH_TOLERANCE = 1e-3
"""How far |q| of a truth may be from 1: four decimals leave 1e-4, what is no rotation mostly more."""


LIKE_METRES = (500.0, 2000.0)
"""How much farther away an estimate is than a truth in metres: 1000 times, give or take an error."""


def unit_quaternions(quaternions: FloatArray, where: Callable[[int], str]) -> FloatArray:
    """Return quaternions (N, 4) of unit length with w >= 0.

    Args:
        quaternions: x y z w, rounded perhaps.
        where: says where a row is.

    Raises:
        TruthError: one is farther than ``LENGTH_TOLERANCE`` from unit length.
    """
    lengths = np.linalg.norm(quaternions, axis=1)
    bad = np.flatnonzero(~(np.abs(lengths - 1.0) <= LENGTH_TOLERANCE))
    if bad.size:
        raise TruthError(
            "quaternion is no rotation",
            where=where(int(bad[0])),
            found=f"length {lengths[bad[0]]:.6g}",
            expected="1",
        )
    return canonical(quaternions)


def check_point_names(names: Sequence[str], found: Sequence[str], where: object) -> None:
    """Raise unless a truth has every point of the estimate; further ones are no fault.

    Args:
        names: of the estimate's points.
        found: of the truth's points.
        where: the truth.

    Raises:
        TruthError: names the points that are missing, and those that the estimate does not have.
    """
    missing = [name for name in names if name not in found]
    others = [name for name in found if name not in names]
    if missing:
        raise TruthError(
            "truth has other points than the result",
            where=where,
            found=", ".join(others) if others else f"{len(found)} points",
            expected=f"also {', '.join(missing)}",
        )


def truth_warnings(result: Result, track: Track, truth: Track, path: Path | None) -> Iterator[str]:
    """Yield a note for each reason to doubt that a truth is of what a result is of.

    Args:
        result: what is measured.
        track: its estimates.
        truth: what they are measured against.
        path: the file that it was taken from; None for what the result carries.
    """
    if truth.pixels is not None:
        yield f"the truth has only image points: {truth.name}"
    if path is not None and _of_another_recording(result, path):
        yield f"the truth {path.name} was made from another recording than the result"
    distance, true_distance = _distance_mm(track), _distance_mm(truth)
    if LIKE_METRES[0] < distance / true_distance < LIKE_METRES[1]:
        yield (
            f"the truth is {true_distance:.3g} mm from the camera, the estimate {distance:.3g} mm: "
            "is it in metres?"
        )


def _of_another_recording(result: Result, path: Path) -> bool:
    """Whether a truth is another run's estimates, and both say what they were made from."""
    if path.is_dir() or not (is_mcap(path) and is_result(path)):
        return False
    mine, its = result.run.get(RECORDING_KEY), read_result(path).run.get(RECORDING_KEY)
    return bool(mine and its and mine != its)


def _distance_mm(track: Track) -> float:
    """The median distance from the camera; NaN where a track does not tell it."""
    places = track.position if track.position is not None else _first_point(track)
    if places is None or not len(places):
        return float("nan")
    return float(np.median(np.linalg.norm(places, axis=1))) or float("nan")


def _first_point(track: Track) -> FloatArray | None:
    return None if track.points is None else track.points[:, 0]


# Rows of a truth's table, in whichever of the text formats that ``export`` writes: CSV, JSON or TUM's


EXPECTED = "a truth is an MCAP file, or an export as CSV, JSON or TUM in UTF-8"
TUM_COLUMNS = ("t_s", *POSITION, *QUATERNION)
"""Of a trajectory in TUM's format, whose positions are metres."""


def open_table(path: Path) -> Table:
    """Read the header of a table.

    Raises:
        TruthError: it cannot be read, is empty, not of its format, or has a header that cannot be meant.
    """
    if path.suffix.lower() == ".json":
        file = TextFile(path, TruthError, EXPECTED, limits.REPORT_BYTES)
        rows = _json_rows(file)
    else:
        file = TextFile(path, TruthError, EXPECTED, most=None)
        rows = _tum_rows(file) if is_tum(file) else file.rows()
    return Table.of(file, rows, "a CSV file with a header row")


def is_tum(file: TextFile) -> bool:
    """Return whether the first line that is not a comment has TUM's eight numbers, separated by spaces."""
    lines = (line for _, line in file.lines())
    first = next((line for line in lines if line.strip() and not line.startswith(COMMENT)), "")
    cells = first.split()
    return len(cells) == len(TUM_COLUMNS) and "," not in first and all(map(_is_number, cells))


def _tum_rows(file: TextFile) -> Iterator[Row]:
    """Yield TUM's rows with positions in mm; what is not a number is left to whoever reads the columns."""
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
    said = file.json(nan=True)
    columns = said.get("columns") if isinstance(said, dict) else None
    if not isinstance(columns, dict):
        expected = "an object with columns, as posetrack export --format json writes it"
        found = ", ".join(map(str, islice(said, 5)))[:80] if isinstance(said, dict) else type(said).__name__
        raise TruthError("holds no table", where=file.path, found=found, expected=expected)
    return file.json_rows(columns)


# Columns of numbers from a table, with errors that name the line and the column


STAMPS = ("stamp_ns", "t_s", "time_s")
"""Columns of stamps: the first that a file has is taken."""
BLOCK_ROWS = 4096  # as text a row takes ten times its numbers' memory


@dataclass(frozen=True, eq=False)
class Columns:
    """Some columns of a table.

    Attributes:
        path: the file.
        names: of the C columns.
        values: (N, C).
        stamp_ns: (N,) strictly increasing.
        lines: (N,) the line of each row in the file, counted from 1.
        lost: how many rows of frames that were lost are left out.
    """

    path: Path
    names: tuple[str, ...]
    values: FloatArray
    stamp_ns: IntArray
    lines: IntArray
    lost: int

    def of(self, names: Sequence[str]) -> FloatArray:
        """Return the columns of these names, (N, len(names))."""
        return self.values[:, [self.names.index(name) for name in names]]

    def where(self, row: int) -> str:
        """Say where a row is."""
        return f"{self.path} line {int(self.lines[row])}"


def read_columns(table: Table, names: Sequence[str], optional: Collection[str] = ()) -> Columns:
    """Read the stamps and some columns of a table, without the rows whose ``status`` is ``lost``.

    Args:
        table: has a column of stamps.
        names: of the C columns.
        optional: those of them in which a cell may be empty or nan, which is NaN then.

    Raises:
        TruthError: names file, line and column of what is no number, of a row that is too short or too
            long, of a stamp that is not later than the one before. Also for a table without rows.
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
        raise TruthError("has no truth", where=table.file.path, found=found, expected="a row per frame")
    read = Columns(table.file.path, tuple(names), np.vstack(blocks), np.array(stamps), np.array(lines), lost)
    _check_order(read, column)
    return read


def _numbers(table: Table, block: list[Row], names: Sequence[str], optional: Collection[str]) -> FloatArray:
    """Return the cells of some columns of a block of rows as numbers."""
    if not (names and block):
        return np.empty((len(block), len(names)))
    places = [table.names.index(name) for name in names]
    pick = itemgetter(*places, places[0])  # one more, so that it is a tuple also of a single column
    try:
        values = np.array([list(map(float, pick(row))) for _, row in block])[:, :-1]
        required = [name not in optional for name in names]
        if np.isfinite(values[:, required]).all() and not (np.abs(values) > limits.NUMBER).any():
            return values
    except ValueError:
        pass
    return np.array(  # slow: for empty cells, or a fault that needs its place
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
            "stamp occurs twice" if stamp == before else "stamps are not sorted",
            where=f"{columns.where(row)}, column {column}",
            found=f"{stamp} ns after {before} ns",
            expected="each later than the one before",
        )


# A trajectory from a CSV file: poses, points, shape and velocities, whichever it has


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
    latter those of the pose alone.

    Args:
        path: the file.
        subject: of the result, whose names the columns have.

    Returns:
        A track without status; quaternions normalised; ``shape_names`` is empty if the file has no shape, and
        an entry of ``twist`` that the file does not have is NaN.

    Raises:
        TruthError: names file, line and column of what cannot be used.
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
    def of(cls, table: Table, subject: Subject) -> _Layout:
        """Find the subject's columns in a header row."""
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
    """Raise unless there are stamps and something to compare."""
    if not layout.columns:
        raise TruthError(
            "no column is known",
            where=table.file.path,
            found=table.shown,
            expected=_known(subject),
        )
    if first_of(STAMPS, table.names) is None:
        expected = " or ".join(STAMPS)
        raise TruthError("has no column of stamps", where=table.file.path, expected=expected)
    if kind_of(subject.name).rigid and layout.points and not (layout.position and layout.quaternion):
        raise TruthError(
            f"points of a {subject.name} are in its model frame and need its pose",
            where=table.file.path,
            expected=", ".join((*POSITION, *QUATERNION)),
        )


def _has_all(table: Table, group: Sequence[str]) -> bool:
    """Whether the file has the columns of a group.

    Raises:
        TruthError: it has only some of them.
    """
    missing = [name for name in group if name not in table.names]
    if missing and len(missing) < len(group):
        expected = f"all or none of {', '.join(group)}"
        raise TruthError(f"lacks {', '.join(missing)}", where=table.file.path, expected=expected)
    return bool(group) and not missing


def _point_names(table: Table, subject: Subject) -> tuple[str, ...]:
    """Return the subject's point names if the file has its points, none if it has no points at all."""
    begun = [name for name in subject.point_names if set(point_columns([name])) & set(table.names)]
    found = {name.removesuffix("_x_mm") for name in table.names if name.endswith("_x_mm")}
    if not (begun or found) or not subject.point_names:
        return ()
    check_point_names(subject.point_names, sorted({*begun, *found}), table.file.path)
    for name in subject.point_names:
        _has_all(table, point_columns([name]))
    return subject.point_names


def _known(subject: Subject) -> str:
    """Return what columns a file of this subject may have."""
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
    """Return the points (N, P, 3) in camera axes; those of a rigid subject come in its own."""
    points = read.of(point_columns(layout.points)).reshape(len(read.values), -1, 3)
    if not kind_of(layout.subject).rigid or position is None or quaternion is None:
        return points
    return in_camera(points, position[:, None], quaternion[:, None])


def _twist(read: Columns, subject: Subject, layout: _Layout) -> FloatArray | None:
    """Return the velocities (N, 6 + K), NaN where the file has none; None if it has none at all."""
    names = (*LINEAR_VELOCITY, *ANGULAR_VELOCITY, *(rate_columns(subject) if layout.shape else ()))
    twist = np.full((len(read.values), len(names)), np.nan)
    for column, name in enumerate(names):
        if name in read.names:
            twist[:, column] = read.values[:, read.names.index(name)]
    return None if np.isnan(twist).all() else twist
