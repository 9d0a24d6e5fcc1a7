"""Weighted normal equations of a pose's tangent vector; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import kernel
from posetrack_cli.hand.anatomy import TANGENT_SIZE
from posetrack_cli.hand.fitting.skeleton import PALM


class NormalEquations(NamedTuple):
    """Of residuals r_i(x (+) e) ~ r_i - J_i e with weights w_i.

    Attributes:
        matrix: (21, 21) sum w J^T J; the lower triangle is filled in by ``complete``.
        vector: (21,) sum w J^T r.
    """

    matrix: FloatArray
    vector: FloatArray


def empty_equations() -> NormalEquations:
    """Return equations of no residual."""
    return NormalEquations(np.zeros((TANGENT_SIZE, TANGENT_SIZE)), np.zeros(TANGENT_SIZE))


@kernel
def clear(equations: NormalEquations) -> None:
    """Forget all residuals."""
    equations.matrix[:] = 0.0
    equations.vector[:] = 0.0


@kernel
def add_row(
    equations: NormalEquations, finger: int, row: FloatArray, residual: float, weight: float
) -> None:
    """Add one residual whose row (9,) is of ``point_row``."""
    H, g = equations.matrix, equations.vector
    for i in range(6):
        scaled = weight * row[i]
        g[i] += scaled * residual
        for j in range(i, 6):
            H[i, j] += scaled * row[j]
    if finger == PALM:
        return
    first = 6 + 3 * finger
    for i in range(6):
        scaled = weight * row[i]
        for j in range(3):
            H[i, first + j] += scaled * row[6 + j]
    for i in range(3):
        scaled = weight * row[6 + i]
        g[first + i] += scaled * residual
        for j in range(i, 3):
            H[first + i, first + j] += scaled * row[6 + j]


@kernel
def complete(equations: NormalEquations) -> None:
    """Fill in the lower triangle of the symmetric matrix."""
    H = equations.matrix
    for i in range(H.shape[0]):
        for j in range(i):
            H[i, j] = H[j, i]
