"""Keypoints in JSON: frames as MediaPipe gives them, COCO's annotations, exports of ours."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
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
    SCORE_FIELDS,
    SIDE,
    Parsed,
    PointKind,
    SetCollector,
    key_of,
    number_of,
    point_of,
    right_of,
    score_of,
    unit_of,
)
from posetrack_cli.recording.keypoints.tables import KIND, parse_table
from posetrack_cli.tables import (
    FRAME_FIELDS,
    NS_PER_UNIT,
    TextFile,
    first_of,
)

_ONE = ("landmarks", "keypoints", "points", "landmark")
_PEOPLE, _INSTANCES, _INFO = "people", "instances", "instance_info"
"""Fields of OpenPose's files, one a frame, and of MMPose's frames and files."""
_LONGER = "a longer file is one of JSON lines (.jsonl) or CSV"
_WHOLE_BODY = 133
"""Points of COCO's whole body."""
_LABELS = {SIDE: SIDE, MIRRORED: MIRRORED, HANDEDNESS: HANDEDNESS, "handednesses": HANDEDNESS}
"""Fields that tell sides, and which of ``SIDE_FIELDS`` they are."""
_LABEL_NAMES = ("label", "category_name", "categoryName", "display_name", "name")
_VISIBILITY = {0.0: 0.0, 1.0: 0.5, 2.0: 1.0}
"""Scores that COCO's flags stand for: not labelled, labelled but hidden, visible."""


def read_json(path: Path, kind: PointKind) -> Parsed:
    """Read one JSON value.

    Raises:
        UsageError: names file, frame and field of what cannot be used.
    """
    file = _file(path)
    return _parsed(file, kind, file.json(_LONGER))


def read_json_lines(path: Path, kind: PointKind) -> Parsed:
    """Read a frame per line; see ``read_json``."""
    file = TextFile(path, UsageError, KIND, limits.KEYPOINT_BYTES)
    lines = ((file.where(number), line) for number, line in file.lines())
    return _parsed(file, kind, (file.json_of(line, where) if line.strip() else None for where, line in lines))


def _file(path: Path) -> TextFile:
    return TextFile(path, UsageError, KIND, limits.KEYPOINT_JSON_BYTES)


def _parsed(file: TextFile, kind: PointKind, said: Any) -> Parsed:
    """What a file's value says, by what it has."""
    path = file.path
    if isinstance(said, Mapping):
        unit = unit_of(said["unit"], path) if said.get("unit") is not None else None
        if isinstance(said.get("columns"), Mapping):
            return parse_table(file, kind, file.json_rows(said["columns"]))
        if isinstance(said.get("annotations"), list):
            return _frames(path, kind, _coco(path, kind, said), unit or PIXELS)
        if isinstance(said.get("frames"), (list, Mapping)):
            return _frames(path, kind, said["frames"], unit)
        if isinstance(said.get(_INFO), list):
            return _frames(path, kind, _with_names(said), unit)
        if isinstance(said.get(_PEOPLE), list):
            return _frames(path, kind, [{FRAME_FIELDS[0]: _number_in(path), **said}], unit)
        if said and all(str(key).isdecimal() for key in said):
            return _frames(path, kind, said, unit)
        found = ", ".join(map(str, list(said)[:5]))[:80] or "an empty object"
        raise UsageError("holds no frames", where=path, found=found, expected=kind.expected)
    if isinstance(said, (list, Iterator)):
        return _frames(path, kind, said, None)
    raise UsageError("holds no frames", where=path, found=type(said).__name__, expected=kind.expected)


def read_folder(path: Path, kind: PointKind) -> Parsed:
    """Read a folder of JSON files, each of which is a frame that its name numbers: OpenPose's or MMPose's.

    Raises:
        UsageError: as of ``read_json``, or there are no such files.
    """
    files = frame_files(path)
    return _frames(path, kind, (_file_frame(file) for file in files), None)


def frame_files(path: Path) -> list[Path]:
    """Return the JSON files of a folder, each of which is a frame.

    Raises:
        UsageError: there are none, too many, or they are too large together.
    """
    try:
        files = sorted(
            file for file in path.iterdir() if file.suffix.lower() == ".json" and file.name[0] != "."
        )
        size = sum(file.stat().st_size for file in files[: limits.KEYPOINT_SETS + 1])
    except OSError as error:
        raise UsageError("cannot be read", where=path, found=error.strerror or error) from error
    if not files:
        expected = "a JSON file per frame, as OpenPose and MMPose write them"
        raise UsageError("folder holds no keypoints", where=path, expected=expected)
    _check_count(len(files) - 1, path)
    if size > limits.KEYPOINT_BYTES:
        expected = f"{limits.KEYPOINT_BYTES} at most"
        raise UsageError("is too large", where=path, found=f"{size} bytes", expected=expected)
    return files


