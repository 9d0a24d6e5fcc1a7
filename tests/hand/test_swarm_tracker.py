"""The swarm's tracker with an objective of plain arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.anatomy import ANGLE_LIMITS, ANGLES, make_anatomy
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.observe.observer import Observer, Outline
from posetrack_cli.hand.start import rest_pose
from posetrack_cli.hand.swarm import Objective, SwarmState, SwarmTracker, search_box
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.velocity import BodySpace
from support.codecs import assert_lawful
from support.hand import KINECT

ANATOMY = make_anatomy()
START = rest_pose(ANATOMY, np.array([0.0, 0.0, 650.0]))
FRAME_NS = 33_333_333
BLANK = np.zeros((424, 512), np.float32)


class Distance:
    """The mean distance of the joints from those of a target, mm, as objective; keeps what it is asked."""

    def __init__(self, target: np.ndarray, scale: float = 1.0) -> None:
        self.joints, self.scale = joint_positions(ANATOMY, target[None])[0], scale
        self.asked: list[np.ndarray] = []

    def evaluate(self, poses: np.ndarray, observation: Observation) -> Objective:
        self.asked.append(poses.copy())
        away = np.linalg.norm(joint_positions(ANATOMY, poses) - self.joints, axis=2).mean(axis=1)
        return Objective(2.0 * self.scale * away, np.minimum(self.scale * away, 40.0))


class Believing(Observer):
    """Takes every frame to show a hand: what its readings mean is up to a fake objective."""

    def outline(self, depth: np.ndarray, pose: np.ndarray) -> Outline:
        return Outline(1.0, 1.0)


def tracker_with(objective: Distance, **tables: dict[str, object]) -> SwarmTracker:
    config = HandConfig.model_validate({"filter": {"kind": "pso"}, **tables})
    return SwarmTracker(config, ANATOMY, objective, Believing(config, ANATOMY, KINECT, segment=True))


def seen(index: int) -> Frame:
    """A frame with readings where the hand is: the fake objective says what they mean."""
    return Frame(index, index * FRAME_NS, (np.full_like(BLANK, 650.0),))


def blank(index: int) -> Frame:
    return Frame(index, index * FRAME_NS, (BLANK,))


def run(tracker: SwarmTracker, frames: list[Frame], seed: int = 0) -> tuple[SwarmState, list[Estimate]]:
    rng = np.random.default_rng(seed)
    state, estimates = tracker.start(START, frames[0].stamp_ns, rng), []
    for frame in frames:
        state, estimate = tracker.step(state, frame, rng)
        estimates.append(estimate)
    return state, estimates


def moved(delta: np.ndarray) -> np.ndarray:
    return BodySpace().retract(START[None], delta[None])[0]


ASIDE = moved(np.concatenate([[6.0, -4.0, 2.0], np.zeros(18)]))


def test_the_swarm_goes_where_the_objective_is_least() -> None:
    target = moved(np.concatenate([[15.0, -10.0, 8.0], [0.1, -0.2, 0.1], np.full(15, 0.1)]))
    objective = Distance(target)
    far = objective.evaluate(START[None], None).depth[0]  # type: ignore[arg-type]
    _, estimates = run(tracker_with(objective), [seen(k) for k in range(5)])
    last = estimates[-1]
    assert last.cost is not None and last.cost < 0.1 * far
    pose = np.concatenate([last.position, last.quaternion, last.shape])
    np.testing.assert_array_equal(last.points, joint_positions(ANATOMY, pose[None])[0])
    assert last.cost == pytest.approx(np.linalg.norm(last.points - objective.joints, axis=1).mean())
    assert last.confidence == pytest.approx(1.0 - last.cost / 40.0)
    assert (last.status, last.frame_index, last.stamp_ns) == (Status.TRACKING, 4, 4 * FRAME_NS)


def test_an_optimiser_states_what_it_knows_and_no_more() -> None:
    _, (estimate,) = run(tracker_with(Distance(START)), [seen(0)])
    unknown = (estimate.pose_rate, estimate.twist, estimate.pose_variance, estimate.twist_variance)
    assert unknown == (None,) * 4
    assert estimate.effective_sample_size is None and not estimate.resampled


def test_the_budget_is_the_published_one_and_every_evaluation_is_counted() -> None:
    objective = Distance(START)
    _, (first, second) = run(tracker_with(objective), [seen(0), blank(1)])
    assert [len(poses) for poses in objective.asked] == [64] * 25 + [1]  # and the estimate's own
    assert (first.evaluations, second.evaluations) == (64 * 25 + 1, 0)


def test_the_swarm_starts_at_the_last_solution_with_the_configured_spread() -> None:
    spread = {"position_mm": 5.0, "rotation_rad": 0.02, "flexion_rad": 0.03, "abduction_rad": 0.01}
    objective = Distance(START)
    tracker = tracker_with(objective, pso={"particles": 4000, "generations": 1, "spread": spread})
    state, _ = run(tracker, [seen(0)])
    first = objective.asked[0]
    np.testing.assert_allclose(first[0], START, atol=1e-12)
    deltas = BodySpace().local(np.broadcast_to(START, first.shape), first)[1:]
    four_errors = 4.0 / np.sqrt(2 * 4000)
    np.testing.assert_allclose(deltas[:, :3].std(axis=0), 5.0, rtol=four_errors)
    np.testing.assert_allclose(deltas[:, 3:6].std(axis=0), 0.02, rtol=four_errors)
    np.testing.assert_allclose(deltas[:, 10].std(), 0.01, rtol=four_errors)  # the index finger's abduction
    tracker.step(state, seen(1), np.random.default_rng(3))
    np.testing.assert_allclose(objective.asked[2][0], state.pose, atol=1e-12)


def test_no_particle_leaves_the_joint_limits_or_the_reach() -> None:
    bent = START.copy()
    bent[ANGLES] = ANGLE_LIMITS[:, 1] + 0.1  # a start beyond the limits is put back
    objective = Distance(moved(np.full(21, 400.0)))  # nowhere near
    tracker = tracker_with(objective, pso={"reach_mm": 30.0})
    rng = np.random.default_rng(0)
    state = tracker.start(bent, 0, rng)
    np.testing.assert_array_equal(state.pose[ANGLES], ANGLE_LIMITS[:, 1])
    state, estimate = tracker.step(state, seen(0), rng)
    asked = np.concatenate(objective.asked)
    rounding = 1e-12
    assert (asked[:, ANGLES] >= ANGLE_LIMITS[:, 0] - rounding).all()
    assert (asked[:, ANGLES] <= ANGLE_LIMITS[:, 1] + rounding).all()
    assert np.abs(asked[:, :3] - START[:3]).max() <= 30.0 + rounding * 650.0
    assert (estimate.shape >= ANGLE_LIMITS[:, 0]).all() and (estimate.shape <= ANGLE_LIMITS[:, 1]).all()


def test_only_finger_angles_are_redrawn() -> None:
    box = search_box(START, 250.0)
    assert box.redrawn.tolist() == list(range(6, 21))
    np.testing.assert_allclose(box.high[6:] - box.low[6:], np.diff(ANGLE_LIMITS, axis=1)[:, 0])


def test_a_blank_frame_is_lost_and_the_hand_stays() -> None:
    _, estimates = run(tracker_with(Distance(START)), [seen(0), blank(1), seen(2)])
    assert [str(e.status) for e in estimates] == ["tracking", "lost", "tracking"]
    np.testing.assert_array_equal(estimates[1].position, estimates[0].position)
    assert (estimates[1].confidence, estimates[1].cost) == (0.0, None)


def test_confidence_that_stays_low_is_lost_and_comes_back() -> None:
    objective = Distance(ASIDE)
    tracker = tracker_with(objective, status={"lost_below": 0.3, "lost_after_frames": 3})
    rng = np.random.default_rng(0)
    state, statuses = tracker.start(START, 0, rng), []
    for k in range(6):
        objective.scale = 1.0 if k in (1, 5) else 1e9  # the start is but assumed until frame 1 bears it out
        state, estimate = tracker.step(state, seen(k), rng)
        statuses.append((str(estimate.status), state.misses))
    assert [status for status, _ in statuses] == ["lost", *["tracking"] * 3, "lost", "tracking"]
    assert [misses for _, misses in statuses[1:]] == [0, 1, 2, 3, 0]


@pytest.mark.parametrize("frames", [1, 3])
def test_a_state_taken_apart_and_put_together_goes_on_bit_by_bit(frames: int) -> None:
    tracker = tracker_with(Distance(ASIDE, 5.0), status={"lost_below": 0.99})
    rng = np.random.default_rng(0)
    state = tracker.start(START, 0, rng)
    for k in range(frames):
        state, _ = tracker.step(state, seen(k), rng)
    restored = assert_lawful(tracker.codec, state)
    assert (restored.stamp_ns, restored.misses) == (state.stamp_ns, state.misses)
    state, expected = tracker.step(state, seen(5), np.random.default_rng(1))
    restored, found = tracker.step(restored, seen(5), np.random.default_rng(1))
    for name in vars(expected):
        np.testing.assert_array_equal(getattr(expected, name), getattr(found, name), err_msg=name)
    assert restored.misses == state.misses


def test_a_step_changes_no_state_and_another_seed_is_another_run() -> None:
    tracker = tracker_with(Distance(ASIDE))
    state, first = run(tracker, [seen(0)])
    pose = state.pose.copy()
    tracker.step(state, seen(1), np.random.default_rng(0))
    np.testing.assert_array_equal(state.pose, pose)
    _, second = run(tracker, [seen(0)], seed=1)
    assert not np.array_equal(first[0].position, second[0].position)


def test_time_must_move_forward() -> None:
    with pytest.raises(FilterError, match="invalid time step"):
        run(tracker_with(Distance(START)), [seen(1), seen(1)])


def test_a_swarm_that_would_not_converge_is_refused_before_the_first_frame() -> None:
    with pytest.raises(FilterError, match="would not converge"):
        tracker_with(Distance(START), pso={"cognitive": 1.5})
