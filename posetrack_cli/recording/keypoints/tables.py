"""Keypoints in CSV: a row per frame (or hand of it), or a row per point."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path, PurePath
from textwrap import shorten

from posetrack_cli import limits
from posetrack_cli.csv_rows import Row, csv_rows
from posetrack_cli.errors import UsageError
from posetrack_cli.recording.keypoints.layout import (
    FRAME_FIELDS,
    KEYS,
    LOST,
    NS_PER_UNIT,
    POINT_FIELDS,
    SCORE,
    SCORE_FIELDS,
    SIDE_FIELDS,
    STATUS,
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
_OTHER_SEPARATORS = {";": "semicolons", "\t": "tabs"}


def read_csv(path: Path, kind: PointKind) -> Parsed:
    """Read a table of keypoints.

    Raises:
        UsageError: names file, line and column of what cannot be used.
    """
    rows = csv_rows(path, UsageError, KIND)
    line, first = next(rows, (0, []))
    names: Sequence[str] = first
    if names and names[0].strip().lower() == _SCORER:
        names, rows = _deeplabcut(path, line, names, rows)
    return parse_table(path, kind, [name.strip() for name in names], rows, f"{path} line {line}")


def _deeplabcut(
    path: Path, line: int, scorer: Sequence[str], rows: Iterator[Row]
) -> tuple[Sequence[str], Iterator[Row]]:
    """Return the columns and rows of a table of DeepLabCut, whose names are spread over three or four rows.

    These are scorer, individuals (of several animals), bodyparts and coords; the first column counts frames
    or names images. A row becomes one for each individual.

    Raises:
        UsageError: the header ends early or does not name bodyparts and coords.
    """
    header: dict[str, Sequence[str]] = {}
    while _COORDS not in header:
        line, row = next(rows, (line, []))
        if not row or len(row) != len(scorer) or len(header) > len(_LEVELS):
            found, expected = f"{len(row)} cells", f"{len(scorer)}, and rows {', '.join(_LEVELS)}"
            raise UsageError(
                "header of DeepLabCut is not complete",
                where=f"{path} line {line}",
                found=found,
                expected=expected,
            )
        header[row[0].strip().lower()] = [cell.strip() for cell in row]
    parts = header.get("bodyparts", [""] * len(scorer))
    first = 1 + sum(1 for cell in parts[1:3] if not cell)  # images may be named in three columns
    who = header.get("individuals", [""] * len(scorer))
    columns: dict[str, list[int]] = {}
    for k in range(first, len(scorer)):
        columns.setdefault(who[k], []).append(k)
    names = [f"{parts[k]}_{header[_COORDS][k]}" for k in next(iter(columns.values()), [])]

    def taken() -> Iterator[Row]:
        for number, row in rows:
            frame = re.findall(r"\d+", PurePath(row[first - 1]).stem if len(row) >= first else "")
            for own in columns.values():
                cells = [row[k] for k in own if k < len(row)]
                if any(cells) or len(row) != len(scorer):
                    yield number, [frame[-1] if frame else "", *cells]

    return [FRAME_FIELDS[0], *names], taken()


def parse_table(path: Path, kind: PointKind, names: Sequence[str], rows: Iterator[Row], where: str) -> Parsed:
    """Return what a table says.

    Args:
        path: of the file.
        kind: of the points.
        names: of the columns.
        rows: with their lines.
        where: the names are.

    Raises:
        UsageError: as of ``read_csv``.
    """
    table = _Table.of(path, kind, names, where)
    collector = SetCollector(path, kind, table.ns_per_unit is not None)
    for line, row in rows:
        if len(row) != len(names):
            what = "row does not fit the header"
            raise UsageError(
                what, where=f"{path} line {line}", found=f"{len(row)} cells", expected=len(names)
            )
        table.take(row, collector, f"{path} line {line}")
    return Parsed(collector.sets(), table.unit, table.side_field, int(table.success >= 0))


@dataclass(frozen=True)
class _Table:
    """Where in a row what is.

    Attributes:
        key, ns_per_unit: column of the frame or, with what its unit is in ns, of the stamp.
        frame: column of the frame next to that of the stamp, -1 for none.
        points: columns of a row per frame; none where each row is a point.
        values: columns of point, x, y, z of a row per point, -1 for none.
        score: of the row, -1 for none.
        side, side_score, hand, status, success: columns, -1 for none.
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
    def of(cls, path: Path, kind: PointKind, names: Sequence[str], where: str) -> _Table:
        """Find the columns.

        Raises:
            UsageError: they are of no known layout.
        """
        plain = [name.lower() for name in names]
        _check_names(path, names, where)
        stamp = next((name for name in NS_PER_UNIT if name in plain), None)
        frame = next((name for name in FRAME_FIELDS if name in plain), None)
        points = tuple(
            (k, found)
            for k, name in enumerate(names)
            if not _is_in_space(name, names) and (found := point_column(kind, name)) is not None
        )
        point = next((name for name in POINT_FIELDS if name in plain), None)
        long_names = {axis: _axis_column(plain, axis) for axis in "xyz"}
        if stamp is None and frame is None:
            raise UsageError("no column tells the frame", where=where, found=_some(names), expected=KEYS)
        is_wide = bool(points) or point is None or min(long_names["x"], long_names["y"]) < 0
        if is_wide:
            points = _ours(kind, points, names, where)
        side = next((name for name in SIDE_FIELDS if name in plain), None)
        key = str(stamp if stamp is not None else frame)
        own = (
            [found.unit for _, found in points] if is_wide else [_unit(plain[k]) for k in long_names.values()]
        )
        return cls(
            plain.index(key),
            None if stamp is None else NS_PER_UNIT[stamp],
            _place(plain, frame) if stamp is not None else -1,
            points if is_wide else (),
            (_place(plain, point), long_names["x"], long_names["y"], long_names["z"]),
            next((plain.index(name) for name in SCORE_FIELDS if name in plain), -1),
            _place(plain, side),
            next((_place(plain, f"{side}_{name}") for name in SCORE_FIELDS if f"{side}_{name}" in plain), -1),
            _place(plain, next((name for name in _SUBJECTS if name in plain), None)),
            _place(plain, STATUS),
            _place(plain, _SUCCESS),
            side,
            _one_unit(own, where),
        )

    def take(self, row: Sequence[str], collector: SetCollector, where: str) -> None:
        """Add a row to the sets."""
        if self.status >= 0 and row[self.status].strip().lower() == LOST:
            return
        if self.success >= 0 and not number_of(row[self.success], f"{where}, {_SUCCESS}") > 0.0:
            return
        key = key_of(row[self.key], self.ns_per_unit, where)
        if self.frame >= 0 and row[self.frame].strip():
            collector.tell_number(key, key_of(row[self.frame], None, where))
        label = row[self.side] if self.side >= 0 else ""
        hand = 0
        if self.hand >= 0:
            hand, told = _hand_of(row[self.hand], where)
            label = label or told
        score = score_of(row[self.score], f"{where}, score") if self.score >= 0 else math.nan
        if self.points:
            hand = collector.new_hand(key, hand)  # a row each for the hands of a frame
            self._take_points(row, collector, (key, hand), score, where)
        else:
            values = collector.set_of(key, hand, where)
            point, *places = self.values
            said = (
                number_of(row[k], f"{where}, {'xyz'[n]}") if k >= 0 else math.nan
                for n, k in enumerate(places)
            )
            x, y, z = said
            collector.put(values, point_of(collector.kind, row[point], where), (x, y, z, score), where)
        if label:
            sure = score_of(row[self.side_score], where) if self.side_score >= 0 else math.nan
            collector.tell_side(key, hand, right_of(label, sure, where))

    def _take_points(
        self, row: Sequence[str], collector: SetCollector, key: tuple[int, int], score: float, where: str
    ) -> None:
        values = collector.set_of(*key, where)
        values[:, SCORE] = score
        for k, column in self.points:
            read = score_of if column.value == SCORE else number_of
            values[column.point, column.value] = read(row[k], f"{where}, column {k + 1}")


