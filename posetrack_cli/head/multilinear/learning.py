"""Learning a face model from stereo results (thesis, 4.2.2 and figure 4.4).

Each person shows two motions in frames of any order. Each motion changes a distance l in the face; its rate
is r = (l - l_min) / (l_max - l_min), and the model is built from the shapes at evenly spaced rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.geometry.rigid import in_object
from posetrack_cli.head.face.points import BROWS, EYES, MOUTH, POINT_NAMES
from posetrack_cli.head.multilinear.build import BuiltModel, build_model, mirrored, possible_ranks
from posetrack_cli.head.subject import HEAD, WEIGHT
from posetrack_cli.losses import Loss
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.estimate import Status
from posetrack_cli.results.fields import NUMBERS
from posetrack_cli.results.reader import Result, read_result

TRACKER = "head-stereo"
LEAST_WEIGHT = 0.05
"""[ours] A frame is used if every point has a higher weight in the tracker."""
LEAST_FRAMES = 30
MOST_SHIFT_MM = 4.0
"""[ours] Maximum asymmetric motion of the mouth corners."""
_RIGHT_CORNER = POINT_NAMES.index("right_mouth_corner")
_FIELDS = ("status", "position", "quaternion", "points", NUMBERS)


@dataclass(frozen=True, eq=False)
class ObservedFace:
    """One person's face in the usable frames.

    Attributes:
        path: of the result.
        frames: number of frames of the result.
        shapes: (N, K, 3) refined points M', mm in the head's frame, with the mean of the eye corners as
            origin.
        losses: parts of the result that could not be read.
    """

    path: Path
    frames: int
    shapes: FloatArray
    losses: Sequence[Loss] = ()


def read_face(path: Path) -> ObservedFace:
    """Read a result of ``posetrack head stereo``.

    Raises:
        UsageError: a result of another tracker.
        ResultError: the result cannot be read, or has too few usable frames.
    """
    result = read_result(path)
    _check_tracker(result)
    columns = result.columns(fields=_FIELDS)
    used = _usable_frames(columns, result.subject.number_names)
    place = (columns[name][used][:, None] for name in ("position", "quaternion"))
    shapes = _symmetric_only(_centred(in_object(columns["points"][used], *place)))
    if len(shapes) < LEAST_FRAMES:
        raise ResultError(
            "too few frames show the whole face",
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
        "cannot learn a face model from this result",
        where=result.path,
        found=f"a result of '{tracker or result.subject.name}'",
        expected="a result of posetrack head stereo, which measures shapes without a model",
    )


def _usable_frames(
    columns: Columns, number_names: Sequence[str]
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return (N,) tracked frames with all points visible; results without weights count as visible."""
    tracked = columns["status"] == Status.TRACKING.value
    rows = [
        number_names.index(f"{WEIGHT}{name}") for name in POINT_NAMES if f"{WEIGHT}{name}" in number_names
    ]
    hidden = np.any(columns[NUMBERS][:, rows] < LEAST_WEIGHT, axis=1)  # False for NaN, an unknown weight
    good: np.ndarray[tuple[int], np.dtype[np.bool_]] = tracked & ~hidden
    return good


def _centred(shapes: FloatArray) -> FloatArray:
    """Move the mean of the eye corners to the origin, by its median over frames because of blinks."""
    return shapes - np.median(shapes[:, EYES].mean(axis=1), axis=0) if len(shapes) else shapes


def _symmetric_only(shapes: FloatArray) -> FloatArray:
    """Return the frames in which both mouth corners move symmetrically, as in the model **[ours]**."""
    if not len(shapes):
        return shapes
    one_sided = 0.5 * (shapes - mirrored(shapes))[:, _RIGHT_CORNER]
    apart = np.linalg.norm(one_sided - np.median(one_sided, axis=0), axis=-1)
    symmetric: FloatArray = shapes[apart <= MOST_SHIFT_MM]
    return symmetric


LEAST_PEOPLE = 2


@dataclass(frozen=True, eq=False)
class LearnedModel:
    """A model and the people it was learned from.

    Attributes:
        built: the model and its samples.
        faces: S people.
        examples: each person's motions.
        possible: largest numbers of identity and deformation parameters that the faces support.
    """

    built: BuiltModel
    faces: tuple[ObservedFace, ...]
    examples: tuple[tuple[MotionExamples, ...], ...]
    possible: tuple[int, int]


def learn_model(faces: Sequence[ObservedFace], identity: int, deformation: int) -> LearnedModel:
    """Build a model from several people, with fewer parameters if the faces do not support more.

    Raises:
        UsageError: there are too few people.
        ResultError: a person shows too little motion.
    """
    if len(faces) < LEAST_PEOPLE:
        raise UsageError(
            "too few people", found=len(faces), expected=f"results of {LEAST_PEOPLE} or more people, one each"
        )
    examples = tuple(examples_of(face) for face in faces)
    shapes = np.stack([np.concatenate([motion.shapes for motion in motions]) for motions in examples])
    possible = possible_ranks(shapes)
    built = build_model(shapes, min(identity, possible[0]), min(deformation, possible[1]))
    return LearnedModel(built, tuple(faces), examples, possible)


