"""Results of one recording beside each other: blocks of one second, and what the test then says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

import posetrack_cli.evaluation.judging.comparing as paired_module
from posetrack_cli.evaluation.judging.comparing import (
    block_means,
    compare,
    lag_one_correlation,
    paired,
    paired_blocks,
)
from support.evaluation import hand_evaluation
from support.tracks import FRAME_NS

SECOND = 1_000_000_000
RUN = {"tracker": "hand", "seed": "1", "input.sha256": "aa"}


def series(name: str, values: np.ndarray, stamps: np.ndarray | None = None, run: dict[str, str] = RUN):
    stamps = np.arange(len(values), dtype=np.int64) * FRAME_NS if stamps is None else stamps
    return hand_evaluation(
        name, 3, run=run, series={"joint_error_mm": np.asarray(values)}, series_stamp_ns=stamps
    )


def test_blocks_are_seconds_from_the_first_stamp_and_empty_ones_are_none() -> None:
    stamps = np.array([5.0, 5.4, 5.999, 6.0, 9.1, 9.2]) * SECOND
    means = block_means(stamps.astype(np.int64), np.array([1.0, 2.0, 6.0, 10.0, 4.0, 8.0]))
    assert means.tolist() == [3.0, 10.0, 6.0]


def test_no_frames_are_no_blocks() -> None:
    assert block_means(np.empty(0, dtype=np.int64), np.empty(0)).tolist() == []


@given(st.lists(st.integers(0, 20 * SECOND), min_size=1, max_size=60, unique=True), st.integers(0, 10**6))
def test_block_means_by_brute_force(stamps: list[int], seed: int) -> None:
    stamp_ns = np.array(sorted(stamps), dtype=np.int64)
    values = np.random.default_rng(seed).normal(size=len(stamp_ns))
    blocks: dict[int, list[float]] = {}
    for stamp, value in zip(stamp_ns.tolist(), values, strict=True):
        blocks.setdefault((stamp - int(stamp_ns[0])) // SECOND, []).append(value)
    np.testing.assert_allclose(
        block_means(stamp_ns, values), [np.mean(v) for v in blocks.values()], atol=1e-12
    )


def test_only_frames_with_a_figure_in_both_are_paired() -> None:
    first = np.array([1, 2, 3, 4]) * (SECOND // 10)
    second = np.array([2, 3, 4, 5, 6]) * (SECOND // 10)
    blocks = paired_blocks(
        first, np.array([9.0, 1.0, 2.0, np.nan]), second, np.array([5.0, 7.0, 1.0, 0.0, 0.0])
    )
    assert (blocks.first.tolist(), blocks.second.tolist()) == ([1.5], [6.0])
    # of the six frames 1 to 6 two are compared; 1, 5 and 6 are in one only, 4 has no figure in one
    assert (blocks.frames, blocks.left_out) == (2, 4)


def walks(count: int, frames: int, phi: float, seed: int) -> np.ndarray:
    """(count, frames) AR(1) series of mean 0 and sd 1: d_t = phi d_{t-1} + sqrt(1 - phi^2) e_t."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(count, frames)) * np.sqrt(1 - phi**2)
    noise[:, 0] = rng.normal(size=count)
    from scipy.signal import lfilter  # a third of a second that every process would take to read the tests

    return np.asarray(lfilter([1.0], [1.0, -phi], noise))