def _is_in_space(name: str, names: Sequence[str]) -> bool:
    """Whether a column is one of OpenFace's X_0, Y_0 and Z_0, mm, beside x_0 and y_0, pixels."""
    return name[:1] in ("X", "Y", "Z") and f"x{name[1:]}" in names


def _check_names(path: Path, names: Sequence[str], where: str) -> None:
    if not names:
        raise UsageError("is empty", where=path, expected=EXPECTED)
    if len(names) > limits.COLUMNS:
        raise UsageError("has too many columns", where=path, found=len(names), expected=limits.COLUMNS)
    other = next(
        (word for sign, word in _OTHER_SEPARATORS.items() if len(names) == 1 and sign in names[0]), ""
    )
    if other:
        hint = "write it with commas, and with points as decimal signs"
        raise UsageError("columns are not separated by commas", where=where, found=other, hint=hint)
    known = {name for name in names if name}
    if len(known) < sum(1 for name in names if name):
        twice = next(name for name in names if name and list(names).count(name) > 1)
        raise UsageError("column occurs twice", where=where, found=twice)


def _ours(
    kind: PointKind, points: Sequence[tuple[int, PointColumn]], names: Sequence[str], where: str
) -> tuple[tuple[int, PointColumn], ...]:
    """Return the columns of our points, by our numbers, of each of which x and y are there."""
    if not points:
        raise UsageError("no column is of a keypoint", where=where, found=_some(names), expected=EXPECTED)
    there = {(column.point, column.value) for _, column in points}
    if len(there) < len(points):
        raise UsageError("two columns are of the same point", where=where, found=_some(names))
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
    return key_of(plain or 0, None, f"{where}, column {_SUBJECTS[0]}"), ""


def _axis_column(names: Sequence[str], axis: str) -> int:
    return next((names.index(n) for n in (axis, *(f"{axis}_{u}" for u in UNIT_NAMES)) if n in names), -1)


def _place(names: Sequence[str], name: str | None) -> int:
    return list(names).index(name) if name is not None and name in names else -1


def _unit(name: str) -> str | None:
    return UNIT_NAMES.get(name.partition("_")[2])


def _one_unit(units: Sequence[str | None], where: str) -> str | None:
    """The unit that columns name.

    Raises:
        UsageError: they name several.
    """
    named = {unit for unit in units if unit is not None}
    if len(named) > 1:
        raise UsageError("columns are in several units", where=where, found=", ".join(sorted(named)))
    return next(iter(named), None)


def _some(names: Sequence[str]) -> str:
    return shorten(", ".join(islice(names, 20)), 100, placeholder=" ...")
