"""What is minimised, and where a view's points are, as the compiled kernels read it.

Everything is in units of its standard deviation:

    F = sum_ik w_ik H(|S_ik (pi(X_ik) - x_ik)|)  +  prior/2 (|u|^2 + sum_i |v_i|^2)  +  1/2 |q|^2       (4.18)
    X_ik = exp(d_i) R_i (Mbar_k + C_k (u + ubar) (v_i + vbar) + D_k q_k) + t_i + e_i                   (4.15)

u, v, q are whitened identity, deformations and offsets, pi the pinhole camera of focal length 1, x rays, S
what takes rays to pixels in units of their standard deviation, H Huber's function: e^2/2 up to h, then
h (e - h/2). The prior of u and q counts once, that of v once a view: so F is minus the logarithm of what is
thought of one person seen n times, and n views outweigh what is thought of the person before **[ours]**.

Without priors and bounds s is known up to a factor only: (4.15) is the same for c s and a / c.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.geometry.kernels import rotate_with_jacobian

POSE = 6


class Problem(NamedTuple):
    """Model, observations and start poses of n views.

    Attributes:
        mean: (K, 3) Mbar, mm.
        core: (K, 3, S, A) C, mm: the model's, times sigma_s sigma_a.
        identity_centre: (S,) ubar = sbar / sigma_s.
        deformation_centre: (A,) vbar = abar / sigma_a.
        offset_deviations: (K, 3) D, mm.
        rotations: (n, 3, 3) R at the start.
        positions: (n, 3) t at the start, mm.
        rays: (n, K, 2) x, observed x/z, y/z without the lens's distortion.
        scales: (n, K, 2, 2) S.
        weights: (n, K) w, 0 where a point is left out.
        huber: h.
        prior: weight of u and v.
    """

    mean: FloatArray
    core: FloatArray
    identity_centre: FloatArray
    deformation_centre: FloatArray
    offset_deviations: FloatArray
    rotations: FloatArray
    positions: FloatArray
    rays: FloatArray
    scales: FloatArray
    weights: FloatArray
    huber: float
    prior: float


class Unknowns(NamedTuple):
    """What is sought; written over.

    Attributes:
        local: (n, 6 + A) tangent vector from the start pose, mm and rad, then v.
        shared: (S + 3K,) u, then q point by point.
    """

    local: FloatArray
    shared: FloatArray


class Boxes(NamedTuple):
    """C of (4.26), of the shape of the unknowns; infinite where there is no bound."""

    local_lower: FloatArray
    local_upper: FloatArray
    shared_lower: FloatArray
    shared_upper: FloatArray


class Part(NamedTuple):
    """Which unknowns move: the first ``local`` of each view first..last-1, and the first ``shared``."""

    first: int
    last: int
    local: int
    shared: int


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
def point_in_camera(
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
