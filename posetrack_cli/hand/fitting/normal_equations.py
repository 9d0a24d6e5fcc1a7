"""Weighted normal equations of a pose's tangent vector; compiled.

A skin point moves with the palm's six numbers and with the three of one finger, or of the forearm, so
residuals are summed in seven blocks of nine unknowns, one per finger, one for the forearm and one for the
palm alone, and put together once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.hand.anatomy import TANGENT_SIZE

ROW = 10  # palm's six unknowns, a finger's or the forearm's three, the residual
ARM_UNKNOWNS = 3
UNKNOWNS = TANGENT_SIZE + ARM_UNKNOWNS
_BLOCKS = 7


class NormalEquations(NamedTuple):
    """Of residuals r_i(x (+) e) ~ r_i - J_i e with weights w_i.

    Attributes:
        matrix: (24, 24) sum w J^T J; the last three unknowns are the forearm's.
        vector: (24,) sum w J^T r.
        blocks: (7, 9, 10) the same per finger, of the forearm, of the palm alone, on and above the diagonal;
            ``gather`` adds them up.
    """

    matrix: FloatArray
    vector: FloatArray
    blocks: FloatArray


def empty_equations() -> NormalEquations:
    """Return equations of no residual."""
    size = UNKNOWNS
    return NormalEquations(np.zeros((size, size)), np.zeros(size), np.zeros((_BLOCKS, ROW - 1, ROW)))


@kernel
def clear(equations: NormalEquations) -> None:
    """Forget all residuals."""
    equations.matrix[:] = 0.0
    equations.vector[:] = 0.0
    equations.blocks[:] = 0.0


@kernel
def copy(equations: NormalEquations, out: NormalEquations) -> None:
    """Write matrix and vector into other equations."""
    for i in range(UNKNOWNS):
        out.vector[i] = equations.vector[i]
        for j in range(UNKNOWNS):
            out.matrix[i, j] = equations.matrix[i, j]


@inlined
def add_row(equations: NormalEquations, finger: int, row: FloatArray, weight: float) -> None:
    """Add one residual with its row (10,) of ``point_row``; finger PALM = -1 is the last block."""
    block = equations.blocks
    f = finger if finger >= 0 else _BLOCKS - 1
    for i in range(ROW - 1):
        scaled = weight * row[i]
        for j in range(i, ROW):
            block[f, i, j] += scaled * row[j]


@kernel
def gather(equations: NormalEquations) -> None:
    """Add the blocks to matrix and vector, and empty them."""
    H, g, blocks = equations.matrix, equations.vector, equations.blocks
    for f in range(_BLOCKS):
        for i in range(6 if f == _BLOCKS - 1 else 9):
            row = i if i < 6 else 3 * f + i
            g[row] += blocks[f, i, 9]
            for j in range(6 if f == _BLOCKS - 1 else 9):
                H[row, j if j < 6 else 3 * f + j] += blocks[f, min(i, j), max(i, j)]
    blocks[:] = 0.0
