"""Formats of keypoint files: CSV with a row per frame, hand or point; JSON of MediaPipe, COCO etc."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path, PurePath
from typing import Any

from posetrack_cli import limits
from posetrack_cli.errors import UsageError
from posetrack_cli.recording.keypoints.layout import (
    HANDEDNESS,
    KEYS,
    MIRRORED,
    PIXELS,
    POINT_FIELDS,
    SCORE,
    SCORE_FIELDS,
    SIDE,
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
    unit_of,
)
from posetrack_cli.tables import FRAME_FIELDS, LOST, NS_PER_UNIT, STATUS, Row, Table, TextFile, first_of

KIND = "keypoints must be a CSV or JSON file in UTF-8"
_LONGER = "use JSON lines (.jsonl) or CSV for longer files"


def parse_keypoints(path: Path, kind: PointKind) -> Parsed:
    """Read another program's keypoints, in the file's unit.

    Args:
        path: CSV; JSON, one value (``.json``) or one per line (``.jsonl``, ``.ndjson``); or a folder of
            JSON files, one per frame.
        kind: subject of the points.

    Raises:
        UsageError: the file does not exist or is invalid; names file, line and field.
    """
    if path.is_dir():
        return _frames(path, kind, (_file_frame(file) for file in frame_files(path)), None)
    suffix = path.suffix.lower()
    if suffix == ".json":
        file = _json_file(path)
        return _parsed(file, kind, file.json(_LONGER))
    file = TextFile(path, UsageError, KIND, limits.KEYPOINT_BYTES)
    if suffix in (".jsonl", ".ndjson"):
        lines = ((file.where(number), line) for number, line in file.lines())
        values = (file.json_of(line, where) if line.strip() else None for where, line in lines)
        return _parsed(file, kind, values)
    rows = file.rows()
    first = list(islice(rows, 1))
    if first and first[0][1][0].strip().lower() == _SCORER:
        return _table(file, kind, _deeplabcut(file, first[0], rows))
    return _table(file, kind, chain(first, rows))


def frame_files(path: Path) -> list[Path]:
    """Return the JSON files of a folder, one per frame.

    Raises:
        UsageError: there are none, too many, or their total size is too large.
    """
    try:
        files = sorted(
            file for file in path.iterdir() if file.suffix.lower() == ".json" and file.name[0] != "."
        )
        size = sum(file.stat().st_size for file in files[: limits.KEYPOINT_SETS + 1])
    except OSError as error:
        raise UsageError("cannot be read", where=path, found=error.strerror or error) from error
    if not files:
        expected = "one JSON file per frame, as OpenPose and MMPose write"
        raise UsageError("no keypoint files in folder", where=path, expected=expected)
    _check_count(len(files) - 1, path)
    if size > limits.KEYPOINT_BYTES:
        expected = f"at most {limits.KEYPOINT_BYTES}"
        raise UsageError("too large", where=path, found=f"{size} bytes", expected=expected)
    return files


# Tables


EXPECTED = (
    "point columns (x0, y0 ... or wrist_x, wrist_y ..., or a row per point with landmark, x, y) "
    "and a frame or stamp column"
)
_SCORER, _COORDS = "scorer", "coords"
# Header rows of a DeepLabCut table after the scorer's.
_LEVELS = ("individuals", "bodyparts", _COORDS)
_SUBJECTS = ("hand", "face", "face_id")  # columns that number the subjects of a frame
# Column of OpenFace: 0 where the face was lost. Its frames count from 1.
_SUCCESS = "success"


def _deeplabcut(file: TextFile, first_row: Row, rows: Iterator[Row]) -> Iterator[Row]:
    """Yield header and rows of a DeepLabCut table, whose names are spread over three or four rows.

    These are scorer, individuals (with several animals), bodyparts and coords; the first column numbers
    frames or names images. A row becomes one for each individual.

    Raises:
        UsageError: the header ends early, or lacks bodyparts or coords.
    """
    line, scorer = first_row
    header: dict[str, Sequence[str]] = {}
    while _COORDS not in header:
        line, row = next(rows, (line, []))
        if not row or len(row) != len(scorer) or len(header) > len(_LEVELS):
            found, expected = f"{len(row)} cells", f"{len(scorer)} cells, and rows {', '.join(_LEVELS)}"
            what = "incomplete DeepLabCut header"
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


def _table(file: TextFile, kind: PointKind, rows: Iterator[Row]) -> Parsed:
    """Return the content of a table, given its rows with the header first."""
    table = Table.of(file, rows, EXPECTED)
    columns = _Columns.of(kind, table)
    collector = SetCollector(file.path, kind, columns.ns_per_unit is not None)
    for line, row in table:
        columns.take(row, collector, file.where(line))
    return Parsed(collector.sets(), columns.unit, columns.side_field, int(_SUCCESS in columns.of_row))


@dataclass(frozen=True)
class _Columns:
    """Column indices of a table.

    Attributes:
        of_row: indices of the key, frame, score etc., for those present.
        ns_per_unit: ns per unit of a stamp; None if the key is a frame number.
        points: point columns of a row per frame; empty if each row is a point.
        side_field: name of the side column.
        unit: unit in the column names.
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
            UsageError: the layout is unknown.
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
            raise UsageError("no frame or stamp column", where=where, found=table.shown, expected=KEYS)
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
            raise UsageError("columns differ in unit", where=where, found=", ".join(named))
        of_row = {what: plain.index(name) for what, name in found.items() if name is not None}
        return cls(of_row, NS_PER_UNIT.get(key), points, side, named[0] if named else None)

    def take(self, row: Sequence[str], collector: SetCollector, where: str) -> None:
        """Add a row to the sets."""
        cells = {what: row[k] for what, k in self.of_row.items()}
        if cells.get(STATUS, "").strip().lower() == LOST:
            return
        if not number_of(cells.get(_SUCCESS, 1), f"{where}, {_SUCCESS}") > 0.0:
            return
        key = key_of(cells["key"], where, ns_per_unit=self.ns_per_unit)
        if self.ns_per_unit is not None and cells.get("frame", "").strip():
            collector.set_number(key, key_of(cells["frame"], where))
        hand, side = _hand_of(cells.get("hand", ""), where)
        score = score_of(cells.get("score"), f"{where}, score")
        if self.points:
            hand = collector.new_hand(key, hand)  # a row each for the hands of a frame
        values = collector.set_of(key, hand, where)
        if self.points:
            values[:, SCORE] = score
            for k, column in self.points:
                read = score_of if column.value == SCORE else number_of
                values[column.point, column.value] = read(row[k], f"{where}, column {k + 1}")
        else:
            x, y, z = (number_of(cells.get(axis), f"{where}, {axis}") for axis in "xyz")
            collector.put(values, point_of(collector.kind, cells["point"], where), (x, y, z, score), where)
        if label := cells.get("side") or side:
            collector.set_side(key, hand, right_of(label, score_of(cells.get("side_score"), where), where))


