"""What a face's shape is learnt from, when, and how (thesis, 3.2.4).

Principal components of shapes that come one by one: CCIPCA (Weng, Zhang and Hwang 2003).

    Mbar_t = (t-1)/t Mbar_{t-1} + 1/t M'_t                                                        (3.20)
    v_j    = (t-1)/t v_j + 1/t u (u . v_j/|v_j|)                                                  (3.24)
    u     <- u - (u . v_j/|v_j|) v_j/|v_j|,    u = M'_t - Mbar_t at first                         (3.25)

for j = 1..B in turn. v_j goes to +-lambda_j x_j, an eigenvalue times its eigenvector. A component begins as
the first residue that is left for it. Time and memory of an update depend on K and B alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rigid import rigid_alignment
from posetrack_cli.head.config import ModelSettings
from posetrack_cli.head.face.pose import HeadPose, ShapeModel, rigid_model
from posetrack_cli.head.face.templates import angle_deg

MEAN_RATE = 0.02
"""Of the mean shape per frame while it is refined; a running average at first."""
FACING_DEG = 25.0
"""Learnt from are frames whose face is turned from the camera by less ..."""
LEAST_MM, MOST_MM = 3.0, 40.0
"""... and whose shape is so far from the mean (length of 3K numbers): farther, a point left its feature."""


@dataclass(frozen=True, eq=False)
class FaceLearning:
    """One face's model while it is learnt.

    Attributes:
        statistics: mean and principal components so far.
        frames: in which the face was tracked since it was first found.
        settings: when and what is learnt.
        found: the shape that was found first, rigid; only where the first frames are tracked with it
            (``rigid_phase = "printed"``).
    """

    statistics: Ccipca
    frames: int
    settings: ModelSettings
    found: ShapeModel | None = None

    @property
    def model(self) -> ShapeModel:
        """The model that the next frame is tracked with; the same object until it changes."""
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
        """Return what is known after a tracked frame.

        The points' own places hold what the pose is wrong by, too: where they are ``align_above_mm`` from the
        model's, they are laid on the mean shape first. The first ``rigid_frames`` frames refine that mean,
        exponentially forgetting the start's **[ours]**; later ones are learnt from as deformations. With
        ``rigid_phase = "printed"`` so are the first ones, and M'_1 to M'_t of all clear frames make the mean.

        Args:
            places: (K, 3) M', mm.
            weights: (K,) how much each point counts in laying them on the mean.
            pose: of the head.
            correlations: (K,) of each point's patches, the best camera's.
            expected: (K, 3) M, the shape that the model has in this frame, mm.
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
        """A running average first, which forgets once ``MEAN_RATE`` is more than its own weight."""
        rate = max(MEAN_RATE, 1.0 / (self.frames + 1))
        mean: FloatArray = self.statistics.mean + rate * (shape - self.statistics.mean)
        return mean


def new_face(shape: FloatArray, settings: ModelSettings) -> FaceLearning:
    """Return what is known of a face (K, 3), mm, that was just found: its shape, which does not deform."""
    if settings.rigid_phase == "printed":  # M'_1 is the first sample of (3.20)
        statistics = untrained_statistics(shape, settings.components, mean_count=1)
        return FaceLearning(statistics, 0, settings, rigid_model(shape))
    statistics = untrained_statistics(shape, settings.components, mean_count=settings.rigid_frames)
    return FaceLearning(statistics, 0, settings)


def off_axis_deg(pose: HeadPose) -> float:
    """Return the angle, degrees, between the direction out of the face and that to the reference camera."""
    towards = -pose.position / np.linalg.norm(pose.position)
    return angle_deg(pose.facing, towards)


NOTHING_MM = 1e-9
"""A residue shorter than this has no direction and begins no component."""


@dataclass(frozen=True, eq=False)
class Ccipca:
    """What was learnt of a face's deformations so far.

    Attributes:
        mean: (K, 3) Mbar_t, mm.
        components: (B, 3K) v_j = lambda_j x_j, mm^2, nearly orthogonal; zero where none has begun.
        variance: mean of |M' - Mbar|^2, mm^2: the sum of all 3K eigenvalues.
        count: t, samples seen, with those that the mean began with.
        learnt: samples seen since.
    """

    mean: FloatArray
    components: FloatArray
    variance: float = 0.0
    count: int = 0
    learnt: int = 0

    def averaged(self, shape: FloatArray) -> Ccipca:
        """Return the state whose mean has another shape M' (K, 3), mm; (3.20)."""
        count = self.count + 1
        return replace(self, mean=self.mean + (shape - self.mean) / count, count=count)

    def updated(self, shape: FloatArray) -> Ccipca:
        """Return the state after another shape M' (K, 3), mm; (3.20), (3.24), (3.25)."""
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
        """(B,) cumulative contribution ratio: share of the variance that the first 1..B components hold.

        Zeros before anything was learnt. Eigenvalues and variance are both running estimates, so that the
        ratio may pass 1 by a little at first; it is cut there.
        """
        if not self.variance > 0.0:
            return np.zeros(len(self.components))
        return np.minimum(np.cumsum(self.eigenvalues) / self.variance, 1.0)

    @cached_property
    def rigid(self) -> ShapeModel:
        """The mean as a face that does not deform."""
        return rigid_model(self.mean)

    @cached_property
    def model(self) -> ShapeModel:
        """The shape model (3.1): mean, begun components by descending eigenvalue, mu = sqrt of eigenvalues.

        The v_j are orthogonal in the limit only: the basis is made so in that order (Gram-Schmidt).
        """
        lengths = np.linalg.norm(self.components, axis=1)
        order = [j for j in np.argsort(-lengths, kind="stable") if lengths[j] > 0.0]
        if not order:
            return ShapeModel(self.mean, np.zeros((*self.mean.shape, 0)), np.zeros(0))
        basis, triangle = np.linalg.qr((self.components[order] / lengths[order, None]).T)
        basis *= np.where(np.diagonal(triangle) < 0.0, -1.0, 1.0)
        return ShapeModel(self.mean, basis.reshape(*self.mean.shape, -1), np.sqrt(lengths[order]))


def untrained_statistics(mean: FloatArray, components: int, mean_count: int = 0) -> Ccipca:
    """Return the state before any deformation was seen.

    Args:
        mean: (K, 3) shape so far, mm.
        components: B.
        mean_count: how many samples that mean counts for **[ours]**; with 0, as printed, the first shape
            replaces it, and is itself no deformation.
    """
    return Ccipca(np.array(mean, dtype=np.float64), np.zeros((components, mean.size)), count=mean_count)


def _learn(component: FloatArray, residue: FloatArray, t: int) -> FloatArray:
    """Update one v_j in place by u, (3.24), and return what is left for the next, (3.25)."""
    length = float(np.linalg.norm(component))
    if length == 0.0:
        if np.linalg.norm(residue) > NOTHING_MM:
            component += residue * (float(np.linalg.norm(residue)) / t)
        return np.zeros_like(residue)
    component += (residue * (float(residue @ component) / length) - component) / t
    direction = component / np.linalg.norm(component)
    left: FloatArray = residue - (residue @ direction) * direction
    return left
