"""Downsampling keeps what can be seen: extremes, ends, missing values."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.evaluation.html.packing import envelope_rows, step_for

VALUES = st.lists(
    st.one_of(st.floats(-1e6, 1e6), st.just(float("nan")), st.just(float("inf"))), min_size=1, max_size=400
)


@given(VALUES, st.integers(5, 60))
def test_extremes_and_ends_are_kept_and_the_limit_holds(values: list[float], limit: int) -> None:
    line = np.array(values)
    rows = envelope_rows(line[None], limit)
    assert np.all(np.diff(rows) > 0)
    assert rows[0] == 0 and rows[-1] == len(line) - 1
    assert len(rows) <= max(limit, 5)
    finite, kept = line[np.isfinite(line)], line[rows][np.isfinite(line[rows])]
    if finite.size:
        assert kept.max() == finite.max() and kept.min() == finite.min()
    assert np.isfinite(line).all() == np.isfinite(line[rows]).all()


def interval_extremes(line: np.ndarray[Any, Any], size: int) -> set[int]:
    """Rows that have to be kept of a line, one interval after the other."""
    rows = {0, len(line) - 1}
    for start in range(0, len(line), size):
        part = line[start : start + size]
        known = [i for i in range(len(part)) if np.isfinite(part[i])]
        if known:
            rows |= {start + min(known, key=lambda i: part[i]), start + max(known, key=lambda i: part[i])}
        rows |= {start + i for i in list(np.flatnonzero(~np.isfinite(part)))[:1]}
    return rows


@pytest.mark.parametrize("seed", range(40))
def test_of_every_interval_exactly_the_extremes_and_the_first_missing_row_are_kept(seed: int) -> None:
    """Against a loop: lines far longer than the limit, rows or a whole stretch of which may be missing."""
    rng = np.random.default_rng(seed)
    count, limit, number = int(rng.integers(300, 1200)), int(rng.integers(12, 90)), int(rng.integers(1, 4))
    lines = rng.standard_normal((number, count))
    lines[0, rng.random(count) < (0.0, 0.3)[seed % 2]] = np.nan
    lines[-1, 100:200] = (np.inf, 0.0)[seed // 2 % 2]
    rows = envelope_rows(lines, limit)
    gappy = int((~np.isfinite(lines)).any(axis=1).sum())
    size = math.ceil(count / max(1, (limit - 2) // (2 * number + gappy)))
    assert set(rows.tolist()) == set().union(*(interval_extremes(line, size) for line in lines))
    assert np.all(np.diff(rows) > 0)
    assert len(rows) <= max(limit, 3 * number + 2)


@given(VALUES, st.integers(5, 60))
def test_a_short_line_is_kept_whole(values: list[float], limit: int) -> None:
    rows = envelope_rows(np.array(values)[None], limit)
    if len(values) <= limit:
        assert rows.tolist() == list(range(len(values)))


def test_every_interval_keeps_its_own_peak() -> None:
    line = np.zeros(1000)
    peaks = np.arange(5, 1000, 100)
    line[peaks] = 1.0 + np.arange(10)
    rows = envelope_rows(line[None], 32)  # ten intervals of 100
    assert set(peaks) <= set(rows)
    assert len(rows) <= 32


def test_each_of_several_lines_keeps_its_peaks() -> None:
    lines = np.zeros((2, 500))
    lines[0, 123], lines[1, 321] = 7.0, -7.0
    assert {123, 321} <= set(envelope_rows(lines, 50))


def test_where_values_are_missing_a_row_without_value_is_kept() -> None:
    line = np.arange(300.0)
    line[105:108] = np.nan
    rows = envelope_rows(line[None], 30)  # intervals of 34: one of them holds all three
    assert rows[np.isnan(line[rows])].tolist() == [105]


@pytest.mark.parametrize(
    ("count", "limit", "step"), [(10, 10, 1), (11, 10, 2), (100_000, 2500, 40), (0, 5, 1)]
)
def test_every_kth_row_is_no_more_than_the_limit(count: int, limit: int, step: int) -> None:
    assert step_for(count, limit) == step
    assert len(range(0, count, step)) <= limit
