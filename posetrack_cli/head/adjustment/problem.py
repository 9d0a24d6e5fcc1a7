"""The bundle adjustment as a least-squares problem: unknowns, residuals, normal equations; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.geometry.kernels import rotate_with_jacobian
from posetrack_cli.geometry.least_squares import huber, huber_weight

# Objective, with all unknowns in units of their standard deviations:
#
#     F = sum_ik w_ik H(|S_ik (pi(X_ik) - x_ik)|)  +  prior/2 (|u|^2 + sum_i |v_i|^2)  +  1/2 |q|^2     (4.18)
#     X_ik = exp(d_i) R_i (Mbar_k + C_k (u + ubar) (v_i + vbar) + D_k q_k) + t_i + e_i                 (4.15)
#
# u, v, q are whitened identity, deformations and offsets, pi the pinhole camera of focal length 1, x rays, S
# the map from rays to pixels in units of their standard deviation, H Huber's function: e^2/2 up to h, then h
# (e - h/2). The prior of u and q counts once, that of v once for each view: F is the negative log-posterior
# of one person seen n times **[ours]**.
#
# Without priors and bounds, s is determined only up to a factor: (4.15) is the same for c s and a / c.

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
    """Unknowns, modified in place.

    Attributes:
        local: (n, 6 + A) tangent vector from the start pose, mm and rad, then v.
        shared: (S + 3K,) u, then q point by point.
    """

    local: FloatArray
    shared: FloatArray


class Boxes(NamedTuple):
    """C of (4.26), shaped like the unknowns; infinite without a bound."""

    local_lower: FloatArray
    local_upper: FloatArray
    shared_lower: FloatArray
    shared_upper: FloatArray


class Part(NamedTuple):
    """Active unknowns: the first ``local`` of each view first..last-1, and the first ``shared``."""

    first: int
    last: int
    local: int
    shared: int


NEAREST_MM = 1.0
"""Minimum depth of a visible point."""


@kernel
def deformation_basis(problem: Problem, shared: FloatArray, out: FloatArray) -> None:
    """Write (K, 3, A), the derivative of this person's points by v: C (u + ubar)."""
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
    """Write (K, 3, S), the derivative of a view's points by u: C (v + vbar)."""
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
    """Write R M_k (3,), the point relative to the head's origin in camera axes, mm."""
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
    """Write the error of a point at X, in standard deviations; return its length."""
    dx, dy = x / z - problem.rays[view, k, 0], y / z - problem.rays[view, k, 1]
    scale = problem.scales[view, k]
    out[0] = scale[0, 0] * dx + scale[0, 1] * dy
    out[1] = scale[1, 0] * dx + scale[1, 1] * dy
    return float(np.sqrt(out[0] * out[0] + out[1] * out[1]))


@kernel
def cost(problem: Problem, unknowns: Unknowns, part: Part) -> float:
    """Return F over the views of the part; infinite if a point lies behind the camera."""
    basis = np.empty((*problem.mean.shape, len(problem.deformation_centre)))
    deformation_basis(problem, unknowns.shared, basis)
    return cost_with_basis(problem, unknowns, part, basis)


@kernel
def cost_with_basis(problem: Problem, unknowns: Unknowns, part: Part, basis: FloatArray) -> float:
    """Return F for a given deformation basis (K, 3, A) of the person."""
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
    """Write (K,) the errors of a view's points, in standard deviations; infinite behind the camera."""
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


# Normal equations, block by block.
#
# A point's two rows of the Jacobian depend on its view's pose and deformation (6 + A columns), the identity
# (S) and its own offset (3). So J^T W J has a block (6 + A)^2 for each view, a shared one (S + 3K)^2, and
# those between a view and the shared unknowns: the cost is linear in n.


class Equations(NamedTuple):
    """Gradient and Gauss-Newton Hessian of F; lower triangles only.

    Attributes:
        local: (n, m, m) of each view.
        cross: (n, m, q) between each view and the shared unknowns.
        shared: (q, q).
        local_gradient: (n, m).
        shared_gradient: (q,).
    """

    local: FloatArray
    cross: FloatArray
    shared: FloatArray
    local_gradient: FloatArray
    shared_gradient: FloatArray


