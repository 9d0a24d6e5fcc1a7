"""A proposal that needs no fits: particles go from the prior to the posterior in many small steps.

A tempered sampler within one frame (Neal 2001; Del Moral, Doucet and Jasra 2006). Pairs of ancestor and pose
are drawn from the prior; then, for temperatures 0 = b_0 < b_1 < ... < b_n = 1, they are weighed by
p(y | x)^(b_j - b_{j-1}), resampled, and moved by Metropolis steps that leave w_i p_i(x) p(y | x)^b_j as it
is. A pose is held as u, with x = x_i (+) (d_i + sqrt(N) u): the prior of u is N(0, 1), on curved spaces too.

Moves change some components at a time, the *blocks*: a palm, then each finger, say. A block's proposal is

    u' = m + r (u - m) + sqrt(1 - r^2) L e,    e ~ N(0, 1),    r^2 = 1 - reach^2

with mean m and covariance L L^T of all particles' blocks, so that steps have the posterior's own scale.
Temperatures are chosen so that each step leaves a given share of effective particles. As both look at the
particles, the evidence is consistent, but no longer free of bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.model import FilterModel, LogLikelihood, StateSpace
from posetrack_cli.filtering.resampling import effective_count, normalise, resample
from posetrack_cli.filtering.step import Prediction, Proposed, Weighing, equal_log_weights, scored

SMALLEST_STEP = 1e-4
"""Of the temperature: bounds the number of steps, however sharp the likelihood."""
LEAST_VARIANCE = 1e-9
"""Of a block's proposal, in units of the prior's: particles that all agree can still move."""


@dataclass(frozen=True, eq=False)
class Annealing:
    """How a frame is annealed; a likelihood is evaluated N (1 + steps * sweeps * blocks) times.

    Attributes:
        blocks: components (B,) of the tangent space that move together, in the order in which they move; none
            for all at once.
        keep: share of effective particles that a step leaves, which decides how large it is.
        sweeps: how often each block moves at each temperature.
        reach: of a move, 0 to 1; at 1 it forgets where it was.

    Raises:
        FilterError: keep or reach outside (0, 1], or sweeps < 1.
    """

    blocks: tuple[IntArray, ...] = ()
    keep: float = 0.5
    sweeps: int = 1
    reach: float = 0.7

    def __post_init__(self) -> None:
        if not (0.0 < self.keep <= 1.0 and 0.0 < self.reach <= 1.0 and self.sweeps >= 1):
            found = f"keep {self.keep}, reach {self.reach}, sweeps {self.sweeps}"
            raise FilterError("annealing cannot be used", found=found, expected="(0, 1], (0, 1], >= 1")

    def __bool__(self) -> bool:
        return True

    def propose(
        self, prediction: Prediction, model: FilterModel, score: LogLikelihood, rng: np.random.Generator
    ) -> Proposed:
        """Draw and weigh as many poses as there are particles; see `Proposer`."""
        scheme, weights = model.resampling.scheme, normalise(prediction.log_weights)[0]
        count, ancestors = weights.size, resample(scheme, weights, rng, weights.size)
        cloud = _Cloud(prediction, model.space, score, ancestors, rng)
        temperature, log_evidence = 0.0, 0.0
        while True:
            step = next_step(cloud.scores, 1.0 - temperature, self.keep)
            log_weights = equal_log_weights(count) + step * cloud.scores
            weights, log_sum = normalise(log_weights)
            temperature, log_evidence = temperature + step, log_evidence + log_sum
            if temperature >= 1.0:
                weighing = Weighing(weights, log_weights - log_sum, log_evidence, effective_count(weights))
                return Proposed(cloud.poses, cloud.increments, cloud.ancestors, weighing)
            cloud.select(resample(scheme, weights, rng, count))
            for block in self.sweeps * (self.blocks or (np.arange(prediction.variance.size),)):
                cloud.move(block, temperature, self.reach, rng)


def next_step(scores: FloatArray, left: float, keep: float) -> float:
    """Return the step of the temperature after which keep * N particles are effective, at most what is left.

    Args:
        scores: (N,) log p(y | x).
        left: up to temperature 1.
        keep: share.
    """
    if _effective_share(scores, left) >= keep:
        return left
    low, high = 0.0, left
    while high - low > 1e-2 * high and high > SMALLEST_STEP:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _effective_share(scores, middle) >= keep else (low, middle)
    return min(left, max(low, SMALLEST_STEP))


def _effective_share(scores: FloatArray, step: float) -> float:
    return effective_count(normalise(step * scores)[0]) / scores.size


class _Cloud:
    """Particles on their way: ancestors (N,), u (N, D), increments, poses, and scores log p(y | x) (N,)."""

    def __init__(
        self,
        prediction: Prediction,
        space: StateSpace,
        log_likelihood: LogLikelihood,
        ancestors: IntArray,
        rng: np.random.Generator,
    ) -> None:
        self._prediction, self._space, self._log_likelihood = prediction, space, log_likelihood
        self._sd = np.sqrt(prediction.variance)
        self.ancestors = ancestors
        self._u = rng.standard_normal((ancestors.size, self._sd.size))
        self.increments, self.poses, self.scores = self._placed(self._u)

    def select(self, chosen: IntArray) -> None:
        """Go on with the chosen ones."""
        self.ancestors, self._u = self.ancestors[chosen], self._u[chosen]
        self.increments, self.poses = self.increments[chosen], self.poses[chosen]
        self.scores = self.scores[chosen]

    def move(self, block: IntArray, temperature: float, reach: float, rng: np.random.Generator) -> None:
        """Move a block of components by one Metropolis step at a temperature."""
        here = self._u[:, block]
        mean = here.mean(axis=0)
        covariance = np.atleast_2d(np.cov(here.T, ddof=0)) + LEAST_VARIANCE * np.eye(block.size)
        lower = np.linalg.cholesky(covariance)
        there = mean + np.sqrt(1.0 - reach**2) * (here - mean)
        there += reach * rng.standard_normal(here.shape) @ lower.T
        moved = self._u.copy()
        moved[:, block] = there
        increments, poses, scores = self._placed(moved)
        inverse = np.linalg.inv(lower)
        gained = temperature * (scores - self.scores) + _log_normal(there) - _log_normal(here)
        gained -= _log_normal((there - mean) @ inverse.T) - _log_normal((here - mean) @ inverse.T)
        taken = np.log1p(-rng.random(gained.size)) < gained
        self._u[taken], self.increments[taken] = moved[taken], increments[taken]
        self.poses[taken], self.scores[taken] = poses[taken], scores[taken]

    def _placed(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        increments = self._prediction.drift[self.ancestors] + self._sd * u
        poses = self._space.retract(self._prediction.poses[self.ancestors], increments)
        scores = scored(poses, self._log_likelihood)
        if np.any(np.isnan(scores)):  # no comparison would be true of it, and nobody would see
            raise FilterError("log-likelihood is NaN", found=f"{np.isnan(scores).sum()} of {scores.size}")
        return increments, poses, scores


def _log_normal(u: FloatArray) -> FloatArray:
    """Return log N(u; 0, 1), (N,), up to a constant."""
    log_density: FloatArray = -0.5 * np.einsum("nd,nd->n", u, u)
    return log_density
