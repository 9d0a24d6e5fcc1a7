"""Frames of a fixed rate, made of stamps as cameras and losses leave them."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli import limits
from posetrack_cli.errors import ResultError
from posetrack_cli.results.export.table import SINGLE_HZ, fixed_rate

START = 1_500_000_000_000_000_000


def stamps(*seconds: float) -> np.ndarray:
    return START + np.rint(np.array(seconds) * 1e9).astype(np.int64)


def test_stamps_in_whole_milliseconds_have_the_rate_of_their_camera() -> None:
    """Steps of 33, 33, 34 ms: at the median, 30.3 Hz, an hour would have a thousand frames too many."""
    frames = 3000
    rate = fixed_rate(START + 1_000_000 * np.rint(np.arange(frames) * 1000 / 30).astype(np.int64), "r")
    assert rate.rate_hz == pytest.approx(30.0, rel=1e-3 / (frames / 30))  # half a millisecond at either end
    assert rate.rows.tolist() == list(range(frames))
    assert not list(rate.notes("filled"))


def test_dropped_frames_are_frames_without_an_estimate() -> None:
    rate = fixed_rate(stamps(0.0, 0.1, 0.2, 0.5, 0.6), "r")
    assert rate.rate_hz == pytest.approx(10.0)
    assert rate.rows.tolist() == [0, 1, 2, -1, -1, 3, 4]
    assert list(rate.notes("filled")) == ["2 of 7 frames at 10 Hz have no estimate: filled"]


def test_times_stay_right_to_half_a_frame_where_stamps_are_irregular() -> None:
    rng = np.random.default_rng(1)
    given = START + np.cumsum(rng.integers(20_000_000, 60_000_000, 500))
    rate = fixed_rate(given, "r")
    (known,) = np.nonzero(rate.known)
    off = (given[rate.rows[known]] - given[0]) * 1e-9 - known / rate.rate_hz
    assert np.abs(off).max() <= 0.5 / rate.rate_hz + 1e-9
    assert len(set(rate.rows[known])) == len(known) <= len(given)
    (note, *_), count = [n for n in rate.notes("") if "left out" in n], len(given) - len(known)
    assert note == f"{count} of 500 estimates left out: less than a frame from others"


def test_of_several_in_a_frame_the_nearest_is_told_whatever_their_order() -> None:
    given = stamps(0.0, 0.1, 0.2, 0.21, 0.3, 0.4)
    assert fixed_rate(given, "r").rows.tolist() == [0, 1, 2, 4, 5]
    assert fixed_rate(given[::-1], "r").rows.tolist() == [5, 4, 3, 1, 0]


def test_one_stamp_is_one_frame_and_none_is_told() -> None:
    for given in (stamps(0.0), stamps(0.0, 0.0)):
        rate = fixed_rate(given, "r")
        assert (rate.rate_hz, rate.rows.tolist()) == (SINGLE_HZ, [0])
    with pytest.raises(ResultError, match=r"^r: has no estimates$"):
        fixed_rate(stamps(), "r")


def test_gaps_make_no_more_frames_than_is_bounded() -> None:
    most = limits.EXPORT_FRAMES / 10  # seconds, at 10 Hz
    assert len(fixed_rate(stamps(0.0, 0.1, 0.2, most - 0.2, most - 0.1), "r").rows) == limits.EXPORT_FRAMES
    with pytest.raises(
        ResultError, match="gaps are too long for a format with a fixed frame rate, found 10001 "
    ):
        fixed_rate(stamps(0.0, 0.1, 0.2, most - 0.1, most), "r")
    with pytest.raises(ResultError, match="gaps are too long"):
        fixed_rate(np.array([0, 1, 2, (1 << 63) - 1]), "r")
