"""What the adjustment minimises, written down once more with numpy, slowly, from poses and shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.geometry.camera import Camera, distortion_jacobian, normalised_from_pixels
from posetrack_cli.head.adjustment.adjuster import OFFSET_SD_MM, Adjuster, PersonParameters, PointView
from posetrack_cli.head.adjustment.problem import Part, Problem, Unknowns
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.multilinear.face_model import FaceModel


@dataclass(frozen=True, eq=False)
class Case:
    """An adjustment problem and its start."""

    views: tuple[PointView, ...]
    person: PersonParameters
    model: FaceModel
    camera: Camera
    settings: AdjustmentSettings

    @property
    def adjuster(self) -> Adjuster:
        return Adjuster(self.model, self.camera, self.settings)

    @property
    def problem(self) -> Problem:
        return self.adjuster.problem(self.views)

    @property
    def start(self) -> Unknowns:
        return self.adjuster.start(self.views, self.person)

    @property
    def everything(self) -> Part:
        size = self.model.identity_size
        return Part(
            0, len(self.views), 6 + self.model.deformation_size, size + (30 if self.settings.offsets else 0)
        )


def joined(unknowns: Unknowns, part: Part) -> np.ndarray:
    """All unknowns of a part as one vector: view by view, then what is shared."""
    return np.concatenate([unknowns.local.ravel(), unknowns.shared[: part.shared]])


def split(x: np.ndarray, like: Unknowns) -> Unknowns:
    """The reverse; what the vector does not hold stays."""
    shared = like.shared.copy()
    shared[: len(x) - like.local.size] = x[like.local.size :]
    return Unknowns(x[: like.local.size].reshape(like.local.shape).copy(), shared)


def whitened_errors(case: Case, unknowns: Unknowns) -> np.ndarray:
    """(n, K, 2) errors of points, in standard deviations, not yet robust, and not weighted."""
    model, camera = case.model, case.camera
    u, q = unknowns.shared[: model.identity_size], unknowns.shared[model.identity_size :]
    identity = model.identity_mean + u * model.identity_deviations
    offsets = q.reshape(10, 3) * OFFSET_SD_MM
    errors = []
    for view, local in zip(case.views, unknowns.local, strict=True):
        deformation = model.deformation_mean + local[6:] * model.deformation_deviations
        points = view.pose.moved(local[:6]).points(model.shapes(identity, deformation) + offsets)
        ray = normalised_from_pixels(camera, view.pixels)
        lens = np.stack(distortion_jacobian(camera, ray[:, 0], ray[:, 1]), axis=-1).reshape(10, 2, 2)
        error = np.einsum("kij,kj->ki", lens, points[:, :2] / points[:, 2:] - ray) * [camera.fx, camera.fy]
        errors.append(error / case.settings.pixel_sd.values[:, None])
    return np.array(errors)


def residual_vector(case: Case, unknowns: Unknowns) -> np.ndarray:
    """All residuals: F is half the sum of their squares.

    A point's two are w^(1/2) r (2 H(|r|))^(1/2) / |r|, so that plain least squares minimises the robust F:
    scipy's own Huber loss is of each residual by itself, not of the length of a point's two.
    """
    errors = whitened_errors(case, unknowns)
    lengths = np.linalg.norm(errors, axis=-1)
    h = case.settings.huber
    squares = np.where(lengths <= h, lengths**2, 2.0 * h * (lengths - 0.5 * h))
    factor = np.sqrt(squares) / np.where(lengths > 0.0, lengths, 1.0)
    factor[lengths == 0.0] = 1.0
    weights = np.array([view.weights for view in case.views])
    size, root = case.model.identity_size, np.sqrt(case.settings.prior)
    return np.concatenate(
        [
            ((np.sqrt(weights) * factor)[..., None] * errors).ravel(),
            root * unknowns.local[:, 6:].ravel(),
            root * unknowns.shared[:size],
            unknowns.shared[size:],
        ]
    )


def numeric_jacobian(function, x, step=1e-5):
    """Central differences, (m, len(x))."""
    columns = [(function(x + d) - function(x - d)) / (2.0 * step) for d in step * np.eye(len(x))]
    return np.stack(columns, axis=1)
