"""Laws of doubt, loss and patience."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.hand.config import StatusSettings
from posetrack_cli.hand.watch import Watch

SETTINGS = StatusSettings(doubt_factor=1.5, doubt_mm=2.0, sure_mm=6.0, lost_below=0.5, lost_after_frames=3)
costs = st.floats(0.01, 40.0)
watches = st.builds(
    Watch,
    lost=st.booleans(),
    misses=st.integers(0, 10),
    usual_mm=st.one_of(st.just(0.0), costs),
    wait=st.integers(0, 200),
    pause=st.integers(1, 16),
)


def refusals(watch: Watch, cost: float, count: int) -> list[int]:
    """How many frames pass between searches of which none finds anything."""
    waits = []
    for _ in range(count):
        watch = watch.refused(cost, SETTINGS)
        waits.append(watch.wait)
        for _ in range(watch.wait):
            watch = watch.waiting()
        assert watch.wait == 0
    return waits


def test_a_hand_is_lost_after_so_many_frames_and_not_before() -> None:
    watch, lost = Watch(usual_mm=3.0), []
    for _ in range(4):
        watch = watch.seen(30.0, 0.2, SETTINGS)
        lost.append(watch.lost)
    assert lost == [False, False, True, True]
    unsteady = Watch(usual_mm=3.0)
    for confidence in (0.2, 0.2, 0.9, 0.2, 0.2, 0.9):
        unsteady = unsteady.seen(3.0, confidence, SETTINGS)
        assert not unsteady.lost


@given(watches, costs)
def test_what_is_seen_well_is_not_lost(watch: Watch, cost: float) -> None:
    after = watch.seen(cost, 0.5, SETTINGS)
    assert (after.misses, after.lost) == (0, False)


@given(watches)
def test_missing_frames_tell_nothing_of_costs(watch: Watch) -> None:
    after = watch.missed(SETTINGS)
    assert after.misses == watch.misses + 1
    assert after.lost == (watch.lost or after.misses >= 3)
    assert replace(after, misses=watch.misses, lost=watch.lost) == watch


@given(watches, costs)
def test_the_usual_cost_follows_good_frames_and_no_bad_ones(watch: Watch, cost: float) -> None:
    after = watch.seen(cost, 0.9, SETTINGS)
    if watch.usual_mm == 0.0:
        assert after.usual_mm == pytest.approx(cost)
    elif watch.is_worse(cost, SETTINGS):
        assert after.usual_mm == watch.usual_mm
    else:
        assert after.usual_mm == pytest.approx(0.9 * watch.usual_mm + 0.1 * cost)


def test_doubt_begins_where_stated() -> None:
    watch = Watch(usual_mm=2.0)  # 1.5 * 2 + 2 = 5
    assert [watch.doubts(cost, SETTINGS) for cost in (4.9, 5.1)] == [False, True]
    assert [Watch(usual_mm=10.0).doubts(cost, SETTINGS) for cost in (5.9, 6.1)] == [False, True]
    assert [Watch().doubts(cost, SETTINGS) for cost in (5.9, 6.1)] == [False, True]  # nothing is usual yet
    assert not Watch().is_worse(1e9, SETTINGS)


@given(watches, costs, costs)
def test_a_dearer_fit_is_doubted_no_less(watch: Watch, first: float, second: float) -> None:
    cheap, dear = sorted((first, second))
    assert watch.doubts(cheap, SETTINGS) <= watch.doubts(dear, SETTINGS)


def test_searches_come_ever_more_seldom_but_soon_enough() -> None:
    assert refusals(Watch(usual_mm=3.0), 30.0, 6) == [1, 2, 4, 4, 4, 4]
    assert refusals(Watch(lost=True), float("inf"), 6) == [1, 2, 4, 4, 4, 4]
    # a hand that always fits badly is reconsidered every half second
    assert refusals(Watch(usual_mm=12.0), 12.0, 10) == [1, 2, 4, 8, 16, 16, 16, 16, 16, 16]


@given(watches)
def test_waiting_ends(watch: Watch) -> None:
    after = watch.waiting()
    assert after.wait == max(0, watch.wait - 1)
    assert replace(after, wait=watch.wait) == watch


def test_a_sure_frame_ends_the_patience() -> None:
    tired = Watch(usual_mm=3.0, wait=4, pause=8)
    assert (tired.seen(3.0, 0.9, SETTINGS).wait, tired.seen(3.0, 0.9, SETTINGS).pause) == (0, 1)
    doubtful = tired.seen(7.0, 0.9, SETTINGS)
    assert (doubtful.wait, doubtful.pause) == (4, 8)


@given(watches, costs)
def test_what_was_found_is_found_and_its_usual_cost_does_not_rise(watch: Watch, cost: float) -> None:
    """A bad find would else be what is usual, and never be doubted."""
    after = watch.restarted(cost)
    assert (after.lost, after.found, after.misses) == (False, True, 0)
    assert after.usual_mm == (cost if watch.usual_mm == 0.0 else min(cost, watch.usual_mm))


def test_another_fit_takes_the_place_of_one_that_costs_a_share_more_or_millimetres() -> None:
    watch, settings = Watch(usual_mm=2.0), StatusSettings(better=0.7, better_mm=2.0)
    assert watch.is_replaced(3.0, 2.0, settings)  # by the share: below 2.1
    assert not watch.is_replaced(3.0, 2.2, settings)
    assert watch.is_replaced(12.0, 9.9, settings)  # by the difference, where the model is not the hand
    assert not watch.is_replaced(12.0, 10.1, settings)


def test_a_fit_is_replaced_by_one_that_is_better_by_a_share_or_by_millimetres() -> None:
    settings = StatusSettings(better=0.7, better_mm=2.0)
    for cost, limit in ((2.0, 1.4), (10.0, 8.0)):  # 0.7 * 2; 10 - 2
        assert Watch().is_replaced(cost, limit - 0.01, settings)
        assert not Watch().is_replaced(cost, limit + 0.01, settings)


def test_a_search_that_was_to_come_late_comes_at_once_when_fits_get_worse() -> None:
    late, soon = Watch(usual_mm=12.0, wait=10), Watch(usual_mm=12.0, wait=3)
    assert late.waits(12.0, SETTINGS)
    assert not late.waits(35.0, SETTINGS)  # above 1.5 x 12 + 2
    assert soon.waits(35.0, SETTINGS)  # the last search of a bad track was a moment ago
    assert not replace(soon, wait=0).waits(12.0, SETTINGS)
