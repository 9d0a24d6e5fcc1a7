"""Where cameras see the feature points of many particles (thesis, 3.4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.distortion import distort
from posetrack_cli.head.particle_kernels import (
    write_pixels,
    write_rotations,
    write_shapes,
    write_transforms,
)
from posetrack_cli.head.pose import POSE_SIZE, HeadPose
from posetrack_cli.head.shape_model import ShapeModel

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
