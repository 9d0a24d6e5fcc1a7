"""The smoothers: against an exact one on linear-Gaussian models, and where the future decides."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.filters import FILTERS, MarginalState, ParticleState, Prior
from posetrack_cli.filtering.guided import Guide
from posetrack_cli.filtering.model import (
    Dynamics,
    Euclidean,
    FilterModel,
    Gaussian,
    kalman_predict,
    kalman_smooth,
)
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.smoothing import GaussianSmoother, Smoothed, Smoother, noise_of, shrunk
from posetrack_cli.filtering.step import Posterior
from posetrack_cli.geometry import rotations as rot

SPACE, RESAMPLING, DT = Euclidean(), Resampling(), 1.0 / 30.0
RUNS = 10
MIXING = np.array([[1.0, 0.5, 0.0], [-0.3, 2.0, 0.4], [0.9, 0.8, 0.7]])
"""Observed are sums of components, so that what is known of them is correlated, up to 0.6."""

State = MarginalState | ParticleState


def smoother(dynamics: Dynamics, space=SPACE, moving: bool = True) -> GaussianSmoother:
    return GaussianSmoother(noise_of(dynamics, moving), space)


def backward(smoother: Smoother, states: list[State], steps: np.ndarray) -> list[Smoothed]:
    """Smooth states; steps[t] leads to state t."""
    kept = [smoother.remember(state) for state in states]
    smoothed = [smoother.begin(kept[-1])]
    for t in range(len(states) - 2, -1, -1):
        smoothed.append(smoother.back(kept[t], steps[t + 1]))
    return smoothed[::-1]


def filtered(world, observations: np.ndarray, seed: int, count: int = 800) -> list[State]:
    """States of the filter with exact fits, which has the least error of its own."""
    rng, ones, states = np.random.default_rng(seed), np.ones(world.dimension), []
    state = FILTERS["rbpf" if world.moving else "pf"].initial(
        Prior(0.0 * ones, ones, 10.0 * ones), count, SPACE, rng
    )
    model = FilterModel(world.dynamics, SPACE, RESAMPLING)
    for dt, y in zip(world.steps, observations, strict=True):
        guide, score = Guide(world.exact_modes(y, y[None]), 0.0), world.log_likelihood(y)
        state, _ = state.step(dt, model, score, rng, guide)
        states.append(state)
    return states


def exact(world, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means (T, 2D or D) and variances of Rauch, Tung and Striebel's smoother."""
    kalman = world.kalman(observations)
    beliefs = [Gaussian(m, C) for m, C in zip(kalman.means, kalman.covariances, strict=True)]
    smoothed = [beliefs[-1]]
    for t in range(len(beliefs) - 2, -1, -1):
        smoothed.append(kalman_smooth(beliefs[t], smoothed[-1], *world.transition(world.steps[t + 1])))
    smoothed.reverse()
    return np.array([b.mean for b in smoothed]), np.array([np.diag(b.covariance) for b in smoothed])


def stacked(smoothed: list[Smoothed], moving: bool) -> tuple[np.ndarray, np.ndarray]:
    if not moving:
        return np.array([s.pose for s in smoothed]), np.array([s.pose_variance for s in smoothed])
    means = np.array([np.r_[s.pose, s.velocity] for s in smoothed])
    return means, np.array([np.r_[s.pose_variance, s.velocity_variance] for s in smoothed])


