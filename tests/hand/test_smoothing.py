"""A hand's smoothed track: chains, gaps and interruptions, against a smoother called by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from posetrack_cli.filtering.filters import MarginalState, ParticleState, Prior
from posetrack_cli.filtering.model import FilterModel
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.smoothing import Smoothed
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.local_fits import FOREARM_CONFIDENCE, INNER
from posetrack_cli.hand.fit.skeleton import NO_INNER, inner_of
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.model.hand import dynamics
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.smoothing import make_smoother, smoothed_hand
from posetrack_cli.hand.start import forearm_confidence_of, rest_pose
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.smoothing import FrameFacts, Kept, SmoothedTrack
from posetrack_cli.tracking.velocity import BodySpace, pose_rates

ANATOMY, SPACE = make_anatomy(), BodySpace()
HAND = smoothed_hand(ANATOMY)
START = rest_pose(ANATOMY, np.array([0.0, 0.0, 650.0]))
DT, FRAME_NS, BEGAN_NS = 1.0 / 30.0, 33_333_333, 1_700_000_000_123_456_789
SD = np.concatenate([np.full(3, 2.0), np.full(18, 0.05)])


def configured(kind: str = "rbpf") -> HandConfig:
    """Of a proposal that fits no frames."""
    return HandConfig.model_validate({"filter": {"kind": kind, "proposal": "marginal"}})


def smoother(kind: str = "rbpf"):
    config = configured(kind)
    return make_smoother(config, dynamics(config))


def tracked(frames: int, seed: int = 0) -> list[MarginalState]:
    """The filter's states after frames that each show the rest pose, more or less."""
    rng, model = np.random.default_rng(seed), dynamics(configured())
    state, states = MarginalState.initial(Prior(START, SD, 2.0 * SD), 40, SPACE, rng), []
    for _ in range(frames):
        seen = SPACE.retract(START[None], SD * rng.standard_normal((1, 21)))[0]
        state, _ = state.step(
            DT,
            FilterModel(model, SPACE, Resampling()),
            lambda x, seen=seen: -0.5 * np.square(SPACE.local(seen, x) / (10.0 * SD)).sum(axis=1),
            rng,
        )
        states.append(state)
    return states


def estimate(index: int, status: Status = Status.TRACKING) -> Estimate:
    """What the run wrote of a frame; of it only these four come back."""
    blank = np.zeros(21)
    return Estimate(
        frame_index=index,
        stamp_ns=BEGAN_NS + index * FRAME_NS,
        status=status,
        confidence=0.5 + 0.01 * index,
        position=START[:3],
        quaternion=START[3:7],
        shape=START[7:],
        pose_rate=np.zeros(22),
        twist=blank,
        pose_variance=blank,
        twist_variance=blank,
        points=np.zeros((21, 3)),
        effective_sample_size=40.0,
        resampled=True,
    )


def assert_same(found: Estimate, expected: Smoothed) -> None:
    pose = np.concatenate([found.position, found.quaternion, found.shape])
    np.testing.assert_array_equal(pose, expected.pose)
    np.testing.assert_array_equal(found.pose_variance, expected.pose_variance)
    np.testing.assert_array_equal(found.twist, expected.velocity)
    np.testing.assert_array_equal(found.twist_variance, expected.velocity_variance)
    np.testing.assert_array_equal(found.points, joint_positions(ANATOMY, pose[None])[0])
    np.testing.assert_array_equal(found.pose_rate, pose_rates(pose, expected.velocity))


def by_hand(states: list[MarginalState], steps: list[float]) -> list[Smoothed]:
    """One chain, smoothed without a file; steps lead to each state but the first."""
    way = smoother()
    smoothed = [way.begin(way.remember(states[-1]))]
    for state, dt in zip(states[-2::-1], steps[::-1], strict=True):
        smoothed.append(way.back(way.remember(state), dt))
    return smoothed[::-1]


def remember(track: SmoothedTrack, states, first: int = 0, **options) -> None:
    for index, state in enumerate(states, first):
        track.remember(state, FrameFacts.of(estimate(index)), DT, cut=index == 0, **options)


def test_a_chain_is_smoothed_as_by_hand(tmp_path: Path) -> None:
    states = tracked(6)
    with SmoothedTrack(tmp_path / "spool", smoother(), HAND) as track:
        remember(track, states)
        found = list(track.backward())[::-1]
    for index, (one, expected) in enumerate(zip(found, by_hand(states, [DT] * 5), strict=True)):
        assert (one.frame_index, one.stamp_ns) == (index, BEGAN_NS + index * FRAME_NS)
        assert (one.status, one.confidence) == (Status.TRACKING, 0.5 + 0.01 * index)
        assert_same(one, expected)


