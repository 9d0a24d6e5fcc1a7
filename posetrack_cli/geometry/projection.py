"""Projection into cameras with lens distortion, and back.

``Camera.pixels_from_points`` is the same without distortion. Points of several cameras are in the axes of the
recording's reference camera; ``in_camera_axes`` takes them into another's.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.distortion import distort, distortion_jacobian, undistort

WIDEST_TAN, RADII = 4.0, 4001
"""Distortion is looked at up to 76 degrees off the axis, in steps of 0.001 of the tangent."""


def in_camera_axes(camera: Camera, points: FloatArray) -> FloatArray:
    """Return points (..., 3) mm given in the reference camera's axes in this camera's: R p + t."""
    transform = np.array(camera.camera_T_reference)
    moved: FloatArray = points @ transform[:, :3].T + transform[:, 3]
    return moved


def pixels_from_points(camera: Camera, points: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Project with lens distortion.

    Args:
        camera: that sees them.
        points: (..., 3) in the camera's own axes, mm.

    Returns:
        (..., 2) pixels, and (...) whether the point lies in front of the camera and within the angle up to
        which the distortion grows outwards; beyond it polynomials fold back into the image.
    """
    normalised = _normalised(points)
    radius = np.hypot(normalised[..., 0], normalised[..., 1])
    valid = (points[..., 2] > 0.0) & (radius < largest_radius(camera))
    return pixels_from_normalised(camera, normalised), valid


def pixels_wherever(camera: Camera, points: FloatArray) -> FloatArray:
    """Return the pixels (..., 2) of ``pixels_from_points``, not asking whether the camera can see them.

    For many cameras: how far the distortion of each grows takes longer than to project a few points.
    """
    return pixels_from_normalised(camera, _normalised(points))


def _normalised(points: FloatArray) -> FloatArray:
    """Normalised coordinates (..., 2) of points (..., 3); finite behind the camera, too."""
    z = np.where(points[..., 2] > 0.0, points[..., 2], 1.0)
    return np.stack([points[..., 0] / z, points[..., 1] / z], axis=-1)


def pixels_and_jacobian(camera: Camera, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distorted pixels (..., 2) of points (..., 3) in the camera's axes and their derivatives.

    Returns:
        Pixels, and (..., 2, 3) their derivatives with respect to the points, pixels per mm. Points must lie
        in front of the camera.
    """
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    lens = np.array(distortion_jacobian(camera, x, y)).reshape(2, 2, *x.shape)
    lens *= np.array([camera.fx, camera.fy]).reshape(2, 1, *[1] * x.ndim)
    by_x, by_y = lens[:, 0] / points[..., 2], lens[:, 1] / points[..., 2]
    jacobian = np.stack([by_x, by_y, -(by_x * x + by_y * y)], axis=1)
    pixels = pixels_from_normalised(camera, np.stack([x, y], axis=-1))
    return pixels, np.moveaxis(jacobian, (0, 1), (-2, -1))


def pixels_from_normalised(camera: Camera, normalised: FloatArray) -> FloatArray:
    """Return distorted pixels (..., 2) of normalised coordinates (..., 2)."""
    x, y = distort(camera, normalised[..., 0], normalised[..., 1])
    return np.stack([camera.fx * x + camera.cx, camera.fy * y + camera.cy], axis=-1)


def normalised_from_pixels(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Return the normalised coordinates (..., 2) of distorted pixels (..., 2): rays (x, y, 1)."""
    x = (pixels[..., 0] - camera.cx) / camera.fx
    y = (pixels[..., 1] - camera.cy) / camera.fy
    return np.stack(undistort(camera, x, y), axis=-1)


def undistorted_pixels(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Return where pixels (..., 2) would be without distortion: straight lines are straight there."""
    if not camera.is_distorted:
        return pixels
    flat: FloatArray = normalised_from_pixels(camera, pixels) * [camera.fx, camera.fy]
    flat += [camera.cx, camera.cy]
    return flat


def pixel_map(target: Camera, source: Camera) -> tuple[Float32Array, Float32Array]:
    """Return u and v (height, width) in a source camera's image of every pixel of a target camera's.

    Both cameras are in one place with the same axes, and differ in intrinsics, distortion and size.
    """
    v, u = np.mgrid[: target.height, : target.width].astype(float)
    rays = normalised_from_pixels(target, np.stack([u, v], axis=-1))
    pixels = pixels_from_normalised(source, rays).astype(np.float32)
    return np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1])


@lru_cache(maxsize=64)
def largest_radius(camera: Camera) -> float:
    """Return the largest sqrt(x^2 + y^2) up to which distorted radii grow; inf if they always do.

    Looked at along the axes of x and y in both directions, up to ``WIDEST_TAN``.
    """
    if not camera.is_distorted:
        return float("inf")
    radii = np.linspace(0.0, WIDEST_TAN, RADII)
    zero = np.zeros_like(radii)
    with np.errstate(all="ignore"):
        along_x = [distortion_jacobian(camera, sign * radii, zero)[0] for sign in (1.0, -1.0)]
        along_y = [distortion_jacobian(camera, zero, sign * radii)[3] for sign in (1.0, -1.0)]
    grows = np.all(np.array(along_x + along_y) > 0.0, axis=0)
    return float("inf") if grows.all() else float(radii[np.argmin(grows)])
