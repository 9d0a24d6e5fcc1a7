"""Unfolding, mode products and decompositions: their laws, and the same as tensorly's."""

from __future__ import annotations

import numpy as np
import pytest
import tensorly
from hypothesis import given
from hypothesis import strategies as st
from tensorly.decomposition import partial_tucker, tucker

from posetrack_cli.head.multilinear.build import (
    hooi,
    mode_product,
    singular_values,
    truncated_svd,
    unfold,
)

ROUNDING = 1e3 * np.finfo(float).eps
"""Of sums of some hundred products of numbers about 1."""
CONVERGED = 1e-5
"""Relative difference of two alternating searches that stopped near the same optimum."""

lengths = st.lists(st.integers(1, 5), min_size=2, max_size=4)
seeds = st.integers(0, 2**32 - 1)


def normal(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def structured(seed: int = 0, noise: float = 0.3) -> np.ndarray:
    """(12, 8, 15) of ranks 3, 2 and 4, with noise upon it."""
    rng = np.random.default_rng(seed)
    tensor = rng.standard_normal((3, 2, 4))
    for mode, length in enumerate((12, 8, 15)):
        tensor = mode_product(tensor, rng.standard_normal((length, tensor.shape[mode])), mode)
    return tensor + noise * rng.standard_normal(tensor.shape)


def error(tensor: np.ndarray, approximation: np.ndarray) -> float:
    return float(np.sum((tensor - approximation) ** 2))


@given(lengths, seeds)
def test_unfolding_is_tensorlys(shape: list[int], seed: int) -> None:
    tensor = normal(*shape, seed=seed)
    for mode in range(len(shape)):
        np.testing.assert_array_equal(unfold(tensor, mode), tensorly.unfold(tensor, mode))


@given(lengths, seeds, st.integers(1, 4))
def test_a_mode_product_multiplies_the_unfolded_tensor(shape: list[int], seed: int, rows: int) -> None:
    """(4.2), and the sum (4.1) as tensorly has it."""
    tensor = normal(*shape, seed=seed)
    for mode, length in enumerate(shape):
        matrix = normal(rows, length, seed=seed + 1)
        product = mode_product(tensor, matrix, mode)
        np.testing.assert_allclose(unfold(product, mode), matrix @ unfold(tensor, mode), atol=ROUNDING)
        np.testing.assert_allclose(product, tensorly.tenalg.mode_dot(tensor, matrix, mode), atol=ROUNDING)


@given(lengths, seeds)
def test_products_along_two_modes_commute_and_along_one_mode_compose(shape: list[int], seed: int) -> None:
    tensor = normal(*shape, seed=seed)
    a, b = normal(3, shape[0], seed=seed + 1), normal(2, shape[1], seed=seed + 2)
    one, other = (
        mode_product(mode_product(tensor, a, 0), b, 1),
        mode_product(mode_product(tensor, b, 1), a, 0),
    )
    np.testing.assert_allclose(one, other, atol=ROUNDING)
    again = normal(4, 3, seed=seed + 3)
    composed = mode_product(tensor, again @ a, 0)
    np.testing.assert_allclose(mode_product(mode_product(tensor, a, 0), again, 0), composed, atol=ROUNDING)


@given(lengths, seeds)
def test_full_rank_is_exact(shape: list[int], seed: int) -> None:
    tensor = normal(*shape, seed=seed)
    full = {mode: np.linalg.matrix_rank(unfold(tensor, mode)) for mode in range(len(shape))}
    for decomposition in (truncated_svd(tensor, full), hooi(tensor, full)):
        np.testing.assert_allclose(decomposition.tensor(), tensor, atol=ROUNDING)


def test_modes_that_are_not_decomposed_stay_in_the_core() -> None:
    tensor = normal(4, 5, 6)
    decomposition = truncated_svd(tensor, {0: 4, 2: 6})
    assert decomposition.core.shape == (4, 5, 6) and set(decomposition.bases) == {0, 2}
    np.testing.assert_allclose(decomposition.tensor(), tensor, atol=ROUNDING)


def test_bases_are_orthonormal_and_the_core_is_all_orthogonal() -> None:
    """De Lathauwer et al., "A multilinear singular value decomposition", 2000: theorem 2."""
    tensor = structured()
    decomposition = truncated_svd(tensor, dict(enumerate(tensor.shape)))
    for mode, basis in decomposition.bases.items():
        np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=ROUNDING)
        rows = unfold(decomposition.core, mode)
        squares = np.diag(singular_values(tensor, mode)[: len(rows)] ** 2)
        np.testing.assert_allclose(rows @ rows.T, squares, atol=ROUNDING * squares.max())


