"""What a step promises beside its statistics: purity, repeatability, order, limits, errors, curved spaces."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.filters import FILTERS, MarginalState, ParticleState, Prior
from posetrack_cli.filtering.model import Dynamics, Euclidean, FilterModel
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.step import velocity_moments
from posetrack_cli.geometry import rotations as rot

SPACE = Euclidean()
DYNAMICS = Dynamics(np.array([4.0, 1.0, 2.0]), np.array([400.0, 100.0, 50.0]))
ALWAYS, NEVER = Resampling(threshold=1.0), Resampling(threshold=0.0)
DT = 1.0 / 30.0
ROUNDING = 1e-12

State = ParticleState | MarginalState
both = pytest.mark.parametrize("kind", ["particle", "marginal"])


def start(kind: str, count: int = 50, seed: int = 0) -> State:
    rng, mean, sd = np.random.default_rng(seed), np.arange(3.0), np.array([1.0, 0.5, 2.0])
    if kind == "particle":
        return ParticleState.initial(Prior(mean, sd, np.zeros(0)), count, SPACE, rng)
    return MarginalState.initial(Prior(mean, sd, np.array([3.0, 2.0, 1.0])), count, SPACE, rng)


def step(state: State, score, resampling=ALWAYS, seed: int = 1, dynamics=DYNAMICS, dt: float = DT, **options):
    model = FilterModel(dynamics, SPACE, resampling, **options)
    return state.step(dt, model, score, np.random.default_rng(seed))


def towards_one(poses: np.ndarray) -> np.ndarray:
    return -0.5 * np.square(poses - 1.0).sum(axis=1)


def arrays_of(state: State) -> list[np.ndarray]:
    return [value for value in vars(state).values() if isinstance(value, np.ndarray)]


@both
@pytest.mark.parametrize("score", [towards_one, None])
@pytest.mark.parametrize("resampling", [ALWAYS, NEVER])
def test_step_leaves_its_input_alone(kind: str, score, resampling: Resampling) -> None:
    state = start(kind)
    before = [values.copy() for values in arrays_of(state)]
    for values in arrays_of(state):
        values.setflags(write=False)
    step(state, score, resampling)
    for values, copy in zip(arrays_of(state), before, strict=True):
        np.testing.assert_array_equal(values, copy)


@both
def test_a_seed_gives_identical_results(kind: str) -> None:
    first, second = (step(start(kind), towards_one, seed=4) for _ in range(2))
    other = step(start(kind), towards_one, seed=5)
    for a, b in zip(arrays_of(first[0]), arrays_of(second[0]), strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(astuple(first[1]), astuple(second[1]), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(first[0].poses, other[0].poses)


@both
def test_estimate_is_taken_before_resampling(kind: str) -> None:
    """(62)-(63): resampling must not change the estimate, only the next state."""
    kept, before = step(start(kind), towards_one, NEVER)
    drawn, after = step(start(kind), towards_one, ALWAYS)
    assert (before.resampled, after.resampled) == (False, True)
    for a, b in zip(astuple(before), astuple(replace(after, resampled=False)), strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_allclose(np.exp(kept.log_weights) @ kept.poses, before.pose, rtol=ROUNDING)
    np.testing.assert_allclose(drawn.log_weights, -np.log(50.0))
    assert {tuple(x) for x in drawn.poses} < {tuple(x) for x in kept.poses}


def test_ancestors_carry_their_velocities() -> None:
    kept, _ = step(start("marginal"), towards_one, NEVER)
    drawn, _ = step(start("marginal"), towards_one, ALWAYS)
    pairs = {tuple(x): tuple(v) for x, v in zip(kept.poses, kept.velocities, strict=True)}
    for x, v in zip(drawn.poses, drawn.velocities, strict=True):
        assert pairs[tuple(x)] == tuple(v)


@both
def test_weights_accumulate_until_resampled(kind: str) -> None:
    state, first = step(start(kind), towards_one, NEVER)
    before = state.log_weights
    after, second = step(state, towards_one, NEVER)
    scores = before + towards_one(after.poses)
    np.testing.assert_allclose(second.log_evidence, np.log(np.exp(scores).sum()), rtol=ROUNDING)
    np.testing.assert_allclose(after.log_weights, scores - second.log_evidence, rtol=ROUNDING)
    assert second.best == int(np.argmax(scores))
    np.testing.assert_array_equal(second.best_pose, after.poses[second.best])
    assert first.effective_sample_size > 1.0


@both
def test_evidence_does_not_depend_on_the_scale_of_the_weights_before(kind: str) -> None:
    state = start(kind)
    _, posterior = step(state, towards_one)
    _, shifted = step(replace(state, log_weights=state.log_weights + 7.0), towards_one)
    assert shifted.log_evidence == pytest.approx(posterior.log_evidence, rel=1e-9)


@both
def test_without_an_observation_weights_stay_and_nothing_is_resampled(kind: str) -> None:
    state, _ = step(start(kind), towards_one, NEVER)
    after, posterior = step(state, None, ALWAYS)
    np.testing.assert_allclose(after.log_weights, state.log_weights, atol=ROUNDING)
    assert not posterior.resampled
    assert posterior.log_evidence == 0.0
    assert not np.array_equal(after.poses, state.poses)


def test_velocity_follows_the_increment_also_without_an_observation() -> None:
    """(59), with hand.md's own formulas for N and L (euler)."""
    dynamics = replace(DYNAMICS, discretisation="euler")
    state, _ = step(start("marginal"), towards_one, NEVER, dynamics=dynamics)
    for score in (None, towards_one):
        after, _ = step(state, score, NEVER, dynamics=dynamics)
        P = state.velocity_variance
        N = DT**2 * P + DT * dynamics.pose_noise
        L = DT * P / N
        z = after.poses - state.poses
        expected = state.velocities + L * (z - DT * state.velocities)
        np.testing.assert_allclose(after.velocities, expected, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(after.velocity_variance, P + DT * dynamics.velocity_noise - L * N * L)


@pytest.mark.parametrize(
    ("kind", "options"),
    [("particle", {}), ("marginal", {"sampling": "marginal"}), ("marginal", {"sampling": "paper"})],
)
def test_frozen_component_does_not_move(kind: str, options: dict[str, str]) -> None:
    dynamics = Dynamics(np.array([4.0, 0.0, 2.0]), np.array([400.0, 0.0, 50.0]))
    state = start(kind)
    if isinstance(state, MarginalState):
        state = replace(state, velocity_variance=np.array([9.0, 0.0, 1.0]))
    after, posterior = step(state, towards_one, NEVER, dynamics=dynamics, **options)
    np.testing.assert_array_equal(after.poses[:, 1], state.poses[:, 1])
    assert np.all(after.poses[:, [0, 2]] != state.poses[:, [0, 2]])
    assert posterior.velocity[1] == 0.0
    assert posterior.velocity_variance[1] == 0.0


@both
@pytest.mark.parametrize(
    ("score", "message"),
    [
        (lambda x: np.full(len(x), -np.inf), "no particle explains"),
        (lambda x: np.where(np.arange(len(x)) == 3, np.nan, 0.0), "log-weights are NaN, found 1 of 50"),
        (lambda x: np.where(np.arange(len(x)) == 3, np.inf, 0.0), "log-weights are infinite"),
        (lambda x: np.zeros(len(x) - 1), "wrong shape"),
        (lambda x: np.zeros((len(x), 1)), "wrong shape"),
    ],
)
def test_likelihoods_that_say_nothing_are_an_error(kind: str, score, message: str) -> None:
    with pytest.raises(FilterError, match=message):
        step(start(kind), score)


@both
def test_one_possible_particle_takes_everything(kind: str) -> None:
    def only_seven(poses: np.ndarray) -> np.ndarray:
        return np.where(np.arange(len(poses)) == 7, -1e5, -np.inf)

    state, posterior = step(start(kind), only_seven)
    assert posterior.effective_sample_size == 1.0
    assert posterior.best == 7
    assert posterior.log_evidence == pytest.approx(-1e5 - np.log(50.0))
    np.testing.assert_array_equal(posterior.pose, posterior.best_pose)
    np.testing.assert_array_equal(posterior.pose_variance, 0.0)
    np.testing.assert_array_equal(state.poses, np.tile(posterior.pose, (50, 1)))


def test_single_particle_is_a_filter_too() -> None:
    _, posterior = step(start("marginal", count=1), towards_one)
    assert posterior.effective_sample_size == 1.0
    assert np.all(posterior.velocity_variance > 0.0)


def test_plain_filter_reports_no_velocity() -> None:
    _, posterior = step(start("particle"), towards_one)
    np.testing.assert_array_equal(posterior.velocity, np.zeros(3))
    np.testing.assert_array_equal(posterior.velocity_variance, np.zeros(3))


@settings(deadline=None)
@given(
    velocities=arrays(np.float64, (6, 2), elements=st.floats(-50.0, 50.0)),
    variance=arrays(np.float64, 2, elements=st.floats(0.0, 50.0)),
    weights=arrays(np.float64, 6, elements=st.floats(0.01, 1.0)),
)
def test_velocity_variance_is_the_mixture_s(
    velocities: np.ndarray, variance: np.ndarray, weights: np.ndarray
) -> None:
    weights = weights / weights.sum()
    mean, total = velocity_moments(velocities, variance, weights)
    second_moment = weights @ (velocities**2 + variance)
    np.testing.assert_allclose(total, second_moment - mean**2, atol=1e-10)  # eps times 50^2, cancelled
    assert np.all(total >= variance)


@both
def test_limits_hold_and_the_velocity_learns_from_what_was_left(kind: str) -> None:
    dynamics = replace(DYNAMICS, constrain=lambda x: np.clip(x, 0.0, 1.5))
    state, _ = step(start(kind), towards_one, NEVER, dynamics=dynamics)
    after, _ = step(state, towards_one, NEVER, dynamics=dynamics)
    assert after.poses.min() >= 0.0
    assert after.poses.max() <= 1.5
    if isinstance(after, MarginalState):
        free = replace(dynamics, constrain=None)
        unlimited, _ = step(state, towards_one, NEVER, dynamics=free)
        held = after.poses != unlimited.poses
        assert held.any() and not held.all()
        np.testing.assert_allclose(after.velocities[~held], unlimited.velocities[~held], rtol=1e-9, atol=1e-9)
        lower = unlimited.poses > 1.5
        assert np.all(after.velocities[lower] < unlimited.velocities[lower])


def test_unknown_proposal_names_the_nearest() -> None:
    with pytest.raises(FilterError, match="did you mean 'marginal'"):
        step(start("marginal"), towards_one, sampling="marginl")


@pytest.mark.parametrize(("count", "sd"), [(0, 1.0), (3, -1.0), (3, np.nan)])
def test_initial_spread_is_checked(count: int, sd: float) -> None:
    rng, spread = np.random.default_rng(0), np.full(3, sd)
    with pytest.raises(FilterError):
        ParticleState.initial(Prior(np.zeros(3), spread, np.zeros(0)), count, SPACE, rng)
    with pytest.raises(FilterError):
        MarginalState.initial(Prior(np.zeros(3), spread, np.ones(3)), count, SPACE, rng)


def test_initial_state_has_the_moments_asked_for() -> None:
    count, sd = 20_000, np.array([1.0, 0.5, 0.0])
    prior = Prior(np.array([1.0, 2.0, 3.0]), sd, np.array([4.0, 5.0, 0.0]))
    state = MarginalState.initial(prior, count, SPACE, np.random.default_rng(0))
    assert np.all(np.abs(state.poses.mean(axis=0) - [1.0, 2.0, 3.0]) <= 4.0 * sd / np.sqrt(count))
    assert np.all(np.abs(state.poses.std(axis=0) - sd) <= 4.0 * sd / np.sqrt(2.0 * count))
    np.testing.assert_array_equal(state.velocity_variance, [16.0, 25.0, 0.0])
    np.testing.assert_array_equal(state.velocities, 0.0)


def test_states_whose_arrays_do_not_match_are_refused() -> None:
    with pytest.raises(FilterError, match="particles do not match"):
        ParticleState(np.zeros((3, 2)), np.zeros(2))
    with pytest.raises(FilterError, match="particles do not match"):
        MarginalState(np.zeros((3, 2)), np.zeros((3, 1)), np.ones(2), np.zeros(3))


class Turning:
    """SO(3) as canonical quaternions: S = 4 and D = 3, body-frame rotation vectors."""

    def retract(self, x: np.ndarray, delta: np.ndarray) -> np.ndarray:
        return rot.canonical(rot.multiply(x, rot.exponential(delta)))

    def local(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return rot.logarithm(rot.multiply(rot.conjugate(x), y))

    def mean(self, x: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return rot.mean_quaternion(x, weights)


def test_velocity_of_a_steady_turn_through_half_a_turn_and_the_sign_flip() -> None:
    """A body turning at 2 rad/s about a fixed axis for 3 s passes w = 0, where canonical quaternions jump."""
    space, rng, sd = Turning(), np.random.default_rng(0), 0.03
    rate = np.array([1.2, -1.6, 0.0])
    dynamics = Dynamics(np.full(3, 1e-4), np.full(3, 0.05))
    state = MarginalState.initial(
        Prior(np.array(rot.IDENTITY), np.full(3, sd), np.full(3, 2.0)), 2000, space, rng
    )
    for frame in range(1, 91):
        seen = rot.exponential(rate * frame * DT)

        def score(poses: np.ndarray, seen: np.ndarray = seen) -> np.ndarray:
            return -0.5 * np.square(rot.angle_between(seen, poses) / sd)

        state, posterior = state.step(DT, FilterModel(dynamics, space, ALWAYS), score, rng)
        assert posterior.pose[3] >= 0.0
    assert posterior.pose_variance.shape == (3,)
    # noise-free observations: what is left is the posterior's own spread, four of its sd per component
    assert np.all(np.abs(posterior.velocity - rate) < 4.0 * np.sqrt(posterior.velocity_variance))
    assert np.all(np.sqrt(posterior.velocity_variance) < 0.3)
    assert rot.angle_between(posterior.pose, seen) < 4.0 * np.sqrt(posterior.pose_variance.max())


def test_filters_are_found_by_the_names_that_configurations_use() -> None:
    assert (FILTERS.find("pf"), FILTERS.find("rbpf")) == (ParticleState, MarginalState)
    with pytest.raises(FilterError, match="unknown filter, found rpbf; did you mean 'rbpf'"):
        FILTERS.find("rpbf")