def test_reference_is_the_joint_gaussian_conditioned_directly(make_world) -> None:
    """Rauch, Tung and Striebel against one big solve: prior of all states, then all observations at once."""
    world = make_world(np.random.default_rng(0).integers(1, 5, 6) / 30.0)
    observations = world.observations(1)
    size, T = 2, len(observations)
    mean, covariance = world.start.mean, world.start.covariance
    joint = np.zeros((size * T, size * T))
    for t in range(T):
        F, Q = world.transition(world.steps[t])
        here, before = slice(size * t, size * (t + 1)), slice(0, size * t)
        predicted = kalman_predict(Gaussian(mean, covariance), F, Q)
        mean, covariance = predicted.mean, predicted.covariance
        joint[here, here] = covariance
        if t:
            last = slice(size * (t - 1), size * t)
            joint[here, before] = F @ joint[last, before]
            joint[before, here] = joint[here, before].T
    H = np.kron(np.eye(T), world.sensor)
    gain = np.linalg.solve(H @ joint @ H.T + np.eye(T), H @ joint).T
    means, variances = exact(world, observations)
    np.testing.assert_allclose(means.ravel(), gain @ observations.ravel(), atol=1e-9)
    np.testing.assert_allclose(variances.ravel(), np.diag(joint - gain @ H @ joint), atol=1e-9)


@pytest.mark.parametrize(("discretisation", "dimension"), [("euler", 1), ("exact", 3)])
def test_smoothers_meet_the_exact_one(make_world, discretisation: str, dimension: int) -> None:
    """Poses and velocities, over unequal steps. The filter's sd is 1.4 to 1.9 times the smoother's."""
    steps = np.random.default_rng(5).integers(1, 5, 20) / 30.0
    mixing = None if dimension == 1 else MIXING
    world = make_world(steps, dimension=dimension, discretisation=discretisation, mixing=mixing)
    assert_exact(world)


def test_smoothers_of_the_plain_filter_meet_the_exact_one(make_world) -> None:
    assert_exact(make_world(np.full(20, DT), dimension=2, moving=False))


def assert_exact(world) -> None:
    """Over runs of the filter on the same observations: no bias, little scatter, the right variance."""
    observations = world.observations(3)
    means, variances = exact(world, observations)
    runs = [
        stacked(
            backward(
                smoother(world.dynamics, moving=world.moving),
                filtered(world, observations, seed),
                world.steps,
            ),
            world.moving,
        )
        for seed in range(RUNS)
    ]
    errors = np.array([found - means for found, _ in runs]) / np.sqrt(variances)
    scatter = errors.std(axis=0, ddof=1)
    assert np.sqrt(np.mean(np.square(scatter))) < 0.2  # of the smoothed sd; the filter's means lie 1 sd off
    # the mean over runs errs by scatter / sqrt(RUNS). That of ten runs is itself uncertain and so pooled over
    # frames, but they are not alike: the first ones scatter up to twice as much, and then their own counts
    pooled = np.sqrt(np.mean(np.square(scatter), axis=0))
    assert np.all(np.abs(errors.mean(axis=0)) < 5.0 * np.maximum(scatter, pooled) / np.sqrt(RUNS))
    # a finite sample's variance is short by that of its mean; of the filter the sum is 1.9 and more
    ratio = np.mean([found / variances for _, found in runs], axis=(0, 1))
    np.testing.assert_allclose(ratio + np.mean(np.square(errors), axis=(0, 1)), 1.0, atol=0.06)


@pytest.mark.parametrize("kind", ["particle", "marginal"])
def test_last_frame_is_the_filter_s(make_world, kind: str) -> None:
    moving = kind == "marginal"
    world = make_world(np.full(5, DT), dimension=2, moving=moving)
    rng, ones = np.random.default_rng(0), np.ones(2)
    state = MarginalState.initial(Prior(0.0 * ones, ones, ones), 50, SPACE, rng)
    if not moving:
        state = ParticleState(state.poses, state.log_weights)
    never = Resampling(threshold=0.0)  # so that the state is what the estimate was taken from
    for y in world.observations(1):
        model = FilterModel(world.dynamics, SPACE, never)
        state, posterior = state.step(DT, model, world.log_likelihood(y), rng)
    way = smoother(world.dynamics, moving=moving)
    assert_equal(way.begin(way.remember(state)), posterior)


