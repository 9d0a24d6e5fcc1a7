"""From the faces of several results to a model (thesis, 4.2.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.errors import UsageError
from posetrack_cli.head.multilinear.build import BuiltModel, build_model, possible_ranks
from posetrack_cli.head.multilinear.examples import MotionExamples, examples_of
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
