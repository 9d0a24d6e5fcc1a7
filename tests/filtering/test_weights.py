"""Log-weights: stable, exact about what has no mass, and the laws of the effective sample size."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.errors import PosetrackError
from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.resampling import (
    TRUNCATION,
    effective_count,
    normalise,
    truncated,
)

ROUNDING = 1e-12
"""A sum of up to 40 terms at exponents of up to 1e4: 40 eps, and 1e4 eps in a log-weight's last bit."""

log_weights = arrays(np.float64, st.integers(1, 40), elements=st.floats(-1e4, 1e4))
relaxed = settings(deadline=None)


@relaxed
@given(log_weights, st.floats(-1e4, 1e4))
def test_normalised_weights_sum_to_one_and_forget_a_common_factor(values: np.ndarray, shift: float) -> None:
    weights, log_sum = normalise(values)
    assert abs(weights.sum() - 1.0) < ROUNDING
    shifted, shifted_sum = normalise(values + shift)
    np.testing.assert_allclose(shifted, weights, atol=1e-11)
    assert abs(shifted_sum - log_sum - shift) < 1e-11


def test_normaliser_is_the_sum_far_outside_the_range_of_exp() -> None:
    weights, log_sum = normalise(np.log([1.0, 2.0, 5.0]) - 5000.0)
    np.testing.assert_allclose(weights, [0.125, 0.25, 0.625], rtol=ROUNDING)
    assert log_sum == pytest.approx(np.log(8.0) - 5000.0, rel=ROUNDING)


def test_minus_infinity_is_a_weight_of_zero() -> None:
    weights, log_sum = normalise(np.array([-np.inf, 0.0, -np.inf]))
    np.testing.assert_array_equal(weights, [0.0, 1.0, 0.0])
    assert log_sum == 0.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([-np.inf, -np.inf], "no particle explains the observation"),
        ([0.0, np.nan], "log-weights are NaN, found 1 of 2"),
        ([-np.inf, np.nan], "log-weights are NaN"),
        ([0.0, np.inf], "log-weights are infinite, found 1 of 2"),
        ([], "invalid weights"),
        ([[0.0]], "invalid weights"),
    ],
)
def test_weights_without_meaning_are_an_error_not_a_zero(values: list, message: str) -> None:
    with pytest.raises(FilterError, match=message) as caught:
        normalise(np.array(values))
    assert isinstance(caught.value, PosetrackError)


@relaxed
@given(log_weights)
def test_effective_sample_size_lies_between_one_and_n(values: np.ndarray) -> None:
    size = effective_count(normalise(values)[0])
    assert 1.0 - ROUNDING <= size <= values.size * (1.0 + ROUNDING)


@relaxed
@given(log_weights, st.randoms())
def test_effective_sample_size_does_not_depend_on_order_or_scale(values: np.ndarray, random) -> None:
    order = list(range(values.size))
    random.shuffle(order)
    assert effective_count(normalise(values[order] + 3.0)[0]) == pytest.approx(
        effective_count(normalise(values)[0]), rel=1e-11
    )


@relaxed
@given(st.integers(1, 40), st.integers(0, 40))
def test_effective_sample_size_counts_equal_weights_and_ignores_zeros(count: int, zeros: int) -> None:
    values = np.r_[np.zeros(count), np.full(zeros, -np.inf)]
    assert effective_count(normalise(values)[0]) == pytest.approx(count, rel=ROUNDING)


@relaxed
@given(log_weights)
def test_copying_every_particle_doubles_the_effective_sample_size(values: np.ndarray) -> None:
    doubled = effective_count(normalise(np.r_[values, values])[0])
    assert doubled == pytest.approx(2.0 * effective_count(normalise(values)[0]), rel=ROUNDING)


def test_effective_count_is_that_of_normalised_weights() -> None:
    assert effective_count(np.array([0.5, 0.5, 0.0])) == 2.0


@relaxed
@given(log_weights)
def test_truncated_weights_sum_to_one_and_keep_their_order(values: np.ndarray) -> None:
    weights = normalise(values)[0]
    cut = truncated(weights)
    assert abs(cut.sum() - 1.0) < ROUNDING
    assert np.all(np.diff(cut[np.argsort(weights)]) >= 0.0)


@relaxed
@given(log_weights)
def test_truncated_weights_are_equal_at_the_limit_and_in_proportion_below(values: np.ndarray) -> None:
    """After scaling by 1 / s the limit is limit / s, where s is what the cut left."""
    weights = normalise(values)[0]
    limit = (1.0 + TRUNCATION * weights.size ** (2.0 / 3.0)) * weights.mean()
    cut, over = truncated(weights), weights > limit
    left = limit * over.sum() + weights[~over].sum()
    np.testing.assert_allclose(cut[~over] * left, weights[~over], rtol=ROUNDING)
    np.testing.assert_allclose(cut[over] * left, limit, rtol=ROUNDING)


@relaxed
@given(log_weights)
def test_truncation_never_loses_effective_particles(values: np.ndarray) -> None:
    weights = normalise(values)[0]
    assert effective_count(truncated(weights)) >= effective_count(weights) * (1.0 - ROUNDING)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 80, 1000])
def test_equal_weights_stay_as_they_are(count: int) -> None:
    np.testing.assert_allclose(truncated(np.full(count, 1.0 / count)), 1.0 / count, rtol=ROUNDING)


def test_truncated_weights_of_eight() -> None:
    """The limit is 1 / 8 + 0.06 / 2 = 0.155 before scaling: 0.7 becomes 0.155, and the sum 0.455."""
    found = truncated(np.array([0.7, 0.1, 0.15, 0.05, 0.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(found, np.array([155, 100, 150, 50, 0, 0, 0, 0]) / 455.0)
