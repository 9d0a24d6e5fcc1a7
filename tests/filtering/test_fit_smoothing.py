"""The smoother over local fits: exact where the fits are, and true to first order where poses turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.filters import MarginalState
from posetrack_cli.filtering.fit_smoothing import FitSmoother, fitted, predicted
from posetrack_cli.filtering.model import (
    Dynamics,
    Euclidean,
    Gaussian,
    kalman_predict,
    kalman_smooth,
)
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.smoothing import NOTHING, Memory, Smoothed, StateGaussian, Step
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.start import rest_pose
from posetrack_cli.tracking.velocity import BodySpace
from support.kalman import kalman_update

SPACE, HANDS = Euclidean(), BodySpace()
START = rest_pose(make_anatomy(), np.array([10.0, -20.0, 650.0]))
STEPS = np.random.default_rng(5).integers(1, 5, 14) / 30.0
EXACT = 1e-8
"""Two ways to write the same numbers: the condition of what is inverted, at most 1e6, times eps."""
ALL = np.array([[1.0, 0.5, 0.0], [-0.3, 2.0, 0.4], [0.9, 0.8, 0.7]])
SENSORS = {"all is seen": ALL, "a plane is seen": ALL[:2], "a line is seen": ALL[2:]}
sensors = pytest.mark.parametrize("mixing", SENSORS.values(), ids=SENSORS.keys())
UNSEEN, STILL, CUT = 3, 6, 9
"""Frames without modes, without time, and after a cut."""


class Kept:
    """Fits that lie in the frame as they are."""

    def known(self, frame: Memory) -> LikelihoodModes | None:
        names = ("poses", "gradients", "information", "log_heights")
        return LikelihoodModes(*(frame[name] for name in names)) if "poses" in frame else None

    def more(self, frame: Memory, known: LikelihoodModes, belief: StateGaussian) -> LikelihoodModes:
        return known


def smoother(dynamics: Dynamics, space=SPACE, fits=None, **doubt) -> FitSmoother:
    return FitSmoother(dynamics, space, fits or Kept(), **doubt)


def step_of(modes: LikelihoodModes | None, dt: float = 1.0 / 30.0, cut: bool = False) -> Step:
    return Step(dt, cut, NOTHING if modes is None else vars(modes))


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
        steps.append(step_of(None if unseen else modes, 0.0 if still else dt, cut))
    return steps


@dataclass
class Known:
    """What is known of a frame from those before it, and with its own observation."""

    expected: Gaussian
    filtered: Gaussian


def exact_filter(world, steps: list[Step], observations: np.ndarray) -> list[Known]:
    """The Kalman filter; chains begin with the clouds' moments."""
    known: list[Known] = []
    H, R = world.sensor, np.eye(len(world.sensor))
    for t, (step, y) in enumerate(zip(steps, observations, strict=True)):
        if t == 0 or step.cut:
            first = belief_of(smoother(world.dynamics).remember(cloud(np.zeros(3), t)))
            known.append(Known(first, first))
            continue
        expected = known[-1].filtered
        if step.dt > 0.0:
            expected = kalman_predict(expected, *world.transition(step.dt))
        seen = kalman_update(expected, y, H, R)[0] if "poses" in step.frame else expected
        known.append(Known(expected, seen))
    return known


def remembered(way: FitSmoother, steps: list[Step]) -> list[Memory]:
    return [way.remember(cloud(np.zeros(3), t), step) for t, step in enumerate(steps)]


def gone_back(way: FitSmoother, kept: list[Memory], steps: list[Step]) -> list[Smoothed]:
    """All frames smoothed, as a run does it; the last frame first."""
    found = [way.begin(kept[-1])]
    for t in range(len(kept) - 2, -1, -1):
        later = steps[t + 1]
        if later.cut:
            found.append(way.begin(kept[t]))
        else:
            found.append(way.back(kept[t], later.dt) if later.dt > 0.0 else way.stay(kept[t], found[-1]))
    return found