def _is_in_space(name: str, names: Sequence[str]) -> bool:
    """Return whether a column is OpenFace's X_0, Y_0 or Z_0, mm, rather than x_0 or y_0, pixels."""
    return name[:1] in ("X", "Y", "Z") and f"x{name[1:]}" in names


def _ours(
    kind: PointKind, points: Sequence[tuple[int, PointColumn]], table: Table
) -> tuple[tuple[int, PointColumn], ...]:
    """Return the columns of our points by our numbering; every point must have x and y."""
    where = table.header
    if not points:
        raise UsageError("no keypoint columns", where=where, found=table.shown, expected=EXPECTED)
    present = {(column.point, column.value) for _, column in points}
    if len(present) < len(points):
        raise UsageError("two columns for the same point", where=where, found=table.shown)
    count = max(point for point, _ in present) + 1
    places = kind.places(count) if count > kind.size else kind.places(kind.size)
    if places is None:
        expected = (
            f"{kind.counts} points, {kind.range}" if len(kind.counted) == 1 else f"{kind.counts} points"
        )
        raise UsageError("unknown set of points", where=where, found=f"point {count - 1}", expected=expected)
    lacking = [(k, axis) for k in places for axis in (X, Y) if (k, axis) not in present]
    if lacking:
        point, axis = lacking[0]
        found = f"{len({point for point, _ in present})} points, no {'xy'[axis]} of point {point}"
        expected = f"x and y of {kind.counts} points"
        raise UsageError("missing point columns", where=where, found=found, expected=expected)
    depths = sum(1 for point, value in present if value == Z and point in places)
    if depths not in (0, kind.size):
        expected = f"0 or {kind.size}"
        raise UsageError("missing point columns", where=where, found=f"{depths} of z", expected=expected)
    return tuple((k, one._replace(point=places[one.point])) for k, one in points if one.point in places)


