"""What is kept of values for pooling, against the values themselves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.evaluation.measuring.evaluation import (
    FEWEST_TO_MERGE,
    SMALLEST,
    STEP,
    Collected,
    Distribution,
    Statistics,
    distribution,
    merged,
    statistics,
)

WIDTH = float(np.expm1(STEP))
"""How far two values of one bin may be apart, a share."""
VALUES = st.lists(st.floats(-1e9, 1e9, allow_subnormal=False), min_size=1, max_size=30)


def kept(values: object) -> Distribution:
    array = np.asarray(values, dtype=np.float64)
    return distribution(array, statistics(array))


def together(*samples: object) -> Statistics:
    return merged([kept(one) for one in samples]).statistics()


def assert_as_all_at_once(*samples: list[float]) -> None:
    every = np.concatenate([np.asarray(one) for one in samples])
    found, brute = together(*samples), statistics(every)
    assert (found.count, found.max) == (brute.count, brute.max)
    largest = float(np.abs(every).max())
    rounding = 1e-9 * largest  # of sums of numbers of either sign, which may cancel
    assert found.mean == pytest.approx(brute.mean, rel=1e-9, abs=rounding)
    assert found.sd == pytest.approx(brute.sd, rel=1e-6, abs=rounding)
    for name in ("p5", "median", "p95"):
        limit = WIDTH * largest + SMALLEST  # between values of either sign the larger one's bin counts
        assert getattr(found, name) == pytest.approx(getattr(brute, name), abs=limit)


@given(st.lists(VALUES, min_size=1, max_size=5))
def test_sets_together_are_as_all_values_at_once(samples: list[list[float]]) -> None:
    assert_as_all_at_once(*samples)


@given(st.lists(st.floats(0.01, 1000.0), min_size=2, max_size=60), st.integers(1, 59))
def test_percentiles_of_errors_are_off_by_less_than_a_bin(values: list[float], cut: int) -> None:
    halves = [half for half in (values[:cut], values[cut:]) if half]
    found, brute = together(*halves), statistics(values)
    for name in ("p5", "median", "p95"):
        assert getattr(found, name) == pytest.approx(getattr(brute, name), rel=WIDTH)


def test_values_that_occur_often_are_told_exactly() -> None:
    found = together([1.0] * 9, [1.0, 1.0, 0.25])
    assert (found.median, found.p95, found.max) == (1.0, 1.0, 1.0)


def test_a_nan_makes_every_figure_nan() -> None:
    found = together([1.0, 2.0], [3.0, float("nan")])
    assert found.count == 4 and all(np.isnan([found.mean, found.sd, found.median, found.p95, found.max]))


def test_an_infinite_value_is_the_largest_and_leaves_the_percentiles_below() -> None:
    """As of values at once: a NEES with next to no variance must not make the median infinite."""
    samples = ([1.0, 2.0, 3.0], [4.0, float("inf")])
    found, brute = together(*samples), statistics(np.concatenate(samples))
    assert found.mean == found.max == np.inf and np.isnan(found.sd)
    assert found.median == brute.median == 3.0 and found.p95 == brute.p95 == np.inf


def test_squares_of_huge_values_do_not_overflow() -> None:
    assert together([1e200, 3e200], [1e200, 3e200]).sd == pytest.approx(1e200)


def test_what_is_kept_does_not_grow_with_the_number_of_results() -> None:
    rng = np.random.default_rng(1)
    collected, brute = Collected(), []
    for _ in range(200):
        brute.append(rng.gamma(2.0, 4.0, 6000))
        collected.add(kept(brute[-1]))
        assert sum(len(one.bins) for one in collected._waiting) < 2 * FEWEST_TO_MERGE
    assert collected.members == 200
    found, expected = collected.total().statistics(), statistics(brute)
    assert found.mean == pytest.approx(expected.mean, rel=1e-12)
    assert found.p95 == pytest.approx(expected.p95, rel=WIDTH)
