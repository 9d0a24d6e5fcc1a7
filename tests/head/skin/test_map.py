"""Maps of a smooth face that is drawn exactly, and poses on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rigid import in_camera
from posetrack_cli.geometry.rotations import canonical, exponential, multiply
from posetrack_cli.head.face.points import POSE_SIZE, HeadPose
from posetrack_cli.head.skin.map import (
    ALIKE,
    LEAST_VIEWS,
    NEAR,
    POINTS,
    SkinMap,
    _at_prior_distance,
    _in_prior_frame,
    _share,
    make_map,
    pose_on_map,
)
from posetrack_cli.head.skin.map import ERROR_DEG as SKIN_ERROR_DEG
from posetrack_cli.head.skin.matching import HEIGHT, WIDTH, place_crop, surface_of, to_image, views_for
from support.mono_cases import assert_same
from support.skin_scene import CAMERA, FRAME_NS, SHAPE, depths, drawn, even, pose_at, shown

VIEWS, ERROR_DEG = 16, 4.0
LEFT_DEG = 0.5
"""Of rotations, less what all are turned by. The 480 places are found to .1 px; what counts is that they lie
1 mm beside their depths: turned by 14 degrees that is .25 mm aside, of arms of 40 mm .35 degrees."""
TOGETHER_DEG = 1.5
"""By how much all may be turned: the rough surface is as tilted, 2 mm over 80."""
DEPTH_MM = 2.0
"""About a plane, of what some tenths of a pixel say of depth with 14 degrees of turn: .3 px of .3 px a mm."""


def turns(poses: HeadPose, true: Sequence[HeadPose]) -> FloatArray:
    """(n, 3) rotations of poses (n) against others, degrees."""
    return np.degrees(poses.difference(HeadPose.stacked(true))[:, 3:])


def spread(errors: FloatArray) -> float:
    """Root mean square of rotations, degrees, less their mean."""
    return float(np.sqrt(np.mean(np.sum((errors - errors.mean(axis=0)) ** 2, axis=1))))


def made(error_deg: float = ERROR_DEG) -> SkinMap:
    found = make_map(shown(VIEWS, error_deg).views, SHAPE, (CAMERA,))
    assert found is not None
    return found


@pytest.fixture(scope="module")
def known() -> SkinMap:
    """A map whose poses were told with an error of yaw."""
    return made()


# Making one


def test_poses_of_a_map_are_nearer_to_the_truth_than_they_were_told(known: SkinMap) -> None:
    """Nothing but the skin tells: an error that goes otherwise than the head turns fits no surface."""
    frames = shown(VIEWS, ERROR_DEG)
    before = turns(HeadPose.stacked([one.view.pose for one in frames.views]), frames.true)
    after = turns(known.poses, frames.true)
    assert spread(before) > 2.5 and spread(after) < LEFT_DEG
    assert np.abs(after.mean(axis=0)).max() < TOGETHER_DEG


def test_exact_poses_stay_about_where_they_are() -> None:
    found, frames = made(0.0), shown(VIEWS, 0.0)
    assert spread(turns(found.poses, frames.true)) < LEFT_DEG
    assert found.share < 0.1, "there is nothing that the skin knows better"


def test_points_come_to_lie_on_the_face(known: SkinMap) -> None:
    """But for how far away, and how much tilted, it is as a whole."""
    away = known.points[:, 2] - depths(known.points[:, :2])
    plane = np.column_stack([np.ones(len(away)), known.points[:, :2]])
    away -= plane @ np.linalg.lstsq(plane, away, rcond=None)[0]
    begun = surface_of(SHAPE).points
    start = begun[:, 2] - depths(begun[:, :2])
    assert np.std(away) < DEPTH_MM < np.std(start)


def test_a_map_holds_its_views_and_each_point_once(known: SkinMap) -> None:
    views = shown(VIEWS, ERROR_DEG).views
    assert known.stamps.tolist() == [FRAME_NS * index for index in range(VIEWS)]
    np.testing.assert_array_equal(known.crops, [one.crops for one in views])
    assert len(known.images) == len(known.places) == len(known.points)
    counts = [known.of_image(index).stop - known.of_image(index).start for index in range(VIEWS)]
    assert sum(counts) == len(known.points) and 0 < min(counts) <= max(counts) <= POINTS
    for index in range(VIEWS):
        assert set(known.images[known.of_image(index)]) == {index}
    assert np.all(known.places >= 0.0) and np.all(known.places < [WIDTH, HEIGHT])


ROUNDING_MM = 1e-9
"""Of numbers below 1000."""


def test_heads_are_as_far_away_as_they_were_told_to_be(known: SkinMap) -> None:
    """On the whole, to the few of 700 mm by which the frame then sits elsewhere in the head."""
    told = np.array([one.view.pose.position for one in shown(VIEWS, ERROR_DEG).views])
    ratios = np.linalg.norm(told, axis=1) / np.linalg.norm(known.poses.position, axis=1)
    assert np.median(np.log(ratios)) == pytest.approx(0.0, abs=0.005)


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 2.0), st.integers(1, 9))
def test_a_map_of_another_size_looks_the_same(seed: int, size: float, count: int) -> None:
    rng = np.random.default_rng(seed)
    told = HeadPose.stacked([pose_at(index) for index in rng.uniform(0.0, 20.0, count)])
    larger = replace(told, position=size * told.position)
    points = rng.normal(0.0, 30.0, (5, 3))
    poses, scaled = _at_prior_distance(larger, points, told)
    np.testing.assert_allclose(poses.position, told.position, rtol=1e-9)
    for index in range(count):
        seen = poses.of_frame(index).points(scaled)
        looked = larger.of_frame(index).points(points)
        np.testing.assert_allclose(seen[:, :2] / seen[:, 2:], looked[:, :2] / looked[:, 2:], atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.integers(1, 9))
def test_a_map_in_another_head_frame_looks_the_same(seed: int, count: int) -> None:
    """And its poses are then, on average, those that were told."""
    rng = np.random.default_rng(seed)
    told = HeadPose.stacked([pose_at(index) for index in rng.uniform(0.0, 20.0, count)])
    other = HeadPose(rng.normal(0.0, 5.0, 3), exponential(rng.normal(0.0, 0.1, 3)))
    turned = canonical(multiply(told.quaternion, other.quaternion))
    before = HeadPose(in_camera(other.position, told.position, told.quaternion), turned)
    points = rng.normal(0.0, 30.0, (5, 3))
    poses, moved = _in_prior_frame(before, points, told)
    np.testing.assert_allclose(poses.difference(told), 0.0, atol=ROUNDING_MM)
    for index in range(count):
        one, was = poses.of_frame(index), before.of_frame(index)
        np.testing.assert_allclose(one.points(moved), was.points(points), atol=ROUNDING_MM)


def test_a_head_at_the_camera_has_no_size() -> None:
    """Nor has it any other become NaN."""
    told = HeadPose.stacked([replace(pose_at(0), position=np.zeros(3)), pose_at(1), pose_at(2)])
    poses, points = _at_prior_distance(told, np.ones((2, 3)), told)
    np.testing.assert_allclose(points, 1.0)
    assert np.isfinite(poses.position).all()


@given(st.lists(st.integers(0, 6), max_size=30), st.integers(0, 3))
def test_points_of_a_view_are_found_by_their_bounds(views: list[int], more: int) -> None:
    """Also where a view, the last ones too, has none."""
    owners = np.array(sorted(views), dtype=np.int64)
    count = int(max(views, default=0)) + 1 + more
    nothing = np.zeros((len(views), 2))
    poses = HeadPose(np.zeros((count, 3)), np.zeros((count, 4)))
    found = SkinMap(
        np.arange(count), np.zeros((count, 1, 1, 1), np.uint8), poses, owners, nothing, nothing, 0.5
    )
    for index in range(count):
        np.testing.assert_array_equal(
            np.arange(len(views))[found.of_image(index)], np.flatnonzero(owners == index)
        )


def test_too_few_views_make_none() -> None:
    views = shown(VIEWS, 0.0).views
    assert make_map(views[: LEAST_VIEWS - 1], SHAPE, (CAMERA,)) is None
    assert make_map(views[:LEAST_VIEWS], SHAPE, (CAMERA,)) is not None
    assert make_map([], SHAPE, (CAMERA,)) is None


def test_even_views_make_none() -> None:
    views = [
        replace(one, crops=np.full((1, HEIGHT, WIDTH), 128, np.uint8)) for one in shown(VIEWS, 0.0).views
    ]
    assert make_map(views, SHAPE, (CAMERA,)) is None


def test_a_view_in_which_nothing_is_seen_stays_as_it_is_told() -> None:
    """But for what all heads are turned and moved by to lie, on average, as they are told to."""
    views = list(shown(VIEWS, 0.0).views)
    views[5] = replace(views[5], crops=np.full((1, HEIGHT, WIDTH), 128, np.uint8))
    found = make_map(views, SHAPE, (CAMERA,))
    assert found is not None and found.of_image(5).start == found.of_image(5).stop
    told, there = views[5].view.pose, found.poses.of_frame(5)
    assert np.degrees(np.linalg.norm(told.difference(there)[3:])) < TOGETHER_DEG
    np.testing.assert_allclose(there.position, told.position, atol=0.02 * told.position[2])


def test_equal_views_make_equal_maps(known: SkinMap) -> None:
    assert_same(made(), known)


# How far it is believed


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 3.0), st.integers(1, 30))
def test_it_is_believed_the_more_the_two_are_apart_and_never_alone(
    seed: int, size: float, count: int
) -> None:
    apart = size * np.random.default_rng(seed).normal(size=(count, POSE_SIZE))
    share = _share(apart, SKIN_ERROR_DEG)
    assert 0.0 <= share < 1.0
    assert share <= _share(1.5 * apart, SKIN_ERROR_DEG)


@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
def test_where_both_agree_but_for_a_turn_of_all_it_is_not_believed(seed: int, count: int) -> None:
    """Which of them is turned nothing tells; and where heads are, the share does not ask."""
    rng = np.random.default_rng(seed)
    apart = np.hstack([rng.normal(size=(count, 3)), np.tile(rng.normal(size=3), (count, 1))])
    assert _share(apart, SKIN_ERROR_DEG) == 0.0


def test_half_is_believed_where_they_are_apart_by_its_own_error() -> None:
    apart = np.zeros((4, POSE_SIZE))
    apart[:, 4] = np.radians(SKIN_ERROR_DEG) * np.array([1.0, -1.0, 1.0, -1.0])
    assert _share(apart, SKIN_ERROR_DEG) == pytest.approx(0.5)


def test_a_map_of_poses_told_wrongly_is_believed(known: SkinMap) -> None:
    """Yaw errs by 4 sin, 2.8 degrees root mean square: as the share says of that."""
    squared = 0.5 * ERROR_DEG**2
    assert known.share == pytest.approx(squared / (squared + SKIN_ERROR_DEG**2), abs=0.1)


# A pose on it


def located(known: SkinMap, index: float, told: HeadPose) -> HeadPose:
    """Where a frame's head is that is not one of the map's."""
    image = drawn(pose_at(index), seed=1000 + round(10 * index))
    return pose_on_map(known, (image,), round(index * FRAME_NS), told, (CAMERA,)).pose


def disturbed(index: float, yaw_deg: float = 2.5) -> HeadPose:
    return pose_at(index).moved(np.concatenate([np.zeros(4), [np.radians(yaw_deg)], [0.0]]))


@pytest.mark.parametrize("index", [2.5, 7.3, 13.6])
@pytest.mark.parametrize("yaw_deg", [2.5, -3.0])
def test_a_pose_told_wrongly_comes_to_where_the_map_has_it(
    known: SkinMap, index: float, yaw_deg: float
) -> None:
    """Believed in full: turned as all of the map's poses are, and wrong by no more than they are."""
    together = turns(known.poses, shown(VIEWS, ERROR_DEG).true).mean(axis=0)
    found = located(replace(known, share=1.0), index, disturbed(index, yaw_deg))
    away = turns(HeadPose.stacked([found]), [pose_at(index)])[0] - together
    assert np.linalg.norm(away) < LEFT_DEG + 0.25  # what is told counts a little, too: one part in ten


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
def test_a_pose_goes_as_far_as_the_map_is_believed(known: SkinMap, share: float) -> None:
    """Straight from what is told to where the skin is."""
    told = disturbed(7.3)
    whole = told.difference(located(replace(known, share=1.0), 7.3, told))
    found = told.difference(located(replace(known, share=share), 7.3, told))
    np.testing.assert_allclose(found, share * whole, atol=1e-9)
    nearer = [np.linalg.norm(one.difference(pose_at(7.3))[3:]) for one in (told, told.moved(found))]
    assert share == 0.0 or nearer[1] < nearer[0]


