"""Counts of frames, on recordings short enough to count by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.evaluation.reading.tracks import Coverage, Track, associate, measure_coverage

MS = 1_000_000
FRAME_NS = 33_333_333
TOLERANCE_NS = 5 * MS


def track_at(stamps: list[int], lost: tuple[int, ...] = (), reinitialised: tuple[int, ...] = ()) -> Track:
    rows = np.arange(len(stamps))
    return Track(
        "a",
        "hand",
        (),
        (),
        (),
        stamp_ns=np.array(stamps, dtype=np.int64),
        lost=np.isin(rows, lost),
        reinitialised=np.isin(rows, reinitialised),
    )


def truth_at(stamps: list[int]) -> Track:
    return Track("truth", "hand", (), (), (), stamp_ns=np.array(stamps, dtype=np.int64))


def coverage(estimates: list[int], truths: list[int], lost: tuple[int, ...] = ()) -> Coverage:
    track, truth = track_at(estimates, lost), truth_at(truths)
    pairs = associate(track.stamp_ns, truth.stamp_ns, TOLERANCE_NS)
    return measure_coverage(track, truth, pairs, tolerance_ns=TOLERANCE_NS)


def frames(*numbers: int) -> list[int]:
    return [number * FRAME_NS for number in numbers]


def test_every_frame_tracked() -> None:
    found = coverage(frames(0, 1, 2), frames(0, 1, 2))
    assert found == Coverage(3, 3, 0, 0, 0, 0, 0, True, 3)
    assert found.share == 1.0


def test_lost_and_unmatched_frames_are_no_success() -> None:
    # frames 0-4; 1 and 4 are lost, truth lacks 3 and 4: tracked and matched are 0 and 2
    found = coverage(frames(0, 1, 2, 3, 4), frames(0, 1, 2), lost=(1, 4))
    assert (found.tracked, found.lost, found.unmatched, found.tracked_and_matched) == (3, 2, 2, 2)
    assert found.share == 2 / 5


def test_reinitialised_frames_are_tracked() -> None:
    track = track_at(frames(0, 1, 2), lost=(0,), reinitialised=(1,))
    found = measure_coverage(track, None, None)
    assert found == Coverage(3, 2, 1, 1, 3, 0, 0, False, 0)
    assert found.share == 2 / 3


def test_a_hole_counts_the_frames_it_lacks() -> None:
    found = coverage(frames(0, 1, 2, 3, 7, 8, 9), frames(*range(10)))
    assert (found.missed, found.unmatched, found.outside) == (3, 0, 0)
    assert found.share == 7 / 10


def test_a_single_frame_left_out_is_missed() -> None:
    assert coverage(frames(0, 1, 3, 4), frames(*range(5))).missed == 1


def test_a_hole_without_truth_is_not_held_against_the_run() -> None:
    assert coverage(frames(0, 1, 2, 7, 8), frames(0, 1, 2, 7, 8)).missed == 0


def test_truths_right_beside_the_ends_of_a_hole_are_no_missed_frames() -> None:
    # truth at 120 Hz has the hole, too, but for 2 1/4 and 6 3/4
    truths = [i * FRAME_NS // 4 for i in (*range(10), *range(27, 33))]
    assert coverage(frames(0, 1, 2, 7, 8), truths).missed == 0


@pytest.mark.parametrize(
    ("tenths", "missed"), [(21, 0), (24, 0), (26, 1), (30, 1), (34, 1), (36, 0), (39, 0)]
)
def test_a_truth_is_of_the_frame_that_is_nearest(tenths: int, missed: int) -> None:
    # frame 3 is left out; up to half an interval from frame 2 or 4 a truth is of these
    truths = sorted([*frames(0, 1, 2, 4, 5), tenths * FRAME_NS // 10])
    assert coverage(frames(0, 1, 2, 4, 5), truths).missed == missed


def test_frames_near_each_other_make_up_for_no_missed_ones() -> None:
    # one frame comes 0.7 intervals late and 0.3 before the next; frame 7 is left out
    late = [FRAME_NS * 27 // 10]
    found = coverage([*frames(0, 1), *late, *frames(3, 4, 5, 6, 8, 9, 10)], frames(*range(11)))
    assert found.missed == 2, "the one that came late, which no truth is near, and frame 7"


def test_truths_before_and_after_were_not_asked_for() -> None:
    found = coverage(frames(3, 4, 5), frames(*range(10)))
    assert (found.missed, found.outside, found.share) == (0, 7, 1.0)


def test_a_truth_within_the_tolerance_of_an_end_is_inside() -> None:
    ends = [-TOLERANCE_NS, FRAME_NS, 2 * FRAME_NS + TOLERANCE_NS]
    assert coverage(frames(0, 1, 2), ends).outside == 0
    assert coverage(frames(0, 1, 2), [ends[0] - 1, ends[1], ends[2] + 1]).outside == 2


def test_a_stride_misses_nothing() -> None:
    assert coverage(frames(*range(0, 20, 3)), frames(*range(19))).missed == 0


@pytest.mark.parametrize("rate", [2, 4, 10])
def test_truth_of_a_higher_rate_misses_nothing(rate: int) -> None:
    truths = [i * FRAME_NS // rate for i in range(9 * rate + 1)]
    assert coverage(frames(*range(10)), truths).missed == 0


@pytest.mark.parametrize("rate", [1, 2, 4, 10])
def test_a_hole_counts_frames_whatever_the_truth_s_rate(rate: int) -> None:
    truths = [i * FRAME_NS // rate for i in range(9 * rate + 1)]
    assert coverage(frames(0, 1, 2, 3, 7, 8, 9), truths).missed == 3


@settings(deadline=None)
@given(st.sets(st.integers(1, 38), max_size=12), st.integers(-TOLERANCE_NS, TOLERANCE_NS))
def test_what_is_dropped_is_missed(dropped: set[int], jitter: int) -> None:
    """Of 40 frames, jitter every second: those left out, and only those, are missed."""
    kept = [i * FRAME_NS + (jitter if i % 2 else 0) for i in range(40) if i not in dropped]
    found = coverage(kept, frames(*range(40)))
    assert (found.frames, found.missed, found.unmatched) == (40 - len(dropped), len(dropped), 0)


@pytest.mark.parametrize(
    ("estimates", "expected"),
    [
        ([], Coverage(0, 0, 0, 0, 0, 0, 5, True, 0)),
        ([2], Coverage(1, 1, 0, 0, 0, 0, 4, True, 1)),
        ([1, 3], Coverage(2, 2, 0, 0, 0, 0, 2, True, 2)),  # may be every second frame: no hole to be seen
    ],
)
def test_hardly_any_estimates(estimates: list[int], expected: Coverage) -> None:
    assert coverage(frames(*estimates), frames(*range(5))) == expected


def test_an_empty_result_covers_nothing() -> None:
    assert coverage([], frames(0, 1)).share == 0.0
    assert measure_coverage(track_at([]), None, None).share == 0.0
