"""What a hand measures, mm: what people can compare with a ruler, whatever numbers a shape is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.anatomy import FINGERS, HandAnatomy
from posetrack_cli.hand.model import HandMaker
from posetrack_cli.hand.shape import HandShape, ShapeSpace

MEASURES: tuple[str, ...] = (
    "hand_length",
    "palm_length",
    "palm_width",
    *(f"{finger}_length" for finger in FINGERS),
    *(f"{finger}_radius" for finger in FINGERS),
)


def measures_of(anatomy: HandAnatomy) -> FloatArray:
    """Return the measures (13,) of a hand, mm, in the order of ``MEASURES``.

    ``hand_length`` is from the wrist to the tip of the straight middle finger, ``palm_length`` to its
    knuckle; ``palm_width`` from the index to the little finger's knuckle; lengths of fingers are from knuckle
    (of the thumb, from its second joint) to tip, radii means over a finger.
    """
    bases, segments = anatomy.base_positions, anatomy.segments
    palm = float(np.linalg.norm(bases[2]))
    lengths = segments.sum(axis=1) - np.array([segments[0, 0], 0.0, 0.0, 0.0, 0.0])
    width = float(np.linalg.norm(bases[1] - bases[4]))
    return np.array([palm + segments[2].sum(), palm, width, *lengths, *anatomy.radii.mean(axis=1)])


@dataclass(frozen=True, eq=False)
class Measured:
    """A hand's measures, mm, and their standard deviations: stated, and what they are before a recording.

    Attributes:
        values, sd, prior_sd: by the names of ``MEASURES``, and ``padding``.
    """

    values: Mapping[str, float]
    sd: Mapping[str, float]
    prior_sd: Mapping[str, float]


def measured(
    maker: HandMaker, space: ShapeSpace, side: str, shape: HandShape, covariance: FloatArray
) -> Measured:
    """Return a shape's measures, and their standard deviations from those of the space's numbers (S, S).

    ``padding``, by how much the skin stands out, is measured beside ``MEASURES`` where the space has one.
    """
    theta = space.theta(shape)

    def numbers(of: FloatArray) -> FloatArray:
        shape = space.shape(of)
        known = measures_of(maker(side, shape).anatomy)
        return np.append(known, shape.padding_mm) if has_padding else known

    has_padding = "padding_mm" in space.names
    names = (*MEASURES, "padding") if has_padding else MEASURES
    here = numbers(theta)
    rates = np.array([(numbers(theta + step) - here) / step.sum() for step in np.diag(space.steps)])

    def deviations(of: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt(np.einsum("sm,st,tm->m", rates, of, rates)))

    stated, before = deviations(covariance), deviations(np.diag(space.sd**2))
    rows = (dict(zip(names, row.tolist(), strict=True)) for row in (here, stated, before))
    return Measured(*rows)
