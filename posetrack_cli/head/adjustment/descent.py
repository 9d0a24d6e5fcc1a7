"""Solver of the bundle adjustment: elimination of views and bounded Levenberg-Marquardt; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.geometry.least_squares import (
    back_substitute,
    backward,
    eliminate,
    factorise,
    forward,
    inverse_diagonal,
)
from posetrack_cli.head.adjustment.problem import (
    POSE,
    Boxes,
    Equations,
    Part,
    Problem,
    Rows,
    Unknowns,
    cost_with_basis,
    deformation_basis,
    linearise,
    make_equations,
    make_rows,
    view_lengths,
)

# Normal equations with the views eliminated (Schur complement).
#
#     [A  B] [x]     [g]        A = L L^T, Y = L^-1 B, c = -L^-1 g for each view
#     [B' C] [z] = - [h]        (C - sum Y' Y) z = -h - sum Y' c,   x = L^-T (c - Y z)
#
# with mu times the diagonal added to A and C (Marquardt's scaling of (4.23), independent of units
# **[ours]**).


class Held(NamedTuple):
    """Which unknowns are fixed: (n, m) and (q,)."""

    local: BoolArray
    shared: BoolArray


class Elimination(NamedTuple):
    """Work arrays and solution.

    Attributes:
        factors: (n, m, m) L.
        halves: (n, m, q) Y.
        middles: (n, m) c.
        reduced: (q, q) Schur complement, then its Cholesky factor.
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
    """Allocate work arrays."""
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
    """Write the step of the free unknowns; return False if a matrix is not positive definite."""
    if not eliminate_views(equations, held, damping, work):
        return False
    forward(work.reduced, work.shared)
    backward(work.reduced, work.shared)
    for view in range(len(work.local)):
        back_substitute(
            work.factors[view], work.halves[view], work.middles[view], work.shared, work.local[view]
        )
    return True


@kernel
def eliminate_views(equations: Equations, held: Held, damping: float, work: Elimination) -> bool:
    """Eliminate the views and factorise the rest; return False if a matrix is not positive definite."""
    _damped(equations.shared, held.shared, damping, work.reduced)
    for j in range(len(work.shared)):
        work.shared[j] = 0.0 if held.shared[j] else -equations.shared_gradient[j]
    for view in range(len(work.local)):
        _damped(equations.local[view], held.local[view], damping, work.factors[view])
        if not factorise(work.factors[view]):
            return False
        for a in range(len(work.middles[view])):
            stays = held.local[view, a]
            work.middles[view, a] = 0.0 if stays else -equations.local_gradient[view, a]
            for j in range(len(work.shared)):
                work.halves[view, a, j] = 0.0 if stays or held.shared[j] else equations.cross[view, a, j]
        eliminate(work.factors[view], work.halves[view], work.middles[view], work.reduced, work.shared)
    return factorise(work.reduced)


@kernel
def _damped(matrix: FloatArray, held: BoolArray, damping: float, out: FloatArray) -> None:
    """Write the damped lower triangle, with identity rows and columns for fixed unknowns."""
    for a in range(len(matrix)):
        for b in range(a):
            out[a, b] = 0.0 if held[a] or held[b] else matrix[a, b]
        # an unknown without influence has diagonal and gradient 0
        out[a, a] = 1.0 if held[a] or matrix[a, a] <= 0.0 else matrix[a, a] * (1.0 + damping)


# Projected Levenberg-Marquardt within a box, (4.23)-(4.28).
#
# Every iteration linearises once. Unknowns at a bound that the gradient pushes outwards are fixed; for the
# others the damped equations are solved and the step is projected onto the box. A step that does not lower F
# is halved along its projection, (4.28); if that fails as well, steepest descent (scaled by the diagonal) is
# searched in the same way. F, the true robust cost, never increases.