def assert_equal(smoothed: Smoothed, posterior: Posterior) -> None:
    for name in ("pose", "pose_variance", "velocity", "velocity_variance"):
        np.testing.assert_allclose(getattr(smoothed, name), getattr(posterior, name), rtol=1e-12, atol=1e-12)


def test_the_future_decides_between_two_modes() -> None:
    """Ten frames at which a finger may be bent or straight, then five that show it bent: it was, all along.

    Truth by a forward-backward pass over a grid.
    """
    side = np.linspace(-1.2, 2.4, 721)
    noise, frames, ambiguous = 0.25, 15, 10
    dynamics = Dynamics(np.array([noise]), np.zeros(1))

    def score(poses: np.ndarray, frame: int) -> np.ndarray:
        straight, bent = (-0.5 * np.square((poses[:, 0] - top) / 0.15) for top in (0.2, 0.9))
        return np.logaddexp(straight, bent) if frame < ambiguous else bent

    transition = np.exp(-0.5 * np.square(side[:, None] - side) / (DT * noise))
    transition /= transition.sum(axis=0)
    seen = [np.exp(score(side[:, None], frame)) for frame in range(frames)]
    density, ahead = [np.exp(-0.5 * np.square((side - 0.5) / 0.3))], [np.ones(side.size)]
    for frame in range(frames):
        density.append(seen[frame] * (transition @ density[-1]))
        density[-1] /= density[-1].sum()
    for frame in range(frames - 1, 0, -1):
        ahead.append(transition.T @ (seen[frame] * ahead[-1]))
    both_ways = np.array(density[1:]) * np.array(ahead[::-1])
    truth = (both_ways / both_ways.sum(axis=1, keepdims=True)) @ side

    means, filter_means = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        state, states = (
            ParticleState.initial(Prior(np.array([0.5]), np.array([0.3]), np.zeros(0)), 300, SPACE, rng),
            [],
        )
        for frame in range(frames):
            state, posterior = state.step(
                DT, FilterModel(dynamics, SPACE, RESAMPLING), lambda x, frame=frame: score(x, frame), rng
            )
            states.append(state)
            filter_means.append(posterior.pose[0])
        way = smoother(dynamics, moving=False)
        means.append([s.pose[0] for s in backward(way, states, np.full(frames, DT))])
    filter_means = np.reshape(filter_means, (20, frames)).mean(axis=0)
    error = np.abs(np.mean(means, axis=0) - truth)
    before = np.abs(filter_means - truth)[:ambiguous]
    assert before.min() > 0.1  # the filter could not know
    # nothing exact is claimed for a mixture: 0.27 to 0.45 of the error is left
    assert np.all(error[:ambiguous] < 0.6 * before)


