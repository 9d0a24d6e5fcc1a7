"""Face model learned while tracking."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rigid import rigid_alignment
from posetrack_cli.head.config import ModelSettings
from posetrack_cli.head.face.points import HeadPose, ShapeModel, rigid_model
from posetrack_cli.head.face.templates import angle_deg

# Incremental principal components of the face's shape (thesis, 3.2.4): CCIPCA (Weng, Zhang and Hwang 2003).
#
#     Mbar_t = (t-1)/t Mbar_{t-1} + 1/t M'_t                                                        (3.20)
#     v_j    = (t-1)/t v_j + 1/t u (u . v_j/|v_j|)                                                  (3.24)
#     u     <- u - (u . v_j/|v_j|) v_j/|v_j|,    u = M'_t - Mbar_t at first                         (3.25)
#
# for j = 1..B in turn. v_j converges to +-lambda_j x_j, an eigenvalue times its eigenvector. A component is
# initialised with the first residue left for it. Time and memory of an update depend only on K and B.

MEAN_RATE = 0.02
"""Learning rate of the mean shape per frame during its refinement, after an initial running average."""
FACING_DEG = 25.0
"""Frames train the model only if the face is turned away from the camera by less than this."""
LEAST_MM, MOST_MM = 3.0, 40.0
"""Range of the distance from the mean (norm of 3K values) of training shapes; beyond it, a point is off its
feature."""


@dataclass(frozen=True, eq=False)
class FaceLearning:
    """Face model during learning.

    Attributes:
        statistics: mean and principal components so far.
        frames: tracked frames since the face was first found.
        settings: of the model.
        found: the initial shape, rigid; only if the first frames use it (``rigid_phase = "printed"``).
    """

    statistics: Ccipca
    frames: int
    settings: ModelSettings
    found: ShapeModel | None = None

    @property
    def model(self) -> ShapeModel:
        """Model for the next frame; the same object until it changes."""
        is_rigid = self.settings.kind == "rigid"
        if self.found is not None and (is_rigid or self.frames < self.settings.rigid_frames):
            return self.found
        return self.statistics.rigid if is_rigid else self.statistics.model

    def after(
        self,
        places: FloatArray,
        weights: FloatArray,
        pose: HeadPose,
        correlations: FloatArray,
        expected: FloatArray,
    ) -> FaceLearning:
        """Return the model after a tracked frame.

        The refined points contain the pose error as well: shapes that differ from the model by
        ``align_above_mm`` are aligned to the mean first. The first ``rigid_frames`` frames refine the mean
        with exponential forgetting **[ours]**; later frames train the deformation. With ``rigid_phase =
        "printed"`` all frames do, and the mean is that of all accepted M'.

        Args:
            places: (K, 3) M', mm.
            weights: (K,) of the points in the alignment.
            pose: of the head.
            correlations: (K,) of each point's patches, the best camera's.
            expected: (K, 3) M, the model's shape in this frame, mm.
        """
        settings = self.settings
        later = replace(self, frames=self.frames + 1)
        if off_axis_deg(pose) > FACING_DEG or not np.all(correlations > settings.correlation):
            return later
        shape = places
        if np.linalg.norm(places - expected) >= settings.align_above_mm:
            R, t = rigid_alignment(places, self.statistics.mean, weights)
            shape = places @ R.T + t
        if self.found is None and self.frames < settings.rigid_frames:
            return replace(later, statistics=replace(self.statistics, mean=self._refined_mean(shape)))
        distance = float(np.linalg.norm(shape - self.statistics.mean))
        if settings.kind != "rigid" and LEAST_MM < distance < MOST_MM:
            return replace(later, statistics=self.statistics.updated(shape))
        if self.found is not None:
            return replace(later, statistics=self.statistics.averaged(shape))
        return later

    def _refined_mean(self, shape: FloatArray) -> FloatArray:
        """Return the refined mean: a running average until ``MEAN_RATE`` exceeds its weight."""
        rate = max(MEAN_RATE, 1.0 / (self.frames + 1))
        mean: FloatArray = self.statistics.mean + rate * (shape - self.statistics.mean)
        return mean


def new_face(shape: FloatArray, settings: ModelSettings) -> FaceLearning:
    """Return the rigid model of a newly found face (K, 3), mm."""
    if settings.rigid_phase == "printed":  # M'_1 is the first sample of (3.20)
        statistics = untrained_statistics(shape, settings.components, mean_count=1)
        return FaceLearning(statistics, 0, settings, rigid_model(shape))
    statistics = untrained_statistics(shape, settings.components, mean_count=settings.rigid_frames)
    return FaceLearning(statistics, 0, settings)


def off_axis_deg(pose: HeadPose) -> float:
    """Return the angle, degrees, between the face's direction and that to the reference camera."""
    towards = -pose.position / np.linalg.norm(pose.position)
    return angle_deg(pose.facing, towards)


