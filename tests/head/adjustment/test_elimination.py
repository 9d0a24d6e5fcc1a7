"""Eliminating the views gives the dense solution."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.geometry.least_squares import inverse_diagonal
from posetrack_cli.head.adjustment.descent import Held, eliminate_views, make_elimination, solve
from posetrack_cli.head.adjustment.problem import Part
from support.adjustment_cases import case_of, dense, equations_at, somewhere

ROUNDING = 1e-9
"""eps times the condition number of the equations in units of their diagonal, some 1e5, and to spare."""


def held_of(equations, share, seed=6):
    rng = np.random.default_rng(seed)
    return Held(
        rng.uniform(size=equations.local_gradient.shape) < share,
        rng.uniform(size=equations.shared_gradient.shape) < share,
    )


def joined_step(work):
    return np.concatenate([work.local.ravel(), work.shared])


@pytest.mark.parametrize("shared", [0, 10, 40])
@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_step_is_that_of_the_dense_equations(shared, damping, share):
    case = case_of()
    equations = equations_at(case.problem, somewhere(case), Part(0, 3, 11, shared))
    held, work = held_of(equations, share), make_elimination(equations)
    assert solve(equations, held, damping, work)
    matrix, gradient = dense(equations)
    matrix += damping * np.diag(np.diag(matrix))
    free = ~np.concatenate([held.local.ravel(), held.shared])
    wanted = np.zeros(len(gradient))
    wanted[free] = np.linalg.solve(matrix[np.ix_(free, free)], -gradient[free])
    scale = np.sqrt(np.diag(matrix))
    found = joined_step(work)
    np.testing.assert_allclose(found * scale, wanted * scale, atol=ROUNDING * np.abs(wanted * scale).max())


def test_variances_are_the_dense_inverse_s():
    case = case_of()
    equations = equations_at(case.problem, somewhere(case), case.everything)
    work, found = make_elimination(equations), np.empty(10)
    assert eliminate_views(equations, held_of(equations, 0.0), 0.0, work)
    inverse_diagonal(work.reduced, found)
    wanted = np.diag(np.linalg.inv(dense(equations)[0]))[33:43]
    np.testing.assert_allclose(found, wanted, rtol=1e-7)
