"""What an adjustment came to: errors of points, and how well the person is known; compiled."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import kernel
from posetrack_cli.head.adjustment.solver.cost import view_lengths
from posetrack_cli.head.adjustment.solver.descent import make_held
from posetrack_cli.head.adjustment.solver.elimination import inverse_diagonal, make_elimination, reduce
from posetrack_cli.head.adjustment.solver.equations import linearise, make_equations, make_rows
from posetrack_cli.head.adjustment.solver.problem import Part, Problem, Unknowns
from posetrack_cli.head.adjustment.solver.shape import deformation_basis


@kernel
def all_lengths(problem: Problem, unknowns: Unknowns, out: FloatArray) -> None:
    """Write (n, K) how far each point is off, in standard deviations."""
    basis = np.empty((*problem.mean.shape, len(problem.deformation_centre)))
    deformation_basis(problem, unknowns.shared, basis)
    for view in range(len(out)):
        view_lengths(problem, unknowns, view, basis, out[view])


@kernel
def identity_variances(problem: Problem, unknowns: Unknowns, part: Part, out: FloatArray) -> None:
    """Write (S,) variances of u: the inverse Schur complement's diagonal; infinite where there is none."""
    equations, rows, held = make_equations(part), make_rows(problem), make_held(part)
    held.local[:], held.shared[:] = False, False
    room = make_elimination(equations)
    deformation_basis(problem, unknowns.shared, rows.deformations)
    linearise(problem, unknowns, part, rows, equations)
    if reduce(equations, held, 0.0, room):
        inverse_diagonal(room.reduced, out)
    else:
        out[:] = np.inf
