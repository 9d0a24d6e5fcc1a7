"""Pairs by stamps against greedy choice by brute force, and the laws that it keeps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.arrays import IntArray
from posetrack_cli.errors import ResultError
from posetrack_cli.evaluation.reading.tracks import associate, check_stamps, nearest_rows

NS_PER_MS = 1_000_000
FRAME_NS = 33_333_333
stamps = st.lists(st.integers(-40, 60), unique=True, max_size=25).map(sorted)
"""So few values that most stamps have several near ones, equal ones, and ties."""
tolerances = st.integers(0, 30)


def as_stamps(values: list[int]) -> IntArray:
    return np.array(values, dtype=np.int64)


def paired(estimate: list[int], truth: list[int], tolerance: int) -> list[tuple[int, int]]:
    pairs = associate(as_stamps(estimate), as_stamps(truth), tolerance)
    return list(zip(pairs.estimate.tolist(), pairs.truth.tolist(), strict=True))


def greedy(estimate: list[int], truth: list[int], tolerance: int) -> list[tuple[int, int]]:
    """Every pair within the tolerance, sorted by difference, then by when; taken if it is free.

    Free: neither stamp is taken, and no taken pair has the two in the other order.
    """
    every = [(abs(e - t), e + t, i, j) for i, e in enumerate(estimate) for j, t in enumerate(truth)]
    taken: list[tuple[int, int]] = []
    for difference, _, i, j in sorted(every):
        if difference <= tolerance and all((i - k) * (j - m) > 0 for k, m in taken):
            taken.append((i, j))
    return sorted(taken)


@settings(deadline=None)
@given(stamps, stamps, tolerances)
def test_the_choice_is_greedy(estimate: list[int], truth: list[int], tolerance: int) -> None:
    assert paired(estimate, truth, tolerance) == greedy(estimate, truth, tolerance)


@settings(deadline=None)
@given(stamps, stamps, tolerances)
def test_one_to_one_in_order_and_within_the_tolerance(
    estimate: list[int], truth: list[int], tolerance: int
) -> None:
    pairs = paired(estimate, truth, tolerance)
    for rows in zip(*pairs, strict=True):
        assert list(rows) == sorted(set(rows))
    assert all(abs(estimate[i] - truth[j]) <= tolerance for i, j in pairs)


@settings(deadline=None)
@given(stamps, stamps, tolerances)
def test_swapping_the_arguments_swaps_the_pairs(
    estimate: list[int], truth: list[int], tolerance: int
) -> None:
    swapped = sorted((i, j) for j, i in paired(truth, estimate, tolerance))
    assert paired(estimate, truth, tolerance) == swapped


@settings(deadline=None)
@given(stamps, stamps, tolerances)
def test_equal_stamps_are_always_paired(estimate: list[int], truth: list[int], tolerance: int) -> None:
    pairs = paired(estimate, truth, tolerance)
    equal = {(estimate.index(stamp), truth.index(stamp)) for stamp in set(estimate) & set(truth)}
    assert equal <= set(pairs)


@settings(deadline=None)
@given(st.data(), st.integers(1, 60))
def test_jitter_below_the_tolerance_and_missing_frames_change_no_pair(
    data: st.DataObject, frames: int
) -> None:
    tolerance = 5 * NS_PER_MS
    jitter = data.draw(st.lists(st.integers(-tolerance, tolerance), min_size=frames, max_size=frames))
    kept = data.draw(st.lists(st.booleans(), min_size=frames, max_size=frames))
    due = data.draw(st.lists(st.booleans(), min_size=frames, max_size=frames))
    estimated = [i for i in range(frames) if kept[i]]
    true = [i for i in range(frames) if due[i]]
    pairs = paired([i * FRAME_NS + jitter[i] for i in estimated], [i * FRAME_NS for i in true], tolerance)
    assert [(estimated[i], true[j]) for i, j in pairs] == [(i, i) for i in estimated if due[i]]


def test_ties_go_to_the_earlier_pair_along_a_whole_chain() -> None:
    estimate, truth = list(range(0, 2000, 2)), list(range(1, 2001, 2))
    assert paired(estimate, truth, 1) == [(i, i) for i in range(1000)]
    assert paired(truth, estimate, 1) == [(i, i) for i in range(1000)]
    assert paired([10], [9, 11], 5) == [(0, 0)]


def test_the_nearest_takes_before_the_earlier() -> None:
    # 110 is within reach of both, but 112 is nearer; 100 then takes what is left in reach
    assert paired([100, 112], [110], 20) == [(1, 0)]
    assert paired([100, 112], [85, 110], 20) == [(0, 0), (1, 1)]
    assert paired([100, 112], [85, 110], 10) == [(1, 1)]


def test_stamps_of_our_time_do_not_overflow_and_keep_their_nanoseconds() -> None:
    late = 2**63 - 1
    assert paired([late - 3, late], [late - 2, late - 1], 1) == [(0, 0), (1, 1)]
    assert paired([late - 3, late], [late - 5, late - 2], 1) == [(0, 1)]


def test_the_later_estimate_never_gets_the_earlier_truth() -> None:
    assert paired([0, 10], [-10, 0], 20) == [(0, 1)]


@pytest.mark.parametrize(("estimate", "truth"), [([], []), ([1], []), ([], [1])])
def test_nothing_pairs_with_nothing(estimate: list[int], truth: list[int]) -> None:
    assert paired(estimate, truth, 10) == []


@pytest.mark.parametrize(
    ("estimate", "truth", "message"),
    [
        ([1, 2, 2, 3], [1], "estimate, row 2: duplicate stamp, found 2 ns after 2 ns"),
        ([1], [5, 9, 7, 6], "truth, row 2: stamps are not sorted, found 7 ns after 9 ns"),
    ],
)
def test_stamps_that_do_not_increase_are_refused(estimate: list[int], truth: list[int], message: str) -> None:
    with pytest.raises(ResultError, match=message):
        paired(estimate, truth, 10)


def test_the_source_with_the_fault_is_named() -> None:
    with pytest.raises(ResultError, match=r"run-7\.mcap, row 1: duplicate stamp"):
        check_stamps(as_stamps([4, 4]), "run-7.mcap")


@settings(deadline=None)
@given(stamps, stamps.filter(bool))
def test_nearest_rows_by_brute_force(values: list[int], others: list[int]) -> None:
    expected = [min(range(len(others)), key=lambda j: (abs(others[j] - v), j)) for v in values]
    assert nearest_rows(as_stamps(values), as_stamps(others)).tolist() == expected
