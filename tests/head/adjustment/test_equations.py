"""The analytic Jacobian against differences of a reference, and that the equations grow with n only."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.head.adjustment.descent import make_elimination
from posetrack_cli.head.adjustment.problem import Part, cost, make_equations
from support.adjustment_cases import QUADRATIC, ROBUST, case_of, dense, equations_at, somewhere
from support.adjustment_reference import joined, numeric_jacobian, residual_vector, split, whitened_errors
from support.bundles import LENSES

STEP = 1e-5
DIFFERENCES = 1e-7
"""Relative error of central differences: third derivatives over first times STEP^2 / 6 ~ 1e-9; rounding of
residuals of 1e2 over STEP ~ 1e-9 each, summed over hundreds of rows."""


@pytest.mark.parametrize("lens", LENSES)
def test_equations_are_those_of_the_numeric_jacobian(lens):
    case = case_of(lens)
    at, part = somewhere(case), case.everything
    matrix, gradient = dense(equations_at(case.problem, at, part))
    J = numeric_jacobian(lambda x: residual_vector(case, split(x, at)), joined(at, part), STEP)
    scale = np.sqrt(np.diag(J.T @ J))
    np.testing.assert_allclose(
        matrix / np.outer(scale, scale), J.T @ J / np.outer(scale, scale), atol=DIFFERENCES
    )
    length = np.linalg.norm(residual_vector(case, at))
    np.testing.assert_allclose(
        gradient / scale / length, J.T @ residual_vector(case, at) / scale / length, atol=DIFFERENCES
    )


@pytest.mark.parametrize("settings", [QUADRATIC, ROBUST, ROBUST.model_copy(update={"offsets": False})])
def test_cost_is_half_the_sum_of_squares(settings):
    case = case_of(settings=settings)
    at = somewhere(case)
    residuals = residual_vector(case, at)
    assert cost(case.problem, at, case.everything) == pytest.approx(0.5 * residuals @ residuals, rel=1e-12)


def test_gradient_is_that_of_the_robust_cost():
    """Reweighted least squares have the robust cost's own gradient."""
    case = case_of(settings=ROBUST)
    at, part, problem = somewhere(case), case.everything, case.problem
    assert np.sum(np.linalg.norm(whitened_errors(case, at), axis=-1) > ROBUST.huber) > 5
    _, gradient = dense(equations_at(problem, at, part))
    wanted = numeric_jacobian(
        lambda x: np.atleast_1d(cost(problem, split(x, at), part)), joined(at, part), STEP
    )
    np.testing.assert_allclose(gradient, wanted[0], atol=DIFFERENCES * np.abs(gradient).max())


def test_a_part_has_the_whole_equations_blocks():
    case = case_of(settings=ROBUST)
    at, problem, whole = somewhere(case), case.problem, case.everything
    everything = equations_at(problem, at, whole)
    poses = equations_at(problem, at, Part(1, 2, 6, 0))
    np.testing.assert_array_equal(np.tril(poses.local[0]), np.tril(everything.local[1, :6, :6]))
    np.testing.assert_array_equal(poses.local_gradient[0], everything.local_gradient[1, :6])
    identity = equations_at(problem, at, Part(0, 3, 11, 10))
    np.testing.assert_array_equal(identity.cross, everything.cross[:, :, :10])
    np.testing.assert_array_equal(np.tril(identity.shared), np.tril(everything.shared[:10, :10]))


def test_a_point_behind_the_camera_costs_without_end_and_pulls_at_nothing():
    case = case_of()
    at, part, problem = case.start, case.everything, case.problem
    at.local[1, 2] = -2000.0
    assert cost(problem, at, part) == np.inf
    equations = equations_at(problem, at, part)
    assert all(np.isfinite(block).all() for block in equations)
    np.testing.assert_array_equal(equations.local_gradient[1, :6], 0.0)


@pytest.mark.parametrize("offsets, shared", [(True, 40), (False, 10)])
def test_room_grows_linearly_with_the_views(offsets, shared):
    """Every loop goes over these blocks; nothing of the size of n^2 exists."""

    def numbers(count):
        part = Part(0, count, 11, shared)
        equations = make_equations(part)
        return sum(block.size for block in (*equations, *make_elimination(equations)))

    assert numbers(60) - numbers(40) == numbers(40) - numbers(20) == 20 * (numbers(2) - numbers(1))