@pytest.mark.parametrize("every", [1, 3, 4, 6, 30])
def test_few_points_count_the_more_of_them_there_are(known: SkinMap, every: int) -> None:
    """In proportion, from none of those that say nothing to all of those that say all; else to the bit."""
    told, index = disturbed(7.3), 7.3
    parts = {name: getattr(known, name)[::every] for name in ("images", "places", "points")}
    thin, stamp_ns = replace(known, **parts), round(index * FRAME_NS)
    pose, share, unmatched = pose_on_map(thin, (drawn(pose_at(index), seed=1073),), stamp_ns, told, (CAMERA,))
    away = np.abs(known.stamps - stamp_ns).astype(np.float64)
    chosen = views_for(told.quaternion, away, known.poses.quaternion, NEAR, ALIKE)
    looked_for = sum(len(thin.places[thin.of_image(view)]) for view in chosen)
    count = round((1.0 - unmatched) * looked_for)
    assert share == pytest.approx(known.share * np.clip((count - 15) / 45, 0.0, 1.0))
    assert (pose is told) == (count <= 15)
    assert (count > 60, count <= 15) == (every == 1, every == 30)


def test_an_even_image_leaves_what_is_told(known: SkinMap) -> None:
    told = disturbed(7.3)
    pose, share, unmatched = pose_on_map(known, (even(),), 0, told, (CAMERA,))
    assert pose is told and (share, unmatched) == (0.0, 1.0)


