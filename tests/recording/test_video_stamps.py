"""Stamps of a video's frames: their own where they are in order, and going on where they begin anew."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.recording.stamps import MAX_REORDERED, VideoStamps

PERIOD = 33


def stamps(told: list[int]) -> list[int]:
    made = VideoStamps(PERIOD)
    return [made.stamp(one) for one in told]


@given(st.sets(st.integers(0, 10**12)).map(sorted))
def test_stamps_in_order_are_the_video_s_own(told: list[int]) -> None:
    assert stamps(told) == told


def test_a_frame_out_of_place_keeps_its_stamp_and_moves_no_other() -> None:
    assert stamps([0, 33, 7200, 7233, 5133, 7266]) == [0, 33, 7200, 7233, 5133, 7266]
    assert stamps([0, 33, 33, 40, 66]) == [0, 33, 33, 40, 66]


def test_stamps_that_are_not_told_go_on_at_the_rate() -> None:
    assert stamps([0, 0, 0, 0]) == [0, 33, 66, 99]
    assert stamps([-5, 28, 61]) == [0, 33, 66]
    rateless = VideoStamps(0)
    assert [rateless.stamp(0) for _ in range(3)] == [0, 1, 2]


def test_stamps_that_begin_anew_go_on() -> None:
    again = [0, 20, 70, 100]
    assert stamps([*again, *again]) == [*again, *(133 + one for one in again)]


def test_stamps_that_stay_behind_go_on_after_as_many_as_decoders_hold_back() -> None:
    behind = [50 + 10 * k for k in range(MAX_REORDERED + 3)]
    found = stamps([0, 5000, *behind])[2:]
    assert found[:MAX_REORDERED] == behind[:MAX_REORDERED]
    assert found[MAX_REORDERED:] == [5033, 5043, 5053]
