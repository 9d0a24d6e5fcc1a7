"""Choices of frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.evaluation.viewing.frame_choice import APART_NS, chosen_rows, fewer_said, worst_rows
from support.tracks import FRAME_NS, hand_track

FRAMES = 120


def track(first: int = 0, step: int = 1) -> Track:
    """A track of every ``step``-th frame of a recording, from ``first`` on."""
    return replace(hand_track("t", FRAMES, 1.0), frame_index=first + step * np.arange(FRAMES))


@pytest.mark.parametrize(
    ("choice", "rows"),
    [
        ("all", list(range(FRAMES))),
        ("7", [7]),
        ("12,7,7", [7, 12]),
        ("0:10:5,100:", [0, 5, *range(100, FRAMES)]),
        (":3", [0, 1, 2]),
        ("117:999", [117, 118, 119]),
        ("118:" + "9" * 30, [118, 119]),
        (" 3 , 5:7 ", [3, 5, 6]),
        ("spread:1", [0]),
        ("spread:3", [0, 60, 119]),
        ("spread:999", list(range(FRAMES))),
    ],
)
def test_what_choices_name(choice: str, rows: list[int]) -> None:
    assert chosen_rows(choice, track(), None).tolist() == rows


def test_numbers_are_those_of_the_recording() -> None:
    assert chosen_rows("100:120:10", track(first=100, step=5), None).tolist() == [0, 2]


@pytest.mark.parametrize(
    "choice", ["", "x", "1-5", "3:9:0", "worst:", "worst:0", "spread:x", "1,,2", "-3", "²"]
)
def test_what_cannot_be_read_is_refused_with_what_can(choice: str) -> None:
    with pytest.raises(UsageError, match=r"invalid --select.*0:300:5.*worst:N"):
        chosen_rows(choice, track(), None)


@pytest.mark.parametrize("choice", ["120", "5,120", "300:", "9:9", "9" * 30, "9" * 30 + "::" + "9" * 30])
def test_frames_that_are_not_there_are_named(choice: str) -> None:
    with pytest.raises(UsageError, match=r"no such frame in the result, expected frames from 0 to 119"):
        chosen_rows(choice, track(), None)


def test_a_result_without_estimates_has_no_frame_to_draw() -> None:
    empty = Track("t", "hand", (), (), (), stamp_ns=np.empty(0, np.int64), frame_index=np.empty(0, np.int64))
    with pytest.raises(UsageError, match="no frame to draw"):
        chosen_rows("all", empty, None)
    assert worst_rows(empty, None, 3).tolist() == []


def test_the_worst_are_those_of_largest_error_a_second_apart() -> None:
    errors = np.zeros(FRAMES)
    errors[[10, 11, 50, 95]] = [30.0, 40.0, 20.0, 35.0]  # 30 frames a second: 10 is too near to 11
    assert worst_rows(track(), errors, 3).tolist() == [11, 95, 50]
    assert chosen_rows("worst:3", track(), errors).tolist() == [11, 50, 95], "drawn in order of time"


@pytest.mark.parametrize(
    ("choice", "found", "said"),
    [
        ("worst:8", 2, "worst:8 selects only 2 frames, as they must be 1 s apart"),
        ("worst:2", 2, ""),
        ("spread:8", 2, ""),
        ("", 9, ""),
    ],
)
def test_fewer_than_were_asked_for_are_explained(choice: str, found: int, said: str) -> None:
    assert fewer_said(choice, found) == said


def test_frames_without_truth_are_not_the_worst() -> None:
    errors = np.full(FRAMES, np.nan)
    errors[[3, 80]] = [1.0, 2.0]
    assert worst_rows(track(), errors, 5).tolist() == [80, 3]


def test_without_truth_lost_frames_are_worst_then_those_of_least_confidence() -> None:
    """As of a head with one camera, whose track tells no cost."""
    sure, lost = np.full(FRAMES, 0.9), np.zeros(FRAMES, np.bool_)
    sure[[20, 100]], sure[60], lost[60] = [0.1, 0.2], 1.0, True
    unsure = replace(track(), confidence=sure, lost=lost, cost=None)
    assert worst_rows(unsure, None, 3).tolist() == [60, 20, 100]


def test_of_frames_alike_in_confidence_those_of_highest_cost_are_worst() -> None:
    cost, lost = np.full(FRAMES, 5.0), np.zeros(FRAMES, np.bool_)
    cost[[20, 100]], cost[60], lost[60] = [30.0, 25.0], 1.0, True
    unsure = replace(track(), cost=cost, lost=lost)
    assert worst_rows(unsure, None, 3).tolist() == [60, 20, 100]
    assert worst_rows(replace(unsure, cost=np.full(FRAMES, np.nan)), None, 1).tolist() == [60]


@given(errors=arrays(np.float64, FRAMES, elements=st.floats(0, 100)), count=st.integers(1, 10))
def test_worst_frames_against_the_definition(errors: np.ndarray, count: int) -> None:
    rows = worst_rows(track(), errors, count).tolist()
    stamps = FRAME_NS * np.arange(FRAMES)
    assert 1 <= len(rows) <= count
    assert all(abs(stamps[a] - stamps[b]) >= APART_NS for a in rows for b in rows if a != b)
    assert [errors[row] for row in rows] == sorted((errors[row] for row in rows), reverse=True)
    for other in range(FRAMES):  # whatever is worse than the last one chosen lies near to one chosen before
        if errors[other] > errors[rows[-1]] or (len(rows) < count and other not in rows):
            assert any(abs(stamps[other] - stamps[row]) < APART_NS for row in rows)