def _file_frame(file: Path) -> Mapping[str, Any]:
    """Return what a file says of its frame: OpenPose's people, or a list of MMPose's instances."""
    said = _file(file).json(_LONGER)
    if isinstance(said, list):
        said = {_INSTANCES: said}
    if not isinstance(said, Mapping):
        raise UsageError("holds no frame", where=file, found=type(said).__name__, expected=_PEOPLE)
    return {FRAME_FIELDS[0]: _number_in(file), **said}


def _number_in(file: Path) -> int:
    """Return the frame's number in a file's name: ``take_000000000012_keypoints.json``."""
    digits = re.findall(r"\d{1,18}", file.stem.removesuffix("_keypoints"))
    if not digits:
        raise UsageError("name has no frame number", where=file)
    return int(digits[-1])


# Frames


def _frames(path: Path, kind: PointKind, frames: Any, unit: str | None) -> Parsed:
    """A list of frames, which count where they do not say their number, or an object of them by number."""
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
            collector.tell_number(key, key_of(frame[number], where))
        sides |= _take_frame(collector, key, frame, where)
    if collector is None:
        raise UsageError("holds no frames", where=path, found="none", expected=kind.expected)
    if len(sides) > 1:
        raise UsageError("sides are told in two ways", where=path, found=" and ".join(sorted(sides)))
    return Parsed(collector.sets(), unit, next(iter(sides), None))


def _check_count(count: int, where: object) -> None:
    """Raise where more frames, images or annotations came before than are looked at."""
    if count >= limits.KEYPOINT_SETS:
        raise UsageError(
            "too many frames", where=where, found="more", expected=f"{limits.KEYPOINT_SETS} at most"
        )


def _key(frame: Mapping[str, Any], stamp: str | None, place: Any, where: str) -> int:
    if stamp is not None:
        if stamp not in frame:
            raise UsageError("has no stamp", where=where, expected=f"{stamp}, as the first frame has")
        return key_of(frame[stamp], f"{where}, {stamp}", ns_per_unit=NS_PER_UNIT[stamp])
    name = first_of(FRAME_FIELDS, frame)
    return key_of(place if name is None else frame[name], where)


def _take_frame(collector: SetCollector, key: int, frame: Mapping[str, Any], where: str) -> set[str]:
    """Add a frame's hands; return which fields told their sides."""
    frame = _of_peers(collector.kind, frame, where)
    first = collector.new_hand(key)  # entries of one frame: a hand each
    told: set[str] = set()
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
            told.add(field)
            collector.tell_side(key, first + n, _right(label[0], where))
    return told


def _with_names(said: Mapping[str, Any]) -> Iterator[Any]:
    """Yield the frames of a file of MMPose, each with the names of its points."""
    about = said.get("meta_info")
    names = about.get("keypoint_id2name") if isinstance(about, Mapping) else None
    return ({**frame, "names": names} if isinstance(frame, Mapping) else frame for frame in said[_INFO])


