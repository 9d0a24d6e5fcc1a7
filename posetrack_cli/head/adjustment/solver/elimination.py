"""Solving the normal equations: the views are eliminated (Schur complement); compiled.

    [A  B] [x]     [g]        A = L L^T, Y = L^-1 B, c = L^-1 g for each view
    [B' C] [z] = - [h]        (C - sum Y' Y) z = -(h - sum Y' c),   x = -L^-T (c + Y z)

with mu times the diagonal added to A and C (Marquardt's form of (4.23), which no unit changes **[ours]**).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.head.adjustment.solver.equations import Equations


class Held(NamedTuple):
    """Which unknowns stay: (n, m) and (q,)."""

    local: BoolArray
    shared: BoolArray


class Elimination(NamedTuple):
    """Room to solve, and the solution.

    Attributes:
        factors: (n, m, m) L.
        halves: (n, m, q) Y.
        middles: (n, m) c.
        reduced: (q, q) the Schur complement, then its Cholesky factor.
        local, shared: (n, m) and (q,) the step.
    """

    factors: FloatArray
    halves: FloatArray
    middles: FloatArray
    reduced: FloatArray
    local: FloatArray
    shared: FloatArray


@kernel
def make_elimination(equations: Equations) -> Elimination:
    """Return room for equations."""
    return Elimination(
        np.empty_like(equations.local),
        np.empty_like(equations.cross),
        np.empty_like(equations.local_gradient),
        np.empty_like(equations.shared),
        np.empty_like(equations.local_gradient),
        np.empty_like(equations.shared_gradient),
    )


@kernel
def solve(equations: Equations, held: Held, damping: float, work: Elimination) -> bool:
    """Write the step of the unknowns that are not held; return False where a matrix is not positive."""
    if not eliminate_views(equations, held, damping, work):
        return False
    _forward(work.reduced, work.shared)
    _backward(work.reduced, work.shared)
    for view in range(len(work.local)):
        for a in range(len(work.local[view])):
            work.local[view, a] = work.middles[view, a]
            for j in range(len(work.shared)):
                work.local[view, a] -= work.halves[view, a, j] * work.shared[j]
        _backward(work.factors[view], work.local[view])
    _negate(work)
    return True


@kernel
def eliminate_views(equations: Equations, held: Held, damping: float, work: Elimination) -> bool:
    """Eliminate the views and factorise what is left; return False where a matrix is not positive."""
    _damped(equations.shared, held.shared, damping, work.reduced)
    for j in range(len(work.shared)):
        work.shared[j] = 0.0 if held.shared[j] else equations.shared_gradient[j]
    for view in range(len(work.local)):
        _damped(equations.local[view], held.local[view], damping, work.factors[view])
        if not factorise(work.factors[view]):
            return False
        _cross(equations, held, view, work)
        _eliminate(work, view)
    return factorise(work.reduced)


@kernel
def _damped(matrix: FloatArray, held: BoolArray, damping: float, out: FloatArray) -> None:
    """Write the lower triangle, damped; rows and columns that are held become those of the identity."""
    for a in range(len(matrix)):
        for b in range(a):
            out[a, b] = 0.0 if held[a] or held[b] else matrix[a, b]
        # a column that nothing depends on has the diagonal 0, and gradient 0 with it
        out[a, a] = 1.0 if held[a] or matrix[a, a] <= 0.0 else matrix[a, a] * (1.0 + damping)


@kernel
def _cross(equations: Equations, held: Held, view: int, work: Elimination) -> None:
    """Begin Y and c with B and g."""
    for a in range(len(work.middles[view])):
        stays = held.local[view, a]
        work.middles[view, a] = 0.0 if stays else equations.local_gradient[view, a]
        for j in range(len(work.shared)):
            work.halves[view, a, j] = 0.0 if stays or held.shared[j] else equations.cross[view, a, j]


@kernel
def _eliminate(work: Elimination, view: int) -> None:
    """Finish Y and c, and take Y' Y and Y' c from the Schur complement and its right side."""
    factor, half, middle = work.factors[view], work.halves[view], work.middles[view]
    _forward(factor, middle)
    for a in range(len(factor)):
        for b in range(a):
            for j in range(half.shape[1]):
                half[a, j] -= factor[a, b] * half[b, j]
        for j in range(half.shape[1]):
            half[a, j] /= factor[a, a]
    for a in range(len(factor)):
        for i in range(half.shape[1]):
            work.shared[i] -= half[a, i] * middle[a]
            for j in range(i + 1):
                work.reduced[i, j] -= half[a, i] * half[a, j]


@kernel
def factorise(matrix: FloatArray) -> bool:
    """Write the Cholesky factor over the lower triangle; return False where there is none."""
    for i in range(len(matrix)):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if j < i:
                matrix[i, j] = total / matrix[j, j]
            elif total > 0.0:
                matrix[i, i] = np.sqrt(total)
            else:
                return False
    return True


@inlined
def _forward(factor: FloatArray, vector: FloatArray) -> None:
    """Write L^-1 v over v."""
    for a in range(len(vector)):
        for b in range(a):
            vector[a] -= factor[a, b] * vector[b]
        vector[a] /= factor[a, a]


@inlined
def _backward(factor: FloatArray, vector: FloatArray) -> None:
    """Write L^-T v over v."""
    for a in range(len(vector) - 1, -1, -1):
        for b in range(a + 1, len(vector)):
            vector[a] -= factor[b, a] * vector[b]
        vector[a] /= factor[a, a]


@inlined
def _negate(work: Elimination) -> None:
    """Take the step downhill."""
    for view in range(len(work.local)):
        for a in range(len(work.local[view])):
            work.local[view, a] = -work.local[view, a]
    for j in range(len(work.shared)):
        work.shared[j] = -work.shared[j]


@kernel
def inverse_diagonal(factor: FloatArray, out: FloatArray) -> None:
    """Write the first entries of the diagonal of (L L')^-1."""
    column = np.empty(len(factor))
    for j in range(len(out)):
        column[:] = 0.0
        column[j] = 1.0
        _forward(factor, column)
        out[j] = np.sum(column * column)
