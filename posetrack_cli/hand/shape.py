"""What people's hands differ by: fourteen factors on the lengths of a hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.anatomy import FINGERS

SHAPE_NAMES: tuple[str, ...] = (
    "scale",
    *(f"{finger}_length" for finger in FINGERS),
    *(f"{finger}_width" for finger in FINGERS),
    "palm_width",
    "palm_length",
    "palm_thickness",
)
SHAPE_SIZE = len(SHAPE_NAMES)
_LENGTHS, _WIDTHS = slice(1, 6), slice(6, 11)
PerFinger = tuple[float, float, float, float, float]
_ONES: PerFinger = (1.0, 1.0, 1.0, 1.0, 1.0)

POPULATION_SD: FloatArray = np.array([0.08, *[0.05] * 5, *[0.07] * 5, 0.06, 0.05, 0.08])
"""(14,) standard deviations of the factors' logarithms among adults **[ours]**.

Hand length among adult men and women together varies by 5 to 6 %, breadth by 7 to 8 %, finger breadths
by about 8 % (US Army survey ANSUR, 1988); what is left of a finger's length when the hand's is known, by
4 %. A little more is allowed here.
"""


@dataclass(frozen=True)
class HandShape:
    """Factors on the lengths of the average hand, or of a hand from a file; all 1 is that hand itself.

    Attributes:
        scale: on every length.
        finger_lengths: further, on each finger's segments, thumb first.
        finger_widths: further, on each finger's radii, thumb first.
        palm_width: further, on the palm across.
        palm_length: further, on the palm from the wrist to the knuckles.
        palm_thickness: further, on the palm from its back to its front.
    """

    scale: float = 1.0
    finger_lengths: PerFinger = _ONES
    finger_widths: PerFinger = _ONES
    palm_width: float = 1.0
    palm_length: float = 1.0
    palm_thickness: float = 1.0

    @property
    def palm(self) -> tuple[float, float, float]:
        """Factors along the hand's x, y and z."""
        return self.palm_width, self.palm_length, self.palm_thickness

    @property
    def factors(self) -> FloatArray:
        """(14,) in the order of ``SHAPE_NAMES``."""
        return np.array([self.scale, *self.finger_lengths, *self.finger_widths, *self.palm])

    @classmethod
    def of_factors(cls, factors: FloatArray) -> HandShape:
        """The shape of (14,) factors in the order of ``SHAPE_NAMES``."""
        values = [float(factor) for factor in factors]
        lengths, widths = tuple(values[_LENGTHS]), tuple(values[_WIDTHS])
        return cls(values[0], lengths, widths, *values[11:])  # type: ignore[arg-type]


def random_shape(rng: np.random.Generator) -> HandShape:
    """A hand as different as may be met: scale .85 to 1.15, fingers' lengths, radii and palm within 10 %."""
    spread = np.array([0.15, *[0.10] * (SHAPE_SIZE - 1)])
    return HandShape.of_factors(1.0 + spread * rng.uniform(-1.0, 1.0, SHAPE_SIZE))
