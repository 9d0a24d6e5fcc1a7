"""Time is real time: one prediction over 2 dt has the distribution of two over dt."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.filters import MarginalState, ParticleState, Prior
from posetrack_cli.filtering.model import (
    Dynamics,
    Euclidean,
    FilterModel,
    Gaussian,
    constant_velocity,
    kalman_predict,
)
from posetrack_cli.filtering.resampling import Resampling

COUNT = 40_000
SIGMAS = 4.5
"""Of the standard error of a sample moment: each comparison fails by chance once in 150 000."""

SPACE, RESAMPLING = Euclidean(), Resampling()
SD, VELOCITY_SD = np.array([1.0, 0.2]), np.array([10.0, 3.0])
DYNAMICS = Dynamics(np.array([4.0, 0.5]), np.array([4000.0, 90.0]))
DT = 1.0 / 15.0


def predict_marginal(parts: int, dynamics: Dynamics, seed: int) -> MarginalState:
    rng = np.random.default_rng(seed)
    state = MarginalState.initial(Prior(np.zeros(2), SD, VELOCITY_SD), COUNT, SPACE, rng)
    for _ in range(parts):
        state, posterior = state.step(2 * DT / parts, FilterModel(dynamics, SPACE, RESAMPLING), None, rng)
        assert not posterior.resampled
        assert posterior.log_evidence == 0.0
    return state


def covariance_of(state: MarginalState) -> np.ndarray:
    """Of (pose, velocity) together: that of the particles, plus P (total variance)."""
    sample = np.cov(np.hstack([state.poses, state.velocities]), rowvar=False)
    sample[[2, 3], [2, 3]] += state.velocity_variance
    return sample


def expected_covariance(dynamics: Dynamics) -> np.ndarray:
    F, Q = constant_velocity(dynamics.over(2 * DT), 2 * DT)
    start = Gaussian(np.zeros(4), np.diag(np.r_[SD, VELOCITY_SD] ** 2))
    return kalman_predict(start, F, Q).covariance


def standard_error(covariance: np.ndarray) -> np.ndarray:
    """Of a Gaussian sample's covariance: sqrt((c_ij^2 + c_ii c_jj) / N)."""
    diagonal = np.diag(covariance)
    return np.sqrt((covariance**2 + np.outer(diagonal, diagonal)) / COUNT)


@pytest.mark.parametrize("parts", [1, 2, 4])
def test_marginal_prediction_is_the_exact_gaussian_in_any_number_of_steps(parts: int) -> None:
    state = predict_marginal(parts, DYNAMICS, seed=parts)
    expected = expected_covariance(DYNAMICS)
    means = np.hstack([state.poses, state.velocities]).mean(axis=0)
    assert np.all(np.abs(means) < SIGMAS * np.sqrt(np.diag(expected) / COUNT))
    assert np.all(np.abs(covariance_of(state) - expected) < SIGMAS * standard_error(expected))


def test_euler_prediction_depends_on_the_number_of_steps() -> None:
    """So the test above can tell: euler misses dt^3 Q^l = 1.2 in the pose's variance, 40 standard errors."""
    dynamics = Dynamics(DYNAMICS.pose_noise, DYNAMICS.velocity_noise, "euler")
    once, twice = (covariance_of(predict_marginal(parts, dynamics, seed=9)) for parts in (1, 2))
    missing = DT**3 * dynamics.velocity_noise
    error = np.sqrt(2.0) * np.diag(standard_error(expected_covariance(DYNAMICS)))[:2]
    assert np.all(np.abs(np.diag(twice - once)[:2] - missing) < SIGMAS * error)
    assert np.all(missing > SIGMAS * error)


@pytest.mark.parametrize("parts", [1, 2, 4])
def test_plain_prediction_is_the_exact_gaussian_in_any_number_of_steps(parts: int) -> None:
    rng = np.random.default_rng(parts)
    state = ParticleState.initial(Prior(np.zeros(2), SD, np.zeros(0)), COUNT, SPACE, rng)
    for _ in range(parts):
        state, _ = state.step(2 * DT / parts, FilterModel(DYNAMICS, SPACE, RESAMPLING), None, rng)
    variance = SD**2 + 2 * DT * DYNAMICS.pose_noise
    assert np.all(np.abs(state.poses.mean(axis=0)) < SIGMAS * np.sqrt(variance / COUNT))
    assert np.all(np.abs(state.poses.var(axis=0) - variance) < SIGMAS * variance * np.sqrt(2.0 / COUNT))


@pytest.mark.parametrize("dt", [0.0, -1.0 / 30.0, np.nan, np.inf])
def test_steps_refuse_time_that_does_not_move_forward(dt: float) -> None:
    rng = np.random.default_rng(0)
    plain = ParticleState.initial(Prior(np.zeros(2), SD, np.zeros(0)), 3, SPACE, rng)
    marginal = MarginalState.initial(Prior(np.zeros(2), SD, VELOCITY_SD), 3, SPACE, rng)
    with pytest.raises(FilterError, match="invalid time step"):
        plain.step(dt, FilterModel(DYNAMICS, SPACE, RESAMPLING), None, rng)
    with pytest.raises(FilterError, match="invalid time step"):
        marginal.step(dt, FilterModel(DYNAMICS, SPACE, RESAMPLING), None, rng)
