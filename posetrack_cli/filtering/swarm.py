"""Particle swarm optimisation in a box, as in Oikonomidis, Kyriazis and Argyros (BMVC 2011).

N particles at positions x_i in R^D store their own best position p_i, and jointly the global best g. Each
generation moves them (Clerc and Kennedy 2002, with the constriction factor w),

    v_i <- w (v_i + c_1 r_1 (p_i - x_i) + c_2 r_2 (g - x_i)),    x_i <- x_i + v_i,

with r_1 and r_2 uniform in [0, 1] per particle and component, and evaluates all of them in one batch.
Positions are clipped to the box. Against premature convergence, one of some components (in the paper:
finger angles) is periodically redrawn uniformly over its range, in half of the particles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.filtering.errors import FilterError


@dataclass(frozen=True)
class SwarmRules:
    """Parameters of a swarm; the defaults are the paper's.

    Attributes:
        generations: evaluations of the whole swarm, including the initial one.
        cognitive: c_1, attraction to a particle's own best.
        social: c_2, attraction to the global best.
        redraw_every: generations between redraws; 0 disables them.
        redraw_share: share of particles that are redrawn.

    Raises:
        FilterError: a number is out of range; c_1 + c_2 must exceed 4 for convergence.
    """

    generations: int = 25
    cognitive: float = 2.8
    social: float = 1.3
    redraw_every: int = 3
    redraw_share: float = 0.5

    def __post_init__(self) -> None:
        if self.generations < 1 or self.redraw_every < 0 or not 0.0 <= self.redraw_share <= 1.0:
            raise FilterError("invalid swarm parameters", found=self)
        constriction(self.cognitive, self.social)

    def redraws(self, generation: int) -> bool:
        """Return whether to redraw components before evaluating this generation; the first is 0."""
        return self.redraw_every > 0 and generation > 0 and generation % self.redraw_every == 0


@dataclass(frozen=True, eq=False)
class Box:
    """Bounds of the search space.

    Attributes:
        low, high: (D,) bounds.
        redrawn: indices of the components that may be redrawn.

    Raises:
        FilterError: invalid bounds.
    """

    low: FloatArray
    high: FloatArray
    redrawn: IntArray

    def __post_init__(self) -> None:
        finite = np.isfinite(self.low).all() and np.isfinite(self.high).all()
        if (
            self.low.ndim != 1
            or self.low.shape != self.high.shape
            or not finite
            or (self.low > self.high).any()
        ):
            raise FilterError("invalid bounds", found=f"{self.low} to {self.high}")

    def nearest(self, positions: FloatArray) -> FloatArray:
        """Return positions (N, D) clipped to the box."""
        return np.clip(positions, self.low, self.high)


@dataclass(frozen=True, eq=False)
class Optimum:
    """Result of a swarm search.

    Attributes:
        position: (D,) g, the best position.
        cost: its cost.
        course: (generations,) cost of g after each generation; never increases.
        evaluations: number of evaluated positions.
    """

    position: FloatArray
    cost: float
    course: FloatArray
    evaluations: int


def constriction(cognitive: float, social: float) -> float:
    """Return w = 2 / |2 - psi - sqrt(psi^2 - 4 psi)| with psi = c_1 + c_2 (Clerc and Kennedy 2002).

    Raises:
        FilterError: a coefficient is negative, or psi is not finite and above 4.
    """
    psi = cognitive + social
    if not (np.isfinite(psi) and psi > 4.0 and min(cognitive, social) >= 0.0):
        found = f"{cognitive} and {social}"
        raise FilterError("swarm would not converge", found=found, expected="c_1 + c_2 above 4, both >= 0")
    return float(2.0 / abs(2.0 - psi - np.sqrt(psi * psi - 4.0 * psi)))


def scattered(
    centre: FloatArray, sd: FloatArray, count: int, box: Box, rng: np.random.Generator
) -> FloatArray:
    """Return start positions (N, D): the centre, and N(centre, diag sd^2) clipped to the box."""
    positions = centre + sd * rng.standard_normal((count, centre.size))
    # The start itself is always a candidate, so the result is never worse.
    positions[0] = centre
    return box.nearest(positions)


def minimise(
    cost: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    box: Box,
    rules: SwarmRules,
    rng: np.random.Generator,
) -> Optimum:
    """Minimise a cost with a swarm.

    Args:
        cost: cost of positions (N, D) -> (N,); +inf for impossible, never NaN; called once per generation.
        start: (N, D) initial positions, at rest.
        box: bounds of the search.
        rules: parameters of the swarm.
        rng: source of randomness.

    Raises:
        FilterError: no particles, or a cost is NaN.
    """
    if start.ndim != 2 or not len(start):
        raise FilterError("swarm has no particles", found=start.shape, expected="(N, D)")
    swarm = _Swarm(box.nearest(start), rules, box, rng)
    course = np.empty(rules.generations)
    for generation in range(rules.generations):
        if generation:
            swarm.move()
        if rules.redraws(generation):
            swarm.redraw()
        course[generation] = swarm.remember(_checked(cost(swarm.positions), len(start)))
    return Optimum(swarm.leader.copy(), float(course[-1]), course, rules.generations * len(start))


class _Swarm:
    """Positions, velocities and memories of the particles."""

    def __init__(self, positions: FloatArray, rules: SwarmRules, box: Box, rng: np.random.Generator) -> None:
        self.positions = positions
        self._velocities = np.zeros_like(positions)
        self._best = positions.copy()
        self._best_costs = np.full(len(positions), np.inf)
        self._rules, self._box, self._rng = rules, box, rng
        self._factor = constriction(rules.cognitive, rules.social)

    @property
    def leader(self) -> FloatArray:
        """(D,) g."""
        best: FloatArray = self._best[np.argmin(self._best_costs)]
        return best

    def move(self) -> None:
        x, rules = self.positions, self._rules
        own, common = self._rng.random((2, *x.shape))
        own *= rules.cognitive * (self._best - x)
        common *= rules.social * (self.leader - x)
        self._velocities = self._factor * (self._velocities + own + common)
        self.positions = self._box.nearest(x + self._velocities)

    def redraw(self) -> None:
        """Redraw one component, uniformly within its bounds, of a random share of the particles."""
        count, redrawn = round(self._rules.redraw_share * len(self.positions)), self._box.redrawn
        if not count or not redrawn.size:
            return
        rows = self._rng.permutation(len(self.positions))[:count]
        columns = self._rng.choice(redrawn, count)
        self.positions[rows, columns] = self._rng.uniform(self._box.low[columns], self._box.high[columns])

    def remember(self, costs: FloatArray) -> float:
        """Update the memories with the current costs (N,); return the cost of g."""
        better = costs < self._best_costs
        self._best[better] = self.positions[better]
        self._best_costs[better] = costs[better]
        return float(self._best_costs.min())


def _checked(costs: FloatArray, count: int) -> FloatArray:
    if costs.shape != (count,) or np.isnan(costs).any():
        found = f"{costs.shape}, {int(np.isnan(costs).sum())} of them NaN"
        raise FilterError("invalid costs", found=found, expected=f"({count},), no NaN")
    return costs
