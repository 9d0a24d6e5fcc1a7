"""Resampling schemes: unbiased counts, what each scheme guarantees, the ends of the cumulative weights."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.resampling import Resampling, resample, resampling_schemes

SCHEMES = resampling_schemes()
BELOW_ONE = np.nextafter(1.0, 0.0)

every_scheme = pytest.mark.parametrize("scheme", SCHEMES)
weights_with_zeros = arrays(
    np.float64, st.integers(1, 30), elements=st.one_of(st.just(0.0), st.floats(1e-12, 1.0))
).filter(lambda w: w.sum() > 0.0)
relaxed = settings(deadline=None)


class FixedUniforms:
    """A generator whose uniforms are all the same: the ends of [0, 1) come up at will."""

    def __init__(self, value: float) -> None:
        self.value = value

    def random(self, size: int | None = None) -> float | np.ndarray:
        return self.value if size is None else np.full(size, self.value)


def counts_of(scheme: str, weights: np.ndarray, rng, count: int | None = None) -> np.ndarray:
    return np.bincount(resample(scheme, weights, rng, count), minlength=weights.size)


@every_scheme
@relaxed
@given(weights=weights_with_zeros, count=st.integers(1, 50), seed=st.integers(0, 2**32))
def test_ancestors_are_valid_and_zero_weights_never_chosen(
    scheme: str, weights: np.ndarray, count: int, seed: int
) -> None:
    ancestors = resample(scheme, weights, np.random.default_rng(seed), count)
    assert ancestors.shape == (count,)
    assert ancestors.dtype == np.int64
    assert np.all(weights[ancestors] > 0.0)


@every_scheme
@pytest.mark.parametrize("u", [0.0, 0.5, BELOW_ONE])
@pytest.mark.parametrize(
    "weights",
    [
        [0.1] * 10,  # sums to 1 - 1 eps
        [0.7, 0.1, 0.1, 0.1 - 1e-9],  # ends clearly below 1
        [0.0, 0.3, 0.7, 0.0],
        [0.0, 0.0, 1.0],
        [1.0, 0.0, 0.0],
        [1.0, 1e-20],  # the last adds nothing to the sum
        [1e-300, 1e-300],
        [1.0],
    ],
)
def test_inverse_cdf_boundary_queries(scheme: str, u: float, weights: list[float]) -> None:
    w = np.array(weights)
    for count in (1, 3, 512, 2**17 + 1):
        ancestors = resample(scheme, w, FixedUniforms(u), count)
        assert ancestors.min() >= 0
        assert ancestors.max() < w.size
        assert np.all(w[ancestors] > 0.0)


def test_inverse_cdf_query_that_rounds_to_one() -> None:
    count = 2**20  # (count - 1 + u) / count rounds to 1: u's last bits are lost in the sum
    assert (count - 1 + BELOW_ONE) / count == 1.0
    ancestors = resample("systematic", np.array([0.5, 0.5, 0.0]), FixedUniforms(BELOW_ONE), count)
    assert ancestors.max() == 1


@every_scheme
def test_one_heavy_particle_gets_all_children(scheme: str) -> None:
    weights = np.zeros(9)
    weights[4] = 1.0
    np.testing.assert_array_equal(resample(scheme, weights, np.random.default_rng(0)), np.full(9, 4))


@every_scheme
def test_counts_are_unbiased(scheme: str) -> None:
    weights = np.array([0.0, 0.31, 0.02, 0.17, 0.4, 0.1])
    rng, runs, count = np.random.default_rng(1), 4000, 7
    mean = np.mean([counts_of(scheme, weights, rng, count) for _ in range(runs)], axis=0)
    # multinomial draws have the largest variance, count w (1 - w); 4.5 sigma for six counts
    tolerance = 4.5 * np.sqrt(count * weights * (1.0 - weights) / runs)
    assert np.all(np.abs(mean - count * weights) <= tolerance)


@relaxed
@given(weights=weights_with_zeros, seed=st.integers(0, 2**32), count=st.integers(1, 50))
def test_systematic_counts_are_floor_or_ceil(weights: np.ndarray, seed: int, count: int) -> None:
    counts = counts_of("systematic", weights, np.random.default_rng(seed), count)
    expected = count * weights / weights.sum()
    rounding = 1e-10  # of count * cumulative sums, both of size 50
    assert np.all(counts >= np.floor(expected - rounding))
    assert np.all(counts <= np.ceil(expected + rounding))


@relaxed
@given(weights=weights_with_zeros, seed=st.integers(0, 2**32), count=st.integers(1, 50))
def test_stratified_counts_are_within_two_of_expected(weights: np.ndarray, seed: int, count: int) -> None:
    # an interval of length w meets at most two strata in part, the others wholly
    counts = counts_of("stratified", weights, np.random.default_rng(seed), count)
    assert np.all(np.abs(counts - count * weights / weights.sum()) < 2.0 + 1e-10)


@relaxed
@given(weights=weights_with_zeros, seed=st.integers(0, 2**32), count=st.integers(1, 50))
def test_residual_keeps_the_whole_part(weights: np.ndarray, seed: int, count: int) -> None:
    counts = counts_of("residual", weights, np.random.default_rng(seed), count)
    assert np.all(counts >= np.floor(count * (weights / weights.sum())))


@pytest.mark.parametrize("scheme", ["residual", "stratified", "systematic"])
def test_equal_weights_survive_once_each(scheme: str) -> None:
    # 64 equal weights are exact in binary: no rounding moves a boundary
    np.testing.assert_array_equal(counts_of(scheme, np.full(64, 1 / 64), np.random.default_rng(2)), 1)


def test_low_variance_schemes_have_lower_variance() -> None:
    weights = np.random.default_rng(3).dirichlet(np.ones(20))
    spread = {
        scheme: np.var(
            [counts_of(scheme, weights, np.random.default_rng(seed)) for seed in range(500)], axis=0
        ).sum()
        for scheme in SCHEMES
    }
    for scheme in ("residual", "stratified", "systematic"):
        assert spread[scheme] < spread["multinomial"]


@every_scheme
def test_a_seed_gives_the_same_ancestors(scheme: str) -> None:
    weights = np.random.default_rng(4).random(100)
    weights.setflags(write=False)
    first, second = (resample(scheme, weights, np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(first, second)


@every_scheme
@pytest.mark.parametrize("weights", [[], [0.0, 0.0], [-0.1, 1.1], [np.nan, 1.0], [np.inf, 1.0], [[0.5, 0.5]]])
def test_what_is_no_weight_is_refused(scheme: str, weights: list) -> None:
    with pytest.raises(FilterError, match="invalid weights"):
        resample(scheme, np.array(weights), np.random.default_rng(0))


def test_unknown_scheme_names_the_nearest() -> None:
    with pytest.raises(FilterError, match="did you mean 'systematic'"):
        Resampling(scheme="sistematic")
    with pytest.raises(FilterError, match="did you mean 'residual'"):
        resample("residul", np.ones(2), np.random.default_rng(0))


def test_nothing_to_draw_is_refused() -> None:
    with pytest.raises(FilterError, match="invalid number of ancestors"):
        resample("systematic", np.ones(2), np.random.default_rng(0), 0)


@pytest.mark.parametrize("threshold", [-0.1, np.nan])
def test_threshold_is_checked(threshold: float) -> None:
    with pytest.raises(FilterError, match="threshold"):
        Resampling(threshold=threshold)


def test_threshold_one_is_always_and_zero_never() -> None:
    assert Resampling(threshold=1.0).is_due(100.0 * (1.0 + 1e-15), 100)
    assert not Resampling(threshold=0.0).is_due(1.0, 100)
    assert Resampling(threshold=0.5).is_due(49.9, 100)
    assert not Resampling(threshold=0.5).is_due(50.0, 100)
