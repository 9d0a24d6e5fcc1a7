"""The particle filters against an exact Kalman filter, to within their own Monte-Carlo error."""

from __future__ import annotations

from itertools import cycle

import numpy as np
import pytest

from posetrack_cli.filtering.resampling import Resampling, resampling_schemes
from posetrack_cli.filtering.step import Posterior

PARTICLES = 4000
ALWAYS = Resampling(threshold=1.0)

SLACK = 2.0
"""On the predicted RMS error (World.monte_carlo_variance): it is first order, and errors of one run are
correlated over about ten frames, so that an RMS over 200 has some 20 independent terms. Seen: 0.6 to 1.5; the
paper's proposal: 3.6 and more."""


def means(posteriors: list[Posterior], moving: bool = True) -> np.ndarray:
    return np.array([np.r_[p.pose, p.velocity] if moving else p.pose for p in posteriors])


def rms(errors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(np.square(errors), axis=0))


def predicted_rms(world, exact, posteriors: list[Posterior], count: int = PARTICLES) -> np.ndarray:
    return np.sqrt(world.monte_carlo_variance(exact, posteriors, count).mean(axis=0))


def log_evidence_error(exact, posteriors: list[Posterior]) -> tuple[float, float]:
    """The error of the log evidence, and its predicted sd: each frame's mean weight errs by 1 / sqrt(ESS)."""
    error = sum(p.log_evidence for p in posteriors) - exact.log_evidence.sum()
    return error, np.sqrt(sum(1.0 / p.effective_sample_size for p in posteriors))


@pytest.mark.parametrize(("discretisation", "seed"), [("euler", 2), ("exact", 3)])
def test_marginal_filter_meets_kalman(make_world, steps: np.ndarray, discretisation: str, seed: int) -> None:
    world = make_world(steps, discretisation=discretisation)
    observations = world.observations(1)
    exact = world.kalman(observations)
    posteriors = world.marginal(observations, PARTICLES, seed, ALWAYS)

    predicted = predicted_rms(world, exact, posteriors)
    assert np.all(rms(means(posteriors) - exact.means) < SLACK * predicted)

    variances = np.array([np.r_[p.pose_variance, p.velocity_variance] for p in posteriors])
    truth = np.diagonal(exact.covariances, axis1=1, axis2=2)
    # of a Gaussian sample the variance errs sqrt(2) times as much as the mean, both relative to the sd
    relative = np.sqrt(2.0) * predicted / np.sqrt(truth.mean(axis=0))
    assert np.all(rms(variances / truth - 1.0) < SLACK * relative)

    error, sd = log_evidence_error(exact, posteriors)
    assert abs(error) < 4.0 * sd


@pytest.mark.parametrize("discretisation", ["euler", "exact"])
def test_paper_s_proposal_is_worse_and_more_particles_do_not_help(make_world, discretisation: str) -> None:
    """(51) as printed drops dt^2 P: a bias, where the marginal proposal errs by 1 / sqrt(N)."""
    world = make_world(np.full(200, 1.0 / 30.0), discretisation=discretisation)
    observations = world.observations(1)
    exact = world.kalman(observations)
    errors = {}
    for proposal in ("marginal", "paper"):
        for count in (PARTICLES, 4 * PARTICLES):
            posteriors = world.marginal(observations, count, 2, ALWAYS, proposal)
            errors[proposal, count] = rms(means(posteriors) - exact.means)
            if proposal == "paper":
                beyond = errors[proposal, count] / predicted_rms(world, exact, posteriors, count)
                assert np.all(beyond > 1.5 * SLACK)
    assert np.all(errors["paper", PARTICLES] > 2.0 * errors["marginal", PARTICLES])
    assert np.all(errors["paper", 4 * PARTICLES] > 0.7 * errors["paper", PARTICLES])
    assert np.all(errors["marginal", 4 * PARTICLES] < 0.7 * errors["marginal", PARTICLES])


