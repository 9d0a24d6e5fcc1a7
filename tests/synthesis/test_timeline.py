from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.synthesis.recording import (
    DROP_PROBABILITY,
    LATE_PROBABILITY,
    LATE_S,
    START_NS,
    make_timeline,
)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_without_switches_frames_are_equally_spaced() -> None:
    timeline = make_timeline(301, 30.0, drops=False, late=False, rng=rng())
    assert not timeline.dropped.any()
    assert timeline.stamps_ns[0] == START_NS
    assert timeline.stamps_ns[300] == START_NS + 10_000_000_000
    assert timeline.seconds == pytest.approx(np.arange(301) / 30.0, abs=1e-9)


def test_drops_have_their_probability_and_spare_the_first_frame() -> None:
    count = 20000
    timeline = make_timeline(count, 30.0, drops=True, late=False, rng=rng())
    assert not timeline.dropped[0]
    # bursts of up to 4 raise the variance of the count by less than that factor; five sd
    tolerance = 5.0 * np.sqrt(4.0 * DROP_PROBABILITY / count)
    assert abs(timeline.dropped.mean() - DROP_PROBABILITY) < tolerance
    edges = np.flatnonzero(np.diff(np.r_[0, timeline.dropped.astype(int), 0]))
    lengths = edges[1::2] - edges[::2]
    assert (lengths == 1).any() and (lengths > 1).any()


@pytest.mark.parametrize("fps", [1.0, 30.0, 500.0])
def test_late_frames_are_late_and_keep_their_order(fps: float) -> None:
    on_time = make_timeline(3000, fps, drops=False, late=False, rng=rng(1)).stamps_ns
    late = make_timeline(3000, fps, drops=False, late=True, rng=rng(1)).stamps_ns
    delay = (late - on_time) * 1e-9
    assert delay[0] == 0.0 and (delay >= 0.0).all() and delay.max() <= LATE_S[1] + 1e-9
    assert (np.diff(late) > 0).all()
    tolerance = 5.0 * np.sqrt(LATE_PROBABILITY * (1.0 - LATE_PROBABILITY) / 3000)
    assert abs((delay > 0.0).mean() - LATE_PROBABILITY) < tolerance


def test_switches_do_not_change_each_other() -> None:
    both = make_timeline(500, 30.0, drops=True, late=True, rng=rng(2))
    drops = make_timeline(500, 30.0, drops=True, late=False, rng=rng(2))
    late = make_timeline(500, 30.0, drops=False, late=True, rng=rng(2))
    assert (both.dropped == drops.dropped).all() and (both.stamps_ns == late.stamps_ns).all()
