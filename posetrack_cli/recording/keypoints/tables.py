"""Keypoints in CSV: a row per frame (or hand of it), or a row per point."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path, PurePath

from posetrack_cli import limits
from posetrack_cli.errors import UsageError
from posetrack_cli.recording.keypoints.layout import (
    KEYS,
    POINT_FIELDS,
    SCORE,
    SCORE_FIELDS,
    SIDE_FIELDS,
    UNIT_NAMES,
    Parsed,
    PointColumn,
    PointKind,
    SetCollector,
    X,
    Y,
    Z,
    key_of,
    number_of,
    point_column,
    point_of,
    right_of,
    score_of,
)
from posetrack_cli.tables import FRAME_FIELDS, LOST, NS_PER_UNIT, STATUS, Row, Table, TextFile, first_of

KIND = "keypoints are a CSV or JSON file in UTF-8"
EXPECTED = (
    "columns of points (x0, y0 ... or wrist_x, wrist_y ..., or a row per point with landmark, x, y), "
    "and of frames or stamps"
)
_SCORER, _COORDS = "scorer", "coords"
_LEVELS = ("individuals", "bodyparts", _COORDS)
"""Rows of the header of a table of DeepLabCut, after the scorer's."""
_SUBJECTS = ("hand", "face", "face_id")
"""Columns that count the subjects of a frame."""
_SUCCESS = "success"
"""A column of OpenFace: 0 where it lost the face. Its frames count from 1."""


def read_csv(path: Path, kind: PointKind) -> Parsed:
    """Read a table of keypoints.

    Raises:
        UsageError: names file, line and column of what cannot be used.
    """
    file = TextFile(path, UsageError, KIND, limits.KEYPOINT_BYTES)
    rows = file.rows()
    first = list(islice(rows, 1))
    if first and first[0][1][0].strip().lower() == _SCORER:
        return parse_table(file, kind, _deeplabcut(file, first[0], rows))
    return parse_table(file, kind, chain(first, rows))


def _deeplabcut(file: TextFile, first_row: Row, rows: Iterator[Row]) -> Iterator[Row]:
    """Yield the header and rows of a table of DeepLabCut, whose names are spread over three or four rows.

    These are scorer, individuals (of several animals), bodyparts and coords; the first column counts frames
    or names images. A row becomes one for each individual.

    Raises:
        UsageError: the header ends early or does not name bodyparts and coords.
    """
    line, scorer = first_row
    header: dict[str, Sequence[str]] = {}
    while _COORDS not in header:
        line, row = next(rows, (line, []))
        if not row or len(row) != len(scorer) or len(header) > len(_LEVELS):
            found, expected = f"{len(row)} cells", f"{len(scorer)}, and rows {', '.join(_LEVELS)}"
            what = "header of DeepLabCut is not complete"
            raise UsageError(what, where=file.where(line), found=found, expected=expected)
        header[row[0].strip().lower()] = [cell.strip() for cell in row]
    parts = header.get("bodyparts", [""] * len(scorer))
    first = 1 + sum(1 for cell in parts[1:3] if not cell)  # images may be named in three columns
    who = header.get("individuals", [""] * len(scorer))
    columns: dict[str, list[int]] = {}
    for k in range(first, len(scorer)):
        columns.setdefault(who[k], []).append(k)
    names = [f"{parts[k]}_{header[_COORDS][k]}" for k in next(iter(columns.values()), [])]
    yield line, [FRAME_FIELDS[0], *names]
    for line, row in rows:
        frame = re.findall(r"\d+", PurePath(row[first - 1]).stem if len(row) >= first else "")
        for own in columns.values():
            cells = [row[k] for k in own if k < len(row)]
            if any(cells) or len(row) != len(scorer):
                yield line, [frame[-1] if frame else "", *cells]


def parse_table(file: TextFile, kind: PointKind, rows: Iterator[Row]) -> Parsed:
    """Return what a table says.

    Args:
        file: of the table.
        kind: of the points.
        rows: with their lines, the header first.

    Raises:
        UsageError: as of ``read_csv``.
    """
    table = Table.of(file, rows, EXPECTED)
    columns = _Columns.of(kind, table)
    collector = SetCollector(file.path, kind, columns.ns_per_unit is not None)
    for line, row in table:
        columns.take(row, collector, file.where(line))
    return Parsed(collector.sets(), columns.unit, columns.side_field, int(_SUCCESS in columns.of_row))


