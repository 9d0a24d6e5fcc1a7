"""One constant offset per joint: what another convention adds is taken out, errors stay."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions
from posetrack_cli.evaluation.reading.alignment import (
    AXES,
    MOST_MM,
    JointOffsets,
    OffsetFrame,
    bone_of_joints,
    remove_joint_offsets,
)
from posetrack_cli.evaluation.reading.tracks import Pairs, Track
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.model.anatomy import JOINT_NAMES, JOINT_PARENTS, make_anatomy
from posetrack_cli.hand.model.kinematics import skinning_transforms
from support.metrics import all_pairs
from support.tracks import random_hand

ANATOMY = make_anatomy()
SINGLE = 1e-4
"""mm: bones' rotations are float32, so an offset of 20 mm is turned to 2e-6 of its length."""


def offsets_of(seed: int = 3) -> FloatArray:
    return np.random.default_rng(seed).uniform(-20.0, 20.0, (len(JOINT_NAMES), 3))


def marked(track: Track, offsets: FloatArray, frame: OffsetFrame) -> Track:
    """The truth as someone marks it whose joints are off by ``offsets`` in these axes."""
    assert track.points is not None and track.position is not None
    assert track.quaternion is not None and track.shape is not None
    if frame == "camera":
        return replace(track, points=track.points + offsets)
    if frame == "palm":
        return replace(track, points=track.points + rotations.rotate(track.quaternion[:, None], offsets))
    points = track.points.copy()
    poses = np.hstack([track.position, track.quaternion, track.shape])
    for row, pose in enumerate(poses):
        bones = skinning_transforms(ANATOMY, pose[None])[0]
        for joint, name in enumerate(JOINT_NAMES):
            finger, part = divmod(joint - 1, 4)
            bone = 0 if name == "wrist" or part == 0 else 1 + 3 * finger + part - 1
            points[row, joint] += bones[bone, :, :3] @ offsets[joint]
    return replace(track, points=points)


def points_of(track: Track) -> FloatArray:
    assert track.points is not None
    return track.points


@pytest.mark.parametrize("frame", get_args(OffsetFrame))
def test_another_convention_is_taken_out_exactly(frame: OffsetFrame) -> None:
    track, offsets = random_hand(40), offsets_of()
    truth = marked(track, offsets, frame)
    without, removed = remove_joint_offsets(track, truth, all_pairs(40), ANATOMY, frame)
    assert removed is not None and removed.frame == frame and removed.names == JOINT_NAMES
    np.testing.assert_allclose(removed.offsets, offsets, atol=SINGLE)
    np.testing.assert_allclose(points_of(without), points_of(truth), atol=SINGLE)


def test_only_a_bone_s_axes_make_a_tip_s_offset_constant() -> None:
    """A tip marked 10 mm farther out along its finger: seen from palm or camera that goes round."""
    track, offsets = random_hand(200), np.zeros((len(JOINT_NAMES), 3))
    offsets[JOINT_NAMES.index("index_tip"), 1] = -10.0
    truth = marked(track, offsets, "bone")
    left = {}
    for frame in get_args(OffsetFrame):
        without, _ = remove_joint_offsets(track, truth, all_pairs(200), ANATOMY, frame)
        left[frame] = np.linalg.norm(points_of(without) - points_of(truth), axis=2).max()
    assert left["bone"] < SINGLE
    assert min(left["palm"], left["camera"]) > 5.0


def test_what_changes_from_frame_to_frame_stays() -> None:
    """White noise of 3 mm on every joint: a constant takes out no more of it than a mean of n does."""
    track, frames = random_hand(400), 400
    noise = 3.0 * np.random.default_rng(1).standard_normal((frames, len(JOINT_NAMES), 3))
    truth = replace(track, points=points_of(track) + noise)
    without, removed = remove_joint_offsets(track, truth, all_pairs(frames), ANATOMY)
    assert removed is not None
    # the median of n normal numbers has an sd of sqrt(pi / 2n); 63 of them stay below five
    assert np.abs(removed.offsets).max() < 5.0 * 3.0 * math.sqrt(math.pi / (2.0 * frames))
    before = np.linalg.norm(noise, axis=2).mean()
    after = np.linalg.norm(points_of(without) - points_of(truth), axis=2).mean()
    assert after == pytest.approx(before, rel=0.01)


def test_frames_that_are_far_off_do_not_pull_the_offset() -> None:
    """A third of the frames has another hand's pose; the mean would be off by centimetres."""
    track, offsets = random_hand(90), offsets_of()
    truth = marked(track, offsets, "bone")
    wrong = points_of(truth).copy()
    wrong[::3] += 150.0
    without, removed = remove_joint_offsets(track, replace(truth, points=wrong), all_pairs(90), ANATOMY)
    assert removed is not None
    # the median lies among the right frames, whose differences are all the same
    np.testing.assert_allclose(removed.offsets, offsets, atol=10 * SINGLE)
    np.testing.assert_allclose(points_of(without)[1::3], wrong[1::3], atol=10 * SINGLE)


def test_lost_frames_say_nothing_but_are_moved_like_the_others() -> None:
    track, offsets = random_hand(30), offsets_of()
    truth = marked(track, offsets, "palm")
    lost = np.arange(30) < 20
    wrong = points_of(truth).copy()
    wrong[lost] += 500.0
    track = replace(track, lost=lost)
    without, removed = remove_joint_offsets(
        track, replace(truth, points=wrong), all_pairs(30), ANATOMY, "palm"
    )
    assert removed is not None
    np.testing.assert_allclose(removed.offsets, offsets, atol=SINGLE)
    np.testing.assert_allclose(points_of(without), points_of(truth), atol=SINGLE)


