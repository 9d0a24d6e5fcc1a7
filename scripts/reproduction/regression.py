"""The regression of most likelihood that says how probable it is that an estimate is right."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np
from scipy.optimize import minimize

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.tracking.confidence import Regression

PENALTY = 1e-3
"""Of the squares of weights of signs in units of their deviations."""
AGAINST: tuple[float | None, float | None] = (None, 0.0)
FOR: tuple[float | None, float | None] = (0.0, None)
"""Bounds of the weight of a sign that can but speak against a frame, or for it."""


class Recording(Protocol):
    """The M frames of one recording."""

    @property
    def person(self) -> str:
        """Who it is of."""

    @property
    def signs(self) -> FloatArray:
        """(M, S)."""

    @property
    def right(self) -> BoolArray:
        """(M,) whether each frame is."""

    @property
    def is_real(self) -> bool:
        """Whether a sensor recorded it, and not a program."""


AnyRecording = TypeVar("AnyRecording", bound=Recording)


def regression_of(
    recordings: Sequence[Recording],
    weights: Sequence[float],
    real_share: float,
    bounds: Sequence[tuple[float | None, float | None]],
) -> Regression:
    """Return the regression of most likelihood to recordings that programs made and to real ones.

    Args:
        recordings: of either kind, or of both.
        weights: of a recording among those of its kind.
        real_share: what all real ones count together, of what the others do.
        bounds: as of ``fitted_regression``.
    """
    signs, right = (np.concatenate([getattr(one, name) for one in recordings]) for name in ("signs", "right"))
    whole = {
        kind: sum(w for one, w in zip(recordings, weights, strict=True) if one.is_real == kind)
        for kind in (False, True)
    }
    each = []
    for one, weight in zip(recordings, weights, strict=True):
        share = weight / whole[one.is_real] * (real_share if one.is_real else 1.0)
        each.append(np.full(len(one.right), share / max(len(one.right), 1)))
    return fitted_regression(signs, right, np.concatenate(each), bounds)


def left_out(
    recordings: Sequence[AnyRecording], fitted: Callable[[Sequence[AnyRecording]], Regression]
) -> list[FloatArray]:
    """Return the probabilities (M,) of each recording's frames by what was fitted to other people."""
    found = []
    for one in recordings:
        others = fitted([other for other in recordings if other.person != one.person])
        found.append(np.array([others.probability(signs) for signs in one.signs]))
    return found


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
