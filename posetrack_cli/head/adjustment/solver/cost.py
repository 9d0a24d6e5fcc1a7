"""F itself, compiled."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.geometry.kernels import rotate_with_jacobian
from posetrack_cli.head.adjustment.solver.problem import (
    NEAREST_MM,
    POSE,
    Part,
    Problem,
    Unknowns,
    deformation_basis,
    point_in_camera,
    residual,
)


@kernel
def cost(problem: Problem, unknowns: Unknowns, part: Part) -> float:
    """Return F over the views of the part; infinite if a point comes to lie behind the camera."""
    basis = np.empty((*problem.mean.shape, len(problem.deformation_centre)))
    deformation_basis(problem, unknowns.shared, basis)
    return cost_with_basis(problem, unknowns, part, basis)


@kernel
def cost_with_basis(problem: Problem, unknowns: Unknowns, part: Part, basis: FloatArray) -> float:
    """Return the same, with this person's deformation basis (K, 3, A) given."""
    lengths = np.empty(len(problem.mean))
    total = prior_of_person(problem, unknowns.shared)
    for view in range(part.first, part.last):
        view_lengths(problem, unknowns, view, basis, lengths)
        for k in range(len(lengths)):
            if problem.weights[view, k] > 0.0:
                total += problem.weights[view, k] * huber(lengths[k], problem.huber)
        for b in range(POSE, unknowns.local.shape[1]):
            total += 0.5 * problem.prior * unknowns.local[view, b] ** 2
    return total


@inlined
def huber(length: float, bound: float) -> float:
    """e^2/2, or bound (e - bound/2) where it is larger than the bound."""
    return 0.5 * length * length if length <= bound else bound * (length - 0.5 * bound)


@kernel
def prior_of_person(problem: Problem, shared: FloatArray) -> float:
    """Return prior/2 |u|^2 + 1/2 |q|^2."""
    identities, total = len(problem.identity_centre), 0.0
    for j in range(len(shared)):
        total += 0.5 * (problem.prior if j < identities else 1.0) * shared[j] ** 2
    return total


@kernel
def view_lengths(
    problem: Problem, unknowns: Unknowns, view: int, basis: FloatArray, lengths: FloatArray
) -> None:
    """Write (K,) how far each point of a view is off, in standard deviations; infinite behind the camera."""
    rotation, left, arm, error = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(2)
    local, position = unknowns.local[view], problem.positions[view]
    rotate_with_jacobian(local[3:6], problem.rotations[view], rotation, left)
    for k in range(len(lengths)):
        point_in_camera(problem, k, local, unknowns.shared, basis, rotation, arm)
        x, y, z = (
            arm[0] + position[0] + local[0],
            arm[1] + position[1] + local[1],
            arm[2] + position[2] + local[2],
        )
        lengths[k] = residual(problem, view, k, x, y, z, error) if z > NEAREST_MM else np.inf
