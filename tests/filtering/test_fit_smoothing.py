"""The smoother over local fits: exact where the fits are, and true to first order where poses turn."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.filtering.fit_smoothing import FitSmoother, fitted, nearest_mode, predicted
from posetrack_cli.filtering.gaussian_smoothing import StateGaussian
from posetrack_cli.filtering.kalman import Gaussian, kalman_predict, kalman_smooth, kalman_update
from posetrack_cli.filtering.marginal import MarginalState
from posetrack_cli.filtering.model import Dynamics, Euclidean
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.smoothing import Memory, Smoothed, Step
from posetrack_cli.hand.anatomy import make_anatomy
from posetrack_cli.hand.space import HandSpace
from posetrack_cli.hand.start import rest_pose

SPACE, HANDS = Euclidean(), HandSpace()
START = rest_pose(make_anatomy(), np.array([10.0, -20.0, 650.0]))
STEPS = np.random.default_rng(5).integers(1, 5, 14) / 30.0
EXACT = 1e-9
"""Two ways to write the same numbers: the condition of what is inverted, at most 1e5, times eps."""
ALL = np.array([[1.0, 0.5, 0.0], [-0.3, 2.0, 0.4], [0.9, 0.8, 0.7]])
SENSORS = {"all is seen": ALL, "a plane is seen": ALL[:2], "a line is seen": ALL[2:]}
sensors = pytest.mark.parametrize("mixing", SENSORS.values(), ids=SENSORS.keys())
UNSEEN, STILL, CUT = 3, 6, 9
"""Frames without modes, without time, and after a cut."""


def cloud(pose: np.ndarray, seed: int = 0, count: int = 200) -> MarginalState:
    """Particles about a pose, of unequal weights."""
    rng, D = np.random.default_rng(seed), pose.size
    poses, velocities = rng.standard_normal((2, count, D))
    own = np.full(D, 0.5)
    return MarginalState(pose + poses, 3.0 * velocities, own, rng.standard_normal(count))


def belief_of(memory: Memory) -> Gaussian:
    return Gaussian(np.r_[memory["pose"], memory["velocity"]], memory["covariance"])


def steps_of(world, observations: np.ndarray, special: bool) -> list[Step]:
    """A step per frame, its fits made anywhere: of a quadratic each is the whole of it."""
    rng, steps = np.random.default_rng(2), []
    for t, (dt, y) in enumerate(zip(world.steps, observations, strict=True)):
        modes = world.exact_modes(y, 3.0 * rng.standard_normal((2, world.dimension)))
        unseen, still, cut = (special and t == frame for frame in (UNSEEN, STILL, CUT))
        steps.append(Step(0.0 if still else dt, cut, None if unseen else modes))
    return steps


def exact_filter(world, first: Gaussian, steps: list[Step], observations: np.ndarray, anew: Gaussian):
    """The Kalman filter from the first frame's belief on; after a cut from another one."""
    beliefs, H, R = [first], world.sensor, np.eye(len(world.sensor))
    for step, y in zip(steps[1:], observations[1:], strict=True):
        if step.cut:
            beliefs.append(anew)
            continue
        belief = beliefs[-1]
        if step.dt > 0.0:
            belief = kalman_predict(belief, *world.transition(step.dt))
        if step.modes is not None:
            belief = kalman_update(belief, y, H, R)[0]
        beliefs.append(belief)
    return beliefs


@sensors
@pytest.mark.parametrize("discretisation", ["exact", "euler"])
def test_forward_it_is_the_kalman_filter(make_world, discretisation: str, mixing: np.ndarray) -> None:
    """Also through a frame without fits, one at no distance in time, and a cut."""
    world = make_world(STEPS, dimension=3, discretisation=discretisation, mixing=mixing)
    observations = world.observations(1)
    steps = steps_of(world, observations, special=True)
    way = FitSmoother(world.dynamics, SPACE)
    kept = [way.remember(cloud(np.zeros(3), t), step) for t, step in enumerate(steps)]
    anew = belief_of(FitSmoother(world.dynamics, SPACE).remember(cloud(np.zeros(3), CUT)))
    exact = exact_filter(world, belief_of(kept[0]), steps, observations, anew)
    for found, belief in zip(map(belief_of, kept), exact, strict=True):
        np.testing.assert_allclose(found.mean, belief.mean, atol=EXACT)
        np.testing.assert_allclose(found.covariance, belief.covariance, atol=EXACT)


