"""Truth in tables (CSV, JSON, TUM): rows, columns, the track that they give, and what is checked of it."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from itertools import islice
from operator import itemgetter
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.csv_rows import COMMENT, Row, csv_rows, text_lines
from posetrack_cli.errors import TruthError
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.files import read_text
from posetrack_cli.geometry.rigid import in_camera
from posetrack_cli.geometry.rotations import canonical
from posetrack_cli.mcap.stream import is_mcap
from posetrack_cli.recording.base import RECORDING_KEY
from posetrack_cli.recording.matching import LATEST_NS
from posetrack_cli.results.estimate import Status, Subject, kind_of
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
from posetrack_cli.units import NS_PER_S

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


def table_rows(path: Path) -> Iterator[Row]:
    """Yield the rows of a file, the header row first.

    Raises:
        TruthError: it cannot be read, or names file and line of what is not of its format.
    """
    if path.suffix.lower() == ".json":
        return _json_rows(path)
    return _tum_rows(path) if is_tum(path) else csv_rows(path, TruthError, EXPECTED)


def is_tum(path: Path) -> bool:
    """Return whether the first line that is not a comment has TUM's eight numbers, separated by spaces."""
    lines = (line for _, line in text_lines(path, TruthError, EXPECTED))
    first = next((line for line in lines if line.strip() and not line.startswith(COMMENT)), "")
    cells = first.split()
    return len(cells) == len(TUM_COLUMNS) and "," not in first and all(map(_is_number, cells))


def _tum_rows(path: Path) -> Iterator[Row]:
    """Yield TUM's rows with positions in mm; what is not a number is left to whoever reads the columns."""
    yield 0, list(TUM_COLUMNS)
    for number, line in text_lines(path, TruthError, EXPECTED):
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


def _json_rows(path: Path) -> Iterator[Row]:
    columns = _columns(path)
    yield 0, list(columns)
    for number, row in enumerate(zip(*columns.values(), strict=True), 1):
        yield number, ["" if value is None else str(value) for value in row]


def _columns(path: Path) -> dict[str, list[Any]]:
    """Return the columns of a JSON export: lists of one length by name."""
    try:
        said = json.loads(read_text(path, limits.REPORT_BYTES))
    except OSError as error:
        raise TruthError("cannot be read", where=path, found=error.strerror or error) from error
    except (ValueError, RecursionError) as error:
        found = "values nested too deeply" if isinstance(error, RecursionError) else error
        raise TruthError("is no JSON", where=path, found=found, hint=EXPECTED) from error
    columns = said.get("columns") if isinstance(said, dict) else None
    if not isinstance(columns, dict) or not all(isinstance(values, list) for values in columns.values()):
        expected = "an object with columns, as posetrack export --format json writes it"
        found = ", ".join(map(str, islice(said, 5)))[:80] if isinstance(said, dict) else type(said).__name__
        raise TruthError("holds no table", where=path, found=found, expected=expected)
    if len({len(values) for values in columns.values()}) > 1:
        raise TruthError("columns are not of one length", where=path)
    return columns


# Columns of numbers from a file of rows, with errors that name the line and the column


SEPARATORS = {";": "semicolons", "\t": "tabs", " ": "spaces"}
"""What other programs write between columns."""
STATUS = "status"
BLOCK_ROWS = 4096  # as text a row takes ten times its numbers' memory
SHOWN = 40
"""Characters of a cell that an error shows."""
NS_PER_UNIT = {"stamp_ns": 1, "t_s": NS_PER_S, "time_s": NS_PER_S}
"""Columns of stamps, the first that a file has is taken, and what one of their units is in ns."""


@dataclass(frozen=True)
class CsvHeader:
    """What a file's header row says.

    Attributes:
        path: the file.
        columns: their names.
    """

    path: Path
    columns: tuple[str, ...]

    @property
    def stamp_column(self) -> str | None:
        """The column of the stamps, None if there is none."""
        return next((name for name in NS_PER_UNIT if name in self.columns), None)


def read_header(path: Path) -> CsvHeader:
    """Read the header row, the first that is no comment.

    Raises:
        TruthError: the file cannot be read, is empty, is not UTF-8, is not separated by commas, or has a
            column twice.
    """
    _, row = next(table_rows(path), (0, []))
    if not row:
        raise TruthError("is empty", where=path, expected="a CSV file with a header row")
    _check_separator(path, row)
    columns = tuple(cell.strip() for cell in row)
    if len(columns) > limits.COLUMNS:
        raise TruthError("has too many columns", where=path, found=len(columns), expected=limits.COLUMNS)
    twice = sorted(name for name, count in Counter(columns).items() if name and count > 1)
    if twice:
        raise TruthError("column occurs twice", where=path, found=", ".join(twice))
    return CsvHeader(path, columns)


def _check_separator(path: Path, row: list[str]) -> None:
    """Raise where a header row has a column of stamps once it is separated by something else than commas."""
    cells = {name: {cell.strip(' "') for cell in row[0].split(sign)} for sign, name in SEPARATORS.items()}
    other = next((name for name, own in cells.items() if len(own) > 1 and own & NS_PER_UNIT.keys()), None)
    if other is not None:
        raise TruthError(
            "columns are not separated by commas",
            where=path,
            found=other,
            hint="write it with commas, and with points as decimal signs",
        )


