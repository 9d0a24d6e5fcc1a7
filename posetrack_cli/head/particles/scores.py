"""How well the images agree with particles: project, score maps, look up (thesis, 3.28 and 3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.distortion import distort
from posetrack_cli.head.face.pose import POSE_SIZE, HeadPose
from posetrack_cli.head.face.shape_model import ShapeModel
from posetrack_cli.head.particles.kernels import (
    add_scores,
    write_pixels,
    write_rotations,
    write_shapes,
    write_transforms,
)
from posetrack_cli.head.particles.score_maps import Box, ScoreMap, boxes_around, score_map

MARGIN_PX = 2
"""What a map has around its particles, so that it often serves for the second weighing too."""


@dataclass(frozen=True, eq=False)
class PatchObservation:
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
        self, observation: PatchObservation, pose: HeadPose, coefficients: FloatArray, model: ShapeModel
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


NORMALISED = np.array([1.0, 1.0, 0.0, 0.0], np.float32)


class ParticleProjection:
    """Projects particles, given as deviations from a reference; keeps its arrays from call to call."""

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._cameras = cameras
        self._transforms = [np.array(camera.camera_T_reference) for camera in cameras]
        self._shape = 0, 0

    def set_reference(self, pose: HeadPose, coefficients: FloatArray, model: ShapeModel) -> None:
        """Count deviations from this pose and these deformation coefficients (B,)."""
        self._pose, rotation = pose, pose.rotation
        points = model.shapes(coefficients) @ rotation.T
        directions = np.tensordot(model.basis, rotation, axes=(1, 1)).transpose(0, 2, 1)
        self._points = points.ravel().astype(np.float32)
        self._directions = np.ascontiguousarray(directions.reshape(points.size, -1), np.float32)

    def set_particles(self, deviations: FloatArray) -> None:
        """Take particles (N, 6 + B): tangent vectors from the reference pose, and coefficients beyond it."""
        parts = np.ascontiguousarray(deviations.T, np.float32)
        self._allocate(len(self._points) // 3, len(deviations))
        self._shifts = parts[:3]
        write_rotations(parts[3:POSE_SIZE], self._rotations)
        write_shapes(self._points, self._directions, parts[POSE_SIZE:], self._shapes)

    def pixels(self, camera: int) -> tuple[Float32Array, Float32Array]:
        """Return the columns and rows (K, N) where a camera sees the points; overwritten by the next call."""
        lens, transform = self._cameras[camera], self._transforms[camera]
        origin = transform[:, :3] @ self._pose.position + transform[:, 3]
        to_camera = np.ascontiguousarray(transform[:, :3], np.float32)
        write_transforms(self._shifts, self._rotations, to_camera, origin.astype(np.float32), self._in_camera)
        intrinsics = np.array([lens.fx, lens.fy, lens.cx, lens.cy], np.float32)
        pinhole = NORMALISED if lens.is_distorted else intrinsics
        write_pixels(self._shapes, self._in_camera, pinhole, self._u, self._v)
        if lens.is_distorted:
            x, y = distort(lens, self._u, self._v)
            np.add(intrinsics[0] * x, intrinsics[2], out=self._u)
            np.add(intrinsics[1] * y, intrinsics[3], out=self._v)
        return self._u, self._v

    def _allocate(self, points: int, count: int) -> None:
        if self._shape == (points, count):
            return
        self._shape = points, count
        self._shapes = np.empty((3 * points, count), np.float32)
        self._rotations = np.empty((9, count), np.float32)
        self._in_camera = np.empty((12, count), np.float32)
        self._u, self._v = np.empty((points, count), np.float32), np.empty((points, count), np.float32)
