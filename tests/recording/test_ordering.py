"""Numbering, selection and strictly increasing stamps."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.errors import UsageError
from posetrack_cli.losses import LossLog, loss_line
from posetrack_cli.recording.base import StoredFrame
from posetrack_cli.recording.matching import select_frames


def frame(stamp: int) -> StoredFrame:
    return StoredFrame(stamp, "x", (None,))


def test_doubled_and_backward_stamps_are_dropped_and_counted() -> None:
    log = LossLog()
    found = [(i, f.stamp_ns) for i, f in select_frames(map(frame, [10, 20, 20, 15, 30, 29, 40]), log)]
    assert found == [(0, 10), (1, 20), (4, 30), (6, 40)]
    (loss,) = log.losses
    assert (loss.count, loss.first) == (3, "frame 2 at 20 ns, x")
    assert "3, first frame 2 at 20 ns" in loss_line(log.losses)


def test_stamps_that_64_bits_cannot_hold_are_dropped_and_harm_no_others() -> None:
    log = LossLog()
    stamps = [-5, 10, 2**63, 2**200, 20, 2**63 - 1, 30]
    assert [i for i, _ in select_frames(map(frame, stamps), log)] == [1, 4, 5]
    assert [(loss.count, loss.first) for loss in log.losses] == [
        (3, "frame 0 at -5 ns, x"),
        (1, "frame 6 at 30 ns, x"),
    ]


def test_unreadable_frame_keeps_its_index() -> None:
    found = [i for i, _ in select_frames([frame(0), None, frame(2)], LossLog())]
    assert found == [0, 2]


@given(
    st.lists(st.integers(0, 30), max_size=25),
    st.integers(0, 8),
    st.none() | st.integers(0, 20),
    st.integers(1, 4),
)
def test_a_range_is_that_part_of_all_frames(
    stamps: list[int], start: int, end: int | None, stride: int
) -> None:
    everything = {i for i, _ in select_frames(map(frame, stamps), LossLog())}
    log = LossLog()
    part = [i for i, _ in select_frames(map(frame, stamps), log, start=start, end=end, stride=stride)]
    wanted = range(start, len(stamps) if end is None else min(end, len(stamps)), stride)
    assert part == [i for i in wanted if i in everything]
    assert sum(loss.count for loss in log.losses) == len(wanted) - len(part)


@pytest.mark.parametrize("bad", [{"start": -1}, {"end": -1}, {"stride": 0}])
def test_ranges_that_cannot_be_meant(bad: dict[str, int]) -> None:
    with pytest.raises(UsageError, match="frame range"):
        next(select_frames([frame(0)], LossLog(), **bad), None)