class Turning:
    """SO(3) as canonical quaternions."""

    def retract(self, x: np.ndarray, delta: np.ndarray) -> np.ndarray:
        return rot.canonical(rot.multiply(x, rot.exponential(delta)))

    def local(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return rot.logarithm(rot.multiply(rot.conjugate(x), y))

    def mean(self, x: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return rot.mean_quaternion(x, weights)

    def log_volume(self, delta: np.ndarray) -> np.ndarray:
        return 2.0 * np.log(np.sinc(np.linalg.norm(delta, axis=-1) / (2.0 * np.pi)))


def test_a_steady_turn_is_smoother_than_it_was_filtered() -> None:
    """Noisy views of a body turning at 2 rad/s through half a turn, where canonical quaternions jump."""
    space, frames, sd, rate = Turning(), 80, 0.06, np.array([1.2, -1.6, 0.0])
    dynamics = Dynamics(np.full(3, 1e-2), np.full(3, 0.05))
    filter_errors, smooth_errors, rates = [], [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        state, states = (
            MarginalState.initial(
                Prior(np.array(rot.IDENTITY), np.full(3, sd), np.full(3, 2.0)), 600, space, rng
            ),
            [],
        )
        truth = rot.exponential(rate * DT * np.arange(1, frames + 1)[:, None])
        for frame in range(frames):
            seen = space.retract(truth[frame : frame + 1], sd * rng.standard_normal((1, 3)))[0]
            state, posterior = state.step(
                DT,
                FilterModel(dynamics, space, RESAMPLING),
                lambda x, seen=seen: -0.5 * np.square(rot.angle_between(seen, x) / sd),
                rng,
            )
            states.append(state)
            filter_errors.append(rot.angle_between(posterior.pose, truth[frame]))
        smoothed = backward(smoother(dynamics, space), states, np.full(frames, DT))
        smooth_errors += [rot.angle_between(s.pose, turn) for s, turn in zip(smoothed, truth, strict=True)]
        rates += [s.velocity for s in smoothed]
    assert np.sqrt(np.mean(np.square(smooth_errors))) < 0.8 * np.sqrt(np.mean(np.square(filter_errors)))
    np.testing.assert_allclose(np.mean(rates, axis=0), rate, atol=0.15)


@pytest.mark.parametrize("count", [5.0, 50.0, 5000.0])
def test_shrinking_takes_away_what_is_there_by_chance(count: int) -> None:
    """Independent components: of sampled correlations little is left, of those with an own velocity all."""
    rng, D = np.random.default_rng(0), 8
    pose = rng.standard_normal((int(count), D)) * np.geomspace(1e-2, 10.0, D)
    sample = np.hstack([pose, 3.0 * pose])
    covariance = np.cov(sample.T)
    left = shrunk(covariance, count)
    np.testing.assert_allclose(np.diag(left), np.diag(covariance))
    np.testing.assert_allclose(np.diag(left, D), np.diag(covariance, D))
    correlations = [c / np.sqrt(np.outer(np.diag(c), np.diag(c))) for c in (left, covariance)]
    others = ~np.eye(D, dtype=bool)
    before, after = (np.sqrt(np.mean(np.square(c[:D, :D][others]))) for c in correlations[::-1])
    assert after < 0.5 * before
    assert np.linalg.eigvalsh(left).min() > -1e-9 * np.linalg.eigvalsh(left).max()


def test_shrinking_keeps_what_many_samples_show() -> None:
    A = np.random.default_rng(1).standard_normal((6, 6))
    covariance = A @ A.T
    np.testing.assert_allclose(shrunk(covariance, 1e6), covariance, rtol=1e-4)


def test_a_pass_begins_with_the_last_frame() -> None:
    dynamics = Dynamics(np.ones(1), np.ones(1))
    way = smoother(dynamics)
    kept = way.remember(
        MarginalState.initial(Prior(np.zeros(1), np.ones(1), np.ones(1)), 5, SPACE, np.random.default_rng(0))
    )
    with pytest.raises(FilterError, match="begins with the last frame"):
        way.back(kept, DT)
    way.begin(kept)
    with pytest.raises(FilterError, match="invalid time step"):
        way.back(kept, 0.0)


def test_frozen_components_stay() -> None:
    """No noise, no spread, no velocity: nothing to smooth, and nothing to divide by."""
    dynamics = Dynamics(np.array([1.0, 0.0]), np.array([1.0, 0.0]))
    rng = np.random.default_rng(0)
    state = MarginalState.initial(
        Prior(np.array([0.0, 7.0]), np.array([1.0, 0.0]), np.array([1.0, 0.0])), 80, SPACE, rng
    )
    states = []
    for _ in range(4):
        state, _ = state.step(
            DT, FilterModel(dynamics, SPACE, RESAMPLING), lambda x: -0.5 * np.square(x[:, 0]), rng
        )
        states.append(state)
    for smoothed in backward(smoother(dynamics), states, np.full(4, DT)):
        assert smoothed.pose[1] == pytest.approx(7.0, abs=1e-9)
        assert smoothed.velocity[1] == smoothed.velocity_variance[1] == 0.0
        assert smoothed.pose_variance[1] == pytest.approx(0.0, abs=1e-12)
        assert np.isfinite(smoothed.velocity).all()
