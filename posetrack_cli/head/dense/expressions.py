"""Strengths of facial expressions from displacements of the dense points **[ours]**.

The expressions are those of ICT-FaceKit (USC Institute for Creative Technologies, MIT licence), named like
ARKit's blend shapes. Their displacements D_e (D, 3) at full strength were measured on that model. As in
``head.actions``, the strengths g >= 0 of displacements d from the neutral face are

    g = argmin |d - sum_e g_e D_e|^2 / s^2 + |g|^2 / p^2

with the points' variances s^2 and the prior standard deviation p of a strength.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.files import read_input
from posetrack_cli.npz import read_npz

BLEND_SHAPES = (
    "jawOpen",
    "mouthPucker",
    "mouthFunnel",
    "mouthLeft",
    "mouthRight",
    "mouthSmileLeft",
    "mouthSmileRight",
    "mouthFrownLeft",
    "mouthFrownRight",
    "mouthStretchLeft",
    "mouthStretchRight",
    "mouthUpperUpLeft",
    "mouthUpperUpRight",
    "mouthLowerDownLeft",
    "mouthLowerDownRight",
    "browInnerUp",
    "browDownLeft",
    "browDownRight",
    "browOuterUpLeft",
    "browOuterUpRight",
)
"""Names of the E expressions, by ARKit."""
SHIPPED = Path(__file__).with_name("expressions.npz")
USUAL = 0.5
"""p, prior standard deviation of a strength."""
LEAST_SD_MM = 0.7
"""Smallest standard deviation of a point: expressions differ between people."""
ROUNDS = 6


@lru_cache(maxsize=1)
def displacements() -> FloatArray:
    """Return D (E, D, 3), mm; zero for irises."""
    shipped: FloatArray = read_npz(read_input(SHIPPED, limits.MODEL_BYTES))["displacements"].astype(
        np.float64
    )
    return shipped


def strengths(moved: FloatArray, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Estimate strengths (E,) and their standard deviations.

    Args:
        moved: (D, 3) mm, displacements from the neutral face; NaN for unknown points.
        variances: (D,) mm^2, of each coordinate.
    """
    known = ~np.isnan(moved[:, 0])
    directions = displacements()[:, known].reshape(len(BLEND_SHAPES), -1)
    precisions = np.repeat(1.0 / (variances[known] + LEAST_SD_MM**2), 3)
    system = directions * precisions @ directions.T + np.eye(len(BLEND_SHAPES)) / USUAL**2
    right = directions @ (precisions * moved[known].ravel())
    free = np.ones(len(BLEND_SHAPES), dtype=bool)
    found = np.zeros(len(BLEND_SHAPES))
    for _ in range(ROUNDS):  # negative strengths are set to zero, and the others estimated again
        found[:] = 0.0
        found[free] = np.linalg.solve(system[np.ix_(free, free)], right[free])
        if (found >= 0.0).all():
            break
        free &= found > 0.0
    return np.maximum(found, 0.0), np.sqrt(np.diag(np.linalg.inv(system)))
