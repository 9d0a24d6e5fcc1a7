"""Named facial actions: jaw open, mouth wide, mouth round, mouth to the left, brows up **[ours]**.

Deformation coefficients are principal directions without a meaning of their own. Actions are named
expressions of ICT-FaceKit (USC Institute for Creative Technologies, MIT licence). Their displacements D_e
(K, 3) of the ten points at full strength were measured on that model: jawOpen; .7 mouthSmile + .3
mouthStretch; mouthPucker; half of mouthLeft less mouthRight; browInnerUp. The strengths g, relative to the
full expression, follow from the points' displacements d from the neutral face:

    g = argmin |d - sum_e g_e D_e|^2 / s^2 + |g|^2 / p^2 = (D^T S^-1 D + 1 / p^2)^-1 D^T S^-1 d

S = s_k^2 is the variance of a point and p the prior standard deviation of a strength; the first factor is
the covariance of g. A strength of 0 is the neutral face, 1 the extreme of the statistics; negative values
are the opposite action (brows down, mouth to the right).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import BROWS, EYES, MIRRORED, MOUTH, NOSTRILS, POINT_COUNT

_RIGHT_SIDE: dict[str, tuple[tuple[float, float, float], ...]] = {
    "jaw_open": ((0, 0, 0), (0, 0, 0), (2.8, -13.1, -11.2), (0, -1.8, -0.3), (0, 0, 0)),
    "mouth_wide": ((0, 0.2, 0.1), (0, 0.1, 0), (-6.9, 6.4, -8.5), (-1.0, 0.7, -1.2), (0, 0, 0)),
    "mouth_round": ((0, 0, 0), (0, 0, 0), (4.6, 2.2, 9.8), (0.2, -0.2, 0.6), (0, 0, 0)),
    "mouth_left": ((0, 0, 0), (0, 0, 0), (10.8, -2.6, 6.7), (7.3, -0.8, 1.3), (0, 0, 0)),
    "brows_up": ((0, 0.1, 0), (0, 0.2, 0.1), (0, 0, 0), (0, 0.3, 0), (-0.5, 5.6, -0.3)),
}
"""(5, 3) mm in the head's frame, of the right outer and inner eye corner, mouth corner, nostril and brow."""
_ONE_SIDED = "mouth_left"
"""The asymmetric action: its left side is the negative mirror image of the right side."""
ACTIONS = tuple(_RIGHT_SIDE)
_RIGHT = (0, 1, 4, 6, 8)
USUAL = 0.5
"""p, prior standard deviation of a strength."""
_NAMES = tuple(f"action_{name}" for name in ACTIONS)
ACTION_NAMES = (*_NAMES, *(f"{name}_sd" for name in _NAMES))
"""Names of the numbers in a result: strengths, then their standard deviations."""


class Strengths(NamedTuple):
    """Strengths of the actions of one face.

    Attributes:
        values: (E,) relative to the extreme of the statistics.
        deviations: (E,) standard deviations.
    """

    values: FloatArray
    deviations: FloatArray


def displacements() -> FloatArray:
    """Return D (E, K, 3), mm."""
    found = np.zeros((len(ACTIONS), POINT_COUNT, 3))
    for action, (name, moved) in enumerate(_RIGHT_SIDE.items()):
        # mirroring flips x; the left side of an asymmetric action moves against its mirror image
        mirror = np.array([-1.0, 1.0, 1.0]) * (-1.0 if name == _ONE_SIDED else 1.0)
        for point, one in zip(_RIGHT, moved, strict=True):
            found[action, point] = one
            found[action, MIRRORED[point]] = mirror * one
    return found


def displacement(action: str) -> FloatArray:
    """Return D_e (K, 3), mm, of one of ``ACTIONS``."""
    found: FloatArray = displacements()[ACTIONS.index(action)]
    return found


def _deviations_mm() -> FloatArray:
    deviations = np.empty(POINT_COUNT)
    deviations[EYES], deviations[MOUTH], deviations[NOSTRILS], deviations[BROWS] = 1.0, 2.0, 1.5, 1.5
    return deviations


MEAN_STRENGTHS = np.array([0.15, 0.15, 0.15, 0.0, 0.2])
"""Strengths in the mean deformation abar of a multilinear model.

abar is the mean of ten training actions: five of a mouth from round to wide, and five of brows from down to
up with an opening jaw (4.2)."""
# prior and noise are constant, so the estimate is a fixed linear map
_PRECISIONS = np.repeat(_deviations_mm() ** -2, 3)
_DIRECTIONS = displacements().reshape(len(ACTIONS), -1)
_COVARIANCE = np.linalg.inv(_DIRECTIONS * _PRECISIONS @ _DIRECTIONS.T + np.eye(len(ACTIONS)) / USUAL**2)
_ONTO = _COVARIANCE @ (_DIRECTIONS * _PRECISIONS)


MEAN_DISPLACEMENTS: FloatArray = np.tensordot(MEAN_STRENGTHS, displacements(), axes=1)
"""(K, 3) mm, from the neutral face to the mean deformation."""


def strengths(moved: FloatArray) -> Strengths:
    """Estimate the strengths of the actions from displacements (K, 3), mm, from the neutral face."""
    return Strengths(_ONTO @ moved.ravel(), np.sqrt(np.diag(_COVARIANCE)))


def action_numbers(moved: FloatArray | None) -> FloatArray:
    """Return the (2 E,) numbers of ``ACTION_NAMES``; NaN without a face."""
    if moved is None:
        return np.full(len(ACTION_NAMES), np.nan)
    return np.concatenate(strengths(moved))
