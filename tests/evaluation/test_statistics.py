"""Statistics of small sets, worked out by hand, and of sets with values that are no numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.evaluation.measuring.evaluation import statistics
from support.metrics import relaxed

VALUES = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40)


def test_a_set_by_hand() -> None:
    got = statistics([[1.0, 2.0], [3.0, 10.0]])
    assert (got.mean, got.median, got.max, got.count) == (4.0, 2.5, 10.0, 4)
    assert got.sd == pytest.approx(math.sqrt((9 + 4 + 1 + 36) / 4))
    assert got.p95 == pytest.approx(3.0 + 0.85 * 7.0)  # place 0.95 * 3 = 2.85, counted from 0
    assert got.p5 == pytest.approx(1.0 + 0.15 * 1.0)  # place 0.05 * 3 = 0.15


def test_nothing_has_no_figures() -> None:
    got = statistics([])
    assert got.count == 0
    assert all(math.isnan(value) for value in (got.mean, got.sd, got.median, got.p95, got.max, got.p5))


def test_a_nan_hides_in_no_figure() -> None:
    got = statistics([1.0, math.nan, 2.0])
    assert got.count == 3
    assert all(math.isnan(value) for value in (got.mean, got.sd, got.median, got.p95, got.max, got.p5))


@pytest.mark.parametrize(
    ("values", "median", "p95"),
    [
        ([1.0, 2.0, math.inf], 2.0, math.inf),
        ([1.0, math.inf], math.inf, math.inf),
        ([math.inf], math.inf, math.inf),
        ([*map(float, range(100)), math.inf], 50.0, 95.0),
    ],
)
def test_an_infinite_value_reaches_only_what_it_touches(
    values: list[float], median: float, p95: float
) -> None:
    got = statistics(values)
    assert (got.mean, got.max, got.median, got.p95) == (math.inf, math.inf, median, p95)
    assert math.isnan(got.sd)


@relaxed
@given(VALUES)
def test_percentiles_are_those_of_the_definition(values: list[float]) -> None:
    ordered = sorted(values)

    def at(share: float) -> float:
        place = share * (len(ordered) - 1)
        low = math.floor(place)
        high = min(low + 1, len(ordered) - 1)
        return ordered[low] + (place - low) * (ordered[high] - ordered[low])

    got = statistics(values)
    assert got.median == pytest.approx(at(0.5), rel=1e-9, abs=1e-6)
    assert got.p95 == pytest.approx(at(0.95), rel=1e-9, abs=1e-6)
    assert got.p5 == pytest.approx(at(0.05), rel=1e-9, abs=1e-6)
    assert got.max == ordered[-1]


@relaxed
@given(VALUES)
def test_the_order_of_values_does_not_matter(values: list[float]) -> None:
    got, reverse = statistics(values), statistics(values[::-1])
    assert got.median == reverse.median
    assert got.mean == pytest.approx(reverse.mean, rel=1e-9, abs=1e-6)
    assert np.sign(got.sd) >= 0


def test_squares_of_huge_values_do_not_overflow() -> None:
    """The NEES of a filter whose particles have become one divides by next to nothing."""
    found = statistics(np.array([1e200, 3e200]))
    assert found.mean == pytest.approx(2e200)
    assert found.sd == pytest.approx(1e200)
