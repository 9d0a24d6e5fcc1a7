"""Normal equations against dense solutions, steps against the quadratic, weights against their costs."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import least_squares

SIZE, KEPT, GONE = 9, slice(4, None), slice(0, 4)


def equations(seed: int, size: int = SIZE) -> tuple[FloatArray, FloatArray]:
    """A matrix with a condition number of some hundreds, and a right side."""
    rng = np.random.default_rng(seed)
    jacobian = rng.standard_normal((2 * size, size))
    return jacobian.T @ jacobian, jacobian.T @ rng.standard_normal(2 * size)


def quadratic(matrix: FloatArray, vector: FloatArray, step: FloatArray) -> float:
    return float(0.5 * step @ matrix @ step - vector @ step)


# Solutions


@pytest.mark.parametrize("seed", range(3))
def test_small_systems_have_the_dense_solution(seed: int) -> None:
    matrix, vector = equations(seed)
    wanted, inverse = np.linalg.solve(matrix, vector), np.linalg.inv(matrix)
    found = np.empty(SIZE)
    least_squares.solve(matrix, vector, found)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    factor, found = matrix.copy(), vector.copy()
    assert least_squares.factorise(factor)
    np.testing.assert_allclose(np.tril(factor), np.linalg.cholesky(matrix), rtol=1e-9)
    least_squares.forward(factor, found)
    least_squares.backward(factor, found)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    first = np.empty(5)
    least_squares.inverse_diagonal(factor, first)
    np.testing.assert_allclose(first, np.diag(inverse)[:5], rtol=1e-9)


def test_a_matrix_that_is_not_positive_has_no_factor() -> None:
    assert least_squares.factorise(np.array([[4.0, 0.0], [2.0, 1.1]]))
    assert not least_squares.factorise(np.array([[4.0, 0.0], [2.0, 0.9]]))
    assert not least_squares.factorise(np.array([[np.nan]]))


def test_a_symmetric_matrix_is_inverted() -> None:
    A, out = equations(4, 3)[0], np.empty((3, 3))
    least_squares.invert_symmetric(A, 0.7, out)
    np.testing.assert_allclose(out, np.linalg.inv(A + 0.7 * np.eye(3)))


# Elimination


@pytest.mark.parametrize("seed", range(3))
def test_an_eliminated_block_is_solved_and_integrated_out(seed: int) -> None:
    """What is left has the whole solution's part, and the marginal's information."""
    matrix, vector = equations(seed)
    wanted, covariance = np.linalg.solve(matrix, vector), np.linalg.inv(matrix)
    reduced, right = least_squares.eliminated(matrix, vector, KEPT, GONE)
    step = np.linalg.solve(reduced, right)
    np.testing.assert_allclose(step, wanted[KEPT], rtol=1e-9)
    np.testing.assert_allclose(np.linalg.inv(reduced), covariance[KEPT, KEPT], rtol=1e-9)
    others = least_squares.back_substituted(matrix, vector, KEPT, GONE, step)
    np.testing.assert_allclose(others, wanted[GONE], rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_kernels_eliminate_the_same(seed: int) -> None:
    matrix, vector = equations(seed)
    wanted, right = least_squares.eliminated(matrix, vector, KEPT, GONE)
    factor, cross, own = matrix[GONE, GONE].copy(), matrix[GONE, KEPT].copy(), vector[GONE].copy()
    kept, left = matrix[KEPT, KEPT].copy(), vector[KEPT].copy()
    assert least_squares.factorise(factor)
    least_squares.eliminate(factor, cross, own, kept, left)
    np.testing.assert_allclose(np.tril(kept), np.tril(wanted), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(left, right, rtol=1e-9)
    step, found = np.linalg.solve(wanted, right), np.empty(4)
    least_squares.back_substitute(factor, cross, own, step, found)
    others = least_squares.back_substituted(matrix, vector, KEPT, GONE, step)
    np.testing.assert_allclose(found, others, rtol=1e-9)


# Steps


@pytest.mark.parametrize("seed", range(5))
def test_a_step_between_bounds_is_the_best_one(seed: int) -> None:
    """Nothing is gained by a move that the bounds allow (Karush, Kuhn and Tucker)."""
    rng = np.random.default_rng(seed)
    matrix, vector = equations(seed)
    least, most = -rng.uniform(0.0, 0.5, SIZE), rng.uniform(0.0, 0.5, SIZE)
    least[0], most[1] = 0.0, 0.0  # numbers that are at their bounds already
    step = least_squares.bounded_step(matrix, vector, least, most)
    uphill = vector - matrix @ step
    low, high = step <= least + 1e-9, step >= most - 1e-9
    assert (low | high).any() and not (low | high).all()
    assert (step >= least - 1e-9).all() and (step <= most + 1e-9).all()
    assert np.abs(uphill[~(low | high)]).max() < 1e-7
    assert (uphill[low] < 1e-7).all() and (uphill[high] > -1e-7).all()
    assert quadratic(matrix, vector, step) < 0.0


def test_a_step_that_no_bound_stops_solves_the_equations() -> None:
    matrix, vector = equations(1)
    wide = np.full(SIZE, 1e6)
    np.testing.assert_allclose(
        matrix @ least_squares.bounded_step(matrix, vector, -wide, wide), vector, atol=1e-8
    )


def test_a_damped_step_is_shorter_and_still_goes_down() -> None:
    matrix, vector = equations(2)
    steps = [least_squares.damped_step(matrix, vector, damping) for damping in (0.0, 0.1, 1.0, 10.0)]
    np.testing.assert_allclose(steps[0], np.linalg.solve(matrix, vector))
    costs = [quadratic(matrix, vector, step) for step in steps]
    assert np.all(np.diff(costs) > 0.0) and costs[-1] < 0.0
    units = np.sqrt(np.diag(matrix))
    assert np.all(np.diff([np.linalg.norm(units * step) for step in steps]) < 0.0)


def test_where_nothing_is_told_a_step_is_the_shortest() -> None:
    np.testing.assert_allclose(least_squares.damped_step(np.ones((2, 2)), np.ones(2), 0.0), [0.5, 0.5])


# Weights

TAU = 1.7
COSTS: dict[str, tuple[Callable[[float], float], Callable[[float], float]]] = {
    "Geman and McClure": (
        lambda e: least_squares.geman_mcclure((e / TAU) ** 2),
        lambda e: 0.5 * e**2 / (1.0 + (e / TAU) ** 2),
    ),
    "Cauchy": (
        lambda e: least_squares.cauchy((e / TAU) ** 2),
        lambda e: 0.5 * TAU**2 * math.log1p((e / TAU) ** 2),
    ),
    "Student": (
        lambda e: least_squares.student_t(e**2, 3.0, 4.0, TAU),
        lambda e: 0.5 * (4.0 + 3.0) * math.log1p(e**2 / (4.0 * TAU**2)),
    ),
    "Huber": (lambda e: least_squares.huber_weight(e, TAU), lambda e: least_squares.huber(e, TAU)),
}


@pytest.mark.parametrize("name", COSTS)
@pytest.mark.parametrize("e", [0.3, 1.6, 1.8, 25.0])
def test_a_weight_times_the_residual_is_the_costs_derivative(name: str, e: float) -> None:
    (weight, cost), h = COSTS[name], 1e-5
    assert weight(e) * e == pytest.approx((cost(e + h) - cost(e - h)) / (2.0 * h), rel=1e-6)


def test_huber_is_a_square_up_to_its_bound_and_without_one() -> None:
    lengths = np.array([0.0, 1.0, 2.0, 4.0])
    np.testing.assert_array_equal(least_squares.huber(lengths, 2.0), [0.0, 0.5, 2.0, 6.0])
    np.testing.assert_array_equal(least_squares.huber_weight(lengths, 2.0), [1.0, 1.0, 1.0, 0.5])
    np.testing.assert_array_equal(least_squares.huber(lengths, np.inf), 0.5 * lengths**2)
    np.testing.assert_array_equal(least_squares.huber_weight(lengths, np.inf), 1.0)


@pytest.mark.parametrize("weight", [least_squares.geman_mcclure, least_squares.cauchy])
def test_arrays_and_numbers_are_weighted_alike(weight: Callable[[object], object]) -> None:
    squares = np.random.default_rng(0).exponential(size=20)
    np.testing.assert_array_equal(weight(squares), [weight(square) for square in squares.tolist()])
