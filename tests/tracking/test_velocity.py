"""The velocity that results state: exact against a dense solution, and the same after an interruption."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.model import constant_velocity, step_noise
from posetrack_cli.geometry import rotations
from posetrack_cli.recording.base import Frame
from posetrack_cli.results import spool
from posetrack_cli.results.columns import LayoutError
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.results.spool import Progress
from posetrack_cli.tracking.loop import RunState, Step, VelocityBelief, checkpoint_of, run_state_at
from posetrack_cli.tracking.velocity import (
    FREEDOM,
    VelocityModel,
    check_belief,
    smoothed_velocities,
    with_velocities,
)
from support.codecs import TRACKER
from support.results import make_estimate

K = 2
SIZE = 6 + K
MODEL = VelocityModel(np.full(SIZE, 30.0), np.full(SIZE, 0.5), np.full(SIZE, 100.0))
NS = 1_000_000_000


def estimates(stamps: FloatArray, position: FloatArray, shape: FloatArray) -> list[Estimate]:
    """Return estimates of a body that does not turn."""
    return [
        replace(
            make_estimate(index, k=K),
            stamp_ns=round(float(stamp) * NS),
            status=Status.TRACKING,
            position=position[index],
            quaternion=np.array([0.0, 0.0, 0.0, 1.0]),
            shape=shape[index],
        )
        for index, stamp in enumerate(stamps)
    ]


def tracked(
    sequence: list[Estimate], model: VelocityModel = MODEL, reached: RunState | None = None
) -> list[Step]:
    """Return the steps of a pass over estimates, which draws a random number in every frame."""
    run_state = reached or RunState(None, np.random.default_rng(0))

    def steps() -> Iterator[Step]:
        for estimate in sequence[run_state.frame_index + 1 :]:
            run_state.rng.standard_normal()
            state = (np.arange(3.0), estimate.frame_index)
            yield Step(cast(Frame, None), (estimate,), RunState(state, run_state.rng, estimate.frame_index))

    return list(with_velocities(steps(), model, run_state.velocities))


def dense(stamps: FloatArray, values: FloatArray, frame: int) -> tuple[float, float]:
    """Return mean and variance of the velocity of a frame given the values up to the next one.

    All states together are one Gaussian: x_t = F x_t-1 + w. It is conditioned on the values at once. The
    first pose is known to r about its own value.
    """
    q, r, start = 30.0**2, 0.5**2, 100.0**2
    last = min(frame + 1, len(stamps) - 1)
    covariance, mean = np.diag([r, start]), np.array([values[0], 0.0])
    blocks, means = [[covariance]], [mean]
    for k in range(1, last + 1):
        dt = float(stamps[k] - stamps[k - 1])
        F, Q = constant_velocity(step_noise(np.zeros(1), np.array([q]), dt), dt)
        above = [F @ block for block in blocks[-1]]
        blocks.append([*above, F @ blocks[-1][-1] @ F.T + Q])
        means.append(F @ means[-1])
    joint = np.block(
        [[blocks[i][j] if j <= i else blocks[j][i].T for j in range(last + 1)] for i in range(last + 1)]
    )
    seen = np.arange(2, 2 * (last + 1), 2)
    which, centre = 2 * frame + 1, np.concatenate(means)

    def surprise(k: int) -> float:
        """The squared innovation of a value given those before, over its variance."""
        before, own = seen[: k - 1], seen[k - 1]
        weights = np.linalg.solve(joint[np.ix_(before, before)] + r * np.eye(k - 1), joint[before, own])
        innovation = values[k] - centre[own] - weights @ (values[1:k] - centre[before])
        return float(innovation**2 / (joint[own, own] + r - weights @ joint[before, own]))

    gain = np.linalg.solve(joint[np.ix_(seen, seen)] + r * np.eye(len(seen)), joint[seen, which])
    expected = centre[which] + gain @ (values[1 : last + 1] - centre[seen])
    variance = joint[which, which] - gain @ joint[seen, which]
    surprises = [surprise(k) if 0 < k <= last else 1.0 for k in (frame, frame + 1)]
    return float(expected), float(variance * (FREEDOM + sum(surprises)) / (FREEDOM + 2.0))


@given(
    st.lists(st.floats(0.005, 0.5), min_size=2, max_size=5),
    st.lists(st.floats(-20.0, 20.0), min_size=6, max_size=6),
)
def test_velocities_are_the_exact_ones_given_the_next_frame(gaps: list[float], walk: list[float]) -> None:
    stamps = np.round(np.cumsum([0.0, *gaps]), 9)
    values = np.array(walk[: len(stamps)])
    position, shape = np.zeros((len(stamps), 3)), np.zeros((len(stamps), K))
    position[:, 1] = shape[:, 1] = values
    for frame, step in enumerate(tracked(estimates(stamps, position, shape))):
        mean, variance = dense(stamps, values, frame)
        estimate = step.estimate
        assert estimate.twist is not None and estimate.twist_variance is not None
        # The dense solution loses half of the digits where variances differ by (100 / .5 / .005)^2.
        assert estimate.twist[[1, 7]] == pytest.approx(mean, rel=1e-6, abs=1e-6)
        assert estimate.twist_variance[[1, 7]] == pytest.approx(variance, rel=1e-5)
        assert estimate.pose_rate is not None
        assert estimate.pose_rate[[1, 8]] == pytest.approx(mean, rel=1e-6, abs=1e-6)


def test_a_body_that_turns_about_one_of_its_axes_has_that_angular_velocity() -> None:
    stamps, rate = np.arange(20) / 30.0, np.array([0.4, -2.0, 1.0])
    model = replace(MODEL, pose_sd=np.full(SIZE, 1e-4))
    turning = [
        replace(each, quaternion=rotations.exponential(rate * stamp))
        for each, stamp in zip(estimates(stamps, np.zeros((20, 3)), np.zeros((20, K))), stamps, strict=True)
    ]
    last = tracked(turning, model)[-2].estimate
    assert last.twist is not None
    # The start at 0 is forgotten: poses err by far less than the acceleration moves a pose in a frame.
    assert last.twist[3:6] == pytest.approx(rate, abs=1e-3)


def test_everything_but_the_velocity_stays_and_entries_beyond_the_model_do() -> None:
    stamps = np.arange(4) / 30.0
    before = estimates(stamps, np.arange(12.0).reshape(4, 3), np.ones((4, K)))
    rigid = VelocityModel(*(values[:6] for values in (MODEL.acceleration, MODEL.pose_sd, MODEL.start_sd)))
    for step, own in zip(tracked(before, rigid), before, strict=True):
        stated = step.estimate
        assert stated.position is own.position and stated.pose_variance is own.pose_variance
        assert own.twist is not None and stated.twist is not None
        assert stated.twist[6:].tolist() == own.twist[6:].tolist()
        assert stated.twist[:3] == pytest.approx(np.full(3, 90.0), abs=80.0)


@pytest.mark.parametrize("status", [Status.LOST, Status.REINITIALISED])
def test_a_jump_of_a_track_that_was_lost_is_no_velocity(status: Status) -> None:
    stamps, place = np.arange(8) / 30.0, np.zeros((8, 3))
    place[4:] = 500.0
    jumping = estimates(stamps, place, np.zeros((8, K)))
    own = jumping[4]
    jumping[4] = replace(own, status=status)
    steps = tracked(jumping)
    for step in steps:
        if step.estimate.status is not Status.LOST:
            assert step.estimate.twist is not None
            assert np.abs(step.estimate.twist).max() < 1e-6
    assert (steps[4].estimate.twist is own.twist) == (status is Status.LOST)


def test_after_an_interruption_velocities_and_random_numbers_go_on(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    sequence = estimates(np.arange(9) / 30.0, rng.normal(0, 3, (9, 3)), rng.normal(0, 3, (9, K)))
    whole = tracked(sequence)
    saved = checkpoint_of(TRACKER, whole[4].after, 5)
    spool.save(tmp_path / "state", saved, Progress(0, 5, 0, {}))
    loaded, _ = spool.load(tmp_path / "state")
    rest = tracked(sequence, reached=run_state_at(TRACKER, loaded, np.random.default_rng(0)))
    assert [step.estimate.frame_index for step in rest] == [5, 6, 7, 8]
    for again, before in zip(rest, whole[5:], strict=True):
        assert vars(again.estimate)["twist"].tobytes() == vars(before.estimate)["twist"].tobytes()
        assert again.after.rng.bit_generator.state == before.after.rng.bit_generator.state


def test_a_track_that_is_given_backwards_has_the_mirrored_velocities() -> None:
    rng = np.random.default_rng(3)
    stamps = np.cumsum(rng.uniform(0.02, 0.05, 7))
    place, shape = rng.normal(0, 3, (7, 3)), rng.normal(0, 3, (7, K))
    forward = list(smoothed_velocities(estimates(stamps, place, shape), MODEL))
    mirrored = estimates(-stamps[::-1], place[::-1], shape[::-1])
    again = list(smoothed_velocities(mirrored[::-1], MODEL, backward=True))
    for one, other in zip(forward, again, strict=True):
        assert one.twist is not None and other.twist is not None and one.twist_variance is not None
        assert other.twist == pytest.approx(-one.twist, rel=1e-9)
        assert other.twist_variance == pytest.approx(one.twist_variance, rel=1e-9)


def test_a_track_that_is_given_backwards_is_cut_where_it_was_begun_anew() -> None:
    stamps, place = np.arange(6) / 30.0, np.zeros((6, 3))
    place[3:] = 400.0
    jumping = estimates(stamps, place, np.zeros((6, K)))
    jumping[3] = replace(jumping[3], status=Status.REINITIALISED)
    for estimate in smoothed_velocities(jumping[::-1], MODEL, backward=True):
        assert estimate.twist is not None and np.abs(estimate.twist).max() < 1e-6


def test_a_belief_that_no_run_saved_is_refused() -> None:
    belief = VelocityBelief(0, np.zeros(SIZE + 1), np.zeros(SIZE), np.zeros((3, SIZE)), np.ones(SIZE))
    reached = RunState((np.arange(3.0), 7), np.random.default_rng(0), 3, (belief,))
    saved = checkpoint_of(TRACKER, reached, 4)
    arrays: dict[str, Any] = dict(saved.arrays)
    name = next(name for name in arrays if name.endswith("covariance"))
    arrays[name] = arrays[name][:, :-1]
    with pytest.raises(LayoutError):
        run_state_at(TRACKER, replace(saved, arrays=arrays), np.random.default_rng(0))


@pytest.mark.parametrize("leap_s", [11.0, 1e5, 1.7e9])
def test_a_clock_that_leaps_begins_another_chain(leap_s: float) -> None:
    stamps = np.arange(6) / 30.0
    stamps[3:] += leap_s
    for step in tracked(estimates(stamps, np.full((6, 3), 5.0), np.zeros((6, K)))):
        assert step.estimate.twist is not None and step.estimate.twist_variance is not None
        assert np.abs(step.estimate.twist).max() < 1e-6
        assert (step.estimate.twist_variance > 0.0).all()


@given(st.lists(st.sampled_from([1e-9, 1e-6, 0.03, 9.9]), min_size=2, max_size=12))
def test_variances_are_positive_whatever_the_gaps(gaps: list[float]) -> None:
    stamps = np.cumsum([0.0, *gaps])
    rng = np.random.default_rng(len(gaps))
    place, shape = rng.normal(0, 1e3, (len(stamps), 3)), rng.normal(0, 1e3, (len(stamps), K))
    for step in tracked(estimates(stamps, place, shape)):
        assert step.estimate.twist_variance is not None and (step.estimate.twist_variance > 0.0).all()
        assert step.estimate.twist is not None and np.isfinite(step.estimate.twist).all()


def test_a_lost_frame_of_a_filter_without_velocity_has_none() -> None:
    sequence = estimates(np.arange(3) / 30.0, np.zeros((3, 3)), np.zeros((3, K)))
    nothing = np.zeros(SIZE)
    sequence[1] = replace(sequence[1], status=Status.LOST, twist=nothing, twist_variance=nothing)
    lost = tracked(sequence)[1].estimate
    assert lost.twist is None and lost.twist_variance is None and lost.pose_rate is None


def test_a_belief_of_another_body_is_refused() -> None:
    pose = np.array([0.0] * 6 + [1.0] + [0.0] * K)
    belief = VelocityBelief(0, pose, np.zeros(SIZE), np.zeros((3, SIZE)), np.ones(SIZE))
    check_belief(belief, MODEL)
    check_belief(belief, None)
    smaller = VelocityModel(*(values[:6] for values in (MODEL.acceleration, MODEL.pose_sd, MODEL.start_sd)))
    with pytest.raises(LayoutError):
        check_belief(belief, smaller)