def test_singular_values_are_those_of_the_unfolded_tensor() -> None:
    tensor = structured()
    for mode in range(3):
        expected = tensorly.tenalg.svd_interface(tensorly.unfold(tensor, mode), "truncated_svd")[1]
        np.testing.assert_allclose(singular_values(tensor, mode), expected, rtol=ROUNDING)


def test_iteration_is_nowhere_worse_than_truncation_and_somewhere_better() -> None:
    tensor = structured(noise=1.0)
    gains = []
    for first in range(1, 13):
        for second in range(1, 9):
            ranks = {0: first, 1: second}
            truncated = error(tensor, truncated_svd(tensor, ranks).tensor())
            iterated = error(tensor, hooi(tensor, ranks).tensor())
            assert iterated <= truncated + ROUNDING * np.sum(tensor**2)
            gains.append(1.0 - iterated / truncated if truncated > 1.0 else 0.0)
    assert max(gains) > 1e-3


def test_more_of_a_rank_never_makes_it_worse() -> None:
    tensor = structured(noise=1.0)
    errors = np.array(
        [[error(tensor, hooi(tensor, {0: a, 1: b}).tensor()) for b in range(1, 9)] for a in range(1, 13)]
    )
    assert np.all(np.diff(errors, axis=0) <= CONVERGED * errors[1:] + ROUNDING * np.sum(tensor**2))
    assert np.all(np.diff(errors, axis=1) <= CONVERGED * errors[:, 1:] + ROUNDING * np.sum(tensor**2))
    assert errors[-1, -1] <= ROUNDING * np.sum(tensor**2)


@pytest.mark.parametrize("ranks", [(3, 2), (2, 2), (5, 4), (1, 1)])
def test_iteration_finds_what_tensorly_finds(ranks: tuple[int, int]) -> None:
    tensor = structured()
    mine = hooi(tensor, dict(enumerate(ranks)))
    (core, factors), _ = partial_tucker(tensor, list(ranks), modes=[0, 1], n_iter_max=500, tol=1e-12)
    theirs = tensorly.tenalg.multi_mode_dot(core, factors, modes=[0, 1])
    scale = np.abs(tensor).max()
    np.testing.assert_allclose(mine.tensor(), theirs, atol=CONVERGED * scale)
    for mode, factor in enumerate(factors):  # the same subspace, whichever way its basis is turned
        basis = mine.bases[mode]
        np.testing.assert_allclose(basis @ basis.T, factor @ factor.T, atol=100 * CONVERGED)


def test_iteration_along_all_modes_finds_what_tensorly_finds() -> None:
    tensor = structured()
    mine = hooi(tensor, {0: 3, 1: 2, 2: 4})
    theirs = tucker(tensor, [3, 2, 4], n_iter_max=500, tol=1e-12)
    assert error(tensor, mine.tensor()) == pytest.approx(
        error(tensor, tensorly.tucker_to_tensor(theirs)), rel=CONVERGED
    )


def test_signs_do_not_depend_on_the_library() -> None:
    for basis in truncated_svd(structured(), {0: 3, 1: 2}).bases.values():
        assert np.all(basis[np.argmax(np.abs(basis), axis=0), range(basis.shape[1])] > 0.0)
