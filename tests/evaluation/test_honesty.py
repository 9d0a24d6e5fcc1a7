"""Confidence against what is right: brute force over pairs, other people's code, laws, examples by hand."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.measuring.honesty import (
    MOST_THRESHOLDS,
    JudgedFrames,
    brier_score,
    calibration_error,
    pooled_frames,
    reliability,
    roc_area,
    roc_curve,
)
from support.metrics import relaxed

EXACT = 1e-12
"""Sums of a hundred terms of order 1, in doubles."""


def brute_force(confidence: FloatArray, right: BoolArray) -> float:
    pairs = list(product(confidence[right], confidence[~right]))
    return sum(1.0 if a > b else 0.5 if a == b else 0.0 for a, b in pairs) / len(pairs)


@st.composite
def judged_confidences(draw: st.DrawFn) -> tuple[FloatArray, BoolArray]:
    """Confidences with ties, of at least one right and one wrong frame."""
    levels = draw(st.sampled_from([2, 10, 1000]))
    right = [True, False, *draw(st.lists(st.booleans(), max_size=60))]
    steps = draw(st.lists(st.integers(0, levels), min_size=len(right), max_size=len(right)))
    return np.array(steps) / levels, np.array(right)


@relaxed
@given(judged_confidences())
def test_the_roc_area_is_the_share_of_pairs_in_order(frames: tuple[FloatArray, BoolArray]) -> None:
    confidence, right = frames
    area = roc_area(confidence, right)
    assert area == pytest.approx(brute_force(confidence, right), abs=EXACT)
    statistic = stats.mannwhitneyu(confidence[right], confidence[~right]).statistic
    assert area == pytest.approx(statistic / (right.sum() * (~right).sum()), abs=EXACT)


@relaxed
@given(judged_confidences())
def test_only_the_order_of_confidences_counts(frames: tuple[FloatArray, BoolArray]) -> None:
    confidence, right = frames
    area = roc_area(confidence, right)
    assert roc_area(np.exp(3.0 * confidence) - 7.0, right) == area
    assert roc_area(-confidence, right) == pytest.approx(1.0 - area, abs=EXACT)
    assert roc_area(confidence, ~right) == pytest.approx(1.0 - area, abs=EXACT)


@relaxed
@given(judged_confidences())
def test_the_curve_has_the_area_and_ends_where_nothing_is_dropped(
    frames: tuple[FloatArray, BoolArray],
) -> None:
    confidence, right = frames
    curve = roc_curve(confidence, right)
    assert curve is not None
    assert np.trapezoid(curve.right_kept, curve.wrong_kept) == pytest.approx(brute_force(confidence, right))
    assert (curve.confidence[0], curve.right_kept[0], curve.wrong_kept[0]) == (np.inf, 0.0, 0.0)
    assert (curve.confidence[-1], curve.right_kept[-1], curve.wrong_kept[-1]) == (confidence.min(), 1.0, 1.0)
    for least, kept, wrongly in zip(curve.confidence, curve.right_kept, curve.wrong_kept, strict=True):
        assert kept == pytest.approx((confidence[right] >= least).mean(), abs=EXACT)
        assert wrongly == pytest.approx((confidence[~right] >= least).mean(), abs=EXACT)


def test_a_long_curve_is_thinned_and_keeps_its_area() -> None:
    rng = np.random.default_rng(0)
    right = rng.random(20_000) < 0.7
    confidence = np.clip(rng.normal(0.5 + 0.2 * right, 0.15), 0.0, 1.0)
    curve = roc_curve(confidence, right)
    assert curve is not None and len(curve.confidence) == MOST_THRESHOLDS + 1
    assert (curve.right_kept[-1], curve.wrong_kept[-1]) == (1.0, 1.0)
    area = np.trapezoid(curve.right_kept, curve.wrong_kept)
    # a chord cuts off less than an eighth of its step in x times its step in y: 200 steps of 1 / 200 each
    assert area == pytest.approx(roc_area(confidence, right), abs=1.0 / MOST_THRESHOLDS)


def test_ties_alone_are_a_half_and_frames_of_one_kind_unknown() -> None:
    right = np.array([True, False, True])
    assert roc_area(np.ones(3), right) == 0.5
    assert roc_area(np.array([1.0, 0.0, 0.5]), right) == 1.0
    assert roc_area(np.array([0.0, 1.0, 0.5]), right) == 0.0
    for same in (right | True, right & False):
        assert np.isnan(roc_area(np.ones(3), same)) and roc_curve(np.ones(3), same) is None


def test_brier_score_bins_and_calibration_error_by_hand() -> None:
    confidence, right = np.array([0.0, 0.05, 0.1, 0.95, 1.0]), np.array([False, True, False, True, False])
    assert brier_score(confidence, right) == pytest.approx((0.0 + 0.9025 + 0.01 + 0.0025 + 1.0) / 5)
    bins = reliability(confidence, right)
    assert [one.count for one in bins] == [2, 1, 0, 0, 0, 0, 0, 0, 0, 2]
    assert (bins[0].low, bins[0].high, bins[9].high) == (0.0, 0.1, 1.0)
    assert (bins[0].confidence, bins[0].right) == (pytest.approx(0.025), 0.5)
    assert (bins[9].confidence, bins[9].right) == (pytest.approx(0.975), 0.5)
    assert np.isnan(bins[5].right) and np.isnan(bins[5].confidence)
    assert calibration_error(bins) == pytest.approx((2 * 0.475 + 1 * 0.1 + 2 * 0.475) / 5)
    nothing = np.empty(0)
    assert np.isnan(brier_score(nothing, nothing > 0))
    assert np.isnan(calibration_error(reliability(nothing, nothing > 0)))


def test_a_confidence_that_is_the_probability_is_found_calibrated() -> None:
    rng = np.random.default_rng(1)
    count = 50_000
    confidence = rng.random(count)
    right = rng.random(count) < confidence
    # a bin of n frames: sd of a share at most 1 / (2 sqrt n), of which the error takes the mean size
    assert calibration_error(reliability(confidence, right)) < 4.0 * 0.5 / np.sqrt(count / 10)
    # E c (1 - c) = 1 / 6, the sd of c (1 - c) and of the squares below 1 / 2
    assert brier_score(confidence, right) == pytest.approx(1.0 / 6.0, abs=4.0 * 0.5 / np.sqrt(count))
    sure = np.where(confidence < 0.5, 0.0, 1.0)  # says more than it knows: a quarter more in each half
    assert calibration_error(reliability(sure, right)) == pytest.approx(0.25, abs=4.0 * 0.5 / np.sqrt(count))


def test_pooled_frames_are_those_of_all() -> None:
    def frames(confidence: list[float], words: str) -> JudgedFrames:
        stated = np.array(confidence)
        return JudgedFrames(stated, stated > 0.5, stated < 0.1, stated < 0.3, words, "far")

    one, other = frames([0.9, 0.0, np.nan], "a"), frames([0.2], "b")
    both = pooled_frames([one, other])
    np.testing.assert_array_equal(both.confidence, [0.9, 0.0, np.nan, 0.2])
    assert both.right.tolist() == [True, False, False, False] and both.far.tolist() == [
        False,
        True,
        False,
        False,
    ]
    assert both.lost.tolist() == [False, True, False, True]
    assert (both.right_if, both.far_if) == ("a / b", "far")
    confidence, right = both.scored
    assert confidence.tolist() == [0.9, 0.0, 0.2] and right.tolist() == [True, False, False]
