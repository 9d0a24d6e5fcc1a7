"""Where local fits start: what is expected, and hands like it that may have moved otherwise."""

from __future__ import annotations

from itertools import product

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.anatomy import TANGENT_SIZE
from posetrack_cli.hand.space import HandSpace

# MCP and PIP flexion, rad, of a straight, curled, half-bent, hooked and flat-bent finger.
_FOLDS = np.array([(0.0, 0.0), (1.2, 1.5), (0.6, 0.8), (0.1, 1.2), (1.2, 0.1)])
_REFOLDED = 0.5  # probability that a finger of a scattered start takes another fold
_FINGER_SD = (0.3, 0.08, 0.36)  # MCP flexion, abduction, PIP flexion, rad
SCATTER: FloatArray = np.array([8.0] * 3 + [0.15] * 3 + [0.3, 0.3, 0.08] + list(_FINGER_SD) * 4)
"""(21,) standard deviations of a scattered start, mm and rad (hand-findings.md)."""


def fit_starts(
    expected: FloatArray, others: FloatArray, count: int, space: HandSpace, rng: np.random.Generator
) -> FloatArray:
    """Return start poses (count, 22): the expected pose, others, then scattered ones about all of these.

    A finger that moved between two frames is mostly found from another fold, not from a nearby angle.

    Args:
        expected: (22,) the prediction.
        others: (M, 22) further poses worth a try.
        count: how many starts.
        space: of poses.
        rng: draws the scatter.
    """
    given = np.concatenate([expected[None], others])[:count]
    more = count - len(given)
    if more <= 0:
        return given
    about = given[np.arange(more) % len(given)]
    scattered = space.retract(about, SCATTER * rng.standard_normal((more, TANGENT_SIZE)))
    fold = _FOLDS[rng.integers(len(_FOLDS), size=(more, 4))]
    refolded = rng.random((more, 4)) < _REFOLDED
    for finger in range(1, 5):
        rows = refolded[:, finger - 1]
        scattered[rows, 7 + 3 * finger] = fold[rows, finger - 1, 0]
        scattered[rows, 9 + 3 * finger] = fold[rows, finger - 1, 1]
    return np.concatenate([given, scattered])


def refolds(pose: FloatArray) -> FloatArray:
    """Return a pose (22,) with each finger in each fold, one at a time: (20, 22)."""
    poses = np.tile(pose, (4 * len(_FOLDS), 1))
    for row, (finger, fold) in enumerate(product(range(1, 5), _FOLDS)):
        poses[row, [7 + 3 * finger, 9 + 3 * finger]] = fold
    return poses