RATES = np.linspace(0.0, 1.0, 5)
MOTIONS = ("mouth sideways", "whole face up and down")
NEAR_MM = 2.0
"""[ours] A motion is at rest if its distance is within this of the neutral face."""
ENDS = (3.0, 97.0)
"""[ours] Percentiles of a distance used as l_min and l_max, which excludes outliers."""
LEAST_RANGE_MM = 5.0
LEAST_AT_RATE, LEAST_VISITED = 3, 3
"""[ours] Minimum number of frames for a rate, and of rates for a motion."""


@dataclass(frozen=True, eq=False)
class MotionExamples:
    """One motion of one person.

    Attributes:
        lowest, highest: l_min and l_max, mm.
        counts: (R,) frames at each of ``RATES``; shapes at rates with fewer than ``LEAST_AT_RATE`` are
            interpolated.
        shapes: (R, K, 3) mm.
    """

    lowest: float
    highest: float
    counts: IntArray
    shapes: FloatArray


def examples_of(face: ObservedFace) -> tuple[MotionExamples, ...]:
    """Return a person's examples of each of ``MOTIONS``.

    A frame belongs to the motion whose distance differs more from the neutral face's **[ours]**: a smile
    shortens the face and an open jaw narrows the mouth, but by less.

    Raises:
        ResultError: the person shows too little of a motion.
    """
    distances = _distances(face.shapes)
    away = np.abs(distances - np.array([neutral_of(values) for values in distances])[:, None])
    at_rest = away.max(axis=0) < NEAR_MM
    moving = away.argmax(axis=0)  # a frame at rest is an example of every motion
    chosen = [(moving == number) | at_rest for number in range(len(MOTIONS))]
    return tuple(
        _examples(face, name, face.shapes[rows], values[rows])
        for name, rows, values in zip(MOTIONS, chosen, distances, strict=True)
    )


def neutral_of(distances: FloatArray) -> float:
    """Return the distance of a face at rest: the median of the shortest interval with half of (N,).

    It is the most frequent distance, even if the face only moves to one side.
    """
    ordered = np.sort(distances)
    half = (len(ordered) + 1) // 2
    first = int(np.argmin(ordered[half - 1 :] - ordered[: len(ordered) - half + 1]))
    return float(np.median(ordered[first : first + half]))


def _distances(shapes: FloatArray) -> FloatArray:
    """Return (motions, N) mm: between the mouth corners, and from the brows to the mouth."""
    right, left = np.moveaxis(shapes[:, MOUTH], 1, 0)
    down = shapes[:, BROWS].mean(axis=1) - shapes[:, MOUTH].mean(axis=1)
    return np.stack([np.linalg.norm(left - right, axis=-1), np.linalg.norm(down, axis=-1)])


def _examples(face: ObservedFace, motion: str, shapes: FloatArray, distances: FloatArray) -> MotionExamples:
    lowest, highest = np.percentile(distances, ENDS) if len(distances) else (0.0, 0.0)
    rates = np.clip((distances - lowest) / max(highest - lowest, 1e-9), 0.0, 1.0)
    nearest = np.rint(rates * (len(RATES) - 1)).astype(np.int64)
    counts = np.bincount(nearest, minlength=len(RATES))
    visited = [nearest == number for number in np.flatnonzero(counts >= LEAST_AT_RATE)]
    if highest - lowest < LEAST_RANGE_MM or len(visited) < LEAST_VISITED:
        raise ResultError(
            f"too little of the motion '{motion}'",
            where=face.path,
            found=f"a range of {highest - lowest:.1f} mm with {len(visited)} rates",
            expected=f"at least {LEAST_RANGE_MM:g} mm with {LEAST_VISITED} rates",
            hint="record the full motion, or leave out this person",
        )
    return MotionExamples(float(lowest), float(highest), counts, _at_rates(shapes, rates, visited))


def _at_rates(shapes: FloatArray, rates: FloatArray, groups: Sequence[IntArray]) -> FloatArray:
    """Return (R, K, 3): medians of groups of frames at their median rates, linearly interpolated."""
    known = np.array([np.median(rates[rows]) for rows in groups])
    medians = np.stack([np.median(shapes[rows], axis=0) for rows in groups])
    shares = np.stack([np.interp(RATES, known, row) for row in np.eye(len(known))], axis=1)
    between: FloatArray = np.tensordot(shares, medians, axes=1)
    return between