DAMPING, LEAST_DAMPING = 1e-3, 1e-12
EASIER, HARDER, STEEPEST = 0.1, 5.0, 100.0
"""Factors on the damping after a full step, a shortened one, and one of steepest descent."""
SHORTENED, TRIALS = 0.5, 12
CONVERGED = 1e-13
"""Minimum relative decrease of F promised by a step; less is rounding error."""


@kernel
def adjust_in_stages(problem: Problem, boxes: Boxes, unknowns: Unknowns, iterations: int, shared: int) -> int:
    """Adjust the poses, then all unknowns including ``shared`` ones; return the number of steps.

    Without shared unknowns, and in the first stage, the views are independent.
    """
    views, size = unknowns.local.shape
    first = 0
    for view in range(views):
        part = Part(view, view + 1, POSE, 0)
        first = max(first, descend(problem, boxes, unknowns, part, iterations))
    if shared > 0:
        return first + descend(problem, boxes, unknowns, Part(0, views, size, shared), iterations)
    second = 0
    for view in range(views):
        part = Part(view, view + 1, size, 0)
        second = max(second, descend(problem, boxes, unknowns, part, iterations))
    return first + second


@kernel
def descend(problem: Problem, boxes: Boxes, unknowns: Unknowns, part: Part, iterations: int) -> int:
    """Minimise F over a part of the unknowns in place; return the number of steps."""
    equations, rows = make_equations(part), make_rows(problem)
    work, held = make_elimination(equations), make_held(part)
    trial = Unknowns(unknowns.local.copy(), unknowns.shared.copy())
    deformation_basis(problem, unknowns.shared, rows.deformations)
    now, damping = cost_with_basis(problem, unknowns, part, rows.deformations), DAMPING
    for taken in range(iterations):
        linearise(problem, unknowns, part, rows, equations)
        find_held(boxes, unknowns, part, equations, held)
        below, factor = now, STEEPEST
        if solve(equations, held, damping, work):
            # stop before evaluating F once the linear prediction is below rounding error
            if -predicted_rise(boxes, unknowns, part, equations, work, trial) <= CONVERGED * now:
                return taken
            below, factor = search_along(problem, boxes, unknowns, trial, part, work, rows, now)
        if not below < now:
            steepest_step(equations, held, work)
            below, _ = search_along(problem, boxes, unknowns, trial, part, work, rows, now)
            factor = STEEPEST
        if not below < now:
            return taken
        accept_trial(trial, part, unknowns)
        now, damping = below, max(damping * factor, LEAST_DAMPING)
    return iterations


@kernel
def predicted_rise(
    boxes: Boxes, unknowns: Unknowns, part: Part, equations: Equations, step: Elimination, trial: Unknowns
) -> float:
    """Return the linear prediction of F's change along the full projected step."""
    project_step(boxes, unknowns, part, step, 1.0, trial)
    rise = 0.0
    for view in range(part.first, part.last):
        for a in range(part.local):
            change = trial.local[view, a] - unknowns.local[view, a]
            rise += equations.local_gradient[view - part.first, a] * change
    for j in range(part.shared):
        rise += equations.shared_gradient[j] * (trial.shared[j] - unknowns.shared[j])
    return rise


@kernel
def make_held(part: Part) -> Held:
    """Allocate the masks of fixed unknowns."""
    views = part.last - part.first
    return Held(np.empty((views, part.local), dtype=np.bool_), np.empty(part.shared, dtype=np.bool_))


@kernel
def find_held(boxes: Boxes, unknowns: Unknowns, part: Part, equations: Equations, held: Held) -> None:
    """Mark the unknowns at a bound beyond which F decreases."""
    for view in range(part.first, part.last):
        i = view - part.first
        _at_bounds(
            boxes.local_lower[view],
            boxes.local_upper[view],
            unknowns.local[view],
            equations.local_gradient[i],
            held.local[i],
        )
    _at_bounds(
        boxes.shared_lower, boxes.shared_upper, unknowns.shared, equations.shared_gradient, held.shared
    )


