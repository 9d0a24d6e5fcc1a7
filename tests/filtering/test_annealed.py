"""Annealing within a frame: the exact posterior at its end, whatever the blocks, and no NaN unseen."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.filtering.annealed import Annealing, next_step
from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.filters import MarginalState, ParticleState, Prior
from posetrack_cli.filtering.model import Dynamics, Euclidean, FilterModel
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.step import Prediction
from posetrack_cli.geometry import rotations as rot

SPACE, RESAMPLING, DT = Euclidean(), Resampling(), 1.0 / 30.0
RUNS = 10
ANNEALINGS = {
    "all at once": Annealing(),
    "blocks": Annealing(blocks=(np.array([0, 2]), np.array([1]))),
    "many small moves": Annealing(keep=0.9, sweeps=2, reach=0.3),
}


@pytest.mark.parametrize("annealing", ANNEALINGS.values(), ids=ANNEALINGS.keys())
@pytest.mark.parametrize("moving", [True, False])
def test_annealing_meets_kalman(make_world, moving: bool, annealing: Annealing) -> None:
    """Mean, variance and evidence, over runs; the likelihood is ten times sharper than the prior."""
    mixing = 10.0 * np.array([[1.0, 0.5, 0.0], [-0.3, 2.0, 0.4], [0.2, 0.1, 0.7]])
    world = make_world(np.full(5, DT), dimension=3, moving=moving, mixing=mixing)
    observations = world.observations(1)
    exact = world.kalman(observations)
    truth = np.diagonal(exact.covariances, axis1=1, axis2=2)
    errors, ratios, evidence = [], [], []
    for seed in range(RUNS):
        run = world.marginal if moving else world.particle
        found = run(observations, 1000, seed, RESAMPLING, guide=lambda y: annealing)
        means = [np.r_[p.pose, p.velocity] if moving else p.pose for p in found]
        variances = [
            np.r_[p.pose_variance, p.velocity_variance] if moving else p.pose_variance for p in found
        ]
        errors.append((np.array(means) - exact.means) / np.sqrt(truth))
        ratios.append(np.array(variances) / truth)
        evidence.append(sum(p.log_evidence for p in found) - exact.log_evidence.sum())
        assert min(p.effective_sample_size for p in found) > 400.0
    scatter = np.std(errors, axis=0, ddof=1)
    assert np.sqrt(np.mean(np.square(scatter))) < 0.25
    # frames are alike, so that their scatter is pooled
    pooled = np.sqrt(np.mean(np.square(scatter), axis=0) / RUNS)
    assert np.all(np.abs(np.mean(errors, axis=0)) < 5.0 * pooled)
    np.testing.assert_allclose(np.mean(ratios, axis=(0, 1)), 1.0, atol=0.12)
    assert abs(np.mean(evidence)) < 4.0 * np.std(evidence, ddof=1) / np.sqrt(RUNS) + 0.02


def test_plain_steps_do_not_reach_what_annealing_does(make_world) -> None:
    """So that the test above is one: of 1000 plain particles hardly one lies where the likelihood is."""
    world = make_world(np.full(5, DT), dimension=3, mixing=10.0 * np.eye(3))
    plain = world.marginal(world.observations(1), 1000, 0, RESAMPLING)
    assert np.median([p.effective_sample_size for p in plain]) < 20.0


@pytest.mark.parametrize("kind", ["particle", "marginal"])
def test_both_modes_keep_their_true_mass(kind: str) -> None:
    """Two narrow fingers of unlike widths, against a sum over a grid."""
    tops, widths, heights = np.array([-0.5, 0.6]), np.array([0.05, 0.02]), np.array([0.0, 1.0])

    def score(poses: np.ndarray) -> np.ndarray:
        return np.logaddexp.reduce(heights - 0.5 * np.square((poses - tops) / widths), axis=1)

    side = np.linspace(-4.0, 4.0, 80_001)
    density = np.exp(score(side[:, None]) - 0.5 * np.square(side) / 0.26)
    truth = density[side > 0.0].sum() / density.sum()
    masses = []
    for seed in range(30):
        rng, mean, sd = np.random.default_rng(seed), np.zeros(1), np.full(1, 0.1)
        if kind == "particle":
            state = ParticleState.initial(Prior(mean, sd, np.zeros(0)), 500, SPACE, rng)
            dynamics = Dynamics(np.full(1, 0.25 / DT), np.zeros(1))
        else:
            state = MarginalState.initial(Prior(mean, sd, np.full(1, 0.4 / DT)), 500, SPACE, rng)
            dynamics = Dynamics(np.full(1, 0.09 / DT), np.zeros(1))
        model = FilterModel(dynamics, SPACE, RESAMPLING)
        after, _ = state.step(DT, model, score, rng, Annealing())
        masses.append(np.exp(after.log_weights)[after.poses[:, 0] > 0.0].sum())
    assert abs(np.mean(masses) - truth) < 4.0 * np.std(masses, ddof=1) / np.sqrt(30.0)
    assert np.std(masses) < 0.1
    assert 0.2 < truth < 0.8


class Turning:
    """SO(3) as canonical quaternions."""

    def retract(self, x: np.ndarray, delta: np.ndarray) -> np.ndarray:
        return rot.canonical(rot.multiply(x, rot.exponential(delta)))

    def local(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return rot.logarithm(rot.multiply(rot.conjugate(x), y))


def test_rotations_meet_brute_force() -> None:
    """Mean turn and evidence against a million draws from the prior, weighed."""
    space, spread, drift = Turning(), np.array([0.5, 0.7, 0.4]), np.array([0.5, -0.2, 0.1])
    seen = rot.exponential(np.array([1.0, 0.3, -0.6]))

    def score(poses: np.ndarray) -> np.ndarray:
        return -20.0 * np.square(rot.angle_between(seen, poses))

    rng, count = np.random.default_rng(0), 20_000
    identity = np.array(rot.IDENTITY)
    turns = space.retract(identity[None], drift + spread * rng.standard_normal((1_000_000, 3)))
    weights = np.exp(score(turns))
    prediction = Prediction(
        np.tile(identity, (count, 1)),
        np.tile(drift, (count, 1)),
        np.square(spread),
        np.full(count, -np.log(count)),
    )
    found = Annealing().propose(
        prediction,
        FilterModel(Dynamics(prediction.variance, np.zeros_like(prediction.variance)), space, RESAMPLING),
        score,
        rng,
    )
    np.testing.assert_allclose(space.local(identity, found.poses), found.increments, atol=1e-9)
    truth = weights @ space.local(seen, turns) / weights.sum()
    mean = found.weighing.weights @ space.local(seen, found.poses)
    # posterior sd 0.16 over the root of the effective size, which moves leave correlated: twice that
    assert np.all(np.abs(mean - truth) < 4.0 * 2.0 * 0.16 / np.sqrt(found.weighing.effective_sample_size))
    assert abs(found.weighing.log_evidence - np.log(weights.mean())) < 0.05


def test_steps_leave_the_share_that_is_asked_for() -> None:
    scores = -np.square(np.random.default_rng(0).standard_normal(2000)) * 300.0
    for keep in (0.3, 0.5, 0.9):
        weights = np.exp(next_step(scores, 1.0, keep) * scores)
        # bisected to a hundredth of the step; of a share that moves at most half as fast
        assert weights.sum() ** 2 / np.square(weights).sum() / 2000.0 == pytest.approx(keep, abs=0.01)


@pytest.mark.parametrize("left", [1.0, 0.3])
def test_a_flat_likelihood_takes_one_step(left: float) -> None:
    assert next_step(np.full(50, -3.0), left, 0.5) == left


def test_a_step_is_never_nothing() -> None:
    scores = np.full(1000, -np.inf)
    scores[0] = 0.0
    assert next_step(scores, 1.0, 0.5) > 0.0


def test_likelihood_evaluations_are_as_many_as_stated() -> None:
    asked = []

    def score(poses: np.ndarray) -> np.ndarray:
        asked.append(len(poses))
        return np.zeros(len(poses))

    state = ParticleState.initial(
        Prior(np.zeros(2), np.ones(2), np.zeros(0)), 30, SPACE, np.random.default_rng(0)
    )
    dynamics = Dynamics(np.ones(2), np.zeros(2))
    state.step(DT, FilterModel(dynamics, SPACE, RESAMPLING), score, np.random.default_rng(1), Annealing())
    assert asked == [30]  # one step: nothing to anneal


def test_a_nan_on_the_way_is_told() -> None:
    calls = []

    def score(poses: np.ndarray) -> np.ndarray:
        calls.append(1)
        values = -1e3 * np.square(poses[:, 0])
        return np.where(np.arange(len(poses)) == 3, np.nan, values) if len(calls) > 1 else values

    state = ParticleState.initial(
        Prior(np.zeros(1), np.ones(1), np.zeros(0)), 50, SPACE, np.random.default_rng(0)
    )
    with pytest.raises(FilterError, match="NaN"):
        model = FilterModel(Dynamics(np.ones(1), np.zeros(1)), SPACE, RESAMPLING)
        state.step(DT, model, score, np.random.default_rng(1), Annealing())
    assert len(calls) > 1


@pytest.mark.parametrize("options", [{"keep": 0.0}, {"keep": 1.1}, {"reach": 0.0}, {"sweeps": 0}])
def test_annealing_that_cannot_be_used_is_refused(options: dict) -> None:
    with pytest.raises(FilterError, match="cannot be used"):
        Annealing(**options)