@dataclass(frozen=True)
class _Columns:
    """Where in a row what is.

    Attributes:
        of_row: columns of the key, frame, score and so on, by these names; of those that there are.
        ns_per_unit: what the unit of a stamp is in ns; None where the key is a frame's number.
        points: columns of a row per frame; none where each row is a point.
        side_field: name of the column of sides.
        unit: that the columns name.
    """

    of_row: Mapping[str, int]
    ns_per_unit: int | None
    points: tuple[tuple[int, PointColumn], ...]
    side_field: str | None
    unit: str | None

    @classmethod
    def of(cls, kind: PointKind, table: Table) -> _Columns:
        """Find the columns.

        Raises:
            UsageError: they are of no known layout.
        """
        names, where = table.names, table.header
        plain = [name.lower() for name in names]
        side = first_of(SIDE_FIELDS, plain)
        wanted = {
            "key": (*NS_PER_UNIT, *FRAME_FIELDS),
            "frame": FRAME_FIELDS,
            "point": POINT_FIELDS,
            **{axis: (axis, *(f"{axis}_{unit}" for unit in UNIT_NAMES)) for axis in "xyz"},
            "score": SCORE_FIELDS,
            "side": SIDE_FIELDS,
            "side_score": [f"{side}_{name}" for name in SCORE_FIELDS],
            "hand": _SUBJECTS,
            STATUS: (STATUS,),
            _SUCCESS: (_SUCCESS,),
        }
        found = {what: first_of(named, plain) for what, named in wanted.items()}
        if (key := found["key"]) is None:
            raise UsageError("no column tells the frame", where=where, found=table.shown, expected=KEYS)
        points = tuple(
            (k, column)
            for k, name in enumerate(names)
            if not _is_in_space(name, names) and (column := point_column(kind, name)) is not None
        )
        if points or None in (found["point"], found["x"], found["y"]):
            points = _ours(kind, points, table)
            units = {column.unit for _, column in points}
        else:
            units = {UNIT_NAMES.get((found[axis] or "").partition("_")[2]) for axis in "xyz"}
        named = sorted(unit for unit in units if unit is not None)
        if len(named) > 1:
            raise UsageError("columns are in several units", where=where, found=", ".join(named))
        of_row = {what: plain.index(name) for what, name in found.items() if name is not None}
        return cls(of_row, NS_PER_UNIT.get(key), points, side, named[0] if named else None)

    def take(self, row: Sequence[str], collector: SetCollector, where: str) -> None:
        """Add a row to the sets."""
        said = {what: row[k] for what, k in self.of_row.items()}
        if said.get(STATUS, "").strip().lower() == LOST:
            return
        if not number_of(said.get(_SUCCESS, 1), f"{where}, {_SUCCESS}") > 0.0:
            return
        key = key_of(said["key"], where, ns_per_unit=self.ns_per_unit)
        if self.ns_per_unit is not None and said.get("frame", "").strip():
            collector.tell_number(key, key_of(said["frame"], where))
        hand, told = _hand_of(said.get("hand", ""), where)
        score = score_of(said.get("score"), f"{where}, score")
        if self.points:
            hand = collector.new_hand(key, hand)  # a row each for the hands of a frame
        values = collector.set_of(key, hand, where)
        if self.points:
            values[:, SCORE] = score
            for k, column in self.points:
                read = score_of if column.value == SCORE else number_of
                values[column.point, column.value] = read(row[k], f"{where}, column {k + 1}")
        else:
            x, y, z = (number_of(said.get(axis), f"{where}, {axis}") for axis in "xyz")
            collector.put(values, point_of(collector.kind, said["point"], where), (x, y, z, score), where)
        if label := said.get("side") or told:
            collector.tell_side(key, hand, right_of(label, score_of(said.get("side_score"), where), where))


def _is_in_space(name: str, names: Sequence[str]) -> bool:
    """Whether a column is one of OpenFace's X_0, Y_0 and Z_0, mm, beside x_0 and y_0, pixels."""
    return name[:1] in ("X", "Y", "Z") and f"x{name[1:]}" in names


def _ours(
    kind: PointKind, points: Sequence[tuple[int, PointColumn]], table: Table
) -> tuple[tuple[int, PointColumn], ...]:
    """Return the columns of our points, by our numbers, of each of which x and y are there."""
    where = table.header
    if not points:
        raise UsageError("no column is of a keypoint", where=where, found=table.shown, expected=EXPECTED)
    there = {(column.point, column.value) for _, column in points}
    if len(there) < len(points):
        raise UsageError("two columns are of the same point", where=where, found=table.shown)
    count = max(point for point, _ in there) + 1
    places = kind.places(count) if count > kind.size else kind.places(kind.size)
    if places is None:
        expected = (
            f"{kind.counts} points, {kind.range}" if len(kind.counted) == 1 else f"{kind.counts} points"
        )
        raise UsageError("has other points", where=where, found=f"point {count - 1}", expected=expected)
    lacking = [(k, axis) for k in places for axis in (X, Y) if (k, axis) not in there]
    if lacking:
        point, axis = lacking[0]
        found = f"{len({point for point, _ in there})} points, no {'xy'[axis]} of point {point}"
        expected = f"x and y of {kind.counts}"
        raise UsageError("columns of points are missing", where=where, found=found, expected=expected)
    depths = sum(1 for point, value in there if value == Z and point in places)
    if depths not in (0, kind.size):
        expected = f"0 or {kind.size}"
        raise UsageError(
            "columns of points are missing", where=where, found=f"{depths} of z", expected=expected
        )
    return tuple((k, one._replace(point=places[one.point])) for k, one in points if one.point in places)


def _hand_of(cell: str, where: str) -> tuple[int, str]:
    """Which hand of its frame a row is of, and its side if that is how it is told."""
    plain = cell.strip().lower()
    if plain in ("right", "left", "r", "l"):
        return int(plain[0] == "l"), plain
    return key_of(plain or 0, f"{where}, column {_SUBJECTS[0]}"), ""