class Rows(NamedTuple):
    """Work arrays of one view: its pose, bases and a point's rows.

    Attributes:
        rotation, left: (3, 3) of ``rotate_with_jacobian``.
        deformations: (K, 3, A) of ``deformation_basis``.
        identities: (K, 3, S) of ``identity_basis``.
        by_point: (2, 3) d r / d X; in_head: times R.
        local: (2, 6 + A) d r / d (pose, v); shared: (2, S + 3) d r / d (u, the point's q).
    """

    rotation: FloatArray
    left: FloatArray
    deformations: FloatArray
    identities: FloatArray
    by_point: FloatArray
    in_head: FloatArray
    local: FloatArray
    shared: FloatArray


@kernel
def make_equations(part: Part) -> Equations:
    """Allocate the equations of a part."""
    views, m, q = part.last - part.first, part.local, part.shared
    return Equations(
        np.empty((views, m, m)),
        np.empty((views, m, q)),
        np.empty((q, q)),
        np.empty((views, m)),
        np.empty(q),
    )


@kernel
def make_rows(problem: Problem) -> Rows:
    """Allocate the rows of a view."""
    points, _, identities, deformations = problem.core.shape
    return Rows(
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((points, 3, deformations)),
        np.empty((points, 3, identities)),
        np.empty((2, 3)),
        np.empty((2, 3)),
        np.empty((2, POSE + deformations)),
        np.empty((2, identities + 3)),
    )


@kernel
def linearise(problem: Problem, unknowns: Unknowns, part: Part, rows: Rows, equations: Equations) -> None:
    """Write the equations at the unknowns; the rows must contain the deformation basis."""
    start_equations(problem, unknowns, part, equations)
    for view in range(part.first, part.last):
        rotate_with_jacobian(unknowns.local[view, 3:6], problem.rotations[view], rows.rotation, rows.left)
        if part.shared > 0:
            identity_basis(problem, unknowns.local[view], rows.identities)
        for k in range(len(problem.mean)):
            if problem.weights[view, k] > 0.0:
                add_point(problem, unknowns, part, view, k, rows, equations)


@kernel
def start_equations(problem: Problem, unknowns: Unknowns, part: Part, equations: Equations) -> None:
    """Write the equations of the priors."""
    equations.local[:], equations.cross[:], equations.shared[:] = 0.0, 0.0, 0.0
    equations.local_gradient[:] = 0.0
    for view in range(part.first, part.last):
        for b in range(POSE, part.local):
            equations.local[view - part.first, b, b] = problem.prior
            equations.local_gradient[view - part.first, b] = problem.prior * unknowns.local[view, b]
    for j in range(part.shared):
        weight = problem.prior if j < len(problem.identity_centre) else 1.0
        equations.shared[j, j] = weight
        equations.shared_gradient[j] = weight * unknowns.shared[j]


@kernel
def add_point(
    problem: Problem, unknowns: Unknowns, part: Part, view: int, k: int, rows: Rows, equations: Equations
) -> None:
    """Add a point in front of the camera, with Huber's weight h / e beyond h."""
    arm, error = np.empty(3), np.empty(2)
    local, position = unknowns.local[view], problem.positions[view]
    point_in_camera(problem, k, local, unknowns.shared, rows.deformations, rows.rotation, arm)
    x, y, z = (
        arm[0] + position[0] + local[0],
        arm[1] + position[1] + local[1],
        arm[2] + position[2] + local[2],
    )
    if z <= NEAREST_MM:
        return
    length = residual(problem, view, k, x, y, z, error)
    weight = problem.weights[view, k] * huber_weight(length, problem.huber)
    _by_point(problem.scales[view, k], x, y, z, rows)
    _local_rows(part, k, arm, rows)
    _add_local(part, view, weight, error, rows, equations)
    if part.shared > 0:
        _shared_rows(problem, part, k, rows)
        _add_cross(problem, part, view, k, weight, rows, equations)
        _add_shared(problem, part, k, weight, error, rows, equations)


