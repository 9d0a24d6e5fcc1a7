"""Which frames a shape is estimated from, against a brute-force choice that keeps all of them."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.hand.shape_fit import FIRST_FRAMES, FrameSelector
from posetrack_cli.recording.base import Frame

AREAS = st.lists(st.sampled_from([0.0, 100.0, 200.0, 300.0, 400.0]), min_size=1, max_size=90)
FRAMES = [Frame(k, k, ()) for k in range(1000)]


def chosen(areas: list[float], most: int, count: int) -> list[int]:
    shown = FrameSelector(most, count)
    for frame, area in zip(FRAMES, areas, strict=False):
        shown.add(frame, area)
    assert shown.seen == len(areas)
    return [frame.index for frame in shown.frames]


def brute_force(areas: list[float], most: int, count: int) -> list[int]:
    first = min(FIRST_FRAMES, most)
    parts: dict[int, list[int]] = {}
    for k in range(len(areas)):
        parts.setdefault(min(k * first // count, first - 1), []).append(k)
    ranked = sorted(range(len(areas)), key=lambda k: (-areas[k], k))
    best = [min(part, key=ranked.index) for part in parts.values()]
    best = [k for k in best if areas[k] > 0.0]
    both = best + [k for k in ranked if k not in best]
    return sorted(both[:first]) + sorted(both[first:most])


@given(AREAS, st.integers(1, 40), st.integers(1, 120))
def test_frames_added_one_by_one_are_chosen_as_if_all_were_known(
    areas: list[float], most: int, count: int
) -> None:
    assert chosen(areas, most, count) == brute_force(areas, most, count)


def test_a_second_that_shows_most_fills_the_first_round_no_more_than_others() -> None:
    areas = np.full(4 * FIRST_FRAMES, 10.0)
    areas[8:32] = 100.0
    first = chosen(areas.tolist(), 2 * FIRST_FRAMES, len(areas))[:FIRST_FRAMES]
    assert [k // 4 for k in first] == [*range(FIRST_FRAMES)]


def test_a_part_without_fingers_leaves_its_place_to_others() -> None:
    areas = [0.0] * 32 + [10.0] * 32  # a hand that comes late
    assert min(chosen(areas, FIRST_FRAMES, len(areas))) == 32


def test_no_more_images_are_kept_than_are_chosen() -> None:
    shown = FrameSelector(20, 500)
    rng = np.random.default_rng(1)
    for frame in FRAMES[:500]:
        shown.add(frame, float(rng.integers(0, 50)))
        assert len(shown.frames) == min(shown.seen, 20)
