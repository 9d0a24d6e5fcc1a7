"""What hands are like: the mean hand and the ways in which hands differ, learned from people.

``population.npz`` is built by ``scripts/build hand-model`` from the skins and joints of hundreds of drawn
people (`scripts/research/README.md`). A hand is the mean plus modes times coefficients, all of
them in lengths of a hand of 179 mm from the wrist to the middle finger's tip. Coefficients are in standard
deviations: among people each is normal, of mean 0 and variance 1, and independent of the others.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.npz import read_npz

SHIPPED = Path(__file__).with_name("population.npz")
HAND_LENGTH_MM = 179.0
"""From the wrist to the tip of the straight middle finger, where its skin ends, at scale 1: the mean of women
and men."""
COEFFICIENTS = 24
"""How many coefficients the hand that is shipped has."""


class RestHand(NamedTuple):
    """A right hand of scale 1 at zero angles, hand coordinates, mm.

    Attributes:
        cage: (C, 3) points of the skin; a smooth surface goes through them.
        bases: (5, 3) where each finger's joint 3 sits.
        segments: (5, 3) lengths from joint 3 to 2, 2 to 1, 1 to the tip.
        radii: (5, 4) of the fingers at the three joints and near the tip.
    """

    cage: FloatArray
    bases: FloatArray
    segments: FloatArray
    radii: FloatArray


@dataclass(frozen=True, eq=False)
class Population:
    """Mean and modes of hands, and the cage that their skins share.

    Attributes:
        mean: (D,) a ``RestHand`` after another, flattened.
        modes: (K, D) what one standard deviation of each coefficient adds.
        weights: (C, 16) skinning weights of the cage.
        triangles: (T, 3) of the cage.
    """

    mean: FloatArray
    modes: FloatArray
    weights: FloatArray
    triangles: IntArray

    def hand(self, coefficients: Sequence[float] = ()) -> RestHand:
        """Return the hand of up to K coefficients; those that are not given are 0."""
        c = np.asarray(coefficients, dtype=np.float64)
        row = self.mean + c @ self.modes[: c.size]
        ends = np.cumsum([3 * len(self.weights), 15, 15])
        cage, bases, segments, radii = np.split(row, ends)
        return RestHand(cage.reshape(-1, 3), bases.reshape(5, 3), segments.reshape(5, 3), radii.reshape(5, 4))


@functools.cache
def population() -> Population:
    """Return the people's hands that are shipped."""
    with SHIPPED.open("rb") as stream:
        arrays = read_npz(stream)
    mean, modes, weights = (arrays[name].astype(np.float64) for name in ("mean", "modes", "weights"))
    return Population(mean, modes, weights, arrays["triangles"].astype(np.int64))
