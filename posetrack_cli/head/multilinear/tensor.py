"""Tensors: unfolding, products with matrices, N-mode SVD, and its best truncation (thesis, 4.2.1).

A mode is the number of an axis. A tensor is unfolded along mode n into a matrix with a row for each index of
that axis; its columns run over the other axes in their order, the last one fastest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray

SWEEPS = 200
"""Most sweeps of ``hooi``."""
SETTLED = 1e-13
"""Share of a tensor's square by which a sweep must improve its approximation for another to follow."""


@dataclass(frozen=True, eq=False)
class Decomposition:
    """T ~ C x_n U_n over the decomposed modes, (4.7), (4.10); other modes stay in the core, (4.12).

    Attributes:
        core: C, as long along each decomposed mode as its basis has columns.
        bases: U_n (I_n, J_n) by mode, with orthonormal columns.
    """

    core: FloatArray
    bases: Mapping[int, FloatArray]

    def tensor(self) -> FloatArray:
        """Return the tensor that is described."""
        return _products(self.core, self.bases)


def unfold(tensor: FloatArray, mode: int) -> FloatArray:
    """Return X_(n) (I_n, product of the other lengths)."""
    matrix: FloatArray = np.moveaxis(tensor, mode, 0).reshape(tensor.shape[mode], -1)
    return matrix


def mode_product(tensor: FloatArray, matrix: FloatArray, mode: int) -> FloatArray:
    """Return the tensor with a matrix (J, I_n) applied along a mode, Y_(n) = C X_(n), (4.1), (4.2)."""
    product: FloatArray = np.moveaxis(np.tensordot(matrix, tensor, axes=(1, mode)), 0, mode)
    return product


def singular_values(tensor: FloatArray, mode: int) -> FloatArray:
    """Return the singular values of a tensor along a mode, descending: how much each basis vector carries."""
    values: FloatArray = np.linalg.svd(unfold(tensor, mode), full_matrices=False)[1]
    return values


def truncated_svd(tensor: FloatArray, ranks: Mapping[int, int]) -> Decomposition:
    """Return the N-mode SVD with so many leading basis vectors of each mode, (4.8)-(4.10).

    Exact at full rank. Not the best approximation of its ranks: see ``hooi``.

    Args:
        tensor: T.
        ranks: J_n by mode; modes that are not named are not decomposed.
    """
    bases = {mode: _leading(tensor, mode, rank) for mode, rank in ranks.items()}
    return Decomposition(_projected(tensor, bases), bases)


def hooi(tensor: FloatArray, ranks: Mapping[int, int]) -> Decomposition:
    """Return a better approximation of the same ranks, by alternating least squares.

    De Lathauwer et al., "On the best rank-1 and rank-(R1, R2, ..., RN) approximation of higher-order
    tensors", 2000 (reference [23] of the thesis). Each basis in turn becomes the best one while the others
    are held, so that no sweep makes the approximation worse and the first is no worse than
    ``truncated_svd``.

    Args:
        tensor: T.
        ranks: J_n by mode; modes that are not named are not decomposed.
    """
    bases = dict(truncated_svd(tensor, ranks).bases)
    square, kept = float(np.sum(tensor**2)), 0.0
    for _ in range(SWEEPS):
        for mode, rank in ranks.items():
            others = {other: basis for other, basis in bases.items() if other != mode}
            bases[mode] = _leading(_projected(tensor, others), mode, rank)
        before, kept = kept, float(np.sum(_projected(tensor, bases) ** 2))
        if kept - before <= SETTLED * square:
            break
    return Decomposition(_projected(tensor, bases), bases)


def _leading(tensor: FloatArray, mode: int, rank: int) -> FloatArray:
    """The first left singular vectors (I_n, rank) along a mode; the largest entry of each is positive."""
    vectors: FloatArray = np.linalg.svd(unfold(tensor, mode), full_matrices=False)[0][:, :rank]
    largest = np.take_along_axis(vectors, np.argmax(np.abs(vectors), axis=0)[None], axis=0)
    signed: FloatArray = vectors * np.where(largest < 0.0, -1.0, 1.0)
    return signed


def _projected(tensor: FloatArray, bases: Mapping[int, FloatArray]) -> FloatArray:
    return _products(tensor, {mode: basis.T for mode, basis in bases.items()})


def _products(tensor: FloatArray, matrices: Mapping[int, FloatArray]) -> FloatArray:
    for mode, matrix in matrices.items():
        tensor = mode_product(tensor, matrix, mode)
    return tensor
