"""Which local fit of a frame a belief goes on with, and how far it is to be trusted.

A fit has the likelihood's local quadratic; under a Gaussian belief it has an evidence. The fit with the
greatest is taken. Where it contradicts the belief its information is lowered as a Student-t density does:
errors of fits are mostly small, and sometimes far larger than a quadratic says: a finger taken for another.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.filtering.gaussian_smoothing import StateGaussian
from posetrack_cli.filtering.model import StateSpace
from posetrack_cli.filtering.modes import LikelihoodModes

_RIDGE = 1e-9
"""Information, per unit^2, of what a fit knows nothing about: far below any prior's."""


def log_evidence(belief: StateGaussian, modes: LikelihoodModes, k: int, space: StateSpace) -> float:
    """Return the log of the integral of the belief's pose times the k-th fit's quadratic.

    With d the fit's pose and b = g + H d the gradient at the belief's mean, C the pose's covariance:
    h - g . d - d^T H d / 2 - log det(1 + C H) / 2 + b^T (1 + C H)^-1 C b / 2.
    """
    size, H, g = belief.velocity.size, modes.information[k], modes.gradients[k]
    C = belief.covariance[:size, :size]
    d = space.local(belief.pose, modes.poses[k])
    b, spread = g + H @ d, np.eye(size) + C @ H
    at_mean = modes.log_heights[k] - g @ d - 0.5 * d @ H @ d
    return float(at_mean + 0.5 * (b @ np.linalg.solve(spread, C @ b) - np.linalg.slogdet(spread)[1]))


def likeliest(belief: StateGaussian, modes: LikelihoodModes, space: StateSpace) -> int:
    """Return which fit has the greatest evidence."""
    if len(modes) == 1:
        return 0
    return int(np.argmax([log_evidence(belief, modes, k, space) for k in range(len(modes))]))


def only(modes: LikelihoodModes, k: int) -> LikelihoodModes:
    """Return the k-th fit alone."""
    k = range(len(modes))[k]
    one = slice(k, k + 1)
    return LikelihoodModes(
        modes.poses[one], modes.gradients[one], modes.information[one], modes.log_heights[one]
    )


def doubted(
    belief: StateGaussian,
    modes: LikelihoodModes,
    groups: Sequence[IntArray],
    freedom: float,
    space: StateSpace,
) -> LikelihoodModes:
    """Return a single fit with less information on those groups of components that contradict a belief.

    Per group of d components, with e its part of (the fit's maximum - the belief's mean) and V that of
    C + H^-1, the weight is w = min(1, (nu + d) / (nu + e^T V^-1 e)), the expected precision of a Student-t
    density of nu degrees of freedom given e. H becomes W^1/2 H W^1/2 with the weights on W's diagonal, and
    the maximum stays.

    Args:
        belief: of the frame, without the fit.
        modes: one fit.
        groups: of components, which err together.
        freedom: nu.
        space: the poses' space.
    """
    size, H = belief.velocity.size, modes.information[0]
    inverse = np.linalg.inv(H + _RIDGE * np.eye(size))
    best = inverse @ modes.gradients[0]
    off = space.local(belief.pose, modes.poses[0]) + best
    spread = belief.covariance[:size, :size] + inverse
    roots = np.ones(size)
    for group in groups:
        chi2 = off[group] @ np.linalg.solve(spread[np.ix_(group, group)], off[group])
        roots[group] = np.sqrt(min(1.0, (freedom + len(group)) / (freedom + chi2)))
    weighted: FloatArray = roots[:, None] * H * roots
    return LikelihoodModes(modes.poses, (weighted @ best)[None], weighted[None], modes.log_heights)
