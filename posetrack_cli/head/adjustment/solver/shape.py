"""Where a view's points are: turning, bending, and the residual of a point; compiled."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.head.adjustment.solver.problem import POSE, Problem

NEAREST_MM = 1.0
"""A point nearer than this, or behind the camera, cannot have been seen."""


@kernel
def deformation_basis(problem: Problem, shared: FloatArray, out: FloatArray) -> None:
    """Write (K, 3, A), how this person's points move with v: C (u + ubar)."""
    points, _, identities, deformations = problem.core.shape
    out[:] = 0.0
    for k in range(points):
        for i in range(3):
            for p in range(identities):
                amount = shared[p] + problem.identity_centre[p]
                for b in range(deformations):
                    out[k, i, b] += problem.core[k, i, p, b] * amount


@kernel
def identity_basis(problem: Problem, local: FloatArray, out: FloatArray) -> None:
    """Write (K, 3, S), how a view's points move with u: C (v + vbar)."""
    points, _, identities, deformations = problem.core.shape
    for k in range(points):
        for i in range(3):
            for p in range(identities):
                total = 0.0
                for b in range(deformations):
                    total += problem.core[k, i, p, b] * (local[POSE + b] + problem.deformation_centre[b])
                out[k, i, p] = total


@inlined
def place(
    problem: Problem,
    k: int,
    local: FloatArray,
    shared: FloatArray,
    basis: FloatArray,
    rotation: FloatArray,
    arm: FloatArray,
) -> None:
    """Write R M_k (3,), the point from the head's origin in camera axes, mm."""
    arm[:] = 0.0
    first = len(problem.identity_centre) + 3 * k
    for i in range(3):
        along = problem.mean[k, i] + problem.offset_deviations[k, i] * shared[first + i]
        for b in range(basis.shape[2]):
            along += basis[k, i, b] * (local[POSE + b] + problem.deformation_centre[b])
        for j in range(3):
            arm[j] += rotation[j, i] * along


@inlined
def residual(problem: Problem, view: int, k: int, x: float, y: float, z: float, out: FloatArray) -> float:
    """Write how far the point at X is from where it was seen, in standard deviations; return the length."""
    dx, dy = x / z - problem.rays[view, k, 0], y / z - problem.rays[view, k, 1]
    scale = problem.scales[view, k]
    out[0] = scale[0, 0] * dx + scale[0, 1] * dy
    out[1] = scale[1, 0] * dx + scale[1, 1] * dy
    return float(np.sqrt(out[0] * out[0] + out[1] * out[1]))
