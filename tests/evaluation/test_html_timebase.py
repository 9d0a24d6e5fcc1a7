"""Times and spans of a page."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.evaluation.html.page_data import MOST_SPANS, TICK_NS, gap_spans, state_spans, timebases
from posetrack_cli.evaluation.measuring.measures import Measures
from posetrack_cli.evaluation.measuring.without_truth import consistency_metrics
from posetrack_cli.evaluation.reading.tracks import Track
from support.tracks import hand_track

SECOND = 1_000_000_000


def track_at(*seconds: float) -> Track:
    stamps = np.array([round(s * SECOND) for s in seconds], dtype=np.int64)
    return dataclasses.replace(hand_track("t", 0, 0.0), stamp_ns=stamps)


def test_results_of_one_time_share_an_origin() -> None:
    bases, shared = timebases([track_at(10.0, 12.0), track_at(9.5, 11.0), track_at()])
    assert shared
    assert {base.origin_ns for base in bases} == {round(9.5 * SECOND)}
    assert bases[0].seconds(np.array([12 * SECOND])).tolist() == pytest.approx([2.5])


def test_results_without_common_time_begin_at_zero_each() -> None:
    bases, shared = timebases([track_at(10.0, 12.0), track_at(1e9, 1e9 + 1)])
    assert not shared
    assert [base.origin_ns for base in bases] == [10 * SECOND, 10**9 * SECOND]


def test_no_frames_at_all() -> None:
    bases, shared = timebases([track_at()])
    assert shared and bases[0].tick_ns == TICK_NS


def test_ticks_of_a_year_still_fit_into_31_bits() -> None:
    year = track_at(0.0, 366 * 86400.0)
    base = timebases([year])[0][0]
    assert base.ticks(year.stamp_ns)[-1] < 2**31
    assert base.tick_ns > TICK_NS


def test_gaps_are_what_the_metric_counts() -> None:
    track = track_at(0.0, 0.1, 0.2, 0.5, 0.6, 0.74, 0.9, 1.0)
    stamps = track.stamp_ns
    assert (gap_spans(stamps) / SECOND).tolist() == [[0.2, 0.5], [0.74, 0.9]]
    alone = dataclasses.replace(track, points=None, position=None, cost=None, confidence=None)
    measures = Measures("")
    consistency_metrics(measures, alone)
    assert measures.metrics["gaps"] == 2.0
    assert gap_spans(stamps[:1]).shape == (0, 2)


def test_state_spans_are_runs() -> None:
    stamps = np.arange(7, dtype=np.int64)
    holds = np.array([True, True, False, False, True, False, True])
    assert state_spans(stamps, holds).tolist() == [[0, 1], [4, 4], [6, 6]]
    assert state_spans(stamps, ~holds).tolist() == [[2, 3], [5, 5]]
    assert state_spans(stamps, np.zeros(7, dtype=np.bool_)).shape == (0, 2)


@given(st.lists(st.booleans(), max_size=60))
def test_state_spans_hold_exactly_the_frames_of_the_state(values: list[bool]) -> None:
    stamps = np.arange(len(values), dtype=np.int64)
    spans = state_spans(stamps, np.array(values, dtype=np.bool_))
    covered = [i for first, last in spans for i in range(first, last + 1)]
    assert covered == [i for i, holds in enumerate(values) if holds]


def test_too_many_spans_are_merged_over_the_shortest_pauses() -> None:
    runs = MOST_SPANS + 1
    stamps = 10 * np.arange(2 * runs, dtype=np.int64)
    stamps[1002:] += 5  # every pause but one is 20 long; this one is 25
    stamps[500:] -= 3  # and this one 17: merged
    spans = state_spans(stamps, np.arange(2 * runs) % 2 == 0)
    assert len(spans) == MOST_SPANS
    assert [498 * 10, 500 * 10 - 3] in spans.tolist()
