"""Points in space from their pixels in two or more calibrated cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import (
    in_camera_axes,
    normalised_from_pixels,
    pixels_and_jacobian,
    pixels_from_points,
)

STEPS = 5
"""Gauss-Newton steps; from the linear solution two suffice for errors of a few pixels."""


def triangulate(
    cameras: Sequence[Camera], pixels: FloatArray, seen: BoolArray | None = None, *, refine: bool = True
) -> tuple[FloatArray, BoolArray]:
    """Return the points that project nearest to given pixels.

    Linear solution on undistorted rays, then Gauss-Newton on the squared distance to the distorted pixels:
    the maximum likelihood estimate for equal Gaussian noise in every image.

    Args:
        cameras: C >= 2 of them.
        pixels: (C, ..., 2) distorted pixels of each point; NaN where it is not seen.
        seen: (C, ...) which pixels count, None for all that are finite.
        refine: whether the linear solution is refined.

    Returns:
        (..., 3) points in the reference camera's axes, mm, and (...) whether at least two cameras with
        different rays see the point in front of them. Points that are not valid are 0.
    """
    used = _usable(pixels, seen)
    flat = np.where(used[..., None], pixels, 0.0).reshape(len(cameras), -1, 2)
    mask = used.reshape(len(cameras), -1)
    points, valid = _linear(cameras, flat, mask)
    if refine and valid.any():
        points[valid] = _refined(cameras, points[valid], flat[:, valid], mask[:, valid])
        valid &= _in_front(cameras, points, mask)
    points[~valid] = 0.0
    return points.reshape(*pixels.shape[1:-1], 3), valid.reshape(pixels.shape[1:-1])


def reprojection_errors(cameras: Sequence[Camera], points: FloatArray, pixels: FloatArray) -> FloatArray:
    """Return the distances (C, ...), px, of points (..., 3) in the reference's axes to pixels (C, ..., 2).

    Infinite where a point lies behind the camera or outside what its lens shows.
    """
    errors = np.full(pixels.shape[:-1], np.inf)
    for camera, own, error in zip(cameras, pixels, errors, strict=True):
        projected, valid = pixels_from_points(camera, in_camera_axes(camera, points))
        error[...] = np.where(valid, np.linalg.norm(projected - own, axis=-1), np.inf)
    return errors


def _usable(pixels: FloatArray, seen: BoolArray | None) -> BoolArray:
    finite: BoolArray = np.asarray(np.isfinite(pixels).all(axis=-1), bool)
    return finite if seen is None else np.logical_and(seen, finite)


def _linear(cameras: Sequence[Camera], pixels: FloatArray, seen: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Least squares of (I - r r^T)(R p + t) = 0 over cameras, r the unit ray: p nearest to all rays."""
    matrix, right = np.zeros((pixels.shape[1], 3, 3)), np.zeros((pixels.shape[1], 3))
    for camera, own, mask in zip(cameras, pixels, seen, strict=True):
        transform = np.array(camera.camera_T_reference)
        rays = _unit_rays(normalised_from_pixels(camera, own)) @ transform[:, :3]
        across = (np.eye(3) - rays[:, :, None] * rays[:, None, :]) * mask[:, None, None]
        matrix += across
        right += across @ (-transform[:, :3].T @ transform[:, 3])
    values = np.linalg.eigvalsh(matrix)
    valid = (seen.sum(axis=0) >= 2) & (values[:, 0] > 1e-12)
    points = np.zeros_like(right)
    points[valid] = np.linalg.solve(matrix[valid], right[valid][..., None])[..., 0]
    return points, valid & _in_front(cameras, points, seen)


def _unit_rays(normalised: FloatArray) -> FloatArray:
    rays = np.concatenate([normalised, np.ones_like(normalised[:, :1])], axis=-1)
    unit: FloatArray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return unit


def _in_front(cameras: Sequence[Camera], points: FloatArray, seen: BoolArray) -> BoolArray:
    depths = np.array([in_camera_axes(camera, points)[:, 2] for camera in cameras])
    in_front: BoolArray = np.all((depths > 0.0) | ~seen, axis=0)
    return in_front


def _refined(
    cameras: Sequence[Camera], points: FloatArray, pixels: FloatArray, seen: BoolArray
) -> FloatArray:
    """Gauss-Newton on the sum of |projection - pixel|^2; a step to behind a camera is not taken."""
    for _ in range(STEPS):
        matrix, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
        for camera, own, mask in zip(cameras, pixels, seen, strict=True):
            local = np.where(mask[:, None], in_camera_axes(camera, points), [0.0, 0.0, 1.0])
            projected, jacobian = pixels_and_jacobian(camera, local)
            jacobian = jacobian @ np.array(camera.camera_T_reference)[:, :3] * mask[:, None, None]
            matrix += np.swapaxes(jacobian, 1, 2) @ jacobian
            right += np.einsum("nij,ni->nj", jacobian, own - projected)
        moved = points + np.linalg.solve(matrix, right[..., None])[..., 0]
        points = np.where(_in_front(cameras, moved, seen)[:, None], moved, points)
    return points
