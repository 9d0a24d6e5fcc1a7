"""What names, numbers, sides and times mean in files of keypoints, however these are laid out."""

from __future__ import annotations

import math
import re
from decimal import Decimal
from typing import Any, NamedTuple

from posetrack_cli import limits
from posetrack_cli.errors import UsageError, nearest_name
from posetrack_cli.recording.keypoints.kind import PointKind
from posetrack_cli.recording.keypoints.sets import SCORE, KeypointSets, X, Y, Z
from posetrack_cli.recording.matching import LATEST_NS
from posetrack_cli.units import NS_PER_S

PIXELS, NORMALISED, MILLIMETRES, METRES = "px", "normalised", "mm", "m"
UNITS = (PIXELS, NORMALISED, MILLIMETRES, METRES)
UNIT_NAMES = {name: name for name in UNITS} | {
    "pixel": PIXELS,
    "pixels": PIXELS,
    "norm": NORMALISED,
    "normalized": NORMALISED,
    "millimetres": MILLIMETRES,
    "metres": METRES,
}
"""What files call the units."""
NS_PER_UNIT = {
    f"{name}_{unit}": ns
    for unit, ns in (("ns", 1), ("us", 1_000), ("ms", 1_000_000), ("s", NS_PER_S))
    for name in ("stamp", "timestamp", "time", "t")
}
"""Fields of stamps, and what one of their units is in ns."""
FRAME_FIELDS = ("frame", "frame_index", "frame_id", "frame_number", "frame_idx", "image_index")
SCORE_FIELDS = ("score", "confidence", "conf", "visibility", "presence", "likelihood")
POINT_FIELDS = ("landmark", "landmark_index", "landmark_id", "keypoint", "joint", "point", "name", "id")
OVER_ONE = 1.2
"""Scores up to this are 1: peaks of confidence maps, as SLEAP and OpenPose state them, may exceed it."""
SIDE, HANDEDNESS, MIRRORED = "side", "handedness", "multi_handedness"
"""Fields that tell right or left: the hand's own side; the label of MediaPipe's tasks, which is that since
version 0.10.15; and that of its solutions, which take every image for that of a mirror and so call a right
hand left where it is none. Files call either the second."""
SIDE_FIELDS = (SIDE, HANDEDNESS, MIRRORED)
STATUS, LOST = "status", "lost"
KEYS = f"a number in {FRAME_FIELDS[0]} (from 0) or a stamp in stamp_ns, timestamp_ms or time_s"
_AXES = {"x": X, "y": Y, "z": Z} | dict.fromkeys((*SCORE_FIELDS, "c"), SCORE)
_NUMBERED = re.compile(r"(?:(?:landmark|keypoint|point|joint|kp|lm)_?)?(\d{1,3})_?([a-z]+)")
_AXIS_FIRST = re.compile(r"([a-z]+)_?(\d{1,3})")
_NAMED = re.compile(r"([a-z_]+[1-4]?)_([a-z]+)")


class Parsed(NamedTuple):
    """What a file says.

    Attributes:
        sets: its points.
        unit: that it names; None where it does not.
        side_field: which field tells sides, one of ``SIDE_FIELDS``; None where none does.
        first: what the first frame's number is.
    """

    sets: KeypointSets
    unit: str | None
    side_field: str | None
    first: int = 0


class PointColumn(NamedTuple):
    """A column of one point: which, which of its values, and the unit that its name ends in, if any."""

    point: int
    value: int
    unit: str | None


def point_of(kind: PointKind, value: Any, where: object) -> int:
    """Return the number of a point that is told by number or by name.

    Raises:
        UsageError: it is none.
    """
    text = str(value).strip()
    number = int(text) if text.isdecimal() and len(text) < 4 else kind.number(text)
    if number is None:
        raise UsageError("unknown point", where=where, found=repr(text), hint=nearest_name(text, kind.names))
    if not 0 <= number < kind.size:
        raise UsageError("no such point", where=where, found=number, expected=kind.range)
    return number


