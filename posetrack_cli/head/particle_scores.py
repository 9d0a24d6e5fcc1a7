"""How well the images agree with particles: project, score maps, look up (thesis, 3.28)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.particle_kernels import add_scores
from posetrack_cli.head.particle_projection import ParticleProjection
from posetrack_cli.head.pose import HeadPose
from posetrack_cli.head.score_maps import Box, ScoreMap, boxes_around, score_map
from posetrack_cli.head.shape_model import ShapeModel

MARGIN_PX = 2
"""What a map has around its particles, so that it often serves for the second weighing too."""


@dataclass(frozen=True, eq=False)
class Observation:
    """What the particles of one frame are compared with.

    Attributes:
        images: one a camera, grey; None where a camera gave none.
        templates: (C, K, PATCH, PATCH) float32, warped to the predicted pose.
        visibility: (C, K) weights 0 to 1 of the correlations.
    """

    images: Sequence[ImageArray | None]
    templates: Float32Array
    visibility: FloatArray

    @property
    def weights(self) -> FloatArray:
        """(C, K) visibility, 0 where there is no image."""
        seen = np.array([image is not None for image in self.images])
        weights: FloatArray = self.visibility * seen[:, None]
        return weights


class ParticleScores:
    """Scores particles on the images of one frame at a time; keeps its arrays from frame to frame."""

    def __init__(self, cameras: Sequence[Camera], between: bool) -> None:
        """Score on images of these cameras, looked up bilinearly if `between`, else at the nearest place."""
        self._projection = ParticleProjection(cameras)
        self._between = between
        self._maps: dict[tuple[int, int], tuple[Box, ScoreMap]] = {}

    def observe(
        self, observation: Observation, pose: HeadPose, coefficients: FloatArray, model: ShapeModel
    ) -> None:
        """Take a frame, and what the particles' deviations are counted from."""
        self._observation, self._weights = observation, observation.weights
        self._projection.set_reference(pose, coefficients, model)
        self._maps.clear()

    @property
    def visible(self) -> float:
        """Sum of the weights: CK where all points are visible."""
        return float(self._weights.sum())

    def missing(self, deviations: FloatArray) -> FloatArray:
        """Return CK - c, (N,): the sum over cameras and points of visibility (1 - correlation), (3.28).

        A point that is not on the image correlates by 0.

        Args:
            deviations: (N, 6 + B) of particles from the reference.
        """
        total = np.zeros(len(deviations))
        self._projection.set_particles(deviations)
        for c, image in enumerate(self._observation.images):
            if image is not None and self._weights[c].any():
                self._add(c, image, total)
        missing: FloatArray = self.visible - total
        return missing

    def _add(self, c: int, image: ImageArray, total: FloatArray) -> None:
        """Add what each particle's points score on one camera's image."""
        u, v = self._projection.pixels(c)
        boxes = boxes_around(u, v, image.shape[1], image.shape[0])
        for k in np.flatnonzero(self._weights[c]).tolist():
            if not boxes[k].is_empty:
                scores, left, top = self._map(c, k, image, boxes[k])
                weight = float(self._weights[c, k])
                add_scores(scores, left, top, u[k], v[k], weight, self._between, total)

    def _map(self, c: int, k: int, image: ImageArray, box: Box) -> ScoreMap:
        """Return a map of at least this box: the one at hand if it is large enough."""
        if (c, k) in self._maps:
            known, scores = self._maps[c, k]
            if known.holds(box):
                return scores
        wide = box.grown(MARGIN_PX, image.shape[1], image.shape[0])
        scores = score_map(image, self._observation.templates[c, k], wide)
        self._maps[c, k] = wide, scores
        return scores
