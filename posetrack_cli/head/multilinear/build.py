"""From the shapes of several people to the separated model of identity and deformation (thesis, 4.2).

A tensor's mode is the number of an axis. A tensor is unfolded along mode n into a matrix with a row for each
index of that axis; its columns run over the other axes in their order, the last one fastest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import BROWS, EYES, MEAN_SHAPE, MIRRORED, MOUTH, NOSTRILS
from posetrack_cli.head.multilinear.face_model import FaceModel

SWEEPS = 200
"""Most sweeps of ``hooi``."""
CONVERGED = 1e-13
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
    bases = {mode: _leading(unfold(tensor, mode), rank) for mode, rank in ranks.items()}
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
            bases[mode] = _leading(unfold(_projected(tensor, others), mode), rank)
        before, kept = kept, float(np.sum(_projected(tensor, bases) ** 2))
        if kept - before <= CONVERGED * square:
            break
    return Decomposition(_projected(tensor, bases), bases)


def _leading(matrix: FloatArray, rank: int) -> FloatArray:
    """The first left singular vectors (I_n, rank) of X_(n); the largest entry of each is positive."""
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
"""Least standard deviation of a parameter, of its root mean square."""
RANK_TOLERANCE = 1e-9
"""Singular values below this share of the largest are rounding."""


@dataclass(frozen=True, eq=False)
class BuiltModel:
    """A model and what it was built from.

    Attributes:
        model: of which ``identities`` and ``deformations`` are parameters.
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
        """Return what the model makes of the samples (2S, A, K, 3), mm, (4.14)."""
        return self.model.shapes(self.identities[:, None], self.deformations[None])


def build_model(shapes: FloatArray, identity: int = 10, deformation: int = 5) -> BuiltModel:
    """Separate who a face is from what it does, (4.11)-(4.15).

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
    """Return the model with one more deformation parameter a, that halves of faces cannot show **[ours]**.

    M = ... + a (c^T s) D, where c^T s is the size of the person as nearly as s tells it. No sample does any
    of it: abar and the rows of U_action are 0 there.

    Args:
        built: without it.
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
    """Return the most S' and A' that shapes (S, A, K, 3) have anything to say about."""
    tensor = _data(shapes)[2]
    return _rank(singular_values(tensor, PEOPLE)), _rank(singular_values(tensor, ACTIONS))


def mirrored(shapes: FloatArray) -> FloatArray:
    """Return shapes (..., K, 3) as a mirror shows them: left and right are exchanged."""
    image: FloatArray = shapes[..., MIRRORED, :] * np.array([-1.0, 1.0, 1.0])
    return image


def symmetric_halves(shapes: FloatArray) -> FloatArray:
    """Return the symmetric faces (2, ..., K, 3) of the right and of the left halves of shapes (..., K, 3)."""
    images = mirrored(shapes)
    right = (MEAN_SHAPE[:, 0] < 0.0)[:, None]
    return np.stack([np.where(right, shapes, images), np.where(right, images, shapes)])


def _data(shapes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Symmetric samples (2S, A, K, 3), their mean (K, 3), and the data tensor, the samples without it."""
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
    """The same decomposition with bases turned so that the rows' elements are not correlated **[ours]**.

    A basis is free up to a rotation, which the core undoes. As its columns are orthonormal, its rows have
    the covariance 1 / n - m m^T about their mean m: diagonal where m lies along the first axis. Then
    the standard deviations say all that the first two moments can. The other axes are sorted by what they
    carry.
    """
    core, bases = found.core, dict(found.bases)
    for mode, basis in found.bases.items():
        turn = _to_mean(basis, core, mode)
        bases[mode] = basis @ turn
        core = np.moveaxis(np.tensordot(turn, core, axes=(0, mode)), 0, mode)
    return Decomposition(core, bases)


def _to_mean(basis: FloatArray, core: FloatArray, mode: int) -> FloatArray:
    """(J, J) orthonormal: the mean row's direction, then those that carry most of what is left."""
    mean = basis.mean(axis=0)
    length = float(np.linalg.norm(mean))
    if length < np.sqrt(np.finfo(float).eps):
        return np.eye(len(mean))
    first = mean / length
    rows = np.moveaxis(core, mode, 0).reshape(len(mean), -1)
    rest = rows - np.outer(first, first @ rows)
    others = np.linalg.svd(rest)[0][:, : len(mean) - 1]
    signs = np.where(others[np.argmax(np.abs(others), axis=0), range(len(mean) - 1)] < 0.0, -1.0, 1.0)
    return np.column_stack([first, others * signs])


KINDS: Mapping[str, slice] = {"eyes": EYES, "mouth": MOUTH, "nostrils": NOSTRILS, "brows": BROWS}


def distances_by_kind(differences: FloatArray) -> dict[str, float]:
    """Return the root mean square distance, mm, of each kind of point and of ``all``.

    Args:
        differences: (..., K, 3) mm.
    """
    squares = np.sum(np.square(differences), axis=-1)
    kinds = {name: float(np.sqrt(np.mean(squares[..., points]))) for name, points in KINDS.items()}
    return kinds | {"all": float(np.sqrt(np.mean(squares)))}


def cumulative_contribution(spectrum: FloatArray) -> FloatArray:
    """Return the share, 0 to 1, of a tensor's square that the first 1, 2, ... singular values hold."""
    squares = np.square(spectrum)
    shares: FloatArray = np.cumsum(squares) / np.sum(squares)
    return shares
