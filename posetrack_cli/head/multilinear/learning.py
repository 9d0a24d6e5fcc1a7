"""From the faces of several results to a model (thesis, 4.2.2 and figure 4.4).

Each person shows two motions in frames of any order. Each motion has a distance l in the face; its rate is
r = (l - l_min) / (l_max - l_min), and the model is built of the shapes at even rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.head.face.points import BROWS, MOUTH
from posetrack_cli.head.multilinear.build import BuiltModel, build_model, possible_ranks
from posetrack_cli.head.multilinear.observed_face import ObservedFace

LEAST_PEOPLE = 2


@dataclass(frozen=True, eq=False)
class LearnedModel:
    """A model and the people it was learned from.

    Attributes:
        built: the model and its samples.
        faces: S people.
        examples: what each of them does, motion by motion.
        possible: the most identity and deformation parameters that their faces tell of.
    """

    built: BuiltModel
    faces: tuple[ObservedFace, ...]
    examples: tuple[tuple[MotionExamples, ...], ...]
    possible: tuple[int, int]


def learn_model(faces: Sequence[ObservedFace], identity: int, deformation: int) -> LearnedModel:
    """Build a model from several people; with fewer parameters than asked where the faces tell of no more.

    Raises:
        UsageError: there are too few people.
        ResultError: one of them shows too little.
    """
    if len(faces) < LEAST_PEOPLE:
        raise UsageError(
            "too few people", found=len(faces), expected=f"results of {LEAST_PEOPLE} or more, one of each"
        )
    examples = tuple(examples_of(face) for face in faces)
    shapes = np.stack([np.concatenate([motion.shapes for motion in motions]) for motions in examples])
    possible = possible_ranks(shapes)
    built = build_model(shapes, min(identity, possible[0]), min(deformation, possible[1]))
    return LearnedModel(built, tuple(faces), examples, possible)


RATES = np.linspace(0.0, 1.0, 5)
MOTIONS = ("mouth sideways", "whole face up and down")
NEAR_MM = 2.0
"""[ours] A motion is at rest where its distance is so near that of the neutral face."""
ENDS = (3.0, 97.0)
"""[ours] Percentiles of a distance that count as l_min and l_max: no outlier does."""
LEAST_RANGE_MM = 5.0
LEAST_AT_RATE, LEAST_VISITED = 3, 3
"""[ours] A rate was visited in so many frames; a motion in so many rates."""


@dataclass(frozen=True, eq=False)
class MotionExamples:
    """One motion of one person.

    Attributes:
        lowest, highest: l_min and l_max, mm.
        counts: (R,) frames at each of ``RATES``; between those with fewer than ``LEAST_AT_RATE`` and their
            neighbours the shapes are interpolated.
        shapes: (R, K, 3) mm.
    """

    lowest: float
    highest: float
    counts: IntArray
    shapes: FloatArray


def examples_of(face: ObservedFace) -> tuple[MotionExamples, ...]:
    """Return what a person does in each of ``MOTIONS``.

    A frame belongs to the motion whose distance differs more from the neutral face's **[ours]**: a smile
    shortens the face, and an open jaw narrows the mouth, but by less.

    Raises:
        ResultError: the person shows too little of a motion.
    """
    distances = _distances(face.shapes)
    away = np.abs(distances - np.array([neutral_of(values) for values in distances])[:, None])
    at_rest = away.max(axis=0) < NEAR_MM
    moving = away.argmax(axis=0)
    chosen = [(moving == number) | at_rest for number in range(len(MOTIONS))]
    return tuple(
        _examples(face, name, face.shapes[rows], values[rows])
        for name, rows, values in zip(MOTIONS, chosen, distances, strict=True)
    )


def neutral_of(distances: FloatArray) -> float:
    """Return the distance of a face at rest: the median of the shortest interval that holds half of (N,).

    It is where a face is most often, also where it moves to one side only.
    """
    ordered = np.sort(distances)
    half = (len(ordered) + 1) // 2
    first = int(np.argmin(ordered[half - 1 :] - ordered[: len(ordered) - half + 1]))
    return float(np.median(ordered[first : first + half]))


def _distances(shapes: FloatArray) -> FloatArray:
    """(motions, N) mm: between the mouth's corners, and from the brows to the mouth."""
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
            f"shows too little of the motion '{motion}'",
            where=face.path,
            found=f"a distance that changes by {highest - lowest:.1f} mm, and {len(visited)} of its rates",
            expected=f"{LEAST_RANGE_MM:g} mm and {LEAST_VISITED} rates or more",
            hint="leave this person out, or record the motion in full",
        )
    return MotionExamples(float(lowest), float(highest), counts, _at_rates(shapes, rates, visited))


def _at_rates(shapes: FloatArray, rates: FloatArray, groups: Sequence[IntArray]) -> FloatArray:
    """(R, K, 3): medians of groups of frames, each at its own median rate, and linear between them."""
    known = np.array([np.median(rates[rows]) for rows in groups])
    medians = np.stack([np.median(shapes[rows], axis=0) for rows in groups])
    shares = np.stack([np.interp(RATES, known, row) for row in np.eye(len(known))], axis=1)
    between: FloatArray = np.tensordot(shares, medians, axes=1)
    return between