def _hand_of(cell: str, where: str) -> tuple[int, str]:
    """Return a row's hand index, and its side if the column holds sides."""
    plain = cell.strip().lower()
    if plain in ("right", "left", "r", "l"):
        return int(plain[0] == "l"), plain
    return key_of(plain or 0, f"{where}, column {_SUBJECTS[0]}"), ""


# JSON


_ONE = ("landmarks", "keypoints", "points", "landmark")
# Fields of OpenPose's per-frame files, and of MMPose's frames and files.
_PEOPLE, _INSTANCES, _INFO = "people", "instances", "instance_info"
_WHOLE_BODY = 133  # points of COCO-WholeBody
# Side fields, mapped to those of ``SIDE_FIELDS``.
_LABELS = {SIDE: SIDE, MIRRORED: MIRRORED, HANDEDNESS: HANDEDNESS, "handednesses": HANDEDNESS}
_LABEL_NAMES = ("label", "category_name", "categoryName", "display_name", "name")
# Scores for COCO's flags: not labelled, labelled but occluded, visible.
_VISIBILITY = {0.0: 0.0, 1.0: 0.5, 2.0: 1.0}


def _json_file(path: Path) -> TextFile:
    return TextFile(path, UsageError, KIND, limits.KEYPOINT_JSON_BYTES)


def _parsed(file: TextFile, kind: PointKind, content: Any) -> Parsed:
    """Return the content of a file's JSON value, by its fields."""
    path = file.path
    if isinstance(content, Mapping):
        unit = unit_of(content["unit"], path) if content.get("unit") is not None else None
        if isinstance(content.get("columns"), Mapping):
            return _table(file, kind, file.json_rows(content["columns"]))
        if isinstance(content.get("annotations"), list):
            return _frames(path, kind, _coco(path, kind, content), unit or PIXELS)
        if isinstance(content.get("frames"), (list, Mapping)):
            return _frames(path, kind, content["frames"], unit)
        if isinstance(content.get(_INFO), list):
            return _frames(path, kind, _with_names(content), unit)
        if isinstance(content.get(_PEOPLE), list):
            return _frames(path, kind, [{FRAME_FIELDS[0]: _number_in(path), **content}], unit)
        if content and all(str(key).isdecimal() for key in content):
            return _frames(path, kind, content, unit)
        found = ", ".join(map(str, list(content)[:5]))[:80] or "an empty object"
        raise UsageError("no frames", where=path, found=found, expected=kind.expected)
    if isinstance(content, (list, Iterator)):
        return _frames(path, kind, content, None)
    raise UsageError("no frames", where=path, found=type(content).__name__, expected=kind.expected)


def _file_frame(file: Path) -> Mapping[str, Any]:
    """Return the frame in a file: OpenPose's people, or a list of MMPose's instances."""
    content = _json_file(file).json(_LONGER)
    if isinstance(content, list):
        content = {_INSTANCES: content}
    if not isinstance(content, Mapping):
        raise UsageError("not a frame", where=file, found=type(content).__name__, expected=_PEOPLE)
    return {FRAME_FIELDS[0]: _number_in(file), **content}


def _number_in(file: Path) -> int:
    """Return the frame number in a file name: ``take_000000000012_keypoints.json``."""
    digits = re.findall(r"\d{1,18}", file.stem.removesuffix("_keypoints"))
    if not digits:
        raise UsageError("no frame number in file name", where=file, expected="e.g. take_0012.json")
    return int(digits[-1])


# Frames


