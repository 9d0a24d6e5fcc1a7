"""Where hair grows on a head, and how it is painted."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.synthesis.head.identity import Looks

# angle from the front, deg: the hairline's height, mm, relative to its height in the middle
_ANGLES = np.radians([0.0, 20.0, 38.0, 52.0, 62.0, 72.0, 82.0, 92.0, 105.0, 120.0, 180.0])
_DROP = np.array([0.0, 1.0, 4.0, 12.0, 38.0, 62.0, 92.0, 84.0, 96.0, 150.0, 165.0])


def hair_share(places: FloatArray, looks: Looks, *, soft_mm: float = 8.0) -> FloatArray:
    """Return how much hair (...) grows at places (..., 3) of the average head: 0 none, 1 full."""
    angle = np.abs(np.arctan2(places[..., 0], (places[..., 2] + 82.0)))
    line = looks.hairline - np.interp(angle, _ANGLES, _DROP)
    s = np.clip((places[..., 1] - line) / soft_mm, 0.0, 1.0)
    share: FloatArray = s * s * (3.0 - 2.0 * s)
    return share
