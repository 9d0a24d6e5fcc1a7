"""Stamps that cannot be meant get one line."""

from __future__ import annotations

import pytest

from posetrack_cli.recording.timeline import StampCheck, Timeline

FRAME_NS = 33_333_333
HOUR_NS = 3600 * 10**9


def remarks(stamps: list[int], stride: int = 1) -> tuple[str, ...]:
    check = StampCheck()
    for number, stamp in enumerate(stamps):
        check.add(stride * number, stamp)
    return check.remarks


@pytest.mark.parametrize("unit", [1, 1000, 1_000_000], ids=["seconds", "milliseconds", "microseconds"])
def test_other_units_taken_for_nanoseconds_are_told(unit: int) -> None:
    stamps = sorted({round(k * unit / 30) for k in range(90)})
    (line,) = remarks(stamps)
    assert "faster than any camera" in line


@pytest.mark.parametrize("interval_ns", [10**9 // 1000, FRAME_NS, 10**9, 5 * 10**9])
@pytest.mark.parametrize("stride", [1, 100])
def test_what_cameras_do_is_no_doubt(interval_ns: int, stride: int) -> None:
    assert remarks([k * interval_ns * stride for k in range(50)], stride) == ()
    assert remarks([0]) == remarks([]) == remarks([0, interval_ns]) == ()


def test_pauses_are_no_doubt_and_a_clock_that_was_set_is() -> None:
    pause = [k * FRAME_NS + (50 * 10**9 if k > 20 else 0) for k in range(50)]
    assert remarks(pause) == ()
    jump = [k * FRAME_NS + (HOUR_NS if k > 20 else 0) for k in range(50)]
    (line,) = remarks(jump)
    assert "before frame 21" in line and "clock" in line
    (line,) = remarks([0, FRAME_NS, 2 * FRAME_NS, 100 * 10**9])
    assert "before frame 3" in line


def test_a_frame_in_an_hour_is_told() -> None:
    (line,) = remarks([k * HOUR_NS for k in range(5)])
    assert "a frame every 3.6e+03 s" in line


def test_info_says_the_same() -> None:
    timeline = Timeline()
    for stamp in (0, 0, 33, 66, 66, 100):
        timeline.add(stamp)
    assert "faster than any camera" in timeline.remarks[0]