def _frames(path: Path, kind: PointKind, frames: Any, unit: str | None) -> Parsed:
    """Return the sets of a list of frames, numbered by position if unnumbered, or of an object."""
    entries = frames.items() if isinstance(frames, Mapping) else enumerate(frames)
    collector: SetCollector | None = None
    stamp: str | None = None
    sides: set[str] = set()
    for count, (place, frame) in enumerate(entries):
        _check_count(count, path)
        if frame is None:
            continue
        where = f"{path}, frame entry {place}"
        if not isinstance(frame, Mapping):
            frame = {_ONE[0]: frame}
        if collector is None:
            stamp = first_of(NS_PER_UNIT, frame)
            collector = SetCollector(path, kind, stamp is not None)
        key = _key(frame, stamp, place, where)
        number = first_of(FRAME_FIELDS, frame)
        if collector.by_stamp and number is not None:
            collector.set_number(key, key_of(frame[number], where))
        sides |= _take_frame(collector, key, frame, where)
    if collector is None:
        raise UsageError("no frames", where=path, found="none", expected=kind.expected)
    if len(sides) > 1:
        raise UsageError("sides given in two fields", where=path, found=" and ".join(sorted(sides)))
    return Parsed(collector.sets(), unit, next(iter(sides), None))


def _check_count(count: int, where: object) -> None:
    """Raise UsageError if ``count`` earlier frames, images or annotations reach the limit."""
    if count >= limits.KEYPOINT_SETS:
        raise UsageError(
            "too many frames", where=where, found="more", expected=f"at most {limits.KEYPOINT_SETS}"
        )


def _key(frame: Mapping[str, Any], stamp: str | None, place: Any, where: str) -> int:
    if stamp is not None:
        if stamp not in frame:
            raise UsageError("no stamp", where=where, expected=f"{stamp}, as in the first frame")
        return key_of(frame[stamp], f"{where}, {stamp}", ns_per_unit=NS_PER_UNIT[stamp])
    name = first_of(FRAME_FIELDS, frame)
    return key_of(place if name is None else frame[name], where)


def _take_frame(collector: SetCollector, key: int, frame: Mapping[str, Any], where: str) -> set[str]:
    """Add a frame's hands; return the fields that gave their sides."""
    frame = _of_peers(collector.kind, frame, where)
    first = collector.new_hand(key)  # several entries of one frame are one hand each
    fields: set[str] = set()
    hands, labels = _hands(collector.kind, frame, where), _labels(frame)
    for n, hand in enumerate(hands):
        points, own = (hand, {}) if not isinstance(hand, Mapping) else (_of(hand, _ONE, hand), hand)
        own_labels = _labels(own)
        field, label = (own_labels[0], own_labels[1][:1]) if own_labels else ("", [])
        if not label and labels is not None and n < len(labels[1]):
            field, label = labels[0], [labels[1][n]]
        if not points:
            continue
        _take_points(
            collector,
            key,
            first + n,
            points,
            f"{where}, {collector.kind.subject} {n}" if len(hands) > 1 else where,
        )
        if label:
            fields.add(field)
            collector.set_side(key, first + n, _right(label[0], where))
    return fields


def _with_names(content: Mapping[str, Any]) -> Iterator[Any]:
    """Yield the frames of an MMPose file, each with its point names."""
    about = content.get("meta_info")
    names = about.get("keypoint_id2name") if isinstance(about, Mapping) else None
    return ({**frame, "names": names} if isinstance(frame, Mapping) else frame for frame in content[_INFO])


