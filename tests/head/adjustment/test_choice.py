"""Which frames stay: against trying every one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.head.adjustment.views import PointView, choose_views, spread, spreads_without
from support.bundles import random_pose

ROUNDING = 1e-12


def view(rng, index=0):
    return PointView(index, np.zeros((10, 2)), np.ones(10), random_pose(rng), np.zeros(5))


def test_spread_is_the_variance_of_small_angles():
    yaw, pitch = 0.02 * np.random.default_rng(1).normal(size=(2, 50))
    facing = np.stack([np.sin(yaw), np.sin(pitch), -np.ones(50)], axis=1)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    wanted = np.var(yaw) + np.var(pitch)
    assert spread(facing) == pytest.approx(wanted, rel=10 * 0.02**2)


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
    views, new = [view(rng, i) for i in range(count)], view(rng, count)
    found = choose_views(views, new, count)
    assert found[-1] is new and len(found) == count
    combinations = [[v for v in views if v is not out] + [new] for out in views]
    best = max(spread(np.array([v.pose.facing for v in one])) for one in combinations)
    assert spread(np.array([v.pose.facing for v in found])) == pytest.approx(best, abs=ROUNDING)


def test_while_there_are_few_frames_none_goes():
    rng = np.random.default_rng(3)
    views: tuple[PointView, ...] = ()
    for index in range(5):
        views = choose_views(views, view(rng, index), 5)
    assert [one.stamp_ns for one in views] == [0, 1, 2, 3, 4]


def test_of_equal_directions_the_oldest_goes():
    rng = np.random.default_rng(4)
    same = view(rng)
    views = tuple(PointView(i, same.pixels, same.weights, same.pose, same.deformation) for i in range(3))
    assert [one.stamp_ns for one in choose_views(views, view(rng, 3), 3)] == [1, 2, 3]


def test_too_many_frames_are_reduced():
    rng = np.random.default_rng(5)
    assert len(choose_views([view(rng, i) for i in range(6)], view(rng, 6), 3)) == 3
