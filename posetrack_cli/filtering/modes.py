"""Local Gaussian approximations of a likelihood: what a proposal that looks at the frame is made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.errors import FilterError


@dataclass(frozen=True, eq=False)
class LikelihoodModes:
    """Quadratic approximations of log p(y | x) about K poses, each in the tangent space of its own pose.

        log p(y | poses_k (+) e) ~ log_heights_k + gradients_k . e - e^T information_k e / 2

    The poses need not be maxima of the likelihood (a local fit with a prior finds a maximum of the
    posterior), so the gradient is kept. The information may be singular: what the image does not show.

    Attributes:
        poses: (K, S) where the approximations are made.
        gradients: (K, D) of log p(y | x).
        information: (K, D, D) symmetric, positive semi-definite.
        log_heights: (K,) log p(y | poses_k), on one common scale.
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
                "modes do not match",
                found=f"poses {self.poses.shape}, gradients {self.gradients.shape}, information "
                f"{self.information.shape}, heights {self.log_heights.shape}",
            )

    def __len__(self) -> int:
        return len(self.poses)
