"""Smooth interpolation of scattered displacements, for faces of other proportions and expressions."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray


class Displacements:
    """The field d(x) = sum_i w_i k(|x - x_i|) that takes given values at given places, and fades elsewhere.

    k(r) = (1 + s) exp(-s), s = sqrt(3) r / reach: Matern's kernel of smoothness 3/2. It overshoots less
    than a Gaussian where two places lie close together.

    Args:
        places: (n, D) all different.
        values: (n, C) of the field there.
        reach: length over which it fades.
    """

    def __init__(self, places: FloatArray, values: FloatArray, reach: float) -> None:
        self._places, self._reach = places, reach
        self._weights = np.linalg.solve(self._kernel(places), values)

    def __call__(self, at: FloatArray) -> FloatArray:
        """The field (..., C) at places (..., D)."""
        flat = at.reshape(-1, at.shape[-1])
        values: FloatArray = self._kernel(flat) @ self._weights
        return values.reshape(*at.shape[:-1], -1)

    def _kernel(self, at: FloatArray) -> FloatArray:
        distance = np.linalg.norm(at[:, None, :] - self._places[None, :, :], axis=-1)
        s = np.sqrt(3.0) / self._reach * distance
        kernel: FloatArray = (1.0 + s) * np.exp(-s)
        return kernel