def test_frames_that_err_alike_are_no_independent_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two trackers with equal mean error, differences AR(1) with phi = 0.8 (0.15 s at 30 frames/s).

    Over n frames the mean's sd is sqrt((1 + phi) / (1 - phi)) = 3 times what independence would give, so a
    test at 5 % over frames rejects in 2 Phi(-1.96 / 3) = 51 % of cases. Means of blocks of b = 30 frames have
    the neighbour correlation r = phi (1 - phi^b)^2 / (b (1 - phi^2) - 2 phi (1 - phi^b)) = 0.087, so that
    over blocks it rejects in 2 Phi(-1.96 / sqrt(1 + 2 r)) = 7.0 %. The counts are binomial: four of
    their sds.
    """
    monkeypatch.setattr(paired_module, "_interval", lambda differences, seed: (0.0, 0.0))  # not looked at
    count, frames, phi, b = 300, 1800, 0.8, 30
    # b frames in each second, to the nanosecond
    stamps = np.arange(frames, dtype=np.int64) * (SECOND // b) + np.arange(frames) // b * (SECOND % b)
    differences = walks(count, frames, phi, seed=11)
    by_frame = sum(paired(np.zeros(frames), d).p_value < 0.05 for d in differences)
    by_second = sum(paired(np.zeros(frames // b), block_means(stamps, d)).p_value < 0.05 for d in differences)
    r = phi * (1 - phi**b) ** 2 / (b * (1 - phi**2) - 2 * phi * (1 - phi**b))
    for found, share in (
        (by_frame, 2 * norm.cdf(-1.96 / np.sqrt((1 + phi) / (1 - phi)))),
        (by_second, 2 * norm.cdf(-1.96 / np.sqrt(1 + 2 * r))),
    ):
        assert abs(found - count * share) < 4 * np.sqrt(count * share * (1 - share))


def test_neighbours_that_are_alike_are_noticed() -> None:
    """An AR(1) series has the correlation phi; its estimate's sd is about sqrt((1 - phi^2) / n) = 0.019."""
    assert abs(lag_one_correlation(walks(1, 1000, 0.8, seed=3)[0]) - 0.8) < 4 * 0.019
    independent = [lag_one_correlation(walk) for walk in walks(200, 100, 0.0, seed=4)]
    # one-sided: Phi(-2) = 2.3 % of 200 are above 2 / sqrt(n), sd 2.1
    assert sum(r > 0 for r in independent) < 5 + 4 * 2.1
    assert lag_one_correlation(np.ones(50)) == lag_one_correlation(np.arange(7.0)) == 0.0
    assert lag_one_correlation(np.empty(0)) == 0.0


def test_the_difference_is_that_of_the_second_s_means() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(5.0, 1.0, 300), rng.normal(4.0, 1.0, 300)
    comparison = compare([series("a", a), series("b", b)])
    assert comparison is not None and comparison.unit == "one second of a recording"
    (difference,) = comparison.differences
    assert (difference.figure, difference.first, difference.second) == ("joint_error_mm", "a", "b")
    seconds = np.arange(300) * FRAME_NS // SECOND
    means = [[series[seconds == s].mean() for s in range(seconds.max() + 1)] for series in (a, b)]
    expected, found = paired(*means), difference.paired
    assert found.count == expected.count == 10
    assert (found.difference, found.p_value) == pytest.approx((expected.difference, expected.p_value), 1e-12)
    # the interval's correction counts resamples below the mean: rounding may move one of 9999 across
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), 1e-3)


def test_each_is_compared_with_the_first_of_its_recording() -> None:
    other = {**RUN, "input.sha256": "bb"}
    values = np.arange(90.0)
    results = [
        series("a", values),
        series("x", values, run=other),
        series("b", values + 1),
        series("y", values, run=other),
        series("c", values),
        series("alone", values, run={**RUN, "input.sha256": "cc"}),
        series("unknown", values, run={}),
        series("unknown too", values, run={}),
    ]
    comparison = compare(results)
    assert comparison is not None
    assert [(d.first, d.second) for d in comparison.differences] == [("a", "b"), ("a", "c"), ("x", "y")]
    assert "no other result of the same recording: alone, unknown, unknown too" in comparison.notes


def test_results_of_different_recordings_are_not_compared() -> None:
    results = [series("a", np.arange(9.0)), series("b", np.arange(9.0), run={**RUN, "input.sha256": "bb"})]
    assert compare(results) is None and compare(results[:1]) is None and compare([]) is None


def test_results_without_a_common_frame_say_so() -> None:
    later = np.arange(9, dtype=np.int64) * FRAME_NS + 60 * SECOND
    comparison = compare([series("a", np.arange(9.0)), series("b", np.arange(9.0), later)])
    assert comparison is not None
    assert comparison.differences[0].paired.count == 0
    assert comparison.differences[0].note == "no pairs; 18 frames without a value in both are left out"


def test_errors_that_last_are_pointed_out() -> None:
    slow = np.repeat(walks(1, 60, 0.95, seed=2)[0], 30)
    stamps = np.arange(1800, dtype=np.int64) * (SECOND // 30)
    comparison = compare([series("a", np.zeros(1800), stamps), series("b", slow, stamps)])
    assert comparison is not None
    assert "consecutive seconds are correlated" in comparison.differences[0].note
