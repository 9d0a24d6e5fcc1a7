"""Recordings of few frames: stills, large strides, dropped frames."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand import tracker as hand_tracker
from posetrack_cli.hand.config import HandConfig, StatusSettings
from posetrack_cli.hand.policy import TrackMonitor
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.confidence import MEMORY, RunningSigns
from support.hand_scene import HANDS, Stage, relaxed, tracker

HAND = HANDS["right"]
FIT_MM = 8.0
"""Mean joint error of a clearly visible hand of known shape: measured 1 to 3 mm."""


def stills() -> list[FloatArray]:
    """A hand at another place in every image, half of the time a fist."""
    places = ((-120.0, 40.0, 600.0), (110.0, 80.0, 750.0), (0.0, 20.0, 650.0), (-60.0, 90.0, 820.0))
    poses = [relaxed(*place, turn=(0.1 * k, 0.2 - 0.1 * k, 0.3 * k)) for k, place in enumerate(places)]
    for pose in poses[1::2]:
        pose[[10, 12, 13, 15, 16, 18, 19, 21]] += 0.9
    return poses


@pytest.mark.parametrize("seconds", [0.2, 1.0])
def test_a_hand_that_may_be_anywhere_after_a_gap_is_found_in_every_image(
    device: RenderingDevice, seconds: float
) -> None:
    poses, stage, follower = stills(), Stage(device, HAND), tracker(device, HAND)
    rng, state = np.random.default_rng(1), cast(Any, None)
    for k, pose in enumerate(poses):
        frame = Frame(k, round(k * seconds * 1e9), (stage.depth(pose),))
        state = follower.start_unknown(relaxed(), frame, rng) if state is None else state
        state, estimate = follower.step(state, frame, rng)
        found = np.concatenate([estimate.position, estimate.quaternion, estimate.shape])
        assert estimate.status is not Status.LOST and stage.error(found, pose) < FIT_MM


def test_a_sign_after_a_gap_counts_like_as_many_equal_ones() -> None:
    once = many = RunningSigns(np.array([1.0, -2.0]), 100)
    new = np.array([3.0, 4.0])
    for _ in range(6):
        many = many.after(new)
    np.testing.assert_allclose(once.after(new, 6).signs, many.signs, rtol=1e-12)
    assert once.after(new).signs[0] == 1.0 + MEMORY * 2.0


def test_a_miss_after_a_gap_counts_like_as_many_misses() -> None:
    status = StatusSettings()
    few = status.lost_after_frames - 1
    assert not TrackMonitor().after_miss(status, few).lost
    assert TrackMonitor().after_miss(status, status.lost_after_frames).lost


def clear_estimate(device: RenderingDevice, **status: float) -> Estimate:
    """The estimate of a clear frame with some settings of status."""
    pose, config = relaxed(), HandConfig.model_validate({"status": status})
    frame = Frame(0, 0, (Stage(device, HAND).depth(pose),))
    follower, rng = tracker(device, HAND, config), np.random.default_rng(1)
    return follower.step(follower.start_unknown(pose, frame, rng), frame, rng)[1]


def test_doubt_about_side_or_size_is_part_of_the_confidence(device: RenderingDevice) -> None:
    """A clear frame of a hand that is the right one with probability .4: as likely wrong, so it is lost."""
    confidences = []
    for probability in (1.0, 0.4):
        estimate = clear_estimate(device, hand_probability=probability)
        assert (estimate.status is Status.LOST) == (probability < 0.5)
        confidences.append(estimate.confidence)
    assert confidences[1] == pytest.approx(0.4 * confidences[0], rel=1e-6)


def test_doubt_about_a_shape_lowers_the_log_odds(device: RenderingDevice) -> None:
    confidences = [clear_estimate(device, shape_doubt=doubt).confidence for doubt in (0.0, 4.0)]
    odds = [one / (1.0 - one) for one in confidences]
    assert odds[1] == pytest.approx(odds[0] * np.exp(-4.0), rel=1e-6)


def test_a_doubtful_start_is_dropped_and_the_next_frame_searched(
    device: RenderingDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The hand then starts as in its first frame: with no sign of the doubtful one, and not reinitialised."""
    pose, follower, rng = relaxed(), tracker(device, HAND, HandConfig()), np.random.default_rng(1)
    frames = [Frame(k, k * 33_333_333, (Stage(device, HAND).depth(pose),)) for k in range(2)]
    start = follower.start_unknown(pose, frames[0], rng)
    with monkeypatch.context() as doubtful:
        doubtful.setattr(hand_tracker, "probability", lambda *arguments: 0.1)
        state, estimate = follower.step(start, frames[0], rng)
    assert estimate.status is Status.LOST and state.monitor == start.monitor
    state, estimate = follower.step(state, frames[1], rng)
    assert estimate.status is Status.TRACKING and state.evidence.frames == 1
