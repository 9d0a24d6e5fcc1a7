"""The frames kept of every direction: against keeping all and choosing at the end."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.adjustment.adjuster import (
    CELL_DEG,
    PER_CELL,
    Album,
    PointView,
    choose_views,
    spread,
    spreads_without,
)
from posetrack_cli.head.face.points import HeadPose
from support.bundles import random_pose

WITHIN = 0.45
"""Of a cell: directions farther from its middle would be the next one's."""
seeds = st.integers(0, 10_000)


def view(stamp: int, yaw_deg: float, pitch_deg: float, roll_deg: float = 0.0) -> PointView:
    angles = np.radians([roll_deg, pitch_deg, yaw_deg])
    pose = HeadPose(np.array([0.0, 0.0, 700.0]), head_quaternion_from_roll_pitch_yaw(angles))
    return PointView(stamp, np.zeros((10, 2)), np.ones(10), pose, np.zeros(5))


def seen(seed: int, count: int) -> list[tuple[tuple[int, int], float, PointView]]:
    """Cells, scores that all differ, and views in them, in the order of no time."""
    rng = np.random.default_rng(seed)
    stamps, scores = rng.permutation(count), rng.permutation(count) / count
    cells = [(int(yaw), int(pitch)) for yaw, pitch in rng.integers(-2, 3, (count, 2))]
    views = [
        view(
            int(stamp), *(CELL_DEG * (np.array(cell) + rng.uniform(-WITHIN, WITHIN, 2))), rng.uniform(-20, 20)
        )
        for stamp, cell in zip(stamps, cells, strict=True)
    ]
    return list(zip(cells, scores.tolist(), views, strict=True))


def album_of(frames: list[tuple[tuple[int, int], float, PointView]]) -> Album:
    album = Album()
    for _, score, one in frames:
        album = album.with_view(one, score)
    return album


def stamps_of(album: Album) -> list[int]:
    return [one.stamp_ns for one in album.views]


@given(seeds, st.integers(1, 60))
def test_keeps_the_best_of_every_cell(seed: int, count: int) -> None:
    frames, best = seen(seed, count), defaultdict(list)
    for cell, score, one in sorted(frames, key=lambda frame: -frame[1]):
        if len(best[cell]) < PER_CELL:
            best[cell].append((score, one.stamp_ns))
    album = album_of(frames)
    found = [[(score, one.stamp_ns) for score, one in page] for page in album.pages.values()]
    assert sorted(found) == sorted(best.values())


@given(seeds, st.integers(1, 60))
def test_views_are_in_the_order_of_time(seed: int, count: int) -> None:
    album = album_of(seen(seed, count))
    assert stamps_of(album) == sorted(stamps_of(album))
    assert len(album.views) == sum(len(page) for page in album.pages.values())


@given(seeds, st.integers(1, 60))
def test_the_order_of_adding_does_not_matter(seed: int, count: int) -> None:
    frames = seen(seed, count)
    shuffled = [frames[i] for i in np.random.default_rng([seed, 1]).permutation(count)]
    assert stamps_of(album_of(frames)) == stamps_of(album_of(shuffled))


def test_of_equal_scores_the_earlier_added_stay() -> None:
    album = Album()
    for stamp in range(PER_CELL + 2):
        album = album.with_view(view(stamp, 0.0, 0.0), 0.5)
    assert stamps_of(album) == list(range(PER_CELL))


def test_roll_is_no_other_direction() -> None:
    album = Album()
    for stamp, roll in enumerate((-30.0, 0.0, 10.0, 30.0)):
        album = album.with_view(view(stamp, 1.0, -1.0, roll), float(stamp))
    assert len(album.pages) == 1


def test_left_and_right_up_and_down_are_four_directions() -> None:
    album = Album()
    for stamp, (yaw, pitch) in enumerate([(20.0, 0.0), (-20.0, 0.0), (0.0, 20.0), (0.0, -20.0)]):
        album = album.with_view(view(stamp, yaw, pitch), 0.5)
    assert len(album.pages) == 4