@inlined
def _by_point(scale: FloatArray, x: float, y: float, z: float, rows: Rows) -> None:
    """Write d r / d X = S d pi / d X, and the same in head axes."""
    for r in range(2):
        rows.by_point[r, 0] = scale[r, 0] / z
        rows.by_point[r, 1] = scale[r, 1] / z
        rows.by_point[r, 2] = -(scale[r, 0] * x + scale[r, 1] * y) / (z * z)
        for i in range(3):
            rows.in_head[r, i] = 0.0
            for j in range(3):
                rows.in_head[r, i] += rows.by_point[r, j] * rows.rotation[j, i]


@inlined
def _local_rows(part: Part, k: int, arm: FloatArray, rows: Rows) -> None:
    """Write d r / d (t, w, v) = G (1, -[R M]_x J, R V)."""
    for r in range(2):
        g = rows.by_point[r]
        turned = (arm[1] * g[2] - arm[2] * g[1], arm[2] * g[0] - arm[0] * g[2], arm[0] * g[1] - arm[1] * g[0])
        for i in range(3):
            rows.local[r, i] = g[i]
            rows.local[r, 3 + i] = (
                turned[0] * rows.left[0, i] + turned[1] * rows.left[1, i] + turned[2] * rows.left[2, i]
            )
        for b in range(part.local - POSE):
            rows.local[r, POSE + b] = 0.0
            for i in range(3):
                rows.local[r, POSE + b] += rows.in_head[r, i] * rows.deformations[k, i, b]


@inlined
def _shared_rows(problem: Problem, part: Part, k: int, rows: Rows) -> None:
    """Write d r / d (u, q_k) = G R (U, D)."""
    identities = len(problem.identity_centre)
    for r in range(2):
        rows.shared[r] = 0.0
        for i in range(3):
            for p in range(identities):
                rows.shared[r, p] += rows.in_head[r, i] * rows.identities[k, i, p]
            rows.shared[r, identities + i] = rows.in_head[r, i] * problem.offset_deviations[k, i]


@inlined
def _add_local(
    part: Part, view: int, weight: float, error: FloatArray, rows: Rows, equations: Equations
) -> None:
    block, gradient = equations.local[view - part.first], equations.local_gradient[view - part.first]
    for a in range(part.local):
        one, two = weight * rows.local[0, a], weight * rows.local[1, a]
        gradient[a] += one * error[0] + two * error[1]
        for b in range(a + 1):
            block[a, b] += one * rows.local[0, b] + two * rows.local[1, b]


@inlined
def _add_cross(
    problem: Problem, part: Part, view: int, k: int, weight: float, rows: Rows, equations: Equations
) -> None:
    block, identities = equations.cross[view - part.first], len(problem.identity_centre)
    for a in range(part.local):
        one, two = weight * rows.local[0, a], weight * rows.local[1, a]
        for p in range(identities):
            block[a, p] += one * rows.shared[0, p] + two * rows.shared[1, p]
        if part.shared > identities:
            for i in range(identities, identities + 3):
                block[a, 3 * k + i] += one * rows.shared[0, i] + two * rows.shared[1, i]


@inlined
def _add_shared(
    problem: Problem, part: Part, k: int, weight: float, error: FloatArray, rows: Rows, equations: Equations
) -> None:
    identities = len(problem.identity_centre)
    for i in range(identities + 3 if part.shared > identities else identities):
        one, two = weight * rows.shared[0, i], weight * rows.shared[1, i]
        row = i if i < identities else 3 * k + i
        equations.shared_gradient[row] += one * error[0] + two * error[1]
        for j in range(min(i + 1, identities)):
            equations.shared[row, j] += one * rows.shared[0, j] + two * rows.shared[1, j]
        for j in range(identities, i + 1):
            equations.shared[row, 3 * k + j] += one * rows.shared[0, j] + two * rows.shared[1, j]