@sensors
@pytest.mark.parametrize("discretisation", ["exact", "euler"])
def test_forward_it_is_the_kalman_filter(make_world, discretisation: str, mixing: np.ndarray) -> None:
    """Also through a frame without fits, one at no distance in time, and a cut."""
    world = make_world(STEPS, dimension=3, discretisation=discretisation, mixing=mixing)
    observations = world.observations(1)
    steps = steps_of(world, observations, special=True)
    kept = remembered(smoother(world.dynamics), steps)
    for found, exact in zip(map(belief_of, kept), exact_filter(world, steps, observations), strict=True):
        np.testing.assert_allclose(found.mean, exact.expected.mean, atol=EXACT)
        np.testing.assert_allclose(found.covariance, exact.expected.covariance, atol=EXACT)


@sensors
@pytest.mark.parametrize("special", [False, True])
@pytest.mark.parametrize("discretisation", ["exact", "euler"])
def test_backward_it_is_the_smoother_of_rauch_tung_and_striebel(
    make_world, discretisation: str, special: bool, mixing: np.ndarray
) -> None:
    """Also through a frame without fits, one at no distance in time, and a cut."""
    world = make_world(STEPS, dimension=3, discretisation=discretisation, mixing=mixing)
    observations = world.observations(1)
    steps = steps_of(world, observations, special=special)
    way = smoother(world.dynamics)
    found = gone_back(way, remembered(way, steps), steps)[::-1]
    exact = exact_filter(world, steps, observations)
    for t in range(len(steps) - 1, -1, -1):
        if t == len(steps) - 1 or steps[t + 1].cut:
            later = exact[t].filtered
        elif steps[t + 1].dt > 0.0:
            later = kalman_smooth(exact[t].filtered, later, *world.transition(steps[t + 1].dt))
        assert_equal(found[t], later)


def assert_equal(smoothed: Smoothed, belief: Gaussian) -> None:
    variance = np.r_[smoothed.pose_variance, smoothed.velocity_variance]
    np.testing.assert_allclose(np.r_[smoothed.pose, smoothed.velocity], belief.mean, atol=EXACT)
    np.testing.assert_allclose(variance, np.diag(belief.covariance), atol=EXACT)


def test_first_frame_has_the_particles_moments(make_world) -> None:
    """Of 8 the two heaviest are cut to 1 / 8 + 0.06 / 2: 0.3 and 0.3 become 0.155."""
    weights = np.array([0.3, 0.3, 0.1, 0.1, 0.05, 0.05, 0.05, 0.05])
    poses = np.array([[0.0], [2.0], [3.0], [9.0], [1.0], [1.0], [4.0], [5.0]])
    state = MarginalState(poses, np.full((8, 1), 5.0), np.array([0.7]), np.log(weights))
    step = steps_of(make_world(STEPS[:1]), np.zeros((1, 1)), special=False)[0]
    found = smoother(Dynamics(np.ones(1), np.ones(1))).remember(state, step)
    cut = np.array([0.155, 0.155, 0.1, 0.1, 0.05, 0.05, 0.05, 0.05]) / 0.71
    mean = cut @ poses[:, 0]
    variance = cut @ np.square(poses[:, 0] - mean)
    np.testing.assert_allclose(found["pose"], [mean])
    np.testing.assert_allclose(found["velocity"], [5.0])
    np.testing.assert_allclose(found["covariance"], [[variance, 0.0], [0.0, 0.7]], atol=1e-12)


@pytest.mark.parametrize("last", [0, UNSEEN, STILL, CUT])
def test_another_smoother_goes_on_with_the_same_numbers(make_world, last: int) -> None:
    world = make_world(STEPS, dimension=3, mixing=ALL[:2])
    steps = steps_of(world, world.observations(1), special=True)
    kept = remembered(smoother(world.dynamics), steps)
    other = smoother(world.dynamics)
    other.resume(kept[last])
    for t in range(last + 1, len(steps)):
        found = other.remember(cloud(np.zeros(3), t), steps[t])
        for name, values in kept[t].items():
            np.testing.assert_array_equal(found[name], values)


