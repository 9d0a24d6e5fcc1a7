"""The shapes that a stereo result saw one person's face in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.geometry.poses import in_object
from posetrack_cli.head.face.points import EYES, POINT_NAMES
from posetrack_cli.head.multilinear.build import mirrored
from posetrack_cli.head.subject import HEAD, WEIGHT
from posetrack_cli.losses import Loss
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.estimate import Status
from posetrack_cli.results.fields import NUMBERS
from posetrack_cli.results.reader import Result, read_result

TRACKER = "head-stereo"
LEAST_WEIGHT = 0.05
"""[ours] A frame counts if every point of it counted more than this for the tracker."""
LEAST_FRAMES = 30
MOST_SHIFT_MM = 4.0
"""[ours] How far the mouth's corners may move other than symmetrically."""
_RIGHT_CORNER = POINT_NAMES.index("right_mouth_corner")
_FIELDS = ("status", "position", "quaternion", "points", NUMBERS)


@dataclass(frozen=True, eq=False)
class ObservedFace:
    """One person's face in the frames that can be relied on.

    Attributes:
        path: the result.
        frames: of the result.
        shapes: (N, K, 3) recalculated points M', mm in the head's frame; the mean of the eye corners is its
            origin.
        losses: what could not be read of the result.
    """

    path: Path
    frames: int
    shapes: FloatArray
    losses: Sequence[Loss] = ()


def read_face(path: Path) -> ObservedFace:
    """Read a result of ``posetrack head stereo``.

    Raises:
        UsageError: it is another tracker's.
        ResultError: it cannot be read, or has too few frames that can be relied on.
    """
    result = read_result(path)
    _check_tracker(result)
    columns = result.columns(fields=_FIELDS)
    used = _relied_on(columns, result.subject.number_names)
    place = (columns[name][used][:, None] for name in ("position", "quaternion"))
    shapes = _symmetric_only(_centred(in_object(columns["points"][used], *place)))
    if len(shapes) < LEAST_FRAMES:
        raise ResultError(
            "too few frames show all of the face",
            where=path,
            found=f"{len(shapes)} of {len(used)}",
            expected=f"{LEAST_FRAMES} or more",
        )
    return ObservedFace(path, len(used), shapes, result.losses)


def _check_tracker(result: Result) -> None:
    tracker = result.run.get("tracker", "")
    if (result.subject.name, tracker) == (HEAD, TRACKER) and result.subject.point_names == POINT_NAMES:
        return
    raise UsageError(
        "faces cannot be learned from this result",
        where=result.path,
        found=f"one of '{tracker or result.subject.name}'",
        expected="one of posetrack head stereo, which sees shapes without a model",
    )


def _relied_on(columns: Columns, number_names: Sequence[str]) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(N,) tracked, with every point seen; where the result states no weights, tracked."""
    tracked = columns["status"] == Status.TRACKING.value
    rows = [
        number_names.index(f"{WEIGHT}{name}") for name in POINT_NAMES if f"{WEIGHT}{name}" in number_names
    ]
    hidden = np.any(columns[NUMBERS][:, rows] < LEAST_WEIGHT, axis=1)  # what is not known is no reason
    good: np.ndarray[tuple[int], np.dtype[np.bool_]] = tracked & ~hidden
    return good


def _centred(shapes: FloatArray) -> FloatArray:
    """With the mean of the eye corners at the origin over the recording: in a frame, they blink."""
    return shapes - np.median(shapes[:, EYES].mean(axis=1), axis=0) if len(shapes) else shapes


def _symmetric_only(shapes: FloatArray) -> FloatArray:
    """The frames in which both corners of the mouth do the same, as in the model **[ours]**."""
    if not len(shapes):
        return shapes
    one_sided = 0.5 * (shapes - mirrored(shapes))[:, _RIGHT_CORNER]
    apart = np.linalg.norm(one_sided - np.median(one_sided, axis=0), axis=-1)
    symmetric: FloatArray = shapes[apart <= MOST_SHIFT_MM]
    return symmetric
