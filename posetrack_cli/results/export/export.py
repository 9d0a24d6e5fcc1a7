"""Export of a result as text, as arrays for numpy, or in a format of another module."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import repeat
from pathlib import Path

import numpy as np

from posetrack_cli.errors import UsageError
from posetrack_cli.files import open_output
from posetrack_cli.outputs import check_target, whole_or_nothing
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.derived import UNITS, derived, range_of_motion
from posetrack_cli.results.estimate import kind_of
from posetrack_cli.results.export.source import (
    ExportSource,
    header_lines,
    header_values,
)
from posetrack_cli.results.export.table import ColumnGroup, Values
from posetrack_cli.results.fields import BY_NAME, NUMBERS
from posetrack_cli.tables import csv_of
from posetrack_cli.text import printable, printable_json
from posetrack_cli.units import METRES_PER_MM, NS_PER_S

TUM_FIELDS = ("stamp_ns", "position", "quaternion")


def csv_text(source: ExportSource) -> Iterator[str]:
    """Yield a header row and one row per frame, 1000 frames at a time.

    There are no comment lines, as spreadsheets and ``pandas.read_csv`` would read them as rows. Column
    names end in their units; the header of ``json_text`` has descriptions. Numbers round-trip exactly;
    missing values are empty cells.
    """
    blocks, groups = source.begun_blocks(), source.table
    yield csv_of([[name for group in groups for name in group.names]])
    for block in blocks:
        yield csv_of(zip(*_cells(groups, block), strict=True))


def tracks_csv_text(sources: Sequence[ExportSource]) -> Iterator[str]:
    """Yield ``csv_text`` of several subjects, one after the other, with a first column ``track``.

    Raises:
        UsageError: the subjects have different columns.
    """
    headers = [[name for group in source.table for name in group.names] for source in sources]
    if any(header != headers[0] for header in headers):
        where = sources[0].result.path
        raise UsageError("tracks have different columns", where=where, hint="export each with --of NAME")
    yield csv_of([["track", *headers[0]]])
    for source in sources:
        for block in source.begun_blocks():
            cells = _cells(source.table, block)
            yield csv_of(zip(repeat(source.result.subject.label), *cells))


def tum_text(source: ExportSource) -> Iterator[str]:
    """Yield the trajectory in TUM format: ``timestamp tx ty tz qx qy qz qw``, seconds and metres.

    The pose is ``camera_T_object``, the object's pose in camera axes. The format has no status and no
    points.
    """
    blocks = source.begun_blocks(TUM_FIELDS)
    yield from _comments(header_lines(source))
    yield from _comments(["timestamp tx ty tz qx qy qz qw: s, m, unit quaternion"])
    for block in blocks:
        poses = np.hstack([METRES_PER_MM * block["position"], block["quaternion"]]).tolist()
        for stamp, pose in zip(block["stamp_ns"].tolist(), poses, strict=True):
            yield f"{stamp // NS_PER_S}.{stamp % NS_PER_S:09d} {' '.join(map(repr, pose))}\n"


def json_text(source: ExportSource) -> Iterator[str]:
    """Yield one object: ``header``, and ``columns`` with a list of N values per column of the table.

    Missing values are null.
    """
    columns = source.columns()
    header = printable_json(json.dumps(header_values(source), indent=1, ensure_ascii=False))
    yield f'{{"header": {header},\n"columns": {{'
    between = "\n"
    for group in source.table:
        for name, values in zip(group.names, group.values(columns).T, strict=True):
            key = printable_json(json.dumps(name, ensure_ascii=False))
            yield f"{between}{key}: {json.dumps(_plain(values))}"
            between = ",\n"
    yield "\n}}\n"


def rom_text(source: ExportSource) -> Iterator[str]:
    """Yield the range of motion as CSV: a row per angle, empty cells without tracked frames."""
    subject = source.result.subject
    further = (NUMBERS,) if subject.number_names else ()
    columns = source.columns(("stamp_ns", "status", "quaternion", "shape", *further))
    table = range_of_motion(columns, subject)
    yield csv_of([list(table)])
    yield csv_of(zip(*map(_plain, table.values()), strict=True))


def _comments(lines: Iterable[str]) -> Iterator[str]:
    for line in lines:
        text = line if line == line.rstrip() and line.isprintable() else " ".join(line.split())
        yield f"# {printable(text)}\n"


def _cells(groups: tuple[ColumnGroup, ...], block: Columns) -> Iterator[list[object]]:
    """Yield the cells of each column; booleans as 1 and 0."""
    for group in groups:
        for values in group.values(block).T:
            yield _plain(values.astype(np.int64) if values.dtype.kind == "b" else values)


def _plain(values: Values) -> list[object]:
    """Return Python values, whose floats round-trip through str(), and None for NaN."""
    if values.dtype.kind == "f" and np.isnan(values).any():
        return [None if value != value else value for value in values.tolist()]
    plain: list[object] = values.tolist()
    return plain


TEXT_FORMATS: Mapping[str, Callable[[ExportSource], Iterator[str]]] = {
    "csv": csv_text,
    "tum": tum_text,
    "json": json_text,
    "rom": rom_text,
}
ROLL_PITCH_YAW = "roll_pitch_yaw_deg"


def export_file(
    source: ExportSource, format_name: str, out: Path, *, overwrite: bool = False
) -> tuple[str, ...]:
    """Write a file in one of ``FORMATS`` atomically.

    Returns:
        Lines about data that the format required to be dropped or filled in.

    Raises:
        UsageError: ``out`` is a folder, the result itself, or exists and may not be replaced.
        ResultError: it cannot be written, or the result cannot be read.
    """
    if format_name in TEXT_FORMATS:
        save_text(text_pieces(source, format_name), source, out, overwrite=overwrite)
        return ()
    with _whole(source, out, overwrite=overwrite) as part:
        return tuple(BINARY_FORMATS[format_name](source, part))


def save_text(pieces: Iterable[str], source: ExportSource, out: Path, *, overwrite: bool = False) -> None:
    """Write text to a file like ``export_file``."""
    with _whole(source, out, overwrite=overwrite) as part, open_output(part) as stream:
        for piece in pieces:
            # Names may have surrogates from file names that are not UTF-8.
            stream.write(piece.encode("utf-8", "backslashreplace"))


@contextmanager
def _whole(source: ExportSource, out: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary name that is renamed to ``out`` at the end; never replace the result itself."""
    check_target(out, overwrite=overwrite, source=source.result.path, source_name="result")
    with whole_or_nothing(out) as part:
        yield part