def modes_at(poses: np.ndarray, information: np.ndarray) -> LikelihoodModes:
    return LikelihoodModes(
        poses, np.zeros((len(poses), len(information[0]))), information, np.zeros(len(poses))
    )


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_follows_the_fits_that_agree_with_each_other(side: float) -> None:
    """Two fits at -1 and 1, as sharp as each other, while all began at one of them."""
    way, modes = smoother(Dynamics(np.ones(1), np.ones(1))), two_fits()
    at = cloud(np.zeros(1))
    state = MarginalState(
        side + 0.1 * at.poses, 0.1 * at.velocities, 0.1 * at.velocity_variance, at.log_weights
    )
    kept = [way.remember(state, step_of(modes)) for _ in range(10)]
    np.testing.assert_allclose(kept[-1]["pose"], [side], atol=0.03)  # three of the fit's sd
    found = gone_back(way, kept, [step_of(modes)] * 10)
    np.testing.assert_allclose([one.pose for one in found[:-1]], np.full((9, 1), side), atol=0.03)


def two_fits() -> LikelihoodModes:
    return modes_at(np.array([[-1.0], [1.0]]), np.full((2, 1, 1), 1e4))


@pytest.mark.parametrize("later", [-1.0, 1.0])
def test_later_frames_decide_between_two_fits(later: float) -> None:
    """The past is no help; the forward choice is overruled, and that fit alone is in the smoothed belief."""
    dynamics = Dynamics(np.full(1, 30.0), np.zeros(1))
    state = MarginalState(np.zeros((4, 1)), np.zeros((4, 1)), np.zeros(1), np.zeros(4))
    way = smoother(dynamics)
    steps = [
        step_of(None),
        step_of(two_fits()),
        step_of(modes_at(np.array([[later]]), np.full((1, 1, 1), 1e4))),
    ]
    kept = [way.remember(state, step) for step in steps]
    found = gone_back(way, kept, steps)[1]
    # variance 1 from the step before, 1 + 1e-4 from the one after, 1e-4 of the fit itself
    variance = 1.0 / (1.0 + 1.0 / (1.0 + 1e-4) + 1e4)
    np.testing.assert_allclose(found.pose_variance, [variance], rtol=1e-6)
    np.testing.assert_allclose(found.pose, [variance * later * (1e4 + 1.0 / (1.0 + 1e-4))], rtol=1e-6)


class Curved:
    """One frame in which y = x + x^3 / 2 was seen with an error of sd 0.1; the filter's fit is a poor one."""

    SEEN, PRECISION = 1.2, 100.0

    def known(self, frame: Memory) -> LikelihoodModes | None:
        if "poses" in frame:
            return Kept().known(frame)
        return self.about(np.array([0.1])) if "curved" in frame else None

    def more(self, frame: Memory, known: LikelihoodModes, belief: StateGaussian) -> LikelihoodModes:
        if "curved" not in frame:
            return known
        pose, precision = belief.pose, 1.0 / belief.covariance[0, 0]
        for _ in range(50):  # Gauss-Newton converges to the last digit
            here = self.about(pose)
            slope = here.gradients[0] + precision * (belief.pose - pose)
            pose = pose + slope / (here.information[0, 0] + precision)
        return self.about(pose)

    def about(self, pose: np.ndarray) -> LikelihoodModes:
        slope, off = 1.0 + 1.5 * pose**2, self.SEEN - pose - 0.5 * pose**3
        return LikelihoodModes(
            pose[None],
            (self.PRECISION * slope * off)[None],
            (self.PRECISION * slope**2)[None, None],
            -0.5 * self.PRECISION * off**2,
        )


