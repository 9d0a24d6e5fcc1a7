"""Weighted normal equations of a pose's tangent vector; compiled.

A skin point moves with the palm's six unknowns and the three of one finger or of the forearm. So residuals
are summed in seven blocks of nine unknowns (one per finger, the forearm, the palm alone) and assembled once.
The thumb's two inner angles and their products are summed separately.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import borrowing, inlined
from posetrack_cli.hand.fit.skeleton import THUMB_ROW
from posetrack_cli.hand.model.anatomy import TANGENT_SIZE
from posetrack_cli.lanes import Lanes, emitted, padded

ROW = 16
"""Palm's six unknowns, a finger's or the forearm's three, the residual, the thumb's inner two, padding."""
RESIDUAL, THUMB_PART = 9, 10  # columns of a row
ARM_PLACE, THUMB_PLACE = TANGENT_SIZE, TANGENT_SIZE + 3  # first unknown of forearm and thumb
UNKNOWNS = THUMB_PLACE + 2
_BLOCKS, _HALF = 7, 8
"""Number of blocks, and lanes of half a row."""


class NormalEquations(NamedTuple):
    """Normal equations of residuals r_i(x (+) e) ~ r_i - J_i e with weights w_i.

    Attributes:
        matrix: (26, 26) sum w J^T J; last the forearm's three unknowns, then the thumb's two inner angles.
        vector: (26,) sum w J^T r.
        blocks: (7, 9, 16) products of rows per finger, for the forearm and for the palm alone, valid in their
            upper triangles; ``gather`` adds them to matrix and vector.
        thumb: (2, 16) products of the thumb's inner angles with a full row.
    """

    matrix: FloatArray
    vector: FloatArray
    blocks: FloatArray
    thumb: FloatArray


def empty_equations() -> NormalEquations:
    """Return equations without residuals."""
    size, blocks = UNKNOWNS, padded(np.zeros((_BLOCKS, RESIDUAL, ROW)))
    return NormalEquations(np.zeros((size, size)), np.zeros(size), blocks, padded(np.zeros((2, ROW))))


@borrowing
def clear(equations: NormalEquations) -> None:
    """Remove all residuals."""
    equations.matrix[:] = 0.0
    equations.vector[:] = 0.0
    equations.blocks[:] = 0.0
    equations.thumb[:] = 0.0


@borrowing
def copy(equations: NormalEquations, out: NormalEquations) -> None:
    """Copy matrix and vector to other equations."""
    for i in range(UNKNOWNS):
        out.vector[i] = equations.vector[i]
        for j in range(UNKNOWNS):
            out.matrix[i, j] = equations.matrix[i, j]


@emitted
def _add_block(blocks: Lanes, at: Lanes, row: Lanes, weight: Lanes) -> None:
    """Add the upper triangle of a row's products with itself."""
    for i in range(RESIDUAL):
        _add_scaled(blocks, at + i * ROW, row, weight * row.number(i), i // _HALF)


@emitted
def _add_thumb(thumb: Lanes, at: Lanes, row: Lanes, weight: Lanes) -> None:
    """Add the products of a row with its entries for the thumb's inner angles."""
    for i in range(2):
        _add_scaled(thumb, at + i * ROW, row, weight * row.number(THUMB_PART + i), 0)


def _add_scaled(sums: Lanes, at: Lanes, row: Lanes, factor: Lanes, first: int) -> None:
    """Add a row's halves from ``first`` on, scaled, to sums."""
    for half in range(first, 2):
        place = at + half * _HALF
        values = row.load(at.constant(half * _HALF), _HALF)
        sums.store(place, sums.load(place, _HALF) + factor * values)


@inlined
def add_row(equations: NormalEquations, finger: int, row: FloatArray, weight: float) -> None:
    """Add one residual with its row (16,) of ``point_row``; finger PALM = -1 is the last block."""
    f = finger if finger >= 0 else _BLOCKS - 1
    _add_block(equations.blocks, f * RESIDUAL * ROW, row, weight)
    if finger == THUMB_ROW:
        _add_thumb(equations.thumb, 0, row, weight)


@borrowing
def gather(equations: NormalEquations) -> None:
    """Add the blocks to matrix and vector, and clear them."""
    H, g, blocks, thumb = equations.matrix, equations.vector, equations.blocks, equations.thumb
    for f in range(_BLOCKS):
        for i in range(6 if f == _BLOCKS - 1 else 9):
            row = i if i < 6 else 3 * f + i
            g[row] += blocks[f, i, RESIDUAL]
            for j in range(6 if f == _BLOCKS - 1 else 9):
                H[row, j if j < 6 else 3 * f + j] += blocks[f, min(i, j), max(i, j)]
    for i in range(2):
        row = THUMB_PLACE + i
        g[row] += thumb[i, RESIDUAL]
        for j in range(RESIDUAL):
            H[row, j] += thumb[i, j]
            H[j, row] += thumb[i, j]
        for j in range(2):
            H[row, THUMB_PLACE + j] += thumb[i, THUMB_PART + j]
    blocks[:], thumb[:] = 0.0, 0.0