@inlined
def _at_bounds(
    lower: FloatArray, upper: FloatArray, values: FloatArray, gradient: FloatArray, out: BoolArray
) -> None:
    for j in range(len(out)):
        below = values[j] <= lower[j] and gradient[j] > 0.0
        out[j] = below or (values[j] >= upper[j] and gradient[j] < 0.0)


@kernel
def search_along(
    problem: Problem,
    boxes: Boxes,
    unknowns: Unknowns,
    trial: Unknowns,
    part: Part,
    step: Elimination,
    rows: Rows,
    now: float,
) -> tuple[float, float]:
    """Write the first of successively halved projected steps that lowers F, and the basis there.

    Returns:
        F there, or ``now`` if none does; the factor on the damping.
    """
    length = 1.0
    for _ in range(TRIALS):
        project_step(boxes, unknowns, part, step, length, trial)
        if part.shared > 0:
            deformation_basis(problem, trial.shared, rows.deformations)
        below = cost_with_basis(problem, trial, part, rows.deformations)
        if below < now:
            return below, EASIER if length == 1.0 else HARDER
        length *= SHORTENED
    return now, STEEPEST


@kernel
def project_step(
    boxes: Boxes, unknowns: Unknowns, part: Part, step: Elimination, length: float, trial: Unknowns
) -> None:
    """Write P(x + length step), (4.27)."""
    for view in range(part.first, part.last):
        for a in range(part.local):
            value = unknowns.local[view, a] + length * step.local[view - part.first, a]
            trial.local[view, a] = min(max(value, boxes.local_lower[view, a]), boxes.local_upper[view, a])
    for j in range(part.shared):
        value = unknowns.shared[j] + length * step.shared[j]
        trial.shared[j] = min(max(value, boxes.shared_lower[j]), boxes.shared_upper[j])


@kernel
def steepest_step(equations: Equations, held: Held, step: Elimination) -> None:
    """Write the step of steepest descent, scaled by the diagonal."""
    for view in range(len(step.local)):
        for a in range(len(step.local[view])):
            scale = equations.local[view, a, a]
            free = scale > 0.0 and not held.local[view, a]
            step.local[view, a] = -equations.local_gradient[view, a] / scale if free else 0.0
    for j in range(len(step.shared)):
        scale = equations.shared[j, j]
        free = scale > 0.0 and not held.shared[j]
        step.shared[j] = -equations.shared_gradient[j] / scale if free else 0.0


@kernel
def accept_trial(trial: Unknowns, part: Part, unknowns: Unknowns) -> None:
    """Copy the trial to the unknowns."""
    for view in range(part.first, part.last):
        for a in range(part.local):
            unknowns.local[view, a] = trial.local[view, a]
    for j in range(part.shared):
        unknowns.shared[j] = trial.shared[j]


@kernel
def residual_lengths(problem: Problem, unknowns: Unknowns, out: FloatArray) -> None:
    """Write (n, K) the errors of the points, in standard deviations."""
    basis = np.empty((*problem.mean.shape, len(problem.deformation_centre)))
    deformation_basis(problem, unknowns.shared, basis)
    for view in range(len(out)):
        view_lengths(problem, unknowns, view, basis, out[view])


@kernel
def identity_variances(problem: Problem, unknowns: Unknowns, part: Part, out: FloatArray) -> None:
    """Write (S,) variances of u: diagonal of the inverse Schur complement, infinite if singular."""
    equations, rows, held = make_equations(part), make_rows(problem), make_held(part)
    held.local[:], held.shared[:] = False, False
    work = make_elimination(equations)
    deformation_basis(problem, unknowns.shared, rows.deformations)
    linearise(problem, unknowns, part, rows, equations)
    if eliminate_views(equations, held, 0.0, work):
        inverse_diagonal(work.reduced, out)
    else:
        out[:] = np.inf
