"""The separated model of identity and deformation (thesis, 4.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.shape_model import ShapeModel


@dataclass(frozen=True, eq=False)
class FaceModel:
    """M = Mbar + C x_shape s^T x_action a^T, (4.15).

    Identity s and deformation a have no unit; their distribution over the people and actions that the model
    was built from is taken for normal.

    Attributes:
        mean: (K, 3) Mbar, mm in the head's frame.
        core: (K, 3, S, A) model tensor, mm.
        identity_mean: (S,) sbar.
        identity_deviations: (S,) sigma_s, all > 0.
        deformation_mean: (A,) abar.
        deformation_deviations: (A,) sigma_a, all > 0.
    """

    mean: FloatArray
    core: FloatArray
    identity_mean: FloatArray
    identity_deviations: FloatArray
    deformation_mean: FloatArray
    deformation_deviations: FloatArray

    @property
    def identity_size(self) -> int:
        """S', the number of identity parameters."""
        return len(self.identity_mean)

    @property
    def deformation_size(self) -> int:
        """A', the number of deformation parameters."""
        return len(self.deformation_mean)

    def shapes(self, identity: FloatArray, deformation: FloatArray) -> FloatArray:
        """Return the shapes (..., K, 3), mm, of s (..., S) and a (..., A), (4.15)."""
        shapes: FloatArray = self.mean + np.einsum("kisa,...s,...a->...ki", self.core, identity, deformation)
        return shapes

    def of_person(self, identity: FloatArray, offsets: FloatArray | None = None) -> ShapeModel:
        """Return how one person's face deforms, (4.38), (4.39).

        Its coefficients are a - abar, so that 0 is the mean deformation: with the deviations sigma_a their
        prior is that of (4.41).

        Args:
            identity: (S,) s.
            offsets: (K, 3) mm, how far each image feature lies from the model's point; none without.
        """
        basis: FloatArray = np.einsum("kisa,s->kia", self.core, identity)
        mean = self.mean + basis @ self.deformation_mean
        shifted = mean if offsets is None else mean + offsets
        return ShapeModel(shifted, basis, self.deformation_deviations)
