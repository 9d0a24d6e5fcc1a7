"""The regression of most likelihood that says how probable it is that an estimate is right."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.tracking.confidence import Regression

PENALTY = 1e-3
"""Of the squares of weights of signs in units of their deviations."""
AGAINST: tuple[float | None, float | None] = (None, 0.0)
FOR: tuple[float | None, float | None] = (0.0, None)
"""Bounds of the weight of a sign that can but speak against a frame, or for it."""


def fitted_regression(
    signs: FloatArray,
    right: BoolArray,
    weights: FloatArray,
    bounds: Sequence[tuple[float | None, float | None]],
) -> Regression:
    """Return the regression of most likelihood.

    Args:
        signs: (M, S) of frames.
        right: (M,) whether they are.
        weights: (M,) how much each counts.
        bounds: of the S weights: what a sign can mean, whatever these frames say.
    """
    weights = weights / weights.sum()
    mean, sd = weights @ signs, signs.std(axis=0) + 1e-9
    design = np.column_stack([np.ones(len(signs)), (signs - mean) / sd])

    def cost(w: FloatArray) -> tuple[float, FloatArray]:
        logit = design @ w
        missing = weights * (1.0 / (1.0 + np.exp(-logit)) - right)
        penalty = np.concatenate([[0.0], 2.0 * PENALTY * w[1:]])
        value = weights @ (np.logaddexp(0.0, logit) - right * logit) + PENALTY * w[1:] @ w[1:]
        return float(value), missing @ design + penalty

    start = np.zeros(design.shape[1])
    w = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=[(None, None), *bounds]).x
    return Regression(float(w[0] - (w[1:] / sd) @ mean), w[1:] / sd)
