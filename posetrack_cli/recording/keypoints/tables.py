"""Keypoints in CSV: a row per frame (or hand of it), or a row per point."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
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
from posetrack_cli.tables import FRAME_FIELDS, NS_PER_UNIT, STATUS, Row, Table, csv_rows, first_of, is_lost

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
    rows = csv_rows(path, UsageError, KIND, limits.KEYPOINT_BYTES)
    first = next(rows, None)
    if first is None:
        return parse_table(path, kind, rows)
    if first[1][0].strip().lower() == _SCORER:
        return parse_table(path, kind, _deeplabcut(path, first, rows))
    return parse_table(path, kind, chain([first], rows))


def _deeplabcut(path: Path, first_row: Row, rows: Iterator[Row]) -> Iterator[Row]:
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
            raise UsageError(what, where=f"{path} line {line}", found=found, expected=expected)
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


def parse_table(path: Path, kind: PointKind, rows: Iterator[Row]) -> Parsed:
    """Return what a table says.

    Args:
        path: of the file.
        kind: of the points.
        rows: with their lines, the header first.

    Raises:
        UsageError: as of ``read_csv``.
    """
    table = Table.of(path, rows, UsageError, EXPECTED)
    columns = _Columns.of(kind, table)
    collector = SetCollector(path, kind, columns.ns_per_unit is not None)
    for line, row in table:
        columns.take(row, collector, table.where(line))
    return Parsed(collector.sets(), columns.unit, columns.side_field, int(columns.success >= 0))


@dataclass(frozen=True)
class _Columns:
    """Where in a row what is, -1 for nowhere.

    Attributes:
        key, ns_per_unit: the frame or, with what its unit is in ns, the stamp.
        frame: next to a stamp.
        points: columns of a row per frame; none where each row is a point.
        values: point, x, y, z of a row per point.
        score: of the row.
        side, side_score, hand, status, success: as the columns are called.
        side_field: name of the column of sides.
        unit: that the columns name.
    """

    key: int
    ns_per_unit: int | None
    frame: int
    points: tuple[tuple[int, PointColumn], ...]
    values: tuple[int, int, int, int]
    score: int
    side: int
    side_score: int
    hand: int
    status: int
    success: int
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

        def place(*wanted: str) -> int:
            found = first_of(wanted, plain)
            return -1 if found is None else plain.index(found)

        points = tuple(
            (k, found)
            for k, name in enumerate(names)
            if not _is_in_space(name, names) and (found := point_column(kind, name)) is not None
        )
        key, frame, side = place(*NS_PER_UNIT, *FRAME_FIELDS), place(*FRAME_FIELDS), place(*SIDE_FIELDS)
        if key < 0:
            raise UsageError("no column tells the frame", where=where, found=table.shown, expected=KEYS)
        point, x, y, z = place(*POINT_FIELDS), *(place(a, *(f"{a}_{u}" for u in UNIT_NAMES)) for a in "xyz")
        is_wide = bool(points) or min(point, x, y) < 0
        if is_wide:
            points = _ours(kind, points, table)
            units = {found.unit for _, found in points}
        else:
            units = {UNIT_NAMES.get(plain[k].partition("_")[2]) for k in (x, y, z) if k >= 0}
        named = sorted(unit for unit in units if unit is not None)
        if len(named) > 1:
            raise UsageError("columns are in several units", where=where, found=", ".join(named))
        ns_per_unit = NS_PER_UNIT.get(plain[key])
        return cls(
            key=key,
            ns_per_unit=ns_per_unit,
            frame=-1 if ns_per_unit is None else frame,
            points=points if is_wide else (),
            values=(point, x, y, z),
            score=place(*SCORE_FIELDS),
            side=side,
            side_score=place(*(f"{plain[side]}_{name}" for name in SCORE_FIELDS)) if side >= 0 else -1,
            hand=place(*_SUBJECTS),
            status=place(STATUS),
            success=place(_SUCCESS),
            side_field=plain[side] if side >= 0 else None,
            unit=next(iter(named), None),
        )

    def take(self, row: Sequence[str], collector: SetCollector, where: str) -> None:
        """Add a row to the sets."""
        if is_lost(row, self.status):
            return
        if self.success >= 0 and not number_of(row[self.success], f"{where}, {_SUCCESS}") > 0.0:
            return
        key = key_of(row[self.key], where, ns_per_unit=self.ns_per_unit)
        if self.frame >= 0 and row[self.frame].strip():
            collector.tell_number(key, key_of(row[self.frame], where))
        label = row[self.side] if self.side >= 0 else ""
        hand = 0
        if self.hand >= 0:
            hand, told = _hand_of(row[self.hand], where)
            label = label or told
        score = score_of(row[self.score], f"{where}, score") if self.score >= 0 else math.nan
        if self.points:
            hand = collector.new_hand(key, hand)  # a row each for the hands of a frame
            values = collector.set_of(key, hand, where)
            values[:, SCORE] = score
            for k, column in self.points:
                read = score_of if column.value == SCORE else number_of
                values[column.point, column.value] = read(row[k], f"{where}, column {k + 1}")
        else:
            values = collector.set_of(key, hand, where)
            point, *places = self.values
            x, y, z = (
                number_of(row[k], f"{where}, {axis}") if k >= 0 else math.nan
                for axis, k in zip("xyz", places, strict=True)
            )
            collector.put(values, point_of(collector.kind, row[point], where), (x, y, z, score), where)
        if label:
            sure = score_of(row[self.side_score], where) if self.side_score >= 0 else math.nan
            collector.tell_side(key, hand, right_of(label, sure, where))


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
