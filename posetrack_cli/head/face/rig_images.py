"""Images of a camera rig at one time, and projection of points into them.

``geometry.camera`` projects for one camera in its own axes. ``project`` takes points in the reference
camera's axes and linearises the lens at each point, as required by the compiled refinement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.compiled import kernel
from posetrack_cli.geometry.camera import (
    Camera,
    distort,
    distortion_jacobian,
    in_camera_axes,
    normalised_from_pixels,
    pixels_from_points,
)
from posetrack_cli.geometry.rigid import inverse


@dataclass(frozen=True, eq=False)
class CameraImage:
    """Image of one camera.

    Attributes:
        camera: with its extrinsics.
        image: (height, width) uint8.
    """

    camera: Camera
    image: ImageArray

    def points_at(self, pixels: FloatArray, depths: FloatArray) -> FloatArray:
        """Return points (..., 3) in the reference's axes at pixels and depths, mm."""
        rays = normalised_from_pixels(self.camera, pixels)
        local = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1) * depths[..., None]
        back = inverse(np.array(self.camera.camera_T_reference))
        points: FloatArray = local @ back[:, :3].T + back[:, 3]
        return points

    def pixels_of(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Project points (..., 3) in the reference's axes; return pixels and validity."""
        return pixels_from_points(self.camera, in_camera_axes(self.camera, points))


@dataclass(frozen=True, eq=False)
class RigImages:
    """Simultaneous images of one or more cameras.

    Attributes:
        cameras: C of them.
        images: (height, width) uint8 per camera; None for a missing image.
    """

    cameras: Sequence[Camera]
    images: Sequence[ImageArray | None]

    @property
    def views(self) -> tuple[CameraImage | None, ...]:
        """Each camera with its image, None where it is missing."""
        pairs = zip(self.cameras, self.images, strict=True)
        return tuple(None if image is None else CameraImage(camera, image) for camera, image in pairs)


def is_reference(camera: Camera) -> bool:
    """Whether a camera defines the recording's axes."""
    return bool(np.array_equal(np.array(camera.camera_T_reference), np.eye(3, 4)))


def required(view: CameraImage | None) -> CameraImage:
    """Return a view that must exist."""
    if view is None:
        raise ValueError("camera without an image")
    return view


@dataclass(frozen=True, eq=False)
class Projection:
    """Projections of K points into C cameras.

    Attributes:
        pixels: (C, K, 2).
        jacobians: (C, K, 2, 3) d pixel / d point in the reference camera's axes, pixels per mm.
        rays: (C, K, 3) unit vectors from the point to the camera, in the reference camera's axes.
        lenses: (C, K, 2, 3) linearised lens at each point: x' = L (x, y, 1), normalised coordinates.
        in_front: (C, K) points in front of the camera; other entries are undefined where False.
    """

    pixels: FloatArray
    jacobians: FloatArray
    rays: FloatArray
    lenses: FloatArray
    in_front: BoolArray


def project(cameras: Sequence[Camera], points: FloatArray) -> Projection:
    """Project points (K, 3), mm in the reference camera's axes, into every camera."""
    count, points = (len(cameras), len(points)), np.ascontiguousarray(points, dtype=np.float64)
    seen = Projection(
        np.empty((*count, 2)),
        np.empty((*count, 2, 3)),
        np.empty((*count, 3)),
        np.empty((*count, 2, 3)),
        np.empty(count, np.bool_),
    )
    for c, camera in enumerate(cameras):
        seen.lenses[c] = _lens(camera, points) if camera.is_distorted else NO_LENS
        transform = np.array(camera.camera_T_reference)
        intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        parts = seen.lenses[c], seen.pixels[c], seen.jacobians[c], seen.rays[c], seen.in_front[c]
        _write_projection(points, transform, intrinsics, *parts)
    return seen


NO_LENS = np.eye(2, 3)


def _lens(camera: Camera, points: FloatArray) -> FloatArray:
    """Return (K, 2, 3) the lens linearised at the projections of points (K, 3)."""
    local = in_camera_axes(camera, points)
    z = np.where(local[:, 2] > 0.0, local[:, 2], 1.0)  # no division by 0; points behind are invalid anyway
    x, y = local[:, 0] / z, local[:, 1] / z
    a, b, c, d = distortion_jacobian(camera, x, y)
    u, v = distort(camera, x, y)
    upper, lower = np.stack([a, b, u - a * x - b * y], axis=-1), np.stack([c, d, v - c * x - d * y], axis=-1)
    return np.stack([upper, lower], axis=1)


@kernel
def _write_projection(
    points: FloatArray,
    transform: FloatArray,
    intrinsics: FloatArray,
    lenses: FloatArray,
    pixels: FloatArray,
    jacobians: FloatArray,
    rays: FloatArray,
    in_front: BoolArray,
) -> None:
    """Write the ``Projection`` of one camera.

    Args:
        points: (K, 3) in the reference camera's axes, mm.
        transform: (3, 4) ``camera_T_reference``.
        intrinsics: fx, fy, cx, cy.
        lenses: (K, 2, 3).
        pixels, jacobians, rays, in_front: out.
    """
    local = np.empty(3)
    for k in range(len(points)):
        for i in range(3):
            turned = transform[i, 0] * points[k, 0] + transform[i, 1] * points[k, 1]
            local[i] = turned + transform[i, 2] * points[k, 2] + transform[i, 3]
        in_front[k] = local[2] > 0.0
        over = 1.0 / (local[2] if in_front[k] else 1.0)
        x, y = local[0] * over, local[1] * over
        away = np.sqrt(local[0] ** 2 + local[1] ** 2 + local[2] ** 2)
        for i in range(2):
            lens = lenses[k, i]
            pixels[k, i] = intrinsics[i] * (lens[0] * x + lens[1] * y + lens[2]) + intrinsics[2 + i]
            along = intrinsics[i] * over  # d pixel / d (X, Y, Z) in the camera's own axes, by its lens
            deeper = -(lens[0] * x + lens[1] * y)
            for j in range(3):
                across = lens[0] * transform[0, j] + lens[1] * transform[1, j]
                jacobians[k, i, j] = along * (across + deeper * transform[2, j])
        for j in range(3):
            to_camera = -(
                transform[0, j] * local[0] + transform[1, j] * local[1] + transform[2, j] * local[2]
            )
            rays[k, j] = to_camera / away
