"""Halfway partitioned sampling against distributions that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.model import Gaussian, kalman_predict
from posetrack_cli.filtering.partitioned import Motion, local_mean, partitioned_step
from posetrack_cli.filtering.resampling import resampling_schemes
from support.kalman import kalman_update

# Two components of the first group and one of the second; the observation mixes them, so that the posterior
# correlates what moves apart.
DRIFT, SD, FIRST = np.array([0.5, -0.2, 0.0]), np.array([0.8, 0.5, 1.2]), 2
MIXING = np.array([[1.0, 0.3, 0.7], [0.0, 1.0, -0.6]])
NOISE = np.diag([1.0, 0.8])
START = Gaussian(np.array([0.2, -0.1, 0.4]), np.diag([0.5, 0.3, 0.6]))
OBSERVATIONS = np.array([[1.6, -0.9], [2.2, 0.3], [2.0, -1.4]])
MOTION = Motion(DRIFT, SD, FIRST)
COUNT, RUNS = 5000, 60
SIGMAS = 5.0
"""Standard errors that the mean over RUNS independent runs may be off: once in 2 million."""


def log_likelihood(y):
    precision = np.linalg.inv(NOISE)

    def of(points):
        residual = y - points @ MIXING.T
        return -0.5 * np.einsum("ni,ij,nj->n", residual, precision, residual)

    return of


def start(rng, count=COUNT):
    return rng.multivariate_normal(START.mean, START.covariance, size=count)


def moments(points, weights):
    mean = weights @ points
    return np.concatenate([mean, weights @ np.square(points - mean)])


def run(seed, sampling, observations, scheme="systematic"):
    """Means and variances (6,) after the last observation."""
    rng = np.random.default_rng(seed)
    points, weights = start(rng), np.full(COUNT, 1.0 / COUNT)
    for y in observations:
        moved = partitioned_step(points, weights, MOTION, log_likelihood(y), sampling, scheme, rng)
        points, weights = moved.points, moved.weighing.weights
    return moments(points, weights)


def predicted(belief, sd, drift):
    shifted = Gaussian(belief.mean + drift, belief.covariance)
    return kalman_predict(shifted, np.eye(3), np.diag(np.square(sd)))


def kalman(observations):
    belief = START
    for y in observations:
        belief, _ = kalman_update(predicted(belief, SD, DRIFT), y, MIXING, NOISE)
    return np.concatenate([belief.mean, np.diag(belief.covariance)])


def printed_target(y):
    """Moments of p(y | x) int N(x; x~, Q) p(y | x~) p_half(x~ | x_0): a mixture of two Gaussians."""
    parts = []
    for moves in (np.arange(3) < FIRST, np.arange(3) >= FIRST):
        halfway, first = kalman_update(predicted(START, SD * moves, DRIFT * moves), y, MIXING, NOISE)
        arrived, second = kalman_update(predicted(halfway, SD, 0.0 * DRIFT), y, MIXING, NOISE)
        parts.append((first + second, arrived))
    weights = np.exp([log - parts[0][0] for log, _ in parts])
    weights /= weights.sum()
    mean = sum(w * part.mean for w, (_, part) in zip(weights, parts, strict=True))
    squares = [np.diag(part.covariance) + np.square(part.mean - mean) for _, part in parts]
    return np.concatenate([mean, weights @ squares])


def assert_agrees(runs, exact):
    """The mean over independent runs is off by its own standard error only; a filter's bias is O(1 / N)."""
    error = np.std(runs, axis=0, ddof=1) / np.sqrt(len(runs))
    assert np.all(np.abs(np.mean(runs, axis=0) - exact) < SIGMAS * error + 2.0 / COUNT)
    assert np.all(SIGMAS * error < 0.07), "the test would not see a bias"


@pytest.mark.parametrize("scheme", resampling_schemes())
def test_weighted_halves_keep_the_filters_posterior(scheme):
    runs = [run(seed, "weighted", OBSERVATIONS, scheme) for seed in range(RUNS)]
    assert_agrees(runs, kalman(OBSERVATIONS))


def test_printed_halves_have_noise_and_likelihood_twice():
    exact = printed_target(OBSERVATIONS[0])
    assert_agrees([run(seed, "printed", OBSERVATIONS[:1]) for seed in range(RUNS)], exact)
    assert np.max(np.abs(exact - kalman(OBSERVATIONS[:1]))) > 0.1, "not the filter's posterior"


