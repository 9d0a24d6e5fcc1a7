"""What a face's shape is learnt from, and when (thesis, 3.2.4)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rigid_alignment import rigid_alignment
from posetrack_cli.head.ccipca import Ccipca, begun
from posetrack_cli.head.config import ModelSettings
from posetrack_cli.head.keyframes import angle_deg
from posetrack_cli.head.pose import HeadPose
from posetrack_cli.head.shape_model import ShapeModel, rigid_model


@dataclass(frozen=True, eq=False)
class FaceLearning:
    """One face's model while it is learnt.

    Attributes:
        statistics: mean and principal components so far.
        frames: in which the face was tracked since it was first found.
        model: of these statistics.
    """

    statistics: Ccipca
    frames: int
    model: ShapeModel

    def after(
        self,
        places: FloatArray,
        weights: FloatArray,
        pose: HeadPose,
        correlations: FloatArray,
        settings: ModelSettings,
    ) -> FaceLearning:
        """Return what is known after a tracked frame.

        The points' own places hold what the pose is wrong by, too: they are laid on the mean shape first. The
        first ``rigid_frames`` frames refine that mean, exponentially forgetting the start's **[ours]**; those
        that come later are learnt from as deformations.

        Args:
            places: (K, 3) M', mm.
            weights: (K,) how much each point counts in laying them on the mean.
            pose: of the head.
            correlations: (K,) of each point's patches, the best camera's.
            settings: gates.
        """
        later = replace(self, frames=self.frames + 1)
        if off_axis_deg(pose) > settings.facing_deg or not np.all(correlations > settings.correlation):
            return later
        R, t = rigid_alignment(places, self.statistics.mean, weights)
        shape = places @ R.T + t
        if self.frames < settings.rigid_frames:
            return later._with(replace(self.statistics, mean=self._refined_mean(shape, settings)), settings)
        distance = float(np.linalg.norm(shape - self.statistics.mean))
        if settings.kind == "rigid" or not settings.least_mm < distance < settings.most_mm:
            return later
        return later._with(self.statistics.updated(shape), settings)

    def _refined_mean(self, shape: FloatArray, settings: ModelSettings) -> FloatArray:
        """A running average first, which forgets once ``mean_rate`` is more than its own weight."""
        rate = max(settings.mean_rate, 1.0 / (self.frames + 1))
        mean: FloatArray = self.statistics.mean + rate * (shape - self.statistics.mean)
        return mean

    def _with(self, statistics: Ccipca, settings: ModelSettings) -> FaceLearning:
        return replace(self, statistics=statistics, model=_model(statistics, settings))


def new_face(shape: FloatArray, settings: ModelSettings) -> FaceLearning:
    """Return what is known of a face (K, 3), mm, that was just found: its shape, which does not deform."""
    return known_face(begun(shape, settings.components, mean_count=settings.rigid_frames), 0, settings)


def known_face(statistics: Ccipca, frames: int, settings: ModelSettings) -> FaceLearning:
    """Return what statistics say that were learnt over so many frames."""
    return FaceLearning(statistics, frames, _model(statistics, settings))


def off_axis_deg(pose: HeadPose) -> float:
    """Return the angle, degrees, between the direction out of the face and that to the reference camera."""
    towards = -pose.position / np.linalg.norm(pose.position)
    return angle_deg(pose.facing, towards)


def _model(statistics: Ccipca, settings: ModelSettings) -> ShapeModel:
    return rigid_model(statistics.mean) if settings.kind == "rigid" else statistics.model