@sensors
def test_backward_it_is_the_smoother_of_rauch_tung_and_striebel(make_world, mixing: np.ndarray) -> None:
    world = make_world(STEPS, dimension=3, mixing=mixing)
    observations = world.observations(1)
    steps = steps_of(world, observations, special=False)
    way = FitSmoother(world.dynamics, SPACE)
    kept = [way.remember(cloud(np.zeros(3), t), step) for t, step in enumerate(steps)]
    first = belief_of(kept[0])
    exact = exact_filter(world, first, steps, observations, first)
    later = exact[-1]
    assert_equal(way.begin(kept[-1]), later)
    for t in range(len(kept) - 2, -1, -1):
        later = kalman_smooth(exact[t], later, *world.transition(STEPS[t + 1]))
        assert_equal(way.back(kept[t], STEPS[t + 1]), later)


def assert_equal(smoothed: Smoothed, belief: Gaussian) -> None:
    variance = np.r_[smoothed.pose_variance, smoothed.velocity_variance]
    np.testing.assert_allclose(np.r_[smoothed.pose, smoothed.velocity], belief.mean, atol=EXACT)
    np.testing.assert_allclose(variance, np.diag(belief.covariance), atol=EXACT)


def test_first_frame_has_the_particles_moments(make_world) -> None:
    """Of 4 the two heaviest are cut to half of all, over sqrt(4): 4 : 4 : 1 : 1 becomes 2.5 : 2.5 : 1 : 1."""
    weights = np.array([0.4, 0.4, 0.1, 0.1])
    poses = np.array([[0.0], [2.0], [3.0], [9.0]])
    state = MarginalState(poses, np.full((4, 1), 5.0), np.array([0.7]), np.log(weights))
    step = steps_of(make_world(STEPS[:1]), np.zeros((1, 1)), special=False)[0]
    found = FitSmoother(Dynamics(np.ones(1), np.ones(1)), SPACE).remember(state, step)
    mean = (2.5 * (0.0 + 2.0) + 3.0 + 9.0) / 7.0
    variance = (2.5 * (mean**2 + (2.0 - mean) ** 2) + (3.0 - mean) ** 2 + (9.0 - mean) ** 2) / 7.0
    np.testing.assert_allclose(found["pose"], [mean])
    np.testing.assert_allclose(found["velocity"], [5.0])
    np.testing.assert_allclose(found["covariance"], [[variance, 0.0], [0.0, 0.7]], atol=1e-12)


@pytest.mark.parametrize("last", [0, UNSEEN, STILL, CUT])
def test_another_smoother_goes_on_with_the_same_numbers(make_world, last: int) -> None:
    world = make_world(STEPS, dimension=3, mixing=ALL[:2])
    steps = steps_of(world, world.observations(1), special=True)
    way = FitSmoother(world.dynamics, SPACE)
    kept = [way.remember(cloud(np.zeros(3), t), step) for t, step in enumerate(steps)]
    other = FitSmoother(world.dynamics, SPACE)
    other.resume(kept[last])
    for t in range(last + 1, len(steps)):
        found = other.remember(cloud(np.zeros(3), t), steps[t])
        for name, values in kept[t].items():
            np.testing.assert_array_equal(found[name], values)


def modes_at(poses: np.ndarray, information: np.ndarray) -> LikelihoodModes:
    return LikelihoodModes(
        poses, np.zeros((len(poses), len(information[0]))), information, np.zeros(len(poses))
    )