def test_rows_are_paired_not_numbered() -> None:
    track, offsets = random_hand(10), offsets_of()
    truth = marked(track, offsets, "bone")
    later = replace(truth, stamp_ns=truth.stamp_ns[4:], points=points_of(truth)[4:])
    pairs = Pairs(np.arange(4, 10), np.arange(6))
    without, removed = remove_joint_offsets(track, later, pairs, ANATOMY)
    assert removed is not None
    np.testing.assert_allclose(removed.offsets, offsets, atol=SINGLE)
    np.testing.assert_allclose(points_of(without), points_of(truth), atol=SINGLE)


def test_long_tracks_are_moved_block_by_block(monkeypatch: pytest.MonkeyPatch) -> None:
    track, offsets = random_hand(23), offsets_of()
    truth = marked(track, offsets, "bone")
    whole, _ = remove_joint_offsets(track, truth, all_pairs(23), ANATOMY)
    monkeypatch.setattr("posetrack_cli.evaluation.reading.alignment.BLOCK_FRAMES", 5)
    blocks, _ = remove_joint_offsets(track, truth, all_pairs(23), ANATOMY)
    np.testing.assert_array_equal(points_of(blocks), points_of(whole))


def test_a_joint_belongs_to_the_bone_that_ends_in_it() -> None:
    bones = dict(zip(JOINT_NAMES, bone_of_joints(JOINT_NAMES).tolist(), strict=True))
    assert {bones[name] for name in ("wrist", "thumb_cmc", "index_mcp", "little_mcp")} == {0}
    assert [bones[f"thumb_{joint}"] for joint in ("mcp", "ip", "tip")] == [1, 2, 3]
    assert [bones[f"little_{joint}"] for joint in ("pip", "dip", "tip")] == [13, 14, 15]
    for name, parent in zip(JOINT_NAMES[1:], JOINT_PARENTS[1:], strict=True):
        assert bones[name] in (0, bones[JOINT_NAMES[parent]] + 1) or bones[JOINT_NAMES[parent]] == 0


def test_offsets_too_large_for_a_convention_are_doubted() -> None:
    small = JointOffsets(("wrist", "thumb_tip"), "palm", np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 15.0]]))
    assert small.note == ("removed constant offset of each joint in palm axes: mean 10.0 mm, max 15.0 mm")


def test_what_is_too_long_for_a_convention_stays_an_error_and_its_joint_is_named() -> None:
    """Of 90 mm 25 are removed, in the same direction; every other joint as before."""
    track, offsets = random_hand(20), offsets_of()
    place = JOINT_NAMES.index("ring_pip")
    offsets[place] = [0.0, 54.0, -72.0]
    truth = marked(track, offsets, "bone")
    without, removed = remove_joint_offsets(track, truth, all_pairs(20), ANATOMY)
    assert removed is not None and removed.capped == ("ring_pip",)
    others = np.arange(len(JOINT_NAMES)) != place
    np.testing.assert_allclose(removed.offsets[others], offsets[others], atol=SINGLE)
    np.testing.assert_allclose(removed.offsets[place], [0.0, 15.0, -20.0], atol=SINGLE)
    left = np.linalg.norm(points_of(without) - points_of(truth), axis=2)
    np.testing.assert_allclose(left[:, others], 0.0, atol=SINGLE)
    np.testing.assert_allclose(left[:, place], 90.0 - MOST_MM, atol=SINGLE)
    assert removed.note.endswith("max 25.0 mm; limited to 25 mm for ring_pip, as larger offsets are errors")


def test_offsets_of_some_joints_leave_the_others() -> None:
    track, chosen = random_hand(20), [12, 3]
    truth = marked(track, offsets_of(), "bone")
    names = tuple(JOINT_NAMES[k] for k in chosen)
    some = replace(truth, point_names=names, points=points_of(truth)[:, chosen])
    _, removed = remove_joint_offsets(track, some, all_pairs(20), ANATOMY)
    assert removed is not None
    np.testing.assert_allclose(removed.offsets[chosen], offsets_of()[chosen], atol=SINGLE)
    assert not np.delete(removed.offsets, chosen, axis=0).any()


def test_without_pairs_nothing_is_removed() -> None:
    none = Pairs(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
    track = random_hand(3)
    assert remove_joint_offsets(track, random_hand(3, 1), none, ANATOMY) == (track, None)


def test_what_cannot_be_compared_is_refused() -> None:
    track = random_hand(3)
    with pytest.raises(UsageError, match="cannot remove joint offsets: the ground truth has no points"):
        remove_joint_offsets(track, replace(track, points=None), all_pairs(3), ANATOMY)
    with pytest.raises(UsageError, match="the result has no quaternion"):
        remove_joint_offsets(replace(track, quaternion=None), track, all_pairs(3), ANATOMY)
    with pytest.raises(UsageError, match="different joints"):
        remove_joint_offsets(track, replace(track, point_names=("a",) * 21), all_pairs(3), ANATOMY)
    with pytest.raises(UsageError, match=r"unknown frame.*found 'skin', expected one of bone, palm, camera"):
        EvalOptions(joint_offsets="skin")  # type: ignore[arg-type]
    assert set(AXES) == set(get_args(OffsetFrame))
