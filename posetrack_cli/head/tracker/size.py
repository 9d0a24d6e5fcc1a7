"""How large a head is, where that is told: one camera does not see it **[ours]**.

Images stay the same where all lengths are multiplied by one factor c. Of c alone is known that the likeliest
face has 1: log c ~ N(0, m^2). A distance X of the pupils, measured with the standard deviation s_X, tells

    log X = log c + log D + e,    e ~ N(0, s^2),    s^2 = (s_X^2 + s_D^2) / X^2

with D the same distance of the person whom the images were adjusted to, c = 1, known to s_D. So

    log c = k log (X / D),    sd(log c) = m sqrt(1 - k),    k = m^2 / (m^2 + s^2).

Pupils are taken to lie midway between the corners of their eye. In the statistics that the shipped model
comes from, ICT-FaceKit's, these middles are 63.0 mm apart on average, and people's pupils 63.4 (Dodgson 2004,
3976 adults). The corners that are followed lie ``CORNERS_OUTSIDE_MM`` farther out than those landmarks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.pose import ShapeModel

CORNERS_OUTSIDE_MM = 2.1
"""So much farther apart are the middles of eyes' corners as they are followed, in true mm, than as the
statistics' landmarks have them: over ten people of the study, whose recordings have the landmarks' places; it
spreads by 1.0 mm between them. It is 2.7 and 4.9 mm for two more. Where corners are found by what was learned
without the person it is 1.1 mm, and spreads by 2.1 mm (1.4 mm without one of them)."""
SMALLEST_SIZE, LARGEST_SIZE = 0.2, 5.0
"""Of any head beside the likeliest; a measurement that tells more is of something else."""
CORNERS_SD_MM = 1.1
"""s_D: the middles of eyes' corners, as followed, are pupils to within this, by nine of ten people of the
study."""
PRIOR_SD = 0.035
"""m: one camera does not see how large a head is. Chosen on the same people."""
DOUBTFUL = 2.5
"""Standard deviations between what is told and what is likely: one person in eighty."""
LEAST_MM = 1.0
"""A model may have faces whose eyes touch: even then logarithms are numbers."""
_RIGHT_EYE, _LEFT_EYE = slice(0, 2), slice(2, 4)


class Size(NamedTuple):
    """What all lengths of a person are multiplied by.

    Attributes:
        factor: c.
        sd: of log c.
    """

    factor: float
    sd: float

    def of_shape(self, shape: ShapeModel) -> ShapeModel:
        """Return how a face of that size deforms."""
        return ShapeModel(self.factor * shape.mean, self.factor * shape.basis, shape.deviations)


class SizeMeasurement(Protocol):
    """What tells how large a person is."""

    def size_of(self, shape: FloatArray) -> Size:
        """Return the size of a person whom images were adjusted to as the neutral shape (K, 3), mm."""


@dataclass(frozen=True)
class PupilDistance:
    """A measured distance of the pupils.

    Attributes:
        distance_mm: X.
        sd_mm: of X beside D, s times X.
        prior_sd: m.
    """

    distance_mm: float
    sd_mm: float
    prior_sd: float = PRIOR_SD

    def size_of(self, shape: FloatArray) -> Size:
        """Return c and its deviation."""
        return _updated(self.distance_mm / pupil_distance(shape), self._sd, self.prior_sd)

    def doubt(self, shape: FloatArray) -> tuple[str, ...]:
        """Return a line where the person (K, 3) would be of a size that hardly anybody has."""
        seen = pupil_distance(shape)
        if abs(np.log(self.distance_mm / seen)) <= DOUBTFUL * float(np.hypot(self._sd, self.prior_sd)):
            return ()
        return (
            f"pupils {self.distance_mm:.3g} mm apart are told, but those of the likeliest such face are"
            f" {seen:.0f} mm apart: is the distance right, and does posetrack view show points at the corners"
            " of the eyes?",
        )

    @property
    def _sd(self) -> float:
        """s."""
        return self.sd_mm / self.distance_mm


def pupil_distance(shape: FloatArray) -> float:
    """Return D, mm, of a shape (K, 3) of followed points."""
    middles = shape[_LEFT_EYE].mean(axis=0) - shape[_RIGHT_EYE].mean(axis=0)
    return max(float(np.linalg.norm(middles)) - CORNERS_OUTSIDE_MM, LEAST_MM)


def _updated(ratio: float, sd: float, prior_sd: float) -> Size:
    """Return the size after one measurement of c: the Kalman step of its logarithm."""
    gain = prior_sd**2 / (prior_sd**2 + sd**2) if prior_sd > 0.0 else 0.0
    factor = float(np.clip(np.exp(gain * np.log(ratio)), SMALLEST_SIZE, LARGEST_SIZE))
    return Size(factor, float(prior_sd * np.sqrt(1.0 - gain)))
