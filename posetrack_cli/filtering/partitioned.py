"""Halfway partitioned sampling: two groups of components move one after the other (thesis, 3.3.2).

Heads mostly either turn or deform. First, every second particle moves only in the first group of components
(pose) and the others only in the second group (deformation). The results are weighted and resampled, then
all particles move again. Two forms:

    printed    the second move is a full one in all components, weighted by the likelihood. Noise and
               likelihood are then applied twice, so the particles represent
               p(y | x_t) int N(x_t; x~, Q) p(y | x~) p_half(x~ | x_{t-1}), not the filter's posterior.
    weighted   **[ours]** the second move is the other half of the first, and the weights are divided by
    those
               used for resampling: p(y | x_t) / p(y | x~). Each particle then makes one full move, one
               group first, and the target is p(x_t | y_1..t), as in partitioned sampling proper (MacCormick
               and Isard 2000): weighted resampling does not change the distribution. If one group is empty,
               the step is an ordinary one.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.model import LogLikelihood
from posetrack_cli.filtering.resampling import normalise, resample
from posetrack_cli.filtering.step import Weighing, scored, weigh_drawn

Sampling: TypeAlias = Literal["weighted", "printed"]


class Motion(NamedTuple):
    """Motion of the particles: x_t = x_{t-1} + drift + w, w ~ N(0, diag sd^2); (3.26).

    Attributes:
        drift: (D,).
        sd: (D,), >= 0.
        first: number of leading components in the first group.
    """

    drift: FloatArray
    sd: FloatArray
    first: int


class Particles(NamedTuple):
    """Points (N, D) in R^D and their weights."""

    points: FloatArray
    weighing: Weighing


def partitioned_step(
    points: FloatArray,
    weights: FloatArray,
    motion: Motion,
    log_likelihood: LogLikelihood,
    sampling: Sampling,
    scheme: str,
    rng: np.random.Generator,
) -> Particles:
    """Advance particles by one frame of halfway partitioned sampling.

    Args:
        points: (N, D) of the previous frame; not modified.
        weights: (N,) their weights, >= 0.
        motion: drift and noise; a group of components may be empty.
        log_likelihood: log p(y_t | x) of points (N, D), up to a constant.
        sampling: ``weighted`` or ``printed``, see the module.
        scheme: resampling scheme.
        rng: source of randomness.

    Returns:
        The weighted particles; the next step begins with resampling them.

    Raises:
        FilterError: invalid shapes or weights, or the likelihood is NaN or zero for all.
    """
    _check(points, motion)
    halfway = points[resample(scheme, weights, rng)]
    if sampling == "weighted" and motion.first in (0, motion.sd.size):
        halfway += motion.drift
        _scatter(halfway, motion.sd, rng)
        return Particles(halfway, weigh_drawn(np.zeros(len(points)), halfway, log_likelihood))
    _move_halves(halfway, motion, sampling, rng)
    scores = scored(halfway, log_likelihood)
    chosen = resample(scheme, normalise(scores)[0], rng)
    if sampling == "printed":
        arrived = halfway[chosen] + motion.sd * rng.standard_normal(points.shape)
        return Particles(arrived, weigh_drawn(np.zeros(len(points)), arrived, log_likelihood))
    of_first = chosen % 2 == 0
    chosen = np.concatenate([chosen[of_first], chosen[~of_first]])
    arrived = halfway[chosen]
    count = int(np.count_nonzero(of_first))
    _scatter(arrived[:count, motion.first :], motion.sd[motion.first :], rng)
    _scatter(arrived[count:, : motion.first], motion.sd[: motion.first], rng)
    return Particles(arrived, weigh_drawn(-scores[chosen], arrived, log_likelihood))


def local_mean(points: FloatArray, weights: FloatArray, scale: FloatArray, radius: float) -> FloatArray:
    """Return the weighted mean of the particles near the heaviest one, (D,); (3.29), (3.30).

    Near is |(x - x_heaviest) / scale| < radius. The thesis specifies neither d nor the units of a sum of
    millimetres and radians **[ours]**.

    Args:
        points: (N, D).
        weights: (N,) >= 0, with any positive sum.
        scale: (D,), > 0.
        radius: d, in units of scale.
    """
    away = (points - points[np.argmax(weights)]) / scale
    near = np.where(np.einsum("nd,nd->n", away, away) < radius * radius, weights, 0.0)
    mean: FloatArray = near @ points / near.sum()
    return mean


def _move_halves(points: FloatArray, motion: Motion, sampling: Sampling, rng: np.random.Generator) -> None:
    """Move even particles in the first group and odd ones in the second; ``printed`` includes the drift.

    The halves are interleaved because resampling schemes keep children in the order of their parents.
    """
    groups = slice(0, motion.first), slice(motion.first, None)
    for parity, group in enumerate(groups):
        _scatter(points[parity::2, group], motion.sd[group], rng)
        if sampling == "printed":
            points[parity::2, group] += motion.drift[group]
    if sampling != "printed":
        points += motion.drift


def _scatter(points: FloatArray, sd: FloatArray, rng: np.random.Generator) -> None:
    """Add draws from N(0, diag sd^2), sd (G,), to points (M, G)."""
    points += sd * rng.standard_normal(points.shape)


def _check(points: FloatArray, motion: Motion) -> None:
    """Raise unless points (N, D) and motion (D,) match, with finite sd >= 0."""
    shapes = {motion.drift.shape, motion.sd.shape}
    if points.ndim != 2 or shapes != {points.shape[1:]} or not 0 <= motion.first <= points.shape[1]:
        raise FilterError(
            "particles and motion do not match",
            found=f"{points.shape}, {shapes}, {motion.first} of them first",
        )
    if not np.all(np.isfinite(motion.sd)) or np.any(motion.sd < 0.0):
        raise FilterError("invalid noise", found=motion.sd, expected="finite, >= 0")
