"""How well the images agree with particles: project, score maps, look up (thesis, 3.28)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.distortion import distort
from posetrack_cli.head.particle_kernels import (
    add_scores,
    write_normalised,
    write_shapes,
    write_transforms,
)
from posetrack_cli.head.pose import POSE_SIZE
from posetrack_cli.head.score_maps import box_around, extremes, score_map

if TYPE_CHECKING:
    from posetrack_cli.head.particles import HeadParticles


class ParticleScores:
    """Scores particles on the images of one frame at a time; keeps its arrays from frame to frame."""

    def __init__(self, cameras: Sequence[Camera], between: bool) -> None:
        """Score on images of these cameras, looked up bilinearly if `between`, else at the nearest place."""
        self._cameras, self._between = cameras, between
        self._transforms = [np.array(camera.camera_T_reference) for camera in cameras]
        self._images: Sequence[ImageArray | None] = []
        self._templates = np.zeros((0, 0, 0, 0), np.float32)
        self._visibility = np.zeros((0, 0))
        self._arrays = _Arrays(0, 0)

    def observe(
        self, images: Sequence[ImageArray | None], templates: ImageArray, visibility: FloatArray
    ) -> None:
        """Take a frame: images, one a camera or None, templates (C, K, PATCH, PATCH), weights (C, K)."""
        seen = np.array([image is not None for image in images])
        self._images, self._templates = images, np.asarray(templates, np.float32)
        self._visibility = np.asarray(visibility, np.float64) * seen[:, None]

    def missing(self, particles: HeadParticles, deviations: FloatArray) -> FloatArray:
        """Return CK - c, (N,): the sum over cameras and points of visibility (1 - correlation), (3.28).

        A point that is not on the image correlates by 0.

        Args:
            particles: whose reference and model it is.
            deviations: (N, 6 + B) of the particles that are asked about.
        """
        arrays = self._sized(len(particles.model.mean), len(deviations))
        arrays.total[:] = 0.0
        self._write_shapes(particles, deviations)
        for c, image in enumerate(self._images):
            if image is not None:
                self._project(c, particles, deviations)
                self._add(c, image)
        missing: FloatArray = self._visibility.sum() - arrays.total
        return missing

    def mean_correlation(self, particles: HeadParticles, deviation: FloatArray) -> float:
        """Return the mean correlation of the visible points of one particle (6 + B,); 0 if none is."""
        visible = float(self._visibility.sum())
        if visible == 0.0:
            return 0.0
        return 1.0 - float(self.missing(particles, deviation[None])[0]) / visible

    def pixels(
        self, camera: int, particles: HeadParticles, deviations: FloatArray
    ) -> tuple[Float32Array, Float32Array]:
        """Return the columns and rows (K, N) at which a camera sees the points of particles (N, 6 + B)."""
        arrays = self._sized(len(particles.model.mean), len(deviations))
        self._write_shapes(particles, deviations)
        self._project(camera, particles, deviations)
        return arrays.u.copy(), arrays.v.copy()

    def _sized(self, points: int, count: int) -> _Arrays:
        if self._arrays.shape != (points, count):
            self._arrays = _Arrays(points, count)
        return self._arrays

    def _write_shapes(self, particles: HeadParticles, deviations: FloatArray) -> None:
        """Deform, and turn into axes that are the camera's for the reference pose."""
        model, rotation = particles.model, particles.pose.rotation
        points = model.shapes(particles.coefficients) @ rotation.T
        directions = np.einsum("ij,kjb->kib", rotation, model.basis).reshape(points.size, -1)
        coefficients = np.ascontiguousarray(deviations[:, POSE_SIZE:].T, np.float32)
        write_shapes(
            points.ravel().astype(np.float32),
            np.ascontiguousarray(directions, np.float32),
            coefficients,
            self._arrays.shapes,
        )

    def _project(self, c: int, particles: HeadParticles, deviations: FloatArray) -> None:
        """Write the pixels of all particles' points on one camera's image."""
        arrays, camera, transform = self._arrays, self._cameras[c], self._transforms[c]
        rotation = np.ascontiguousarray(transform[:, :3])
        origin = rotation @ particles.pose.position + transform[:, 3]
        write_transforms(deviations, rotation, origin, arrays.transforms)
        write_normalised(arrays.shapes, arrays.transforms, arrays.u, arrays.v)
        if camera.is_distorted:
            arrays.u[:], arrays.v[:] = distort(camera, arrays.u, arrays.v)
        arrays.u *= np.float32(camera.fx)
        arrays.u += np.float32(camera.cx)
        arrays.v *= np.float32(camera.fy)
        arrays.v += np.float32(camera.cy)

    def _add(self, c: int, image: ImageArray) -> None:
        """Add what each particle's points score on one camera's image."""
        arrays = self._arrays
        (left, right), (top, bottom) = extremes(arrays.u), extremes(arrays.v)
        for k in np.flatnonzero(self._visibility[c]):
            box = box_around((left[k], right[k]), (top[k], bottom[k]), image.shape[1], image.shape[0])
            if not box.is_empty:
                scores, column, row = score_map(image, self._templates[c, k], box)
                weight = float(self._visibility[c, k])
                add_scores(scores, column, row, arrays.u[k], arrays.v[k], weight, self._between, arrays.total)


class _Arrays:
    """What is written per step: shapes (3K, N), transforms (12, N), pixels u and v (K, N), total (N,)."""

    def __init__(self, points: int, count: int) -> None:
        self.shape = points, count
        self.shapes = np.empty((3 * points, count), np.float32)
        self.transforms = np.empty((12, count), np.float32)
        self.u, self.v = np.empty((points, count), np.float32), np.empty((points, count), np.float32)
        self.total = np.empty(count)
