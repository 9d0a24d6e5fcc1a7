"""Local Gaussian approximations of a likelihood, and their products with the particles' priors (Laplace)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.model import StateSpace
from posetrack_cli.filtering.step import Prediction

RESOLUTION = 1e-9
"""Components that vary less, relative to the largest pose component, are rounding noise and ignored."""


@dataclass(frozen=True, eq=False)
class LikelihoodModes:
    """Quadratic approximations of log p(y | x) about K poses, each in its pose's tangent space.

        log p(y | poses_k (+) e) ~ log_heights_k + gradients_k . e - e^T information_k e / 2

    The poses need not maximise the likelihood (a local fit with a prior finds a maximum of the posterior),
    so the gradient is kept. The information is singular in directions that the image does not constrain.

    Attributes:
        poses: (K, S) expansion points.
        gradients: (K, D) of log p(y | x).
        information: (K, D, D) symmetric, positive semi-definite.
        log_heights: (K,) log p(y | poses_k), on a common scale.
    """

    poses: FloatArray
    gradients: FloatArray
    information: FloatArray
    log_heights: FloatArray

    def __post_init__(self) -> None:
        count, dimension = self.gradients.shape
        shapes = (len(self.poses), *self.information.shape, *self.log_heights.shape)
        if shapes != (count, count, dimension, dimension, count) or not np.isfinite(self.information).all():
            raise FilterError(
                "inconsistent modes",
                found=f"poses {self.poses.shape}, gradients {self.gradients.shape}, information "
                f"{self.information.shape}, heights {self.log_heights.shape}",
            )

    def __len__(self) -> int:
        return len(self.poses)


def scaled(modes: LikelihoodModes, share: float) -> LikelihoodModes:
    """Return p(y | x)^share: the same modes with less information."""
    return LikelihoodModes(
        modes.poses, share * modes.gradients, share * modes.information, share * modes.log_heights
    )


@dataclass(frozen=True, eq=False)
class LaplaceMixture:
    """Gaussians p_i l_k, over u = e / sd, in which the prior is N(0, 1).

    Attributes:
        prediction: priors p_i.
        modes: fits l_k.
        space: space of poses.
        means: (K, N, D) the priors' means in the chart of each fit.
        whitened: (K, N, D) y, and
        unwhitening: (K, D, D) L^-1: the product has precision B = L L^T and mean L^-T y.
        log_masses: (K, N) log c_ik, the integrals of p_i l_k.
    """

    prediction: Prediction
    modes: LikelihoodModes
    space: StateSpace
    means: FloatArray
    whitened: FloatArray
    unwhitening: FloatArray
    log_masses: FloatArray

    def sample(self, picked: IntArray, ancestors: IntArray, rng: np.random.Generator) -> FloatArray:
        """Return poses (M, S) from p_i l_k for ancestors i (M,) and fits k (M,); k = K means p_i alone."""
        prediction = self.prediction
        u = rng.standard_normal((ancestors.size, prediction.variance.size))
        base, offset = prediction.poses[ancestors], prediction.drift[ancestors]
        for k in range(len(self.modes)):
            rows = np.flatnonzero(picked == k)
            chosen = ancestors[rows]
            u[rows] = (self.whitened[k, chosen] + u[rows]) @ self.unwhitening[k]
            base[rows], offset[rows] = self.modes.poses[k], self.means[k, chosen]
        return self.space.retract(base, offset + np.sqrt(prediction.variance) * u)

    def log_fits(self, poses: FloatArray, increments: FloatArray, ancestors: IntArray) -> FloatArray:
        """Return log l_k(x) (K, M), multiplied by the ratio of the sampled to the true prior.

        The ratio is 1 in a flat space. In a curved one the prior is Gaussian in the tangent space of x_i,
        while ``sample`` draws from a Gaussian in that of the fit.

        Args:
            poses: (M, S) x.
            increments: (M, D) x (-) x_i.
            ancestors: (M,) i.
        """
        offsets = self.space.local(self.modes.poses[:, None], poses)
        slopes = self.modes.gradients[:, None] - offsets @ (0.5 * self.modes.information)
        log_fits: FloatArray = self.modes.log_heights[:, None] + np.einsum("kid,kid->ki", offsets, slopes)
        precision = precisions(self.prediction.variance, self.prediction.poses)
        log_fits += self.space.log_volume(increments) - self.space.log_volume(offsets)
        true = np.square(increments - self.prediction.drift[ancestors]) @ precision
        offsets -= self.means[:, ancestors]
        log_fits += 0.5 * (true - np.square(offsets, out=offsets) @ precision)
        return log_fits


def laplace_mixture(prediction: Prediction, modes: LikelihoodModes, space: StateSpace) -> LaplaceMixture:
    """Multiply every prior by every fit.

    In the chart of a fit with height h, gradient g and information H, e = mu + S u, S = sqrt(N):

        B = 1 + S H S,   b = S (g - H mu),   u ~ N(B^-1 b, B^-1)
        log c = h + g mu - mu H mu / 2 + b B^-1 b / 2 - log det(B) / 2

    B >= 1 even if N is zero or H singular, so neither is inverted.

    Raises:
        FilterError: a fit's information is not positive semi-definite.
    """
    centres = space.retract(prediction.poses, prediction.drift)
    means, sd = space.local(modes.poses[:, None], centres), np.sqrt(prediction.variance)
    lower = _cholesky(np.eye(sd.size) + sd[:, None] * modes.information * sd)
    inverse = np.asarray(np.linalg.inv(lower), dtype=np.float64)
    gradients = modes.gradients[:, None]
    slopes = gradients - means @ modes.information
    whitened = slopes @ np.ascontiguousarray(sd[:, None] * np.swapaxes(inverse, 1, 2))
    heights = modes.log_heights - np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
    log_masses = heights[:, None] + 0.5 * np.einsum("kid,kid->ki", means, slopes + gradients)
    log_masses += 0.5 * np.einsum("kid,kid->ki", whitened, whitened)
    return LaplaceMixture(prediction, modes, space, means, whitened, inverse, log_masses)


def precisions(variance: FloatArray, poses: FloatArray) -> FloatArray:
    """Return 1 / variance (D,), and 0 for components of the poses (N, S) that are frozen up to rounding.

    Their density would be a quotient of rounding errors.
    """
    smallest = RESOLUTION * max(1.0, float(np.abs(poses).max()))
    moves = variance > smallest**2
    precision: FloatArray = np.where(moves, 1.0 / np.where(moves, variance, 1.0), 0.0)
    return precision


def _cholesky(precision: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.cholesky(precision), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise FilterError(
            "invalid information of a mode", found=error, expected="symmetric, positive semi-definite"
        ) from error