@dataclass(frozen=True, eq=False)
class CsvTable:
    """Some columns of a file.

    Attributes:
        path: the file.
        columns: names of the C columns.
        values: (N, C).
        stamp_ns: (N,) strictly increasing.
        lines: (N,) the line of each row in the file, counted from 1.
        lost: how many rows of frames that were lost are left out.
    """

    path: Path
    columns: tuple[str, ...]
    values: FloatArray
    stamp_ns: IntArray
    lines: IntArray
    lost: int

    def of(self, names: Sequence[str]) -> FloatArray:
        """Return the columns of these names, (N, len(names))."""
        return self.values[:, [self.columns.index(name) for name in names]]

    def where(self, row: int) -> str:
        """Say where a row is."""
        return f"{self.path} line {int(self.lines[row])}"


def read_table(header: CsvHeader, columns: Sequence[str], optional: Collection[str] = ()) -> CsvTable:
    """Read the stamps and some columns of a file, without the rows whose ``status`` is ``lost``.

    Args:
        header: of the file; has a column of stamps.
        columns: to read, C names.
        optional: those of them in which a cell may be empty or nan, which is NaN then.

    Raises:
        TruthError: names file, line and column of what is no number, of a row that is too short or too
            long, of a stamp that is not later than the one before. Also for a file without rows.
    """
    stamps: list[int] = []
    lines: list[int] = []
    blocks = []
    lost = 0
    for block in _blocks(header):
        kept = _not_lost(header, block)
        lost += len(block) - len(kept)
        stamps += _stamps(header, kept)
        lines += [line for line, _ in kept]
        blocks.append(_numbers(header, kept, columns, optional))
    if not lines:
        found = f"{lost} rows, all lost" if lost else "no row after the header"
        raise TruthError("has no truth", where=header.path, found=found, expected="a row per frame")
    values = np.vstack(blocks)
    table = CsvTable(header.path, tuple(columns), values, np.array(stamps), np.array(lines), lost)
    _check_order(table, str(header.stamp_column))
    return table


def _blocks(header: CsvHeader) -> Iterator[list[Row]]:
    """Yield the rows after the header, some at a time, each of the header's length."""
    rows = islice(table_rows(header.path), 1, None)
    while block := list(islice(rows, BLOCK_ROWS)):
        for line, row in block:
            if len(row) != len(header.columns):
                raise TruthError(
                    "row does not fit the header",
                    where=f"{header.path} line {line}",
                    found=f"{len(row)} cells",
                    expected=len(header.columns),
                )
        yield block


def _not_lost(header: CsvHeader, block: list[Row]) -> list[Row]:
    if STATUS not in header.columns:
        return block
    place = header.columns.index(STATUS)
    return [(line, row) for line, row in block if row[place].strip() != Status.LOST.value]


def _stamps(header: CsvHeader, block: list[Row]) -> list[int]:
    column = str(header.stamp_column)
    place, unit = header.columns.index(column), NS_PER_UNIT[column]
    return [
        _stamp(row[place].strip(), unit, f"{header.path} line {line}, column {column}") for line, row in block
    ]


def _stamp(cell: str, ns_per_unit: int, where: str) -> int:
    """Return a stamp, ns; by way of decimals, since floats of today's seconds are off by 0.2 microseconds."""
    try:
        stamp = Decimal(cell) * ns_per_unit
        if abs(stamp) > LATEST_NS:  # before it is rounded: 1e99999 has as many digits
            raise TruthError("stamp does not fit into 64 bits", where=where, found=cell)
        if ns_per_unit == 1 and stamp != int(stamp):
            raise TruthError("stamp is no whole number", where=where, found=cell)
        return round(stamp)
    except (ValueError, ArithmeticError) as error:
        raise TruthError("stamp is not a number", where=where, found=repr(cell)) from error


def _numbers(
    header: CsvHeader, block: list[Row], columns: Sequence[str], optional: Collection[str]
) -> FloatArray:
    """Return the cells of some columns of a block of rows as numbers."""
    if not (columns and block):
        return np.empty((len(block), len(columns)))
    places = [header.columns.index(name) for name in columns]
    pick = itemgetter(*places, places[0])  # one more, so that it is a tuple also of a single column
    try:
        values = np.array([list(map(float, pick(row))) for _, row in block])[:, :-1]
        required = [name not in optional for name in columns]
        if np.isfinite(values[:, required]).all() and not (np.abs(values) > limits.NUMBER).any():
            return values
    except ValueError:
        pass
    return np.array(
        [
            [
                cell_number(row[place], name in optional, f"{header.path} line {line}, column {name}")
                for place, name in zip(places, columns, strict=True)
            ]
            for line, row in block
        ]
    )


def cell_number(cell: str, optional: bool, where: str) -> float:
    """Return one cell; slow, for blocks with empty cells or with a fault that needs its place.

    Args:
        cell: its text.
        optional: whether an empty cell or ``nan`` is NaN.
        where: the cell is.

    Raises:
        TruthError: it is not a number, not finite or too large.
    """
    cell = cell.strip()
    if optional and cell.lower() in ("", "nan"):
        return math.nan
    try:
        value = float(cell)
    except ValueError as error:
        raise TruthError("is not a number", where=where, found=repr(cell[:SHOWN])) from error
    if not math.isfinite(value):
        raise TruthError("is not finite", where=where, found=cell[:SHOWN])
    if abs(value) > limits.NUMBER:
        raise TruthError(
            "is too large", where=where, found=cell[:SHOWN], expected=f"{limits.NUMBER:g} at most"
        )
    return value


def _check_order(table: CsvTable, column: str) -> None:
    back = np.flatnonzero(np.diff(table.stamp_ns) <= 0)
    if back.size:
        row = int(back[0]) + 1
        stamp, before = int(table.stamp_ns[row]), int(table.stamp_ns[row - 1])
        raise TruthError(
            "stamp occurs twice" if stamp == before else "stamps are not sorted",
            where=f"{table.where(row)}, column {column}",
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
