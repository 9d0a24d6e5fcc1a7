"""How large the person is whom views were adjusted to **[ours]**.

Images say nothing of it; what is known of people does, and more than that the likeliest such shape is the one
nearest to the mean. Let y (3K) be the shape that images tell up to its size c, turn and place, and m, V mean
and covariance of shapes: identity and offsets together. Of shapes X = c y the density at c, for all that
images determine,

    p(c | y)  ~  c^n exp(-1/2 |c y - m|^2_V),

has the volume that a y of some exactness fills in X: c to the number n of determined numbers. An adjustment
that seeks the largest exp(-1/2 |X - m|^2_V) leaves it out, and makes everybody too small: the nearest
multiple of a vector that deviates from m at random is a shorter one, on average by n over |m|^2_V: a face is
some twenty numbers, and 1 / |m|_V, about the standard deviation of sizes, some 4 %: that is 4 %.

With a = |y|^2, b = y . m in the metric of V, from which common shifts are projected out, the maximum of the
logarithm, n log c - a c^2 / 2 + b c, is at c = (b + sqrt(b^2 + 4 a n)) / 2 a.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.adjustment.adjuster import offset_deviations
from posetrack_cli.head.adjustment.views import Adjusted, PersonParameters
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.multilinear.face_model import FaceModel

OFFSETS_SHARE = 2.0 / 3.0
"""People's offsets spread so much of what an adjustment lets them: of ten people of the study, whose points
were compared with true vertices, by 1.2 0.9 1.1 mm (eyes), 2.2 1.1 1.0 (mouth), 1.7 0.8 3.1 (nostrils) and
1.5 1.4 1.4 (brows). An adjustment has points that slide to explain, too."""


def of_likely_size(
    adjusted: Adjusted, model: FaceModel, settings: AdjustmentSettings
) -> tuple[PersonParameters, float]:
    """Return a person whom views were adjusted to in the likeliest size, and how many times larger that is.

    Offsets make it so: with the identity the way in which the face deforms would change.
    """
    person = adjusted.person
    shape = model.of_person(person.identity, person.offsets).mean
    size = likely_size(shape, adjusted.determined, model, settings)
    return replace(person, offsets=person.offsets + (size - 1.0) * shape), size


def likely_size(
    shape: FloatArray, determined: float, model: FaceModel, settings: AdjustmentSettings
) -> float:
    """Return what a shape (K, 3) of one camera is to be multiplied by.

    Args:
        shape: mean deformed shape of the person whom views were adjusted to, mm.
        determined: n, how many numbers of the person the views tell.
        model: of faces.
        settings: which deviations offsets have.
    """
    precision = _precision_of_shapes(model, settings)
    mean = model.of_person(model.identity_mean).mean.ravel()
    y = shape.ravel()
    a, b = float(y @ precision @ y), float(y @ precision @ mean)
    return float((b + np.sqrt(b * b + 4.0 * a * determined)) / (2.0 * a))


def _identity_basis(model: FaceModel) -> FloatArray:
    """(K, 3, S) how a face of the mean deformation moves with whitened identity, mm."""
    basis: FloatArray = (
        np.einsum("kisa,a->kis", model.core, model.deformation_mean) * model.identity_deviations
    )
    return basis


def _precision_of_shapes(model: FaceModel, settings: AdjustmentSettings) -> FloatArray:
    """(3K, 3K) V^-1, 1 / mm^2, from which shifts of all points together are projected out."""
    B = _identity_basis(model).reshape(-1, model.identity_size)
    D = OFFSETS_SHARE * offset_deviations(settings.offset_mm).ravel()
    W: FloatArray = np.linalg.inv(np.asarray(B @ B.T + np.diag(D * D), dtype=np.float64))
    T = np.tile(np.eye(3), (len(model.mean), 1))
    WT = W @ T
    projected: FloatArray = W - WT @ np.linalg.solve(T.T @ WT, WT.T)
    return projected
