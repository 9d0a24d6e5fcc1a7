"""Image scores of particles: projection, correlation, look-up (thesis, 3.28 and 3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera, distort
from posetrack_cli.head.face.points import POSE_SIZE
from posetrack_cli.head.particles.particles import HeadParticles
from posetrack_cli.head.particles.score_maps import (
    ScoreMaps,
    add_all_scores,
    write_pixels,
    write_rotations,
    write_shapes,
    write_transforms,
)


@dataclass(frozen=True, eq=False)
class PatchObservation:
    """Data that the particles of one frame are compared with.

    Attributes:
        images: grey, one per camera; None for a missing image.
        templates: (C, K, PATCH, PATCH) float32 of zero mean and unit norm, warped to the predicted pose.
        visibility: (C, K) weights of the correlations, 0 to 1.
    """

    images: Sequence[ImageArray | None]
    templates: Float32Array
    visibility: FloatArray

    @property
    def weights(self) -> FloatArray:
        """(C, K) visibility, 0 without an image."""
        seen = np.array([image is not None for image in self.images])
        weights: FloatArray = self.visibility * seen[:, None]
        return weights


class ParticleScores:
    """Scores particles on the images of one frame at a time, reusing its arrays.

    Attributes:
        maps_made: number of score maps computed for the frame.
    """

    def __init__(self, cameras: Sequence[Camera], between: bool) -> None:
        """Use these cameras, with bilinear look-up if `between`, otherwise nearest."""
        self._projection = ParticleProjection(cameras)
        self._between = between
        self._maps: list[ScoreMaps] = []
        self.maps_made = 0

    def observe(self, observation: PatchObservation, particles: HeadParticles) -> None:
        """Set the frame, and the reference of the particles' deviations."""
        self._images = [_for_kernels(image) for image in observation.images]
        self._templates, self._weights = observation.templates, observation.weights
        self._projection.set_reference(particles)
        cameras, points = self._weights.shape
        if not self._maps:
            self._maps = [ScoreMaps.of(points) for _ in range(cameras)]
        for maps in self._maps:
            maps.clear()
        self.maps_made = 0

    @property
    def visible(self) -> float:
        """Sum of the weights: CK if all points are visible."""
        return float(self._weights.sum())

    def missing(self, deviations: FloatArray) -> FloatArray:
        """Return CK - c, (N,): summed visibility (1 - correlation) of all points, (3.28).

        Points outside the image have a correlation of 0.

        Args:
            deviations: (N, 6 + B) of particles from the reference.
        """
        total = np.zeros(len(deviations))
        self._projection.set_particles(deviations)
        for c, image in enumerate(self._images):
            weights = self._weights[c]
            if image is not None and weights.any():
                pixels, templates = self._projection.pixels(c), self._templates[c]
                parts = image, templates, weights, *pixels, self._between, *self._maps[c], total
                self.maps_made += add_all_scores(*parts)
        missing: FloatArray = self.visible - total
        return missing


def _for_kernels(image: ImageArray | None) -> ImageArray | None:
    """Return a C-contiguous, writable image, the only layout for which the kernels are compiled."""
    return None if image is None else np.require(image, np.uint8, ("C", "W"))


NORMALISED = np.array([1.0, 1.0, 0.0, 0.0], np.float32)


class ParticleProjection:
    """Projects particles, given as deviations from a reference, reusing its arrays."""

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._cameras = cameras
        self._transforms = [np.array(camera.camera_T_reference) for camera in cameras]
        self._shape = 0, 0

    def set_reference(self, particles: HeadParticles) -> None:
        """Set the reference pose and deformation."""
        self._pose, model = particles.pose, particles.model
        rotation = self._pose.rotation
        points = model.shapes(particles.coefficients) @ rotation.T
        directions = np.tensordot(model.basis, rotation, axes=(1, 1)).transpose(0, 2, 1)
        self._points = points.ravel().astype(np.float32)
        self._directions = np.ascontiguousarray(directions.reshape(points.size, -1), np.float32)

    def set_particles(self, deviations: FloatArray) -> None:
        """Set the particles (N, 6 + B): tangent vectors and coefficients relative to the reference."""
        parts = np.ascontiguousarray(deviations.T, np.float32)
        self._allocate(len(self._points) // 3, len(deviations))
        self._shifts = parts[:3]
        write_rotations(parts[3:POSE_SIZE], self._rotations)
        write_shapes(self._points, self._directions, parts[POSE_SIZE:], self._shapes)

    def pixels(self, camera: int) -> tuple[Float32Array, Float32Array]:
        """Return columns and rows (K, N) of the points in a camera; overwritten by the next call."""
        lens, transform = self._cameras[camera], self._transforms[camera]
        origin = transform[:, :3] @ self._pose.position + transform[:, 3]
        to_camera = np.ascontiguousarray(transform[:, :3], np.float32)
        write_transforms(self._shifts, self._rotations, to_camera, origin.astype(np.float32), self._in_camera)
        intrinsics = np.array([lens.fx, lens.fy, lens.cx, lens.cy], np.float32)
        # a lens distorts normalised coordinates, so the intrinsics are applied afterwards
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
