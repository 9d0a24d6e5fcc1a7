"""Construction of the multilinear face model from the shapes of several people (thesis, 4.2).

A tensor's mode is the number of an axis. Unfolding a tensor along mode n gives a matrix with a row for each
index of that axis; its columns run over the other axes in order, the last one fastest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import BROWS, EYES, MEAN_SHAPE, MIRRORED, MOUTH, NOSTRILS
from posetrack_cli.head.multilinear.face_model import FaceModel

SWEEPS = 200
"""Maximum number of sweeps of ``hooi``."""
CONVERGED = 1e-13
"""Minimum improvement of a sweep, relative to the tensor's square."""


@dataclass(frozen=True, eq=False)
class Decomposition:
    """T ~ C x_n U_n over the decomposed modes, (4.7), (4.10); other modes stay in the core, (4.12).

    Attributes:
        core: C, with the number of basis vectors along each decomposed mode.
        bases: U_n (I_n, J_n) by mode, with orthonormal columns.
    """

    core: FloatArray
    bases: Mapping[int, FloatArray]

    def tensor(self) -> FloatArray:
        """Return the represented tensor."""
        return _products(self.core, self.bases)


def unfold(tensor: FloatArray, mode: int) -> FloatArray:
    """Return X_(n) (I_n, product of the other lengths)."""
    matrix: FloatArray = np.moveaxis(tensor, mode, 0).reshape(tensor.shape[mode], -1)
    return matrix


def mode_product(tensor: FloatArray, matrix: FloatArray, mode: int) -> FloatArray:
    """Apply a matrix (J, I_n) along a mode, Y_(n) = C X_(n), (4.1), (4.2)."""
    product: FloatArray = np.moveaxis(np.tensordot(matrix, tensor, axes=(1, mode)), 0, mode)
    return product


def singular_values(tensor: FloatArray, mode: int) -> FloatArray:
    """Return the singular values of a tensor along a mode, descending."""
    values: FloatArray = np.linalg.svd(unfold(tensor, mode), full_matrices=False)[1]
    return values


def truncated_svd(tensor: FloatArray, ranks: Mapping[int, int]) -> Decomposition:
    """Return the N-mode SVD with the leading basis vectors of each mode, (4.8)-(4.10).

    Exact at full rank. Not the best approximation of its ranks: see ``hooi``.

    Args:
        tensor: T.
        ranks: J_n by mode; other modes are not decomposed.
    """
    bases = {mode: _leading(unfold(tensor, mode), rank) for mode, rank in ranks.items()}
    return Decomposition(_projected(tensor, bases), bases)


def hooi(tensor: FloatArray, ranks: Mapping[int, int]) -> Decomposition:
    """Improve the truncated SVD by alternating least squares (HOOI).

    De Lathauwer et al., "On the best rank-1 and rank-(R1, R2, ..., RN) approximation of higher-order
    tensors", 2000 (reference [23] of the thesis). Each basis in turn is optimised while the others are fixed,
    so the approximation is never worse than ``truncated_svd``.

    Args:
        tensor: T.
        ranks: J_n by mode; other modes are not decomposed.
    """
    bases = dict(truncated_svd(tensor, ranks).bases)
    square, kept = float(np.sum(tensor**2)), 0.0
    for _ in range(SWEEPS):
        # the kept square can only increase, as each basis is optimal for the others
        for mode, rank in ranks.items():
            others = {other: basis for other, basis in bases.items() if other != mode}
            bases[mode] = _leading(unfold(_projected(tensor, others), mode), rank)
        before, kept = kept, float(np.sum(_projected(tensor, bases) ** 2))
        if kept - before <= CONVERGED * square:
            break
    return Decomposition(_projected(tensor, bases), bases)


