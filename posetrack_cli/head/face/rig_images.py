"""The images that the cameras of a rig took at one time, and where its cameras see points.

``geometry.projection`` projects for one camera and points in its own axes; ``project`` here takes points in
the reference's, and keeps the lens as a matrix at each point, as the refinement's compiled kernels use it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.distortion import distort, distortion_jacobian
from posetrack_cli.geometry.projection import in_camera_axes, normalised_from_pixels, pixels_from_points
from posetrack_cli.geometry.rigid import inverse


@dataclass(frozen=True, eq=False)
class CameraImage:
    """One camera's image.

    Attributes:
        camera: with its place.
        image: (height, width) uint8.
    """

    camera: Camera
    image: ImageArray

    def points_at(self, pixels: FloatArray, depths: FloatArray) -> FloatArray:
        """Return the points (..., 3) in the reference's axes seen at pixels and depths, mm."""
        rays = normalised_from_pixels(self.camera, pixels)
        local = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1) * depths[..., None]
        back = inverse(np.array(self.camera.camera_T_reference))
        points: FloatArray = local @ back[:, :3].T + back[:, 3]
        return points

    def pixels_of(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return where points (..., 3) in the reference's axes appear, and whether they can."""
        return pixels_from_points(self.camera, in_camera_axes(self.camera, points))


@dataclass(frozen=True, eq=False)
class RigImages:
    """What the cameras of a rig, one or more, saw at one time.

    Attributes:
        cameras: C of them.
        images: (height, width) uint8, one a camera; None where a camera gave none.
    """

    cameras: Sequence[Camera]
    images: Sequence[ImageArray | None]

    @property
    def views(self) -> tuple[CameraImage | None, ...]:
        """Each camera with its image, None where it has none."""
        pairs = zip(self.cameras, self.images, strict=True)
        return tuple(None if image is None else CameraImage(camera, image) for camera, image in pairs)


def is_reference(camera: Camera) -> bool:
    """Whether a camera's axes are the recording's."""
    return bool(np.array_equal(np.array(camera.camera_T_reference), np.eye(3, 4)))


def required(view: CameraImage | None) -> CameraImage:
    """Return a view that is known to be there."""
    if view is None:
        raise ValueError("a camera without an image")
    return view


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
