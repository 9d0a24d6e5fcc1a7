"""A linear-Gaussian world with an exact Kalman filter, against which the particle filters are measured.

Parameters of method/hand.md: dt 1/30 s, Q^n 4, Q^l 400, observation sd 1. Every component is an independent
copy of (pose, velocity), observed in its pose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from posetrack_cli.filtering.filters import MarginalState, ParticleState, Prior
from posetrack_cli.filtering.guided import Guide
from posetrack_cli.filtering.model import (
    Dynamics,
    Euclidean,
    FilterModel,
    Gaussian,
    constant_velocity,
    kalman_predict,
    step_noise,
    velocity_gain,
)
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.step import Posterior
from support.kalman import kalman_update

POSE_NOISE, VELOCITY_NOISE, OBSERVATION_VARIANCE = 4.0, 400.0, 1.0
START_SD, START_VELOCITY_SD = 1.0, 10.0


@dataclass(frozen=True)
class Exact:
    """The Kalman filter's answer: means (T, 2D), covariances (T, 2D, 2D), log evidence (T,), transitions."""

    means: np.ndarray
    covariances: np.ndarray
    log_evidence: np.ndarray
    transitions: list[np.ndarray]
    gains: list[np.ndarray]


@dataclass(frozen=True)
class World:
    """Time steps (T,), dimension D, whether there is a velocity, and what of the pose is observed (M, D)."""

    steps: np.ndarray
    dimension: int = 1
    discretisation: str = "exact"
    moving: bool = True
    space: Euclidean = field(default_factory=Euclidean)
    mixing: np.ndarray | None = None
    start_sd: float = START_SD

    @property
    def dynamics(self) -> Dynamics:
        ones = np.ones(self.dimension)
        return Dynamics(POSE_NOISE * ones, VELOCITY_NOISE * ones, self.discretisation)

    def transition(self, dt: float) -> tuple[np.ndarray, np.ndarray]:
        if not self.moving:
            return np.eye(self.dimension), dt * POSE_NOISE * np.eye(self.dimension)
        dynamics = self.dynamics
        noise = step_noise(dynamics.pose_noise, dynamics.velocity_noise, dt, self.discretisation)
        return constant_velocity(noise, dt)

    @property
    def sensor(self) -> np.ndarray:
        pose = np.eye(self.dimension, (1 + self.moving) * self.dimension)
        return pose if self.mixing is None else self.mixing @ pose

    @property
    def start(self) -> Gaussian:
        sd = [self.start_sd] * self.dimension + [START_VELOCITY_SD] * (self.dimension if self.moving else 0)
        return Gaussian(np.zeros(len(sd)), np.diag(np.square(sd)))

    def observations(self, seed: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        state = rng.multivariate_normal(self.start.mean, self.start.covariance)
        seen = []
        for dt in self.steps:
            F, Q = self.transition(dt)
            state = rng.multivariate_normal(F @ state, Q)
            seen.append(self.sensor @ state + rng.standard_normal(len(self.sensor)))
        return np.array(seen)

    def log_likelihood(self, y: np.ndarray):
        constant = 0.5 * y.size * np.log(2.0 * np.pi * OBSERVATION_VARIANCE)
        mixing = self.sensor[:, : self.dimension]
        return lambda poses: (
            -0.5 * np.square(poses @ mixing.T - y).sum(axis=1) / OBSERVATION_VARIANCE - constant
        )

    def exact_modes(self, y: np.ndarray, poses: np.ndarray) -> LikelihoodModes:
        """The likelihood of y, expanded about each of some poses (K, D): a quadratic, and so exact."""
        mixing = self.sensor[:, : self.dimension]
        information = mixing.T @ mixing / OBSERVATION_VARIANCE
        gradients = (y - poses @ mixing.T) @ mixing / OBSERVATION_VARIANCE
        heights = self.log_likelihood(y)(poses)
        return LikelihoodModes(poses, gradients, np.tile(information, (len(poses), 1, 1)), heights)

    def kalman(self, observations: np.ndarray) -> Exact:
        belief, H = self.start, self.sensor
        R = OBSERVATION_VARIANCE * np.eye(len(H))
        beliefs, evidence, transitions, gains = [], [], [], []
        for dt, y in zip(self.steps, observations, strict=True):
            F, Q = self.transition(dt)
            belief, log_evidence = kalman_update(kalman_predict(belief, F, Q), y, H, R)
            beliefs.append(belief)
            evidence.append(log_evidence)
            transitions.append(F)
            gains.append(belief.covariance @ H.T @ np.linalg.inv(R))
        return Exact(
            np.array([b.mean for b in beliefs]),
            np.array([b.covariance for b in beliefs]),
            np.array(evidence),
            transitions,
            gains,
        )

    def marginal(
        self,
        observations: np.ndarray,
        count: int,
        seed: int,
        resampling: Resampling,
        proposal: str = "marginal",
        guide: Callable[[np.ndarray], Guide | None] = lambda y: None,
    ) -> list[Posterior]:
        rng, ones = np.random.default_rng(seed), np.ones(self.dimension)
        state = MarginalState.initial(
            Prior(0.0 * ones, self.start_sd * ones, START_VELOCITY_SD * ones), count, self.space, rng
        )
        posteriors = []
        for dt, y in zip(self.steps, observations, strict=True):
            score = self.log_likelihood(y)
            state, posterior = state.step(
                dt, FilterModel(self.dynamics, self.space, resampling, proposal), score, rng, guide(y)
            )
            posteriors.append(posterior)
        return posteriors

    def particle(
        self,
        observations: np.ndarray,
        count: int,
        seed: int,
        resampling: Resampling,
        guide: Callable[[np.ndarray], Guide | None] = lambda y: None,
    ) -> list[Posterior]:
        rng, ones = np.random.default_rng(seed), np.ones(self.dimension)
        state = ParticleState.initial(
            Prior(0.0 * ones, self.start_sd * ones, np.zeros(0)), count, self.space, rng
        )
        posteriors = []
        for dt, y in zip(self.steps, observations, strict=True):
            score = self.log_likelihood(y)
            state, posterior = state.step(
                dt, FilterModel(self.dynamics, self.space, resampling), score, rng, guide(y)
            )
            posteriors.append(posterior)
        return posteriors

    def velocity_variances(self) -> np.ndarray:
        """P of (57) after each step, (T, D): the part of the velocity's variance that no particle carries."""
        P, dynamics, variances = np.full(self.dimension, START_VELOCITY_SD**2), self.dynamics, []
        for dt in self.steps:
            noise = step_noise(dynamics.pose_noise, dynamics.velocity_noise, dt, self.discretisation)
            P = velocity_gain(P, noise, dt).variance
            variances.append(P)
        return np.array(variances)

    def monte_carlo_variance(self, exact: Exact, posteriors: list[Posterior], count: int) -> np.ndarray:
        """Predicted variance (T, D or 2D) of the filter's means about the exact ones.

        To first order the error of the particles' mean obeys the Kalman filter's own closed loop: an error e
        becomes (1 - K H) F e, and each frame adds that of a weighted mean, C / ESS, where C is the posterior
        covariance of what particles carry (pose and mean velocity: the exact one less P), plus that of
        resampling, at most C / N. So E_t = A E_{t-1} A^T + C_t (1 / ESS_t + 1 / N).
        """
        size = exact.means.shape[1]
        carried = exact.covariances.copy()
        if self.moving:
            index = np.arange(self.dimension, size)
            carried[:, index, index] -= self.velocity_variances()
        E, variances = np.zeros((size, size)), []
        for F, K, C, posterior in zip(exact.transitions, exact.gains, carried, posteriors, strict=True):
            A = (np.eye(size) - K @ self.sensor) @ F
            E = A @ E @ A.T + C * (1.0 / posterior.effective_sample_size + 1.0 / count)
            variances.append(np.diag(E))
        return np.array(variances)


def regular(count: int) -> np.ndarray:
    return np.full(count, 1.0 / 30.0)


def irregular(count: int) -> np.ndarray:
    """A frame of 30 Hz, and now and then up to three of them lost."""
    return np.random.default_rng(5).integers(1, 5, count) / 30.0


@pytest.fixture(params=[regular, irregular], ids=["regular", "irregular"])
def steps(request: pytest.FixtureRequest) -> np.ndarray:
    return request.param(200)


@pytest.fixture
def make_world():
    return World
