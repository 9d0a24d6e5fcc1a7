"""Least squares: normal equations, elimination of blocks, bounded steps, robust weights.

Residuals r(x (+) d) ~ r - J d with weights W have the normal equations H d = g, with H = J^T W J, which is
symmetric and positive definite, and g = J^T W r.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import borrowing, inlined, kernel

Value = TypeVar("Value", float, FloatArray)


def eliminated(
    matrix: FloatArray, vector: FloatArray, kept: slice, gone: slice
) -> tuple[FloatArray, FloatArray]:
    """Return the equations of the kept unknowns (Schur complement).

    H_kk - H_kg H_gg^-1 H_gk and g_k - H_kg H_gg^-1 g_g: the other unknowns are marginalised.
    """
    carried = np.linalg.solve(matrix[gone, gone], np.column_stack([matrix[gone, kept], vector[gone]]))
    across = matrix[kept, gone]
    return matrix[kept, kept] - across @ carried[:, :-1], vector[kept] - across @ carried[:, -1]


def back_substituted(
    matrix: FloatArray, vector: FloatArray, kept: slice, gone: slice, step: FloatArray
) -> FloatArray:
    """Return the step of the eliminated unknowns given that of the kept ones."""
    left = vector[gone] - matrix[gone, kept] @ step
    return np.asarray(np.linalg.solve(matrix[gone, gone], left), dtype=np.float64)


def bounded_step(matrix: FloatArray, vector: FloatArray, least: FloatArray, most: FloatArray) -> FloatArray:
    """Return the d within bounds that minimises d^T H d / 2 - g^T d.

    Unknowns at a bound count as known: all others are optimal given the bound, instead of being clipped
    separately.
    """
    from scipy.optimize import lsq_linear

    root = np.linalg.cholesky(matrix).T
    found = lsq_linear(root, np.linalg.solve(root.T, vector), bounds=(least, most), method="bvls")
    return np.asarray(found.x, dtype=np.float64)


def damped_step(matrix: FloatArray, vector: FloatArray, damping: float) -> FloatArray:
    """Return the Levenberg-Marquardt step; the minimum-norm one if H is singular."""
    damped = matrix + damping * np.diag(np.diagonal(matrix))
    try:
        step = np.linalg.solve(damped, vector)
    except np.linalg.LinAlgError:
        step, *_ = np.linalg.lstsq(damped, vector)
    return np.asarray(step, dtype=np.float64)


# Robust weights rho'(e) / e of residuals e with cost rho; compiled, for scalars and (new) arrays.


@kernel
def geman_mcclure(square: Value) -> Value:
    """Return (1 + s)^-2, s the square of e / tau; rho = tau^2 / 2 s / (1 + s) (Geman and McClure 1987)."""
    spread = 1.0 + square
    return 1.0 / (spread * spread)


@kernel
def cauchy(square: Value) -> Value:
    """Return 1 / (1 + s), s the square of e / tau, for rho = tau^2 / 2 log(1 + s)."""
    return 1.0 / (1.0 + square)


@inlined
def student_t(square: float, dimensions: float, freedom: float, scale: float) -> float:
    """Return (nu + D) / (nu scale^2 + e^2), for rho = (nu + D) / 2 log(1 + e^2 / (nu scale^2)).

    rho is the negative log-density of a Student-t residual in D dimensions, the weight its expected
    precision.
    """
    return (freedom + dimensions) / (freedom * scale * scale + square)


@kernel
def huber(length: Value, bound: float) -> Value:
    """Return rho = e^2 / 2, or bound (e - bound / 2) for e >= bound; e >= 0 (Huber 1964)."""
    small: Value = np.minimum(length, bound)
    return small * (length - 0.5 * small)


@kernel
def huber_weight(length: Value, bound: float) -> Value:
    """Return the weight of ``huber``: 1 or bound / e."""
    weight: Value = np.minimum(1.0, bound / length)
    return weight


# Small systems and eliminations for kernels; compiled.


@kernel
def solve(matrix: FloatArray, vector: FloatArray, out: FloatArray) -> None:
    """Write H^-1 g."""
    solution = np.linalg.solve(matrix, vector)
    for i in range(len(out)):
        out[i] = solution[i]


@borrowing
def solve_positive(matrix: FloatArray, vector: FloatArray, out: FloatArray) -> None:
    """Write H^-1 g of a positive definite matrix, which is overwritten, by elimination without pivots."""
    count = len(out)
    for i in range(count):
        out[i] = vector[i]
    for k in range(count):
        pivots = matrix[k]
        for i in range(k + 1, count):
            share, across = pivots[i] / pivots[k], matrix[i]
            out[i] -= share * out[k]
            for j in range(i, count):
                across[j] -= share * pivots[j]
    for i in range(count - 1, -1, -1):
        across = matrix[i]
        for j in range(i + 1, count):
            out[i] -= across[j] * out[j]
        out[i] /= across[i]


@kernel
def invert_symmetric(A: FloatArray, added: float, out: FloatArray) -> None:
    """Write (A + added 1)^-1 of a symmetric (3, 3) matrix, by cofactors."""
    a, b, c = A[0, 0] + added, A[0, 1], A[0, 2]
    d, e, f = A[1, 1] + added, A[1, 2], A[2, 2] + added
    out[0, 0], out[0, 1], out[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    out[1, 1], out[1, 2], out[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * out[0, 0] + b * out[0, 1] + c * out[0, 2]
    for i in range(3):
        for j in range(i, 3):
            out[i, j] /= determinant
            out[j, i] = out[i, j]


@kernel
def factorise(matrix: FloatArray) -> bool:
    """Write the Cholesky factor L over the lower triangle; return False if not positive definite."""
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
def forward(factor: FloatArray, vector: FloatArray) -> None:
    """Write L^-1 v over v."""
    for a in range(len(vector)):
        for b in range(a):
            vector[a] -= factor[a, b] * vector[b]
        vector[a] /= factor[a, a]


@inlined
def backward(factor: FloatArray, vector: FloatArray) -> None:
    """Write L^-T v over v."""
    for a in range(len(vector) - 1, -1, -1):
        for b in range(a + 1, len(vector)):
            vector[a] -= factor[b, a] * vector[b]
        vector[a] /= factor[a, a]


@kernel
def inverse_diagonal(factor: FloatArray, out: FloatArray) -> None:
    """Write the first diagonal entries of (L L^T)^-1."""
    column = np.empty(len(factor))
    for j in range(len(out)):
        column[:] = 0.0
        column[j] = 1.0
        forward(factor, column)
        out[j] = np.sum(column * column)


@kernel
def eliminate(
    factor: FloatArray, cross: FloatArray, own: FloatArray, kept: FloatArray, right: FloatArray
) -> None:
    """Eliminate a block of unknowns with Cholesky factor L from the equations of the kept ones.

    Args:
        factor: (m, m) L.
        cross: (m, q) B between the block and the kept unknowns; overwritten by L^-1 B.
        own: (m,) right side of the block; overwritten by L^-1 times it.
        kept: (q, q), reduced by B^T (L L^T)^-1 B on and below the diagonal.
        right: (q,), reduced by B^T (L L^T)^-1 own.
    """
    forward(factor, own)
    for a in range(len(factor)):
        for b in range(a):
            for j in range(cross.shape[1]):
                cross[a, j] -= factor[a, b] * cross[b, j]
        for j in range(cross.shape[1]):
            cross[a, j] /= factor[a, a]
    for a in range(len(factor)):
        for i in range(cross.shape[1]):
            right[i] -= cross[a, i] * own[a]
            for j in range(i + 1):
                kept[i, j] -= cross[a, i] * cross[a, j]


@inlined
def back_substitute(
    factor: FloatArray, cross: FloatArray, own: FloatArray, step: FloatArray, out: FloatArray
) -> None:
    """Write the step of a block given that of the kept unknowns; inputs as written by ``eliminate``."""
    for a in range(len(out)):
        out[a] = own[a]
        for j in range(len(step)):
            out[a] -= cross[a, j] * step[j]
    backward(factor, out)