def _leading(matrix: FloatArray, rank: int) -> FloatArray:
    """Return the leading left singular vectors (I_n, rank) of X_(n).

    The sign of a singular vector is arbitrary; the largest entry is made positive.
    """
    vectors: FloatArray = np.linalg.svd(matrix, full_matrices=False)[0][:, :rank]
    largest = np.take_along_axis(vectors, np.argmax(np.abs(vectors), axis=0)[None], axis=0)
    signed: FloatArray = vectors * np.where(largest < 0.0, -1.0, 1.0)
    return signed


def _projected(tensor: FloatArray, bases: Mapping[int, FloatArray]) -> FloatArray:
    return _products(tensor, {mode: basis.T for mode, basis in bases.items()})


def _products(tensor: FloatArray, matrices: Mapping[int, FloatArray]) -> FloatArray:
    for mode, matrix in matrices.items():
        tensor = mode_product(tensor, matrix, mode)
    return tensor


PEOPLE, ACTIONS = 0, 1
"""Modes of the data tensor (2S, A, K, 3)."""
LEAST_DEVIATION = 1e-4
"""Minimum standard deviation of a parameter, relative to its root mean square."""
RANK_TOLERANCE = 1e-9
"""Singular values below this share of the largest are rounding errors."""


@dataclass(frozen=True, eq=False)
class BuiltModel:
    """A model with its training data.

    Attributes:
        model: face model with parameters ``identities`` and ``deformations``.
        samples: (2S, A, K, 3) symmetric shapes, mm: those of the right halves, then those of the left.
        identities: (2S, S') s of each sample, the rows of U_shape.
        deformations: (A, A') a of each action, the rows of U_action.
        spectra: singular values of the data tensor along people and actions, descending.
    """

    model: FaceModel
    samples: FloatArray
    identities: FloatArray
    deformations: FloatArray
    spectra: tuple[FloatArray, FloatArray]

    def approximations(self) -> FloatArray:
        """Return the model's reconstruction of the samples (2S, A, K, 3), mm, (4.14)."""
        return self.model.shapes(self.identities[:, None], self.deformations[None])


def build_model(shapes: FloatArray, identity: int = 10, deformation: int = 5) -> BuiltModel:
    """Separate identity and deformation of faces, (4.11)-(4.15).

    Args:
        shapes: (S, A, K, 3) of each person in each action, mm in the head's frame.
        identity: S', at most 2S.
        deformation: A', at most A.
    """
    samples, mean, tensor = _data(shapes)
    found = _along_means(hooi(tensor, {PEOPLE: identity, ACTIONS: deformation}))
    identities, deformations = found.bases[PEOPLE], found.bases[ACTIONS]
    model = FaceModel(
        mean,
        np.moveaxis(found.core, (2, 3), (0, 1)),
        identities.mean(axis=0),
        _deviations(identities),
        deformations.mean(axis=0),
        _deviations(deformations),
    )
    spectra = (singular_values(tensor, PEOPLE), singular_values(tensor, ACTIONS))
    return BuiltModel(model, samples, identities, deformations, spectra)


def add_deformation(
    built: BuiltModel, displacement: FloatArray, sizes: FloatArray, deviation: float
) -> BuiltModel:
    """Add a deformation parameter a that symmetrised faces cannot contain **[ours]**.

    M = ... + a (c^T s) D, where c^T s predicts the size of the person from s. The samples do not contain it:
    abar and the rows of U_action are 0 there.

    Args:
        built: model without it.
        displacement: D (K, 3), mm, for a = 1 of a face of size 1.
        sizes: (2S,) of the samples' people, 1 on average.
        deviation: sigma_a.
    """
    model = built.model
    grows = np.linalg.lstsq(built.identities, sizes)[0]
    core = np.concatenate([model.core, (displacement[:, :, None] * grows)[..., None]], axis=-1)
    wider = replace(
        model,
        core=core,
        deformation_mean=np.append(model.deformation_mean, 0.0),
        deformation_deviations=np.append(model.deformation_deviations, deviation),
    )
    return replace(built, model=wider, deformations=np.pad(built.deformations, ((0, 0), (0, 1))))


