"""Paired differences: against enumeration of all signs, known distributions, and laws."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.evaluation.judging.comparing import paired

WHOLE = st.integers(-6, 6).map(float)  # ties and zeros happen; sums of them are exact


def p_by_enumeration(differences: np.ndarray) -> float:
    """Two-sided p of the signed-rank test: share of the 2^n signs at least as extreme, ranks averaged."""
    sizes = np.abs(differences)
    ranks = np.array([(sizes < s).sum() + ((sizes == s).sum() + 1) / 2 for s in sizes])
    sums = np.array([ranks[np.array(signs)].sum() for signs in product([False, True], repeat=len(ranks))])
    observed = ranks[differences > 0].sum()
    return min(1.0, 2 * min((sums <= observed).mean(), (sums >= observed).mean()))


@settings(deadline=None, max_examples=15)
@given(st.lists(WHOLE.filter(bool), min_size=1, max_size=9))
def test_p_is_the_share_of_signs_at_least_as_extreme(values: list[float]) -> None:
    differences = np.array(values)
    p = paired(np.zeros(len(values)), differences).p_value
    # scipy's two-sided p of a permutation test doubles the smaller tail, as the enumeration does
    np.testing.assert_allclose(p, p_by_enumeration(differences), rtol=1e-9)


def test_a_textbook_example() -> None:
    """Differences 1 to 6 with signs + + + + + -: W- = 6; 14 of 64 sign sets reach 6 or less, p = 28/64."""
    result = paired(np.zeros(6), np.array([1.0, 2.0, 3.0, 4.0, 5.0, -6.0]))
    assert result.p_value == pytest.approx(28 / 64)
    assert result.difference == pytest.approx(9 / 6)


@settings(max_examples=15, deadline=None)
@given(arrays(np.float64, (2, 8), elements=WHOLE))
def test_the_two_exchanged_give_the_opposite(samples: np.ndarray) -> None:
    one, other = paired(samples[0], samples[1]), paired(samples[1], samples[0])
    assert one.difference == -other.difference
    assert (one.mean_first, one.mean_second) == (other.mean_second, other.mean_first)
    assert one.p_value == pytest.approx(other.p_value, rel=1e-12)
    assert one.low <= one.difference <= one.high


def test_pairs_that_do_not_differ_leave_the_test_and_not_the_mean() -> None:
    differences = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    with_equal = np.concatenate([differences, np.zeros(6)])
    assert paired(np.zeros(12), with_equal).p_value == paired(np.zeros(6), differences).p_value
    assert paired(np.zeros(12), with_equal).difference == pytest.approx(21 / 12)


def test_equal_samples() -> None:
    result = paired(np.arange(9.0), np.arange(9.0))
    assert (result.p_value, result.low, result.difference, result.high) == (1.0, 0.0, 0.0, 0.0)
    assert result.note == "no pair differs"


def test_a_constant_difference_has_an_interval_without_width() -> None:
    result = paired(np.arange(8.0), np.arange(8.0) + 2.0)
    assert (result.low, result.high) == (2.0, 2.0)
    assert result.p_value == pytest.approx(2 / 2**8)


@pytest.mark.parametrize(("count", "smallest"), [(1, 1.0), (5, 0.0625), (6, 0.03125)])
def test_few_pairs_say_what_p_can_be(count: int, smallest: float) -> None:
    result = paired(np.zeros(count), np.arange(1.0, count + 1))
    assert result.p_value == pytest.approx(smallest)
    said = f"too few data: p >= {smallest:g} with {count} differing pair{'s' * (count > 1)}"
    assert result.note == (said if smallest > 0.05 else "")


def test_one_pair_has_no_interval_and_none_has_nothing() -> None:
    assert np.isnan([paired([1.0], [2.0]).low, paired([1.0], [2.0]).high]).all()
    nothing = paired([], [])
    assert nothing.count == 0 and nothing.note == "no pairs"
    assert np.isnan([nothing.difference, nothing.p_value, nothing.low]).all()


@pytest.mark.parametrize(
    ("first", "second"), [([1.0], [1.0, 2.0]), ([np.nan], [1.0]), ([1.0], [np.inf]), ([[1.0]], [[1.0]])]
)
def test_what_is_no_pair_is_refused(first: list[float], second: list[float]) -> None:
    with pytest.raises(ValueError, match="paired samples"):
        paired(first, second)


def test_the_interval_holds_the_true_mean_as_often_as_it_says() -> None:
    """300 samples of 40 normal differences. The bootstrap's interval of a mean is narrower than Student's by
    about z sqrt((n - 1) / n) / t = 0.957, so it holds the mean with p = 0.943; the count's sd is
    sqrt(300 p (1 - p)) = 4.0. Four of them either way."""
    rng = np.random.default_rng(7)
    samples = rng.normal(1.5, 3.0, size=(300, 40))
    inside = sum(r.low <= 1.5 <= r.high for r in (paired(np.zeros(40), s) for s in samples))
    assert abs(inside - 300 * 0.943) < 16


def test_the_same_seed_gives_the_same_interval() -> None:
    sample = np.random.default_rng(1).normal(size=30)
    assert paired(np.zeros(30), sample, 5) == paired(np.zeros(30), sample, 5)
    assert paired(np.zeros(30), sample, 5) != paired(np.zeros(30), sample, 6)


def test_many_pairs_are_resampled_in_batches() -> None:
    """The interval of n pairs is the mean +- 1.96 sd / sqrt(n) to within the bootstrap's own noise."""
    count = 3000
    sample = np.random.default_rng(2).normal(size=count)
    result = paired(np.zeros(count), sample)
    half = 1.96 * sample.std() / np.sqrt(count)
    # the 2.5 % quantile of 9999 resamples has the standard error sqrt(0.025 * 0.975 / 9999) / 0.0584 = 0.027
    noise = 4 * 0.027 * sample.std() / np.sqrt(count)
    assert abs(result.low - (sample.mean() - half)) < noise
    assert abs(result.high - (sample.mean() + half)) < noise