def _of_peers(kind: PointKind, frame: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """Return an OpenPose or MMPose frame as a list of hands or faces, any other unchanged."""
    found: list[Mapping[str, Any]] = []
    if isinstance(frame.get(_PEOPLE), list):
        for person in frame[_PEOPLE]:
            flat = person if isinstance(person, Mapping) else {}
            found += [_set(_triples(flat.get(name), where), side) for name, side in kind.flat.items()]
    elif isinstance(frame.get(_INSTANCES), list):
        for instance in frame[_INSTANCES]:
            if isinstance(instance, Mapping):
                found += _instance(kind, instance, frame.get("names"))
    else:
        return frame
    return {kind.several[0]: [one for one in found if one[_ONE[0]]]}


def _set(points: Any, side: str) -> Mapping[str, Any]:
    return {_ONE[0]: points, SIDE: side} if side else {_ONE[0]: points}


def _triples(values: Any, where: str) -> list[Any]:
    """Return flat x, y, score values as points; None for score 0, and [] if there are no points."""
    if not isinstance(values, list) or len(values) % 3:
        if values is None:
            return []
        raise UsageError(
            "invalid points",
            where=where,
            found=f"{len(values)} numbers" if isinstance(values, list) else type(values).__name__,
            expected="x, y, score of each point in a row",
        )
    points = [_scored(values[k], values[k + 1], values[k + 2]) for k in range(0, len(values), 3)]
    return points if any(points) else []


def _scored(x: Any, y: Any, score: Any) -> list[Any] | None:
    return None if score == 0 else [x, y, None, score]


def _instance(kind: PointKind, instance: Mapping[str, Any], names: Any) -> list[Mapping[str, Any]]:
    """Return an MMPose instance as sets: all its points, or the parts of a whole body."""
    points, scores = instance.get("keypoints"), instance.get("keypoint_scores")
    if not isinstance(points, list):
        return []
    if not isinstance(scores, list) or len(scores) != len(points):
        scores = [None] * len(points)
    scored = [
        _scored(point[0], point[1], score) if isinstance(point, list) and len(point) > 1 else point
        for point, score in zip(points, scores, strict=True)
    ]
    if len(scored) == _WHOLE_BODY:
        return [_set(scored[part], side) for side, part in kind.parts.items()]
    named = names if isinstance(names, Mapping) else {}
    own = [str(named.get(str(k), "")) for k in range(len(scored))]
    if all(kind.number(name) is not None for name in own):
        return [_set(dict(zip(own, scored, strict=True)), "")]
    return [_set(scored, "")]


def _hands(kind: PointKind, frame: Mapping[str, Any], where: str) -> Sequence[Any]:
    """Return a frame's hands or faces, each as points or an object with points."""
    hands = _of(frame, kind.several, None)
    if hands is None:
        one = _of(frame, _ONE, None)
        if one is None:
            return ()
        return one if _is_list_of_hands(one) else (one,)
    if not isinstance(hands, list):
        what = f"{kind.subject}s are not a list"
        raise UsageError(what, where=where, found=type(hands).__name__, expected=kind.expected)
    return hands


def _is_list_of_hands(value: Any) -> bool:
    """Return whether landmarks are those of several hands: nested lists, as from MediaPipe's tasks."""
    if not isinstance(value, list) or not value or not isinstance(value[0], list):
        return False
    return bool(value[0]) and isinstance(value[0][0], (list, Mapping))


def _labels(frame: Mapping[str, Any]) -> tuple[str, list[Any]] | None:
    """Return which of ``SIDE_FIELDS`` a frame or hand has, and its value for each hand."""
    name = next((name for name in _LABELS if frame.get(name) is not None), None)
    if name is None:
        return None
    labels = frame[name]
    return _LABELS[name], labels if isinstance(labels, list) else [labels]


def _right(label: Any, where: str) -> float:
    """Return the probability of a right hand from a label, alone or with a score, possibly nested."""
    for _ in range(3):
        if isinstance(label, list) and label:
            label = label[0]
        elif isinstance(label, Mapping) and "classification" in label:
            label = label["classification"]
    if isinstance(label, Mapping):
        score = score_of(label.get("score"), f"{where}, score of the side")
        return right_of(_of(label, _LABEL_NAMES, None), score, where)
    return right_of(label, math.nan, where)


def _take_points(collector: SetCollector, key: int, hand: int, points: Any, where: str) -> None:
    """Add a set's points: a list, or an object by name or number."""
    kind = collector.kind
    values = collector.set_of(key, hand, where)
    if isinstance(points, Mapping):
        named = [
            (name, point)
            for name, point in points.items()
            if kind.number(name) is not None or name.isdecimal()
        ]
        if not named:
            found = ", ".join(map(str, list(points)[:5]))[:80]
            raise UsageError("no points", where=where, found=found, expected=kind.expected)
        listed = [(point_of(kind, name, where), point) for name, point in named]
    elif isinstance(points, list):
        places = kind.places(len(points))
        if places is None:
            what = "unexpected number of points"
            raise UsageError(what, where=where, found=len(points), expected=kind.counts)
        ours = ((places[k], points[k]) for k in places)
        listed = [(_named(kind, point, k, where), point) for k, point in ours]
    else:
        what = "points are not a list"
        raise UsageError(what, where=where, found=type(points).__name__, expected=kind.expected)
    for number, point in listed:
        collector.put(values, number, _values(point, f"{where}, point {number}"), where)


def _named(kind: PointKind, point: Any, place: int, where: str) -> int:
    """Return the number of a list's point: by its own name if it has one, else by position."""
    name = _of(point, POINT_FIELDS, None) if isinstance(point, Mapping) else None
    return place if name is None else point_of(kind, name, where)


def _values(point: Any, where: str) -> tuple[float, float, float, float]:
    """Return x, y, z and score of a point, NaN if unknown."""
    if point is None:
        return (math.nan,) * 4
    if isinstance(point, Mapping):
        x, y, z = (number_of(point.get(axis), f"{where}, {axis}") for axis in "xyz")
        return x, y, z, score_of(_of(point, SCORE_FIELDS, None), f"{where}, score")
    if not isinstance(point, list) or not 2 <= len(point) <= 4:
        found = f"{len(point)} numbers" if isinstance(point, list) else type(point).__name__
        raise UsageError(
            "not a point", where=where, found=found, expected="[x, y], [x, y, z] or [x, y, z, score]"
        )
    x, y, z = (number_of(value, where) for value in [*point, None][:3])
    return x, y, z, score_of(point[3] if len(point) == 4 else None, f"{where}, score")


def _of(content: Mapping[str, Any], names: Sequence[str], otherwise: Any) -> Any:
    return next((content[name] for name in names if content.get(name) is not None), otherwise)


# COCO annotations, as exported by labelling tools


def _coco(path: Path, kind: PointKind, content: Mapping[str, Any]) -> Iterator[Mapping[str, Any] | None]:
    """Yield the frames of COCO keypoint annotations; None for annotations without points."""
    frames = _coco_frames(path, content.get("images"))
    order = _coco_order(path, kind, content.get("categories"))
    for n, annotation in enumerate(content["annotations"]):
        where = f"{path}, annotation {n}"
        points = annotation.get("keypoints") if isinstance(annotation, Mapping) else None
        if not points:
            yield None
            continue
        image = annotation.get("image_id")
        if isinstance(image, (list, dict)) or image not in frames:
            raise UsageError("unknown image_id", where=where, found=image, expected="an id in images")
        if not isinstance(points, list) or len(points) != 3 * kind.size:
            found = f"{len(points)} numbers" if isinstance(points, list) else type(points).__name__
            raise UsageError(
                "invalid keypoints", where=where, found=found, expected=f"{kind.size} times x, y, v"
            )
        listed: list[Any] = [None] * kind.size
        for k, point in enumerate(order):
            x, y, v = (number_of(value, f"{where}, point {k}") for value in points[3 * k : 3 * k + 3])
            score = _VISIBILITY.get(v, v)
            listed[point] = [None, None, None, score] if score == 0.0 else [x, y, None, score]
        yield {FRAME_FIELDS[0]: frames[image], _ONE[0]: listed}


def _coco_frames(path: Path, images: Any) -> dict[Any, int]:
    """Return frame numbers by image id."""
    if not isinstance(images, list) or not all(isinstance(image, Mapping) for image in images):
        raise UsageError("no image list", where=path, expected="images with id and file_name")
    frames: dict[Any, int] = {}
    for n, image in enumerate(images):
        _check_count(n, path)
        where = f"{path}, image {n}"
        name = first_of(FRAME_FIELDS, image)
        digits = re.findall(r"\d{1,18}", PurePath(str(image.get("file_name", ""))).stem)
        if name is None and not digits:
            raise UsageError("no frame number", where=where, found=image.get("file_name"), expected=KEYS)
        ident = image.get("id")
        if not isinstance(ident, (int, str)):
            raise UsageError("image has no id", where=where, found=ident)
        frames[ident] = key_of(digits[-1] if name is None else image[name], where)
    return frames


def _coco_order(path: Path, kind: PointKind, categories: Any) -> Sequence[int]:
    """Return the number of each annotated point, by the category's names if they are ours."""
    first = categories[0] if isinstance(categories, list) and categories else {}
    names = first.get("keypoints") if isinstance(first, Mapping) else None
    if not isinstance(names, list) or any(kind.number(str(name)) is None for name in names):
        return range(kind.size)
    order = [point_of(kind, name, f"{path}, categories") for name in names]
    if sorted(order) != list(range(kind.size)):
        where = f"{path}, categories"
        raise UsageError("unexpected keypoint names", where=where, found=len(names), expected=kind.size)
    return order
