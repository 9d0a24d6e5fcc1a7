"""Proposal that uses the frame: every particle's prior times the likelihood's local fits.

The belief before the frame is the mixture sum_i w_i p_i(x) of the particles' priors. The local fits
approximate the likelihood by l_1(x) + ... + l_K(x), each a Gaussian in the tangent space of its pose.
Ancestor and pose are drawn jointly from

    q(i, x) = a w_i p_i(x) + (1 - a) / C  sum_k w_i p_i(x) l_k(x)        C = sum_i sum_k w_i c_ik

with a the prior's share. The product p_i l_k is the Laplace approximation, a Gaussian of mass c_ik:
ancestors are selected by how well their prediction explains the frame, as in a fully adapted auxiliary
filter (Pitt and Shephard 1999). The importance weight, hand paper (24) for the pair (i, x), is

    w_i p_i(x) p(y | x) / q(i, x) = p(y | x) / (a + (1 - a) / C  sum_k l_k(x))

It does not depend on i: given x, ancestors already have their exact conditional distribution. Summing over
them (the marginal particle filter, Klaas et al. 2005) would cost N^2 without changing anything. The weight
is at most p(y | x) / a for any fits (a defensive mixture, Hesterberg 1995), and constant if the fits are
exact and a = 0.

On a curved space the weight uses the true densities with the volume factors of their charts. Only the mass
of a Gaussian beyond half a turn from its chart's pose is neglected, which is of order exp(-pi^2 / (2 N)).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.model import FilterModel, LogLikelihood, StateSpace
from posetrack_cli.filtering.modes import LikelihoodModes, laplace_mixture
from posetrack_cli.filtering.resampling import normalise, resample
from posetrack_cli.filtering.step import Prediction, Proposed, weigh_drawn


@dataclass(frozen=True, eq=False)
class Guide:
    """Local fits for the proposal, and their weight relative to the prior.

    Attributes:
        modes: local fits of log p(y | x); without any, only the prior is used.
        prior_share: a, the share of particles drawn from the prior alone, in [0, 1].
        inflation: s >= 1; divides the fits' gradients and information, for heavier tails.

    Raises:
        FilterError: a share outside [0, 1], or an inflation below 1 or not finite.
    """

    modes: LikelihoodModes
    prior_share: float = 0.1
    inflation: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.prior_share <= 1.0:
            raise FilterError("invalid prior share", found=self.prior_share, expected="0 to 1")
        if not 1.0 <= self.inflation < np.inf:
            raise FilterError("invalid inflation", found=self.inflation, expected="finite, >= 1")

    def __bool__(self) -> bool:
        return len(self.modes) > 0

    def propose(
        self, prediction: Prediction, model: FilterModel, score: LogLikelihood, rng: np.random.Generator
    ) -> Proposed:
        """Draw as many poses as there are particles from q(i, x), and weight them by (24).

        Raises:
            FilterError: the likelihood has the wrong shape, a NaN or an infinity, or is zero for all.
        """
        draw = draw_guided(prediction, self, model.space, model.resampling.scheme, rng)
        weighing = weigh_drawn(draw.log_weights, draw.poses, score)
        return Proposed(draw.poses, draw.increments, draw.ancestors, weighing)

    @property
    def inflated(self) -> LikelihoodModes:
        """Modes with the inflation applied."""
        modes, s = self.modes, self.inflation
        return LikelihoodModes(modes.poses, modes.gradients / s, modes.information / s, modes.log_heights)


class Draw(NamedTuple):
    """Poses drawn for one frame.

    Attributes:
        poses: (N, S) x.
        increments: (N, D) x (-) x_i from their ancestors.
        ancestors: (N,) i.
        log_weights: (N,) log of w_i p_i(x) / q(i, x) / N, the factor of p(y | x).
    """

    poses: FloatArray
    increments: FloatArray
    ancestors: IntArray
    log_weights: FloatArray


def draw_guided(
    prediction: Prediction, guide: Guide, space: StateSpace, scheme: str, rng: np.random.Generator
) -> Draw:
    """Draw as many poses as there are particles from q(i, x).

    The sum of p(y | x) times the weights is an unbiased estimate of p(y_t | y_1..t-1).

    Args:
        prediction: belief before the frame.
        guide: at least one mode, and the shares.
        space: space of poses.
        scheme: scheme for drawing pairs of ancestor and mode, one of ``resampling_schemes``.
        rng: source of randomness.

    Raises:
        FilterError: a mode's information is not positive semi-definite, or a fit is not finite.
    """
    count, a = prediction.log_weights.size, guide.prior_share
    weights, log_sum = normalise(prediction.log_weights)
    mixture = laplace_mixture(prediction, guide.inflated, space)
    shares, log_mass = normalise((prediction.log_weights - log_sum + mixture.log_masses).ravel())
    # One joint draw over (mode, ancestor) pairs; the last block is the prior alone.
    table = np.concatenate([(1.0 - a) * shares, a * weights])
    picked, ancestors = np.divmod(resample(scheme, table, rng, count), count)
    poses = mixture.sample(picked, ancestors, rng)
    increments = space.local(prediction.poses[ancestors], poses)
    log_fits = mixture.log_fits(poses, increments, ancestors) - log_mass
    return Draw(poses, increments, ancestors, -_log_mixture(log_fits, a) - np.log(count))


def _log_mixture(log_fits: FloatArray, prior_share: float) -> FloatArray:
    """Return log(a + (1 - a) sum_k exp(log_fits_k)), (N,), of (K, N)."""
    with np.errstate(divide="ignore"):  # a share of 0 gives log 0 = -inf, as it should
        log_prior, log_rest = np.log(prior_share), np.log1p(-prior_share)
    mixture: FloatArray = np.logaddexp(log_prior, log_rest + np.logaddexp.reduce(log_fits, axis=0))
    return mixture