def test_skin_that_is_covered_is_not_found(known: SkinMap) -> None:
    """Of the whole face nearly all is; of one whose lower part is even, no more than a part."""
    index, told = 7.3, pose_at(7.3)
    image = drawn(told, seed=1)
    below = round(float(to_image(place_crop(CAMERA, told), np.array([0.0, 0.4 * HEIGHT]))[1]))
    covered = image.copy()
    covered[below:] = 128
    unmatched = [
        pose_on_map(known, (one,), round(index * FRAME_NS), told, (CAMERA,)).unmatched
        for one in (image, covered)
    ]
    assert unmatched[0] < 0.15 and 0.3 < unmatched[1] < 0.8


def test_a_face_outside_the_image_is_where_it_is_told(known: SkinMap) -> None:
    told = disturbed(7.3).moved(np.array([2000.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    pose, share, unmatched = pose_on_map(known, (drawn(pose_at(7.3)),), 0, told, (CAMERA,))
    assert pose is told and (share, unmatched) == (0.0, 1.0)


def test_a_map_without_views_that_look_alike_leaves_what_is_told(known: SkinMap) -> None:
    """Turned away by 60 degrees."""
    told = disturbed(7.3, 60.0)
    pose, share, unmatched = pose_on_map(known, (drawn(told),), 0, told, (CAMERA,))
    assert pose is told and (share, unmatched) == (0.0, 1.0)
