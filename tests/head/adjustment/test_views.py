"""The frames kept of every direction: against keeping all and choosing at the end."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.geometry.euler import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.adjustment.views import CELL_DEG, PER_CELL, Album, PointView
from posetrack_cli.head.face.pose import HeadPose

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