def test_the_thumb_of_each_frame_is_the_fits(tmp_path: Path) -> None:
    """Poses are smoothed, inner numbers are those that were kept of a frame."""
    states, inner = tracked(3), np.array([0.0, 1.0, 0.0, 0.1, 0.3, -0.2])
    with SmoothedTrack(tmp_path / "spool", smoother(), HAND) as track:
        for index, state in enumerate(states):
            kept = {INNER: inner * (1.0 if index == 1 else 0.0), FOREARM_CONFIDENCE: 0.25 * index}
            track.remember(state, FrameFacts.of(estimate(index)), DT, cut=index == 0, frame=kept)
        found = list(track.backward())[::-1]
    pose = np.concatenate([found[1].position, found[1].quaternion, found[1].shape])
    np.testing.assert_allclose(inner_of(found[1].numbers), inner)
    np.testing.assert_array_equal(found[1].points, joint_positions(ANATOMY, pose[None], inner[4:])[0])
    np.testing.assert_array_equal(inner_of(found[2].numbers), NO_INNER)
    assert forearm_confidence_of(found[1].numbers) == 0.25
    assert np.isnan(forearm_confidence_of(found[2].numbers))  # which has no forearm


def test_what_was_found_anew_says_nothing_about_before(tmp_path: Path) -> None:
    before, after = tracked(3, seed=1), tracked(3, seed=2)
    with SmoothedTrack(tmp_path / "spool", smoother(), HAND) as track:
        for index, state in enumerate(before + after):
            status = Status.REINITIALISED if index == 3 else Status.TRACKING
            track.remember(state, FrameFacts.of(estimate(index, status)), DT, cut=index in (0, 3))
        found = list(track.backward())[::-1]
    expected = [chain for states in (before, after) for chain in by_hand(states, [DT] * 2)]
    for one, smoothed in zip(found, expected, strict=True):
        assert_same(one, smoothed)
    assert [one.status for one in found].index(Status.REINITIALISED) == 3


def test_a_filter_that_stood_still_has_one_estimate_for_all_its_frames(tmp_path: Path) -> None:
    """With nothing seen for long the filter is not advanced: dt is 0, and the state the same."""
    states = tracked(3)
    standing = [states[0], states[1], states[1], states[1], states[2]]
    steps = [DT, 4.0 * DT, 0.0, 0.0, 2.0 * DT]
    with SmoothedTrack(tmp_path / "spool", smoother(), HAND) as track:
        for index, (state, dt) in enumerate(zip(standing, steps, strict=True)):
            track.remember(state, FrameFacts.of(estimate(index, Status.LOST)), dt, cut=index == 0)
        found = list(track.backward())[::-1]
    expected = by_hand(states, [4.0 * DT, 2.0 * DT])
    for one, smoothed in zip(found, [expected[i] for i in (0, 1, 1, 1, 2)], strict=True):
        assert_same(one, smoothed)
    assert all(one.status is Status.LOST for one in found)


def test_a_resumed_run_smooths_the_same(tmp_path: Path) -> None:
    states, path = tracked(6), tmp_path / "spool"
    with SmoothedTrack(path, smoother(), HAND) as track:
        remember(track, states[:5])
        track.flush()
    kept = Kept(3, states[5])  # two frames past the checkpoint
    with SmoothedTrack(path, smoother(), HAND, kept) as track:
        assert len(track) == 3
        remember(track, states[3:], first=3)
        resumed = list(track.backward())[::-1]
    for one, expected in zip(resumed, by_hand(states, [DT] * 5), strict=True):
        assert_same(one, expected)


def test_a_filter_without_velocity_has_none_when_smoothed(tmp_path: Path) -> None:
    states = [ParticleState(state.poses, state.log_weights) for state in tracked(4)]
    with SmoothedTrack(tmp_path / "spool", smoother("pf"), HAND) as track:
        remember(track, states)
        for one in track.backward():
            np.testing.assert_array_equal(one.twist, np.zeros(21))
            assert np.all(one.pose_variance > 0.0)


def test_nothing_remembered_is_nothing_smoothed(tmp_path: Path) -> None:
    with SmoothedTrack(tmp_path / "spool", smoother(), HAND) as track:
        assert list(track.backward()) == []
        track.delete()
    assert not (tmp_path / "spool").exists()