NOTHING_MM = 1e-9
"""A shorter residue has no direction and initialises no component."""


@dataclass(frozen=True, eq=False)
class Ccipca:
    """Incremental principal components of a face's shapes.

    Attributes:
        mean: (K, 3) Mbar_t, mm.
        components: (B, 3K) v_j = lambda_j x_j, mm^2, nearly orthogonal; zero before initialisation.
        variance: mean of |M' - Mbar|^2, mm^2: the sum of all 3K eigenvalues.
        count: t, number of samples, including those assumed for the initial mean.
        learnt: number of samples since.
    """

    mean: FloatArray
    components: FloatArray
    variance: float = 0.0
    count: int = 0
    learnt: int = 0

    def averaged(self, shape: FloatArray) -> Ccipca:
        """Update the mean with another shape M' (K, 3), mm; (3.20)."""
        count = self.count + 1
        return replace(self, mean=self.mean + (shape - self.mean) / count, count=count)

    def updated(self, shape: FloatArray) -> Ccipca:
        """Update mean and components with another shape M' (K, 3), mm; (3.20), (3.24), (3.25)."""
        after, learnt = self.averaged(shape), self.learnt + 1
        residue = (shape - after.mean).ravel()
        variance = self.variance + (float(residue @ residue) - self.variance) / learnt
        components = self.components.copy()
        for component in components:
            residue = _learn(component, residue, learnt)
        return replace(after, components=components, variance=variance, learnt=learnt)

    @property
    def eigenvalues(self) -> FloatArray:
        """(B,) |v_j|, mm^2, descending."""
        return np.sort(np.linalg.norm(self.components, axis=1))[::-1]

    @property
    def contribution(self) -> FloatArray:
        """(B,) cumulative contribution ratio: share of the variance in the first 1..B components.

        Zeros without samples. Eigenvalues and variance are running estimates, so the ratio is clipped at 1.
        """
        if not self.variance > 0.0:
            return np.zeros(len(self.components))
        return np.minimum(np.cumsum(self.eigenvalues) / self.variance, 1.0)

    @cached_property
    def rigid(self) -> ShapeModel:
        """The mean as a rigid face."""
        return rigid_model(self.mean)

    @cached_property
    def model(self) -> ShapeModel:
        """Shape model (3.1): mean, components by descending eigenvalue, mu = sqrt of eigenvalues.

        The v_j are orthogonal only in the limit; Gram-Schmidt in that order makes the basis orthonormal.
        """
        lengths = np.linalg.norm(self.components, axis=1)
        order = [j for j in np.argsort(-lengths, kind="stable") if lengths[j] > 0.0]
        if not order:
            return ShapeModel(self.mean, np.zeros((*self.mean.shape, 0)), np.zeros(0))
        basis, triangle = np.linalg.qr((self.components[order] / lengths[order, None]).T)
        basis *= np.where(np.diagonal(triangle) < 0.0, -1.0, 1.0)
        return ShapeModel(self.mean, basis.reshape(*self.mean.shape, -1), np.sqrt(lengths[order]))


def untrained_statistics(mean: FloatArray, components: int, mean_count: int = 0) -> Ccipca:
    """Return the statistics before any deformation was seen.

    Args:
        mean: (K, 3) initial shape, mm.
        components: B.
        mean_count: number of samples that the initial mean counts for **[ours]**; with 0, as printed, the
            first shape replaces it and is not a deformation.
    """
    return Ccipca(np.array(mean, dtype=np.float64), np.zeros((components, mean.size)), count=mean_count)


def _learn(component: FloatArray, residue: FloatArray, t: int) -> FloatArray:
    """Update one v_j in place with u, (3.24), and return the residue for the next, (3.25)."""
    length = float(np.linalg.norm(component))
    if length == 0.0:
        # not initialised: the residue becomes the component, which leaves nothing for the next ones
        if np.linalg.norm(residue) > NOTHING_MM:
            component += residue * (float(np.linalg.norm(residue)) / t)
        return np.zeros_like(residue)
    component += (residue * (float(residue @ component) / length) - component) / t
    direction = component / np.linalg.norm(component)
    left: FloatArray = residue - (residue @ direction) * direction
    return left