@pytest.mark.parametrize("first", [0, 3])
def test_one_group_alone_keeps_the_posterior_too(first):
    motion, results = Motion(DRIFT, SD, first), []
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        weights = np.full(COUNT, 1.0 / COUNT)
        moved = partitioned_step(
            start(rng), weights, motion, log_likelihood(OBSERVATIONS[0]), "weighted", "systematic", rng
        )
        results.append(moments(moved.points, moved.weighing.weights))
    assert_agrees(results, kalman(OBSERVATIONS[:1]))


def test_each_particle_makes_one_whole_move():
    """Without information and from one place: N(drift, Q), equal weights."""
    count, rng = 40_000, np.random.default_rng(3)
    points, weights = np.zeros((count, 3)), np.full(count, 1.0 / count)
    moved = partitioned_step(
        points, weights, MOTION, lambda p: np.zeros(len(p)), "weighted", "systematic", rng
    )
    assert moved.weighing.effective_sample_size == pytest.approx(count)
    assert moved.points.mean(axis=0) == pytest.approx(DRIFT, abs=4.0 * SD.max() / np.sqrt(count))
    covariance = np.cov(moved.points.T)
    tolerance = 4.0 * np.sqrt(2.0 / count) * np.outer(SD, SD)
    assert np.all(np.abs(covariance - np.diag(np.square(SD))) < tolerance)
    assert np.all(points == 0.0), "what was handed over is left as it was"


def test_printed_halves_move_in_one_group_each_before_the_first_weighing():
    seen = []

    def watching(points):
        seen.append(points.copy())
        return np.zeros(len(points))

    rng, points = np.random.default_rng(0), np.zeros((10, 3))
    partitioned_step(points, np.full(10, 0.1), MOTION, watching, "printed", "systematic", rng)
    halfway, arrived = seen
    assert np.all(halfway[::2, :FIRST] != 0.0) and np.all(halfway[::2, FIRST:] == 0.0)
    assert np.all(halfway[1::2, :FIRST] == 0.0) and np.all(halfway[1::2, FIRST:] != 0.0)
    assert np.all(arrived != 0.0)


def test_same_seed_same_particles():
    first, second = (run(7, "weighted", OBSERVATIONS).tolist() for _ in range(2))
    assert first == second


@pytest.mark.parametrize(
    "motion",
    [
        Motion(DRIFT[:2], SD, FIRST),
        Motion(DRIFT, SD[:2], FIRST),
        Motion(DRIFT, SD, 4),
        Motion(DRIFT, -SD, FIRST),
        Motion(DRIFT, SD * np.nan, FIRST),
    ],
)
def test_what_does_not_match_is_refused(motion):
    rng = np.random.default_rng(0)
    with pytest.raises(FilterError):
        partitioned_step(
            np.zeros((4, 3)), np.ones(4), motion, lambda p: np.zeros(len(p)), "weighted", "systematic", rng
        )


def test_local_mean_by_hand():
    """The heaviest is (0, 0); (2, 0) is one unit away, (0, 3) three, and (40, 0) far."""
    points = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 3.0], [40.0, 0.0]])
    weights = np.array([0.4, 0.2, 0.2, 0.2])
    scale = np.array([2.0, 1.0])
    assert local_mean(points, weights, scale, 2.0).tolist() == pytest.approx([0.4 / 0.6, 0.0])
    assert local_mean(points, weights, scale, 4.0).tolist() == pytest.approx([0.4 / 0.8, 0.6 / 0.8])
    assert local_mean(points, weights, scale, 0.5).tolist() == [0.0, 0.0]


@given(st.integers(1, 30), st.integers(0, 2**32 - 1), st.floats(0.1, 10.0))
def test_local_mean_lies_within_the_radius_and_ignores_units(count, seed, radius):
    rng = np.random.default_rng(seed)
    points, weights = rng.normal(size=(count, 3)), rng.random(count) + 0.01
    scale, units = rng.random(3) + 0.1, np.array([1.0, 1000.0, 0.01])
    mean = local_mean(points, weights, scale, radius)
    assert np.linalg.norm((mean - points[np.argmax(weights)]) / scale) <= radius * (1.0 + 1e-12)
    assert local_mean(points * units, weights, scale * units, radius) == pytest.approx(mean * units)
