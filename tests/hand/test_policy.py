"""The state machine of a track: laws of doubt, loss and patience, and a table of what becomes of a hand."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.hand.config import StatusSettings
from posetrack_cli.hand.fit.skeleton import NO_INNER
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.policy import (
    LEAVE_AFTER_SEARCHES,
    Decision,
    Policy,
    TrackedFrame,
    TrackMonitor,
    status_of,
)
from posetrack_cli.hand.search import NO_BAR, Acquisition, Bar, Candidate
from posetrack_cli.hand.start import rest_pose
from posetrack_cli.results.estimate import Status
from support.hand_scene import turned_about_its_length

ANATOMY = make_anatomy()
SETTINGS = StatusSettings(doubt_above_mm=6.0, lost_below=0.5, lost_after_frames=3)
costs = st.floats(0.01, 40.0)
watches = st.builds(
    TrackMonitor,
    lost=st.booleans(),
    misses=st.integers(0, 10),
    mean_cost_mm=st.one_of(st.just(0.0), costs),
    search_wait=st.integers(0, 200),
    next_search_wait=st.integers(1, 6),
)


def refusals(monitor: TrackMonitor, cost: float, count: int) -> list[int]:
    """How many frames pass between searches of which none finds anything."""
    waits = []
    for _ in range(count):
        monitor = monitor.after_failed_search(cost)
        waits.append(monitor.search_wait)
        for _ in range(monitor.search_wait):
            monitor = monitor.after_search_wait()
        assert monitor.search_wait == 0
    return waits


def test_a_hand_is_lost_after_so_many_frames_and_not_before() -> None:
    monitor, lost = TrackMonitor(mean_cost_mm=3.0), []
    for _ in range(4):
        monitor = monitor.after_fit(30.0, 0.2, SETTINGS)
        lost.append(monitor.lost)
    assert lost == [False, False, True, True]
    unsteady = TrackMonitor(mean_cost_mm=3.0)
    for confidence in (0.2, 0.2, 0.9, 0.2, 0.2, 0.9):
        unsteady = unsteady.after_fit(3.0, confidence, SETTINGS)
        assert not unsteady.lost


@given(watches, costs)
def test_what_is_seen_well_is_not_lost(monitor: TrackMonitor, cost: float) -> None:
    after = monitor.after_fit(cost, 0.5, SETTINGS)
    assert (after.misses, after.lost) == (0, False)


@given(watches)
def test_missing_frames_tell_nothing_of_costs(monitor: TrackMonitor) -> None:
    after = monitor.after_miss(SETTINGS)
    assert after.misses == monitor.misses + 1
    assert after.lost == (monitor.lost or after.misses >= 3)
    assert replace(after, misses=monitor.misses, lost=monitor.lost) == monitor


@given(watches, costs)
def test_the_usual_cost_follows_good_frames_and_no_bad_ones(monitor: TrackMonitor, cost: float) -> None:
    after = monitor.after_fit(cost, 0.9, SETTINGS)
    if monitor.mean_cost_mm == 0.0:
        assert after.mean_cost_mm == pytest.approx(cost)
    elif monitor.is_far_above_mean(cost):
        assert after.mean_cost_mm == monitor.mean_cost_mm
    else:
        assert after.mean_cost_mm == pytest.approx(0.9 * monitor.mean_cost_mm + 0.1 * cost)


def test_doubt_begins_where_stated() -> None:
    monitor = TrackMonitor(mean_cost_mm=2.0)  # 1.5 * 2 + 2 = 5
    assert [monitor.is_doubtful(cost, SETTINGS) for cost in (4.9, 5.1)] == [False, True]
    assert [TrackMonitor(mean_cost_mm=10.0).is_doubtful(cost, SETTINGS) for cost in (5.9, 6.1)] == [
        False,
        True,
    ]
    assert [TrackMonitor().is_doubtful(cost, SETTINGS) for cost in (5.9, 6.1)] == [
        False,
        True,
    ]  # nothing is usual yet
    assert not TrackMonitor().is_far_above_mean(1e9)


def test_poor_fits_are_no_doubt_where_good_ones_of_the_recording_are_as_poor() -> None:
    """With a hand of another shape, every frame would else be searched."""
    monitor, known = TrackMonitor(mean_cost_mm=9.0), StatusSettings(baseline_cost_mm=8.0)
    assert [monitor.is_doubtful(cost, known) for cost in (10.4, 10.6)] == [False, True]  # 1.25 * 8 + .5
    assert monitor.is_doubtful(10.4, SETTINGS)  # the recording is unknown: all fits may be at a wrong place
    stuck = replace(monitor, baseline_cost_mm=12.0)  # at a wrong place from the first frame
    assert stuck.is_doubtful(12.0, known)
    better = replace(monitor, baseline_cost_mm=4.0)
    assert [better.is_doubtful(cost, known) for cost in (5.9, 6.1)] == [False, True]  # never below 6


@given(watches, costs, costs)
def test_a_dearer_fit_is_doubted_no_less(monitor: TrackMonitor, first: float, second: float) -> None:
    cheap, dear = sorted((first, second))
    assert monitor.is_doubtful(cheap, SETTINGS) <= monitor.is_doubtful(dear, SETTINGS)


def test_searches_come_ever_more_seldom_but_soon_enough() -> None:
    assert refusals(TrackMonitor(mean_cost_mm=3.0), 30.0, 6) == [1, 2, 4, 4, 4, 4]
    assert refusals(TrackMonitor(lost=True), float("inf"), 6) == [1, 2, 4, 4, 4, 4]
    # a hand that always fits badly is reconsidered five times a second
    assert refusals(TrackMonitor(mean_cost_mm=12.0), 12.0, 6) == [1, 2, 4, 6, 6, 6]


@given(watches)
def test_waiting_ends(monitor: TrackMonitor) -> None:
    after = monitor.after_search_wait()
    assert after.search_wait == max(0, monitor.search_wait - 1)
    assert replace(after, search_wait=monitor.search_wait) == monitor


def test_a_sure_frame_ends_the_wait_and_halves_the_next() -> None:
    """Costs about the limit, one frame above it and one below, would else have every other frame searched."""
    tired = TrackMonitor(mean_cost_mm=3.0, search_wait=4, next_search_wait=8)
    assert (
        tired.after_fit(3.0, 0.9, SETTINGS).search_wait,
        tired.after_fit(3.0, 0.9, SETTINGS).next_search_wait,
    ) == (0, 4)
    doubtful = tired.after_fit(7.0, 0.9, SETTINGS)
    assert (doubtful.search_wait, doubtful.next_search_wait) == (4, 8)


@given(watches, costs)
def test_what_was_found_is_found_and_its_usual_cost_does_not_rise(monitor: TrackMonitor, cost: float) -> None:
    """A bad find would else be what is usual, and never be doubted."""
    after = monitor.after_restart(cost)
    assert (after.lost, after.was_found, after.misses) == (False, True, 0)
    assert after.mean_cost_mm == (cost if monitor.mean_cost_mm == 0.0 else min(cost, monitor.mean_cost_mm))


def test_another_fit_takes_the_place_of_one_that_costs_a_share_more_or_millimetres() -> None:
    monitor = TrackMonitor(mean_cost_mm=2.0)
    assert monitor.prefers(3.0, 2.0)  # by the share: below 2.1
    assert not monitor.prefers(3.0, 2.2)
    assert monitor.prefers(12.0, 9.9)  # by the difference, where the model is not the hand
    assert not monitor.prefers(12.0, 10.1)


def test_a_fit_is_replaced_by_one_that_is_better_by_a_share_or_by_millimetres() -> None:
    for cost, limit in ((2.0, 1.4), (10.0, 8.0)):  # 0.7 * 2; 10 - 2
        assert TrackMonitor().prefers(cost, limit - 0.01)
        assert not TrackMonitor().prefers(cost, limit + 0.01)


def test_a_search_that_was_to_come_late_comes_at_once_when_fits_get_worse() -> None:
    late, soon = (
        TrackMonitor(mean_cost_mm=12.0, search_wait=6),
        TrackMonitor(mean_cost_mm=12.0, search_wait=3),
    )
    assert late.skips_search(12.0)
    assert not late.skips_search(35.0)  # above 1.5 x 12 + 2
    assert soon.skips_search(35.0)  # the last search of a bad track was a moment ago
    assert not replace(soon, search_wait=0).skips_search(12.0)


def test_a_track_is_left_for_another_place_after_so_many_searches_in_a_row_and_not_before() -> None:
    """A single frame in which the elbow looks better moves nothing; one in which it does not begins anew."""
    monitor, better, worse = TrackMonitor(mean_cost_mm=8.0), (9.0, 6.9), (9.0, 7.1)  # by 2.1 and by 1.9 mm
    for here, there in [better] * 4 + [worse] + [better] * 4:
        monitor = monitor.after_elsewhere(here, there)
        assert monitor.better_elsewhere < LEAVE_AFTER_SEARCHES
        if monitor.better_elsewhere:
            waiting = replace(monitor, search_wait=3)
            assert not waiting.skips_search(8.0)  # what may be better is looked at every frame
    assert monitor.after_elsewhere(*better).better_elsewhere == LEAVE_AFTER_SEARCHES
    assert monitor.after_restart(7.0).better_elsewhere == 0


def test_fingers_that_were_seen_are_forgotten_slowly() -> None:
    """A fist is no doubt for some seconds after an open hand; fingers count at once."""
    monitor = TrackMonitor().after_finger_bonus(4.5)
    assert monitor.finger_bonus_mm == 4.5
    for _ in range(30):
        monitor = monitor.after_finger_bonus(-3.0)
    assert 3.5 < monitor.finger_bonus_mm < 4.5
    for _ in range(1000):
        monitor = monitor.after_finger_bonus(-3.0)
    assert monitor.finger_bonus_mm == -3.0


@given(costs, st.lists(costs, min_size=1, max_size=30))
def test_the_level_of_good_fits_is_none_that_no_fit_had(first: float, later: list[float]) -> None:
    """It falls towards what is cheaper and rises by no more than a few hundredths a frame."""
    monitor = TrackMonitor().after_fit(first, 1.0, SETTINGS)
    assert monitor.baseline_cost_mm == first
    for cost in later:
        before, monitor = monitor.baseline_cost_mm, monitor.after_fit(cost, 1.0, SETTINGS)
        assert min(cost, before) <= monitor.baseline_cost_mm <= min(max(cost, before), before + 0.03 + 1e-12)


@given(costs)
def test_a_fit_is_sufficient_up_to_where_it_is_raised(cost: float) -> None:
    """Where all fits cost alike, the usual cost is that of good fits."""
    assert TrackMonitor().accept_below_mm == math.inf
    monitor = TrackMonitor().after_fit(cost, 1.0, SETTINGS)
    enough = monitor.accept_below_mm
    assert enough > cost
    assert not monitor.is_above_baseline(enough)
    assert monitor.is_above_baseline(math.nextafter(enough, math.inf))


def test_a_bad_second_stays_a_bad_second() -> None:
    """The usual cost follows it within a second, so that nothing would be tried any more."""
    monitor = TrackMonitor()
    for cost in [8.0] * 30 + [12.0] * 30:
        monitor = monitor.after_fit(cost, 1.0, SETTINGS)
    assert monitor.is_above_baseline(12.0)
    assert monitor.is_far_above_baseline(12.0, SETTINGS)
    assert monitor.is_above_baseline(10.8)  # a little above what good fits cost
    assert not monitor.is_far_above_baseline(10.8, SETTINGS)
    assert not TrackMonitor(baseline_cost_mm=2.0).is_far_above_baseline(
        5.9, SETTINGS
    )  # of a hand whose shape is known
    assert not monitor.is_above_baseline(8.5)
    assert not monitor.is_far_above_mean(12.0)


def test_poor_fits_in_the_beginning_are_no_good_ones_where_the_whole_recording_tells_better() -> None:
    monitor, told = TrackMonitor(), StatusSettings(baseline_cost_mm=6.0)
    assert monitor.cost_ratio(9.0, SETTINGS) == 1.0
    assert monitor.cost_ratio(9.0, told) == 1.5
    for _ in range(30):
        monitor = monitor.after_fit(9.0, 1.0, told)
    assert monitor.cost_ratio(9.0, SETTINGS) == 1.0
    assert monitor.cost_ratio(9.0, told) == 1.5
    for _ in range(30):
        monitor = monitor.after_fit(4.5, 1.0, told)
    assert monitor.cost_ratio(9.0, told) == pytest.approx(2.0, rel=1e-3)  # better ones than were told of
    assert monitor.cost_ratio(4.0, told) == 1.0


def test_looks_that_do_not_help_come_seldom_and_one_is_due_when_fits_get_worse() -> None:
    monitor, waits = TrackMonitor(baseline_cost_mm=5.0), []
    for _ in range(4):
        monitor = monitor.after_retry(7.0, helped=False)
        waits.append(monitor.retry_wait)
        assert monitor.skips_retry(7.0)
        assert not monitor.skips_retry(9.0)
        for _ in range(monitor.retry_wait):
            monitor = monitor.after_retry_wait()
        assert not monitor.skips_retry(7.0)
    assert waits == [1, 2, 3, 3]
    assert monitor.after_retry(7.0, helped=True).after_retry(7.0, helped=False).retry_wait == 1


class Finder:
    """Finds what it was given: in a window, and in the whole image or at a place of it."""

    def __init__(self, in_window: Candidate | None = None, in_image: Candidate | None = None) -> None:
        self._in_window, self._in_image = in_window, in_image
        self.asked: list[str] = []
        self.bar = NO_BAR  # of the last search

    def reconsider(self, observation: object, pose: object, below_mm: float) -> Candidate | None:
        self.asked.append("window")
        self.bar = Bar(below_mm, -np.inf)
        return self._in_window

    def search(
        self, depth: object, told: object = (), bar: Bar = NO_BAR, around: object = None
    ) -> Candidate | None:
        self.asked.append("image" if around is None else "place")
        self.bar = bar
        return self._in_image


def placed(aside_mm: float = 0.0, *, faces_away: bool = False) -> np.ndarray:
    """A pose (22,) 600 mm away."""
    pose = rest_pose(ANATOMY, np.array([aside_mm, 0.0, 600.0]))
    return turned_about_its_length(pose, np.pi) if faces_away else pose


HERE, BESIDE, AWAY = placed(), placed(10.0), placed(300.0)
USUAL = TrackMonitor(mean_cost_mm=2.0, baseline_cost_mm=2.0)
"""Doubts begin at 1.5 * 2 + 2 = 5 mm, looks at 1.15 * 2 + .5 = 2.8."""
POOR = TrackMonitor(mean_cost_mm=5.0, baseline_cost_mm=5.0, search_wait=3)
"""Doubtful above 6 mm, far above good fits from 1.25 * 5 + .5 = 6.75; no search of the image is due."""
NEARLY = replace(USUAL, better_elsewhere=LEAVE_AFTER_SEARCHES - 1)
KEEP, REFINE, RESTART = "keep", "refine", "restart"
TABLE: dict[str, tuple[TrackMonitor, float, Candidate | None, Candidate | None, str, list[str]]] = {
    "a usual fit": (USUAL, 2.1, None, None, KEEP, []),
    "raised, nothing better": (USUAL, 3.0, None, None, KEEP, ["window"]),
    "raised, a little better and alike": (USUAL, 3.0, Candidate(HERE, 2.5), None, REFINE, ["window"]),
    "raised, a little better, its back": (
        USUAL,
        3.0,
        Candidate(placed(faces_away=True), 2.5),
        None,
        KEEP,
        ["window"],
    ),
    "raised, a look is not due": (
        replace(USUAL, retry_wait=1, last_retry_cost_mm=3.0),
        3.0,
        None,
        None,
        KEEP,
        [],
    ),
    "far above good fits, better in the window": (POOR, 6.9, Candidate(HERE, 6.0), None, REFINE, ["window"]),
    "far above good fits, better at the place": (
        POOR,
        6.9,
        Candidate(HERE, 6.8),
        Candidate(BESIDE, 6.0),
        REFINE,
        ["window", "place"],
    ),
    "far above good fits, better elsewhere": (
        POOR,
        6.9,
        None,
        Candidate(AWAY, 2.0, total_cost=2.0),
        KEEP,
        ["window", "place"],
    ),
    "doubtful, better in the window": (USUAL, 6.5, Candidate(HERE, 2.0), None, REFINE, ["window"]),
    "doubtful, nothing anywhere": (USUAL, 6.5, None, None, KEEP, ["window", "image"]),
    "doubtful, better in the image, here": (
        USUAL,
        6.5,
        None,
        Candidate(BESIDE, 2.0, total_cost=2.0),
        REFINE,
        ["window", "image"],
    ),
    "doubtful, better elsewhere, once": (
        USUAL,
        6.5,
        None,
        Candidate(AWAY, 2.0, total_cost=2.0),
        KEEP,
        ["window", "image"],
    ),
    "doubtful, better elsewhere, again": (
        NEARLY,
        6.5,
        None,
        Candidate(AWAY, 2.0, total_cost=2.0),
        RESTART,
        ["window", "image"],
    ),
    "doubtful, worse elsewhere": (
        NEARLY,
        6.5,
        None,
        Candidate(AWAY, 6.0, total_cost=20.0),
        KEEP,
        ["window", "image"],
    ),
    "doubtful, a search is not due": (replace(USUAL, search_wait=2), 5.5, None, None, KEEP, ["window"]),
}


def policy_with(finder: Finder) -> Policy:
    observer: Any = SimpleNamespace(observe=lambda *_: None)
    return Policy(SETTINGS, ANATOMY, cast(Acquisition, finder), observer)


def kind_of(decision: Decision) -> str:
    if decision.candidate is None:
        return KEEP
    return RESTART if decision.restart else REFINE


@pytest.mark.parametrize("case", TABLE)
def test_what_becomes_of_a_hand_that_is_followed(case: str) -> None:
    monitor, cost, in_window, in_image, expected, asked = TABLE[case]
    finder = Finder(in_window, in_image)
    fits: Any = SimpleNamespace(cost=cost, modes=SimpleNamespace(poses=HERE[None]))
    window: Any = SimpleNamespace(hidden=0.0)
    sight = TrackedFrame(monitor, np.empty((0, 0), np.float32), window, fits, NO_INNER)
    decision = policy_with(finder).decide_tracked(sight, None)
    assert (kind_of(decision), finder.asked) == (expected, asked)
    if (found := decision.candidate) is not None:  # a search may stop at its bar, so what is used is below
        assert found.cost < finder.bar.cost or found.total_cost < finder.bar.total_cost


@pytest.mark.parametrize(
    ("wait", "there", "expected", "left"),
    [(0, None, KEEP, 1), (0, Candidate(AWAY, 2.0), RESTART, 0), (3, Candidate(AWAY, 2.0), KEEP, 2)],
)
def test_what_becomes_of_a_hand_that_is_lost(
    wait: int, there: Candidate | None, expected: str, left: int
) -> None:
    """It is searched for unless it has just been; a search that finds nothing is followed by a pause."""
    finder = Finder(in_image=there)
    monitor = TrackMonitor(lost=True, search_wait=wait)
    decision = policy_with(finder).decide_lost(monitor, np.empty((0, 0), np.float32), ())
    assert (kind_of(decision), decision.monitor.search_wait) == (expected, left)
    assert finder.asked == ([] if wait else ["image"])


@pytest.mark.parametrize(
    ("is_tracked", "is_another", "status"),
    [
        (False, False, Status.LOST),
        (False, True, Status.LOST),
        (True, False, Status.TRACKING),
        (True, True, Status.REINITIALISED),
    ],
)
def test_what_an_estimate_states(is_tracked: bool, is_another: bool, status: Status) -> None:
    assert status_of(is_tracked=is_tracked, is_restarted=is_another) is status
