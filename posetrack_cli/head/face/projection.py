"""Points seen by several cameras: pixels, and how they move with the points.

``geometry.projection`` is the same for one camera and points in its own axes; here points are in the
reference's, and the lens is kept as a matrix at each point, as the compiled kernels of the refinement use it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.distortion import distort, distortion_jacobian


@dataclass(frozen=True, eq=False)
class Projection:
    """K points on the images of C cameras.

    Attributes:
        pixels: (C, K, 2).
        jacobians: (C, K, 2, 3) d pixel / d point in the reference camera's axes, pixels per mm.
        rays: (C, K, 3) unit vectors from the point to the camera, in the reference camera's axes.
        lenses: (C, K, 2, 3) the lens about each point: x' = L (x, y, 1), normalised coordinates.
        in_front: (C, K) whether a point lies in front of the camera; where not, the rest means nothing.
    """

    pixels: FloatArray
    jacobians: FloatArray
    rays: FloatArray
    lenses: FloatArray
    in_front: BoolArray


def project(cameras: Sequence[Camera], points: FloatArray) -> Projection:
    """Project points (K, 3), mm in the reference camera's axes, through pinhole and lens of every camera."""
    seen = [_project_one(camera, points) for camera in cameras]
    return Projection(*(np.stack(parts) for parts in zip(*seen, strict=True)))


def _project_one(camera: Camera, points: FloatArray) -> tuple[FloatArray, ...]:
    transform = np.array(camera.camera_T_reference)
    R, t = transform[:, :3], transform[:, 3]
    local = points @ R.T + t
    in_front = local[:, 2] > 0.0
    z = np.where(in_front, local[:, 2], 1.0)
    x, y = local[:, 0] / z, local[:, 1] / z
    lens = _lens(camera, x, y)
    focal = np.array([camera.fx, camera.fy])
    pinhole = np.zeros((len(points), 2, 3))  # d (x, y) / d local point
    pinhole[:, 0, 0] = pinhole[:, 1, 1] = 1.0 / z
    pinhole[:, 0, 2], pinhole[:, 1, 2] = -x / z, -y / z
    jacobian = focal[:, None] * (lens[:, :, :2] @ pinhole) @ R
    distorted = np.einsum("kij,kj->ki", lens, np.stack([x, y, np.ones_like(x)], axis=-1))
    pixels = focal * distorted + np.array([camera.cx, camera.cy])
    to_camera = -local @ R
    rays = to_camera / np.linalg.norm(to_camera, axis=-1, keepdims=True)
    return pixels, jacobian, rays, lens, in_front


def _lens(camera: Camera, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return (K, 2, 3) the lens linearised at normalised coordinates (K,): exact there."""
    lens = np.zeros((len(x), 2, 3))
    if not camera.is_distorted:
        lens[:, 0, 0] = lens[:, 1, 1] = 1.0
        return lens
    a, b, c, d = distortion_jacobian(camera, x, y)
    u, v = distort(camera, x, y)
    lens[:, 0] = np.stack([a, b, u - a * x - b * y], axis=-1)
    lens[:, 1] = np.stack([c, d, v - c * x - d * y], axis=-1)
    return lens