def test_a_frame_fitted_again_is_at_the_posteriors_maximum() -> None:
    """Given the frames before and after, which are linear; the filter's own fit is far off."""
    dynamics, dt = Dynamics(np.ones(1), np.ones(1)), 0.1
    state = MarginalState(np.array([[-0.5], [0.5]]), np.zeros((2, 1)), np.ones(1), np.zeros(2))
    after = modes_at(np.array([[1.1]]), np.full((1, 1, 1), 4.0))
    steps = [step_of(None, dt), Step(dt, False, {"curved": 1}), step_of(after, dt)]
    unseen = [steps[0], step_of(None, dt), steps[2]]
    way, linear = smoother(dynamics, fits=Curved()), smoother(dynamics)
    found = gone_back(way, [way.remember(state, step) for step in steps], steps)[1]
    others = gone_back(linear, [linear.remember(state, step) for step in unseen], unseen)[1]
    curved, precision = Curved(), 1.0 / others.pose_variance[0]

    def cost(x: float) -> float:
        return 0.5 * precision * (x - others.pose[0]) ** 2 - curved.about(np.array([x])).log_heights[0]

    best = minimize_scalar(cost, bounds=(-1.0, 2.0), method="bounded", options={"xatol": 1e-9}).x
    assert abs(best - Curved.SEEN) > 0.2
    assert found.pose[0] == pytest.approx(best, abs=1e-6)
    information = curved.about(np.array([best])).information[0, 0]
    assert found.pose_variance[0] == pytest.approx(1.0 / (precision + information), rel=1e-5)


def test_one_wild_fit_is_doubted_and_the_others_are_not() -> None:
    """Ten frames at 0 and one at 50 of their sd: the mean is moved by it, a Student-t smoother hardly."""
    dynamics = Dynamics(np.full(1, 1e-4), np.full(1, 1e-4))
    state = MarginalState(np.array([[-0.1], [0.1]]), np.zeros((2, 1)), np.full(1, 1e-4), np.zeros(2))
    at = np.where(np.arange(11) == 5, 5.0, 0.0)
    steps = [step_of(modes_at(np.array([[x]]), np.full((1, 1, 1), 100.0))) for x in at]
    means = []
    for doubt in ({}, {"groups": [np.arange(1)], "freedom": 4.0}):
        way = smoother(dynamics, **doubt)
        found = gone_back(way, [way.remember(state, step) for step in steps], steps)
        means.append(np.abs([one.pose[0] for one in found]).max())
    assert means[0] > 0.3
    assert means[1] < 0.01 * means[0]


def test_a_pass_begins_with_the_last_frame() -> None:
    way = smoother(Dynamics(np.ones(1), np.ones(1)))
    kept = way.remember(cloud(np.zeros(1)))
    with pytest.raises(FilterError, match="begins with the last frame"):
        way.back(kept, 0.1)
    with pytest.raises(FilterError, match="begins with the last frame"):
        way.stay(kept, Smoothed(*np.zeros((4, 1))))
    way.begin(kept)
    with pytest.raises(FilterError, match="invalid time step"):
        way.back(kept, 0.0)


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
    way, dt = smoother(Dynamics(noise, 100.0 * noise), space), 1.0 / 30.0
    mixing = rng.standard_normal((frames, 21, 21)) / sd
    seen, kept = scale * sd * rng.standard_normal((frames, 21)), []
    for t in range(frames):
        information = (mixing[t].T @ mixing[t])[None] / scale**2
        near = place(seen[t] + scale * sd * rng.standard_normal((40, 21)))
        velocities = 5.0 * scale * sd * rng.standard_normal((40, 21))
        state = MarginalState(near, velocities, noise, np.zeros(40))
        modes = modes_at(place(seen[t][None]), information)
        kept.append(way.remember(state, step_of(modes, dt)))
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