def point_column(kind: PointKind, name: str) -> PointColumn | None:
    """Return what a column of a wide table is of: ``x0``, ``landmark_0_x``, ``thumb_tip_x_mm`` ..."""
    plain, unit = name.strip().lower().replace(".", "_"), None
    for ending in UNIT_NAMES:
        if plain.endswith(f"_{ending}"):
            plain, unit = plain.removesuffix(f"_{ending}"), UNIT_NAMES[ending]
            break
    if found := _NUMBERED.fullmatch(plain):
        point, axis = int(found[1]), found[2]
    elif found := _AXIS_FIRST.fullmatch(plain):
        point, axis = int(found[2]), found[1]
    elif (found := _NAMED.fullmatch(plain)) and (named := kind.number(found[1])) is not None:
        point, axis = named, found[2]
    else:
        return None
    return PointColumn(point, _AXES[axis], unit) if axis in _AXES else None


def key_of(value: Any, ns_per_unit: int | None, where: object) -> int:
    """Return a frame's number, or a stamp in ns of a number of units; by decimals, so exact.

    Raises:
        UsageError: it is none.
    """
    try:
        if isinstance(value, bool):
            raise ValueError
        number = Decimal(str(value).strip()) * (ns_per_unit or 1)
        if not 0 <= number <= LATEST_NS:  # before it is rounded: 1e99999 has as many digits
            raise ValueError
        if ns_per_unit is None and number != int(number):
            raise ValueError
        return round(number)
    except (ValueError, ArithmeticError):
        kind = "frame number" if ns_per_unit is None else "stamp"
        expected = "a whole number, 0 or more" if ns_per_unit is None else f"0 to {LATEST_NS} ns"
        raise UsageError(
            f"{kind} cannot be used", where=where, found=_shown(value), expected=expected
        ) from None


def number_of(value: Any, where: object) -> float:
    """Return a coordinate; NaN for nothing: None, an empty cell or ``nan``.

    Raises:
        UsageError: it is no number, infinite or too large.
    """
    if value is None or (isinstance(value, str) and value.strip().lower() in ("", "nan", "none", "null")):
        return math.nan
    try:
        if isinstance(value, (bool, list, dict)):
            raise ValueError
        number = float(value)
    except (ValueError, OverflowError):
        raise UsageError("is not a number", where=where, found=_shown(value)) from None
    if math.isnan(number):
        return number
    if abs(number) > limits.LENGTH_MM:
        what = "is too large" if math.isfinite(number) else "is not finite"
        raise UsageError(what, where=where, found=_shown(value), expected=f"{limits.LENGTH_MM:g} at most")
    return number


def score_of(value: Any, where: object) -> float:
    """Return a score; NaN for none.

    Raises:
        UsageError: it is not between 0 and 1.
    """
    score = number_of(value, where)
    if 1.0 < score <= OVER_ONE:
        return 1.0
    if not math.isnan(score) and not 0.0 <= score <= 1.0:
        raise UsageError("score cannot be used", where=where, found=_shown(value), expected="0 to 1")
    return score


def right_of(label: Any, score: float, where: object) -> float:
    """Return the probability that a hand labelled right or left is a right one; NaN for no label.

    Args:
        label: ``right``, ``left``, their first letters, or nothing.
        score: of the label, NaN for 1.
        where: it is said.

    Raises:
        UsageError: another label.
    """
    plain = str(label if label is not None else "").strip().lower()
    if plain in ("", "unknown", "none", "nan"):
        return math.nan
    if plain not in ("right", "left", "r", "l"):
        raise UsageError("unknown side", where=where, found=_shown(label), expected="right or left")
    sure = 1.0 if math.isnan(score) else max(score, 0.5)  # a label less probable than the other is no label
    return sure if plain[0] == "r" else 1.0 - sure


def unit_of(name: Any, where: object) -> str:
    """Return a unit by its name in a file.

    Raises:
        UsageError: there is none of this name.
    """
    if (plain := str(name).strip().lower()) not in UNIT_NAMES:
        raise UsageError("unknown unit", where=where, found=_shown(name), expected=", ".join(UNITS))
    return UNIT_NAMES[plain]


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:40]}..."