def test_adding_leaves_the_album_before_as_it_was() -> None:
    before = Album().with_view(view(0, 0.0, 0.0), 0.5)
    before.with_view(view(1, 0.0, 0.0), 0.9).with_view(view(2, 30.0, 0.0), 0.9)
    assert stamps_of(before) == [0] and len(before.pages) == 1


# Which frames stay: against trying every one


ROUNDING = 1e-12


def view_at_random(rng, index=0):
    return PointView(index, np.zeros((10, 2)), np.ones(10), random_pose(rng), np.zeros(5))


def test_spread_is_the_variance_of_small_angles():
    yaw, pitch = 0.02 * np.random.default_rng(1).normal(size=(2, 50))
    facing = np.stack([np.sin(yaw), np.sin(pitch), -np.ones(50)], axis=1)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    wanted = np.var(yaw) + np.var(pitch)
    assert spread(facing) == pytest.approx(wanted, rel=10 * 0.02**2)


@given(st.integers(0, 10_000), st.integers(2, 8))
def test_as_printed_the_set_of_the_largest_variance_of_angles_is_chosen(seed, count):
    """4.3.2: of the n sets in which the new frame replaces one, against numpy's variance of each."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-70.0, 70.0, (count + 1, 2))
    *kept, new = [view(stamp, *one) for stamp, one in enumerate(angles)]
    variances = [np.var(np.delete(angles, left_out, axis=0), axis=0).sum() for left_out in range(count)]
    wanted = set(range(count + 1)) - {int(np.argmax(variances))}
    chosen = choose_views(kept, new, count, by_angles=True)
    assert {one.stamp_ns for one in chosen} == wanted and chosen[-1] is new


def test_directions_and_angles_disagree_near_the_pole():
    """At a pitch of 75 degrees 50 degrees of yaw are 13 of direction, less than 35 of pitch."""
    turned, level, new = view(0, 50.0, 75.0), view(1, 0.0, 40.0), view(2, 0.0, 75.0)
    assert choose_views([turned, level], new, 2, by_angles=True) == (turned, new)
    assert choose_views([turned, level], new, 2) == (level, new)


def test_spread_does_not_depend_on_axes():
    rng = np.random.default_rng(2)
    facing = np.array([random_pose(rng).facing for _ in range(7)])
    assert spread(facing @ random_pose(rng).rotation.T) == pytest.approx(spread(facing), abs=ROUNDING)


@given(st.integers(0, 10_000), st.integers(2, 8))
def test_spreads_without_each_are_those_of_the_others(seed, count):
    rng = np.random.default_rng(seed)
    facing = np.array([random_pose(rng).facing for _ in range(count)])
    wanted = [spread(np.delete(facing, i, axis=0)) for i in range(count)]
    np.testing.assert_allclose(spreads_without(facing), wanted, atol=ROUNDING)


@given(st.integers(0, 10_000), st.integers(1, 7))
def test_new_frame_replaces_the_one_that_leaves_most_variance(seed, count):
    rng = np.random.default_rng(seed)
    views, new = [view_at_random(rng, i) for i in range(count)], view_at_random(rng, count)
    found = choose_views(views, new, count)
    assert found[-1] is new and len(found) == count
    combinations = [[v for v in views if v is not out] + [new] for out in views]
    best = max(spread(np.array([v.pose.facing for v in one])) for one in combinations)
    assert spread(np.array([v.pose.facing for v in found])) == pytest.approx(best, abs=ROUNDING)


def test_while_there_are_few_frames_none_goes():
    rng = np.random.default_rng(3)
    views: tuple[PointView, ...] = ()
    for index in range(5):
        views = choose_views(views, view_at_random(rng, index), 5)
    assert [one.stamp_ns for one in views] == [0, 1, 2, 3, 4]


def test_of_equal_directions_the_oldest_goes():
    rng = np.random.default_rng(4)
    same = view_at_random(rng)
    views = tuple(PointView(i, same.pixels, same.weights, same.pose, same.deformation) for i in range(3))
    assert [one.stamp_ns for one in choose_views(views, view_at_random(rng, 3), 3)] == [1, 2, 3]


def test_too_many_frames_are_reduced():
    rng = np.random.default_rng(5)
    assert len(choose_views([view_at_random(rng, i) for i in range(6)], view_at_random(rng, 6), 3)) == 3