def text_pieces(source: ExportSource, format_name: str) -> Iterator[str]:
    """Yield text in one of ``TEXT_FORMATS``, piece by piece.

    Raises:
        UsageError: it is not a text format.
        ResultError: the result cannot be read.
    """
    if format_name not in TEXT_FORMATS:
        raise UsageError(
            f"{format_name} is not a text format",
            expected=", ".join(TEXT_FORMATS),
            hint="name a file with -o",
        )
    yield from TEXT_FORMATS[format_name](source)


def write_npz(source: ExportSource, path: Path) -> None:
    """Write every field of the estimates as one array, frames first.

    Also contains ``roll_pitch_yaw_deg`` (N, 3), the arrays of ``results.derived``, the names of their parts
    (``point_names``, ``camera_names`` etc.), and ``header``, a JSON text with units, Euler order and the run
    record.
    """
    columns, subject, cameras = source.columns(), source.result.subject, source.result.image_cameras
    more = derived(columns, subject, cameras)
    header = {key: value for key, value in header_values(source).items() if key != "meanings"}
    header["units"] = _units((*source.result.field_names, *more))  # of arrays
    extras = {
        ROLL_PITCH_YAW: np.degrees(kind_of(subject.name).euler_angles(columns["quaternion"])),
        "shape_names": np.array(subject.shape_names, dtype=np.str_),
        "point_names": np.array(subject.point_names, dtype=np.str_),
        "header": np.array(json.dumps(header, ensure_ascii=False)),
    }
    for name, names in {
        "number_names": subject.number_names,
        "camera_names": tuple(camera.name for camera in cameras),
        "angle_names": source.result.angle_names,
    }.items():
        if names:
            extras[name] = np.array(names, dtype=np.str_)
    with open_output(path) as stream:
        np.savez(stream, **columns, **more, **extras)  # type: ignore[arg-type]


def _units(fields: Iterable[str]) -> dict[str, str]:
    """Return the units of the arrays, including derived ones."""
    units = {}
    for name in fields:
        if unit := UNITS.get(name) or BY_NAME[name].unit:
            units[name] = unit
        if name == "quaternion":
            units[ROLL_PITCH_YAW] = "deg"
    return units


def _write_npz(source: ExportSource, path: Path) -> Iterator[str]:
    write_npz(source, path)
    yield from ()


def _write_c3d(source: ExportSource, path: Path) -> Iterator[str]:
    from posetrack_cli.results.export.c3d import write_c3d

    yield from write_c3d(source, path).notes("their markers are not seen")


def _write_parquet(source: ExportSource, path: Path) -> Iterator[str]:
    from posetrack_cli.results.export.parquet import write_parquet

    write_parquet(source, path)
    yield from ()


def _write_nwb(source: ExportSource, path: Path) -> Iterator[str]:
    from posetrack_cli.results.export.nwb import write_nwb

    write_nwb(source, path)
    yield from ()


def _write_ros2(source: ExportSource, path: Path) -> Iterator[str]:
    from posetrack_cli.results.export.ros2 import write_ros2

    write_ros2(source, path)
    yield from ()


def _write_protobuf(source: ExportSource, path: Path) -> Iterator[str]:
    from posetrack_cli.results.export.protobuf import write_protobuf

    yield from write_protobuf(source, path)


BINARY_FORMATS: Mapping[str, Callable[[ExportSource, Path], Iterable[str]]] = {
    "npz": _write_npz,
    "parquet": _write_parquet,
    "nwb": _write_nwb,
    "c3d": _write_c3d,
    "mcap": _write_ros2,
    "protobuf": _write_protobuf,
}
FORMATS = (*TEXT_FORMATS, *BINARY_FORMATS)