def test_distances_of_the_method_s_notes(make_world) -> None:
    """hand.md: mean distance 0.017 / 0.125 with both fixes, 0.066 / 0.54 with the paper's proposal."""
    world = make_world(np.full(200, 1.0 / 30.0), discretisation="euler")
    distances = {"marginal": [], "paper": []}
    for seed in range(6):
        observations = world.observations(100 + seed)
        exact = world.kalman(observations)
        for proposal, found in distances.items():
            posteriors = world.marginal(observations, PARTICLES, seed, ALWAYS, proposal)
            found.append(np.abs(means(posteriors) - exact.means).mean(axis=0))
    # the notes give one run each; runs scatter by some 25 % of their mean
    np.testing.assert_allclose(np.mean(distances["marginal"], axis=0), [0.017, 0.125], rtol=0.35)
    np.testing.assert_allclose(np.mean(distances["paper"], axis=0), [0.066, 0.54], rtol=0.35)


def test_plain_particle_filter_meets_kalman(make_world, steps: np.ndarray) -> None:
    world = make_world(steps, moving=False)
    observations = world.observations(1)
    exact = world.kalman(observations)
    posteriors = world.particle(observations, PARTICLES, 2, ALWAYS)
    predicted = predicted_rms(world, exact, posteriors)
    assert np.all(rms(means(posteriors, moving=False) - exact.means) < SLACK * predicted)
    truth = np.diagonal(exact.covariances, axis1=1, axis2=2)
    relative = np.sqrt(2.0) * predicted / np.sqrt(truth.mean(axis=0))
    variances = np.array([p.pose_variance for p in posteriors])
    assert np.all(rms(variances / truth - 1.0) < SLACK * relative)
    error, sd = log_evidence_error(exact, posteriors)
    assert abs(error) < 4.0 * sd


@pytest.mark.parametrize(("scheme", "threshold"), list(zip(resampling_schemes(), cycle([0.3, 1.0]))))
def test_every_scheme_and_threshold_meets_kalman(make_world, scheme: str, threshold: float) -> None:
    world = make_world(np.full(200, 1.0 / 30.0))
    observations = world.observations(4)
    exact = world.kalman(observations)
    posteriors = world.marginal(observations, PARTICLES, 5, Resampling(scheme, threshold))
    assert any(p.resampled for p in posteriors)
    assert all(p.resampled for p in posteriors) == (threshold == 1.0)
    assert np.all(rms(means(posteriors) - exact.means) < SLACK * predicted_rms(world, exact, posteriors))
    error, sd = log_evidence_error(exact, posteriors)
    assert abs(error) < 4.0 * sd


def test_three_components_meet_kalman(make_world) -> None:
    """All components share the weights: with three the effective size is a third of N, and falls to N / 100.

    The first-order prediction leaves out the sampled correlations between components; over seeds the ratio is
    1.4 on average and the same from 4000 to 64000 particles, so it is Monte-Carlo error and no bias.
    """
    world = make_world(np.full(200, 1.0 / 30.0), dimension=3)
    observations = world.observations(6)
    exact = world.kalman(observations)
    errors = []
    for count in (PARTICLES, 4 * PARTICLES):
        posteriors = world.marginal(observations, count, 7, ALWAYS)
        ratio = (means(posteriors) - exact.means) / predicted_rms(world, exact, posteriors, count)
        for part in (ratio[:, :3], ratio[:, 3:]):  # poses, velocities
            assert rms(part.ravel()) < SLACK
        errors.append(rms(means(posteriors) - exact.means).mean())
    assert 0.35 < errors[1] / errors[0] < 0.7  # 1 / sqrt(4), to the 25 % that runs scatter by


@pytest.mark.parametrize(("moving", "threshold"), [(True, 0.5), (False, 1.0)])
def test_evidence_is_unbiased(make_world, moving: bool, threshold: float) -> None:
    """E[estimate of p(y_1..T)] = p(y_1..T) for any number of particles (Del Moral 2004, section 7.4.1)."""
    world = make_world(np.full(10, 1.0 / 30.0), dimension=2, moving=moving)
    observations = world.observations(8)
    truth = world.kalman(observations).log_evidence.sum()
    run = world.marginal if moving else world.particle
    resampling = Resampling(threshold=threshold)
    ratios = np.exp(
        [
            sum(p.log_evidence for p in run(observations, 1000, seed, resampling)) - truth
            for seed in range(300)
        ]
    )
    assert abs(ratios.mean() - 1.0) < 4.0 * ratios.std() / np.sqrt(ratios.size)
    assert ratios.std() < 1.0  # so that the line above tells 1 from 1.25, whatever numbers a numpy draws