def possible_ranks(shapes: FloatArray) -> tuple[int, int]:
    """Return the largest S' and A' supported by shapes (S, A, K, 3)."""
    tensor = _data(shapes)[2]
    return _rank(singular_values(tensor, PEOPLE)), _rank(singular_values(tensor, ACTIONS))


def mirrored(shapes: FloatArray) -> FloatArray:
    """Return mirrored shapes (..., K, 3), with left and right points exchanged."""
    image: FloatArray = shapes[..., MIRRORED, :] * np.array([-1.0, 1.0, 1.0])
    return image


def symmetric_halves(shapes: FloatArray) -> FloatArray:
    """Return symmetric faces (2, ..., K, 3) from the right and the left halves of shapes (..., K, 3)."""
    images = mirrored(shapes)
    right = (MEAN_SHAPE[:, 0] < 0.0)[:, None]
    return np.stack([np.where(right, shapes, images), np.where(right, images, shapes)])


def _data(shapes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return symmetric samples (2S, A, K, 3), their mean (K, 3), and the centred data tensor."""
    samples = symmetric_halves(shapes).reshape(-1, *shapes.shape[1:])
    mean: FloatArray = samples.mean(axis=(PEOPLE, ACTIONS))
    return samples, mean, samples - mean


def _rank(values: FloatArray) -> int:
    return int(np.sum(values > RANK_TOLERANCE * values[0]))


def _deviations(rows: FloatArray) -> FloatArray:
    least = LEAST_DEVIATION * np.sqrt(np.mean(rows**2, axis=0))
    deviations: FloatArray = np.maximum(rows.std(axis=0), least)
    return deviations


def _along_means(found: Decomposition) -> Decomposition:
    """Rotate the bases so that the rows' elements are uncorrelated **[ours]**.

    A basis is determined only up to a rotation, which the core compensates. With orthonormal columns, the
    rows have the covariance 1 / n - m m^T about their mean m, which is diagonal if m lies along the first
    axis. Standard deviations then describe the first two moments completely. The other axes are sorted by
    singular value.
    """
    core, bases = found.core, dict(found.bases)
    for mode, basis in found.bases.items():
        turn = _to_mean(basis, core, mode)
        bases[mode] = basis @ turn
        core = np.moveaxis(np.tensordot(turn, core, axes=(0, mode)), 0, mode)
    return Decomposition(core, bases)


def _to_mean(basis: FloatArray, core: FloatArray, mode: int) -> FloatArray:
    """Return (J, J) orthonormal: the mean row's direction, then the leading directions of the rest."""
    mean = basis.mean(axis=0)
    length = float(np.linalg.norm(mean))
    if length < np.sqrt(np.finfo(float).eps):  # no mean direction: the rows are uncorrelated already
        return np.eye(len(mean))
    first = mean / length
    rows = np.moveaxis(core, mode, 0).reshape(len(mean), -1)
    rest = rows - np.outer(first, first @ rows)
    others = np.linalg.svd(rest)[0][:, : len(mean) - 1]
    signs = np.where(others[np.argmax(np.abs(others), axis=0), range(len(mean) - 1)] < 0.0, -1.0, 1.0)
    return np.column_stack([first, others * signs])


KINDS: Mapping[str, slice] = {"eyes": EYES, "mouth": MOUTH, "nostrils": NOSTRILS, "brows": BROWS}


def distances_by_kind(differences: FloatArray) -> dict[str, float]:
    """Return the RMS distance, mm, of each kind of point and of ``all``.

    Args:
        differences: (..., K, 3) mm.
    """
    squares = np.sum(np.square(differences), axis=-1)
    kinds = {name: float(np.sqrt(np.mean(squares[..., points]))) for name, points in KINDS.items()}
    return kinds | {"all": float(np.sqrt(np.mean(squares)))}


def cumulative_contribution(spectrum: FloatArray) -> FloatArray:
    """Return the share, 0 to 1, of a tensor's square in the first 1, 2, ... singular values."""
    squares = np.square(spectrum)
    shares: FloatArray = np.cumsum(squares) / np.sum(squares)
    return shares