def _of_peers(kind: PointKind, frame: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """Return a frame of OpenPose or MMPose as a list of hands or faces, any other as it is."""
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
    """Return x, y, score one after the other as points; one of score 0 is none, and so is a set of such."""
    if not isinstance(values, list) or len(values) % 3:
        if values is None:
            return []
        raise UsageError("points are not x, y, score", where=where, found=type(values).__name__)
    points = [_scored(values[k], values[k + 1], values[k + 2]) for k in range(0, len(values), 3)]
    return points if any(points) else []


def _scored(x: Any, y: Any, score: Any) -> list[Any] | None:
    return None if score == 0 else [x, y, None, score]


def _instance(kind: PointKind, instance: Mapping[str, Any], names: Any) -> list[Mapping[str, Any]]:
    """Return an instance of MMPose as sets: of all its points, or of the parts of a whole body."""
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
    """What a frame says of its hands or faces, each as points or as an object with them."""
    hands = _of(frame, kind.several, None)
    if hands is None:
        one = _of(frame, _ONE, None)
        if one is None:
            return ()
        return one if _is_list_of_hands(one) else (one,)
    if not isinstance(hands, list):
        what = f"{kind.subject}s are no list"
        raise UsageError(what, where=where, found=type(hands).__name__, expected=kind.expected)
    return hands


def _is_list_of_hands(value: Any) -> bool:
    """Whether landmarks are those of several hands: points of points, as MediaPipe's tasks give them."""
    if not isinstance(value, list) or not value or not isinstance(value[0], list):
        return False
    return bool(value[0]) and isinstance(value[0][0], (list, Mapping))


def _labels(frame: Mapping[str, Any]) -> tuple[str, list[Any]] | None:
    """Which of ``SIDE_FIELDS`` a frame or a hand has, and what it says of each hand."""
    name = next((name for name in _LABELS if frame.get(name) is not None), None)
    if name is None:
        return None
    said = frame[name]
    return _LABELS[name], said if isinstance(said, list) else [said]


def _right(label: Any, where: str) -> float:
    """The probability of a right hand that a label states, alone or with a score, in lists or by itself."""
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
    """Add a set's points: a list, an object by name or number, or x, y, score one after the other."""
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
            raise UsageError("holds no points", where=where, found=found, expected=kind.expected)
        listed = [(point_of(kind, name, where), point) for name, point in named]
    elif isinstance(points, list):
        places = kind.places(len(points))
        if places is None:
            what = "has another number of points"
            raise UsageError(what, where=where, found=len(points), expected=kind.counts)
        ours = ((places[k], points[k]) for k in places)
        listed = [(_named(kind, point, k, where), point) for k, point in ours]
    else:
        what = "points are no list"
        raise UsageError(what, where=where, found=type(points).__name__, expected=kind.expected)
    for number, point in listed:
        collector.put(values, number, _values(point, f"{where}, point {number}"), where)


def _named(kind: PointKind, point: Any, place: int, where: str) -> int:
    """Which point an entry of a list is: by its own name where it has one, else by its place."""
    name = _of(point, POINT_FIELDS, None) if isinstance(point, Mapping) else None
    return place if name is None else point_of(kind, name, where)


def _values(point: Any, where: str) -> tuple[float, float, float, float]:
    """x, y, z and score of a point, NaN where unknown."""
    if point is None:
        return (math.nan,) * 4
    if isinstance(point, Mapping):
        x, y, z = (number_of(point.get(axis), f"{where}, {axis}") for axis in "xyz")
        return x, y, z, score_of(_of(point, SCORE_FIELDS, None), f"{where}, score")
    if not isinstance(point, list) or not 2 <= len(point) <= 4:
        found = f"{len(point)} numbers" if isinstance(point, list) else type(point).__name__
        raise UsageError(
            "is no point", where=where, found=found, expected="[x, y], [x, y, z], [x, y, z, score]"
        )
    x, y, z = (number_of(value, where) for value in [*point, None][:3])
    return x, y, z, score_of(point[3] if len(point) == 4 else None, f"{where}, score")


def _of(said: Mapping[str, Any], names: Sequence[str], otherwise: Any) -> Any:
    return next((said[name] for name in names if said.get(name) is not None), otherwise)


# Exports of label tools


def _coco(path: Path, kind: PointKind, said: Mapping[str, Any]) -> Iterator[Mapping[str, Any] | None]:
    """Yield the frames of COCO's keypoint annotations, as label tools export them; None without points."""
    frames = _coco_frames(path, said.get("images"))
    order = _coco_order(path, kind, said.get("categories"))
    for n, annotation in enumerate(said["annotations"]):
        where = f"{path}, annotation {n}"
        points = annotation.get("keypoints") if isinstance(annotation, Mapping) else None
        if not points:
            yield None
            continue
        image = annotation.get("image_id")
        if isinstance(image, (list, dict)) or image not in frames:
            raise UsageError("image is not listed", where=where, found=image, expected="an id in images")
        if not isinstance(points, list) or len(points) != 3 * kind.size:
            found = f"{len(points)} numbers" if isinstance(points, list) else type(points).__name__
            raise UsageError(
                "has other points", where=where, found=found, expected=f"{kind.size} times x, y, v"
            )
        listed: list[Any] = [None] * kind.size
        for k, point in enumerate(order):
            x, y, v = (number_of(value, f"{where}, point {k}") for value in points[3 * k : 3 * k + 3])
            score = _VISIBILITY.get(v, v)
            listed[point] = [None, None, None, score] if score == 0.0 else [x, y, None, score]
        yield {FRAME_FIELDS[0]: frames[image], _ONE[0]: listed}


def _coco_frames(path: Path, images: Any) -> dict[Any, int]:
    """Frame numbers by the images' ids."""
    if not isinstance(images, list) or not all(isinstance(image, Mapping) for image in images):
        raise UsageError("images are not listed", where=path, expected="images with id and file_name")
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
    """The number of each annotated point: by the category's names, where these are ours."""
    first = categories[0] if isinstance(categories, list) and categories else {}
    names = first.get("keypoints") if isinstance(first, Mapping) else None
    if not isinstance(names, list) or any(kind.number(str(name)) is None for name in names):
        return range(kind.size)
    order = [point_of(kind, name, f"{path}, categories") for name in names]
    if sorted(order) != list(range(kind.size)):
        where = f"{path}, categories"
        raise UsageError("has other points", where=where, found=len(names), expected=kind.size)
    return order
