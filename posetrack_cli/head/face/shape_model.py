"""A face that deforms linearly: M = Mbar + V a (thesis, 3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """Mean shape and deformation directions of one face.

    Attributes:
        mean: (K, 3) neutral shape in the head's frame, mm.
        basis: (K, 3, B) orthonormal directions of deformation; B = 0 is a rigid face.
        deviations: (B,) mu, standard deviation of each coefficient, mm, descending.
    """

    mean: FloatArray
    basis: FloatArray
    deviations: FloatArray

    @property
    def size(self) -> int:
        """B, the number of deformation coefficients."""
        return len(self.deviations)

    def shapes(self, coefficients: FloatArray) -> FloatArray:
        """Return the shapes (..., K, 3), mm, of deformation coefficients (..., B), mm."""
        shapes: FloatArray = self.mean + np.tensordot(coefficients, self.basis, axes=(-1, -1))
        return shapes


def rigid_model(mean: FloatArray) -> ShapeModel:
    """Return the model of a face (K, 3) that does not deform."""
    return ShapeModel(mean, np.zeros((*mean.shape, 0)), np.zeros(0))