def test_a_pose_belongs_to_the_fit_that_explains_it() -> None:
    """From (0, 0): (1, 0) is known to 0.1 across, 10 sd away; (0, 3) to 2 along, 1.5 sd away."""
    information = np.array([np.diag([100.0, 1.0]), np.diag([1.0, 0.25])])
    modes = modes_at(np.array([[1.0, 0.0], [0.0, 3.0]]), information)
    assert nearest_mode(modes, np.zeros(2), SPACE) == 1
    assert nearest_mode(modes, np.array([0.9, 0.5]), SPACE) == 0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_follows_the_fit_that_the_filter_believes_in(side: float) -> None:
    """Two fits at -1 and 1, as sharp as each other, while the filter's particles are at one of them."""
    dynamics = Dynamics(np.ones(1), np.ones(1))
    way, modes = FitSmoother(dynamics, SPACE), modes_at(np.array([[-1.0], [1.0]]), np.full((2, 1, 1), 1e4))
    for seed in range(10):
        at = cloud(np.zeros(1), seed)
        state = MarginalState(side + 0.1 * at.poses, at.velocities, at.velocity_variance, at.log_weights)
        kept = way.remember(state, Step(1.0 / 30.0, False, modes))
    np.testing.assert_allclose(kept["pose"], [side], atol=0.03)  # three of the fit's sd


def test_a_fit_that_knows_nothing_changes_nothing() -> None:
    C = np.diag([1.0, 2.0, 3.0, 4.0])
    before = StateGaussian(np.array([1.0, 2.0]), np.array([3.0, 4.0]), C)
    after = fitted(before, modes_at(np.array([[50.0, 60.0]]), np.zeros((1, 2, 2))), 0, SPACE)
    for name, values in vars(before).items():
        np.testing.assert_array_equal(getattr(after, name), values)


def test_no_time_changes_nothing() -> None:
    before = StateGaussian(np.zeros(1), np.ones(1), np.eye(2))
    assert predicted(before, 0.0, Dynamics(np.ones(1), np.ones(1)), SPACE) is before


def hand_track(space, place, scale: float, frames: int = 8) -> list[Smoothed]:
    """Smooth a hand's track, all of whose lengths and angles are multiplied by a scale.

    Args:
        space: the poses' space.
        place: of tangent vectors (N, 21), the poses that they lead to.
        scale: of everything, so that gains do not depend on it.
        frames: how many.
    """
    rng, sd = np.random.default_rng(8), np.concatenate([np.full(3, 10.0), np.full(18, 0.3)])
    noise = np.square(scale * sd)
    way, dt = FitSmoother(Dynamics(noise, 100.0 * noise), space), 1.0 / 30.0
    mixing = rng.standard_normal((frames, 21, 21)) / sd
    seen, kept = scale * sd * rng.standard_normal((frames, 21)), []
    for t in range(frames):
        information = (mixing[t].T @ mixing[t])[None] / scale**2
        near = place(seen[t] + scale * sd * rng.standard_normal((40, 21)))
        velocities = 5.0 * scale * sd * rng.standard_normal((40, 21))
        state = MarginalState(near, velocities, noise, np.zeros(40))
        modes = modes_at(place(seen[t][None]), information)
        kept.append(way.remember(state, Step(dt, False, modes)))
    smoothed = [way.begin(kept[-1])]
    return smoothed + [way.back(memory, dt) for memory in kept[-2::-1]]


def turned(scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Poses and velocities of a hand's track about a pose, and those of its tangent space, over the scale."""
    hands = hand_track(HANDS, lambda d: HANDS.retract(np.tile(START, (len(d), 1)), d), scale)
    flat = hand_track(SPACE, lambda d: d, scale)
    found = np.array([np.r_[HANDS.local(START, s.pose), s.velocity] for s in hands])
    return found / scale, np.array([np.r_[s.pose, s.velocity] for s in flat]) / scale


def test_turning_hands_are_smoothed_to_first_order() -> None:
    """What a chart neglects is of second order: with half the angles its share is half as large."""
    differences = []
    for scale in (2e-3, 1e-3):
        found, flat = turned(scale)
        differences.append(np.linalg.norm(found - flat) / np.linalg.norm(flat))
    assert 0.0 < differences[1] < 1e-3
    assert differences[1] / differences[0] == pytest.approx(0.5, abs=0.02)
