"""The pose of a known shape from its pixels in one image (perspective n points) **[ours]**.

The thesis begins its bundle adjustment with a face in the middle of the image that looks at the camera; here
each frame's pose is found first, so that the adjustment begins near where it ends.

A face is nearly flat: under weak perspective a plane and its mirror image in depth look the same, which
exchanges looking up with looking down, left with right. Both are descended from, and the better is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import (
    normalised_from_pixels,
    pixels_and_jacobian,
    pixels_from_normalised,
)
from posetrack_cli.geometry.rotations import quaternions_from_matrices
from posetrack_cli.head.pose import POSE_SIZE, HeadPose

LEAST_POINTS = 4
MOST_STEPS = 30
# A step is the last that lowers the cost by less than this part of it, or than this many squared pixels.
CONVERGED, CONVERGED_PX2 = 1e-5, 1e-8
FIRST_DAMPING, MORE_DAMPING, LESS_DAMPING = 1e-4, 10.0, 0.1
MOST_DAMPING = 1e6
NEAREST_MM = 10.0
"""No point of a face comes nearer to the camera's plane."""
HUBER = 2.0
"""Influence of a point is bounded at so many standard deviations of a coordinate's error."""
LEAST_ERROR_PX = 0.05
# The median length of a normal vector in two dimensions, in standard deviations of a coordinate.
MEDIAN_LENGTH = 1.177


@dataclass(frozen=True, eq=False)
class _Seen:
    """The points that count: pixels (n, 2), square roots of weights (n,), shape (n, 3)."""

    camera: Camera
    pixels: FloatArray
    roots: FloatArray
    shape: FloatArray


def pose_of(
    pixels: FloatArray, weights: FloatArray, camera: Camera, shape: FloatArray
) -> tuple[HeadPose, float]:
    """Return the pose that lays a shape's projection on pixels, and how far off the points remain.

    Minimises sum_k h(w_k |m_k - P(R M_k + t)|^2), h Huber's function with its bound from the median error, by
    Levenberg and Marquardt's method through the lens.

    Args:
        pixels: (K, 2) as recorded.
        weights: (K,) relative; points of weight 0 or without a finite pixel are left out.
        camera: that sees them, in its own axes.
        shape: (K, 3) in the head's frame, mm.

    Returns:
        The pose, and the weighted root mean square, pixels, of the points' distances.

    Raises:
        ValueError: fewer than four points count.
    """
    used = (weights > 0.0) & np.isfinite(pixels).all(axis=1)
    if used.sum() < LEAST_POINTS:
        raise ValueError(f"a pose needs {LEAST_POINTS} points, found {used.sum()}")
    seen = _Seen(camera, pixels[used], np.sqrt(weights[used] / weights[used].max()), shape[used])
    first = [_descended(seen, start, np.inf) for start in _starts(seen)]
    bound = _bound(seen, min(first, key=lambda one: one[1])[0])
    pose, _ = min((_descended(seen, one, bound) for one, _ in first), key=lambda one: one[1])
    lengths = _lengths(seen, pose)
    return pose, float(np.sqrt(np.sum(lengths**2) / np.sum(seen.roots**2)))


def _starts(seen: _Seen) -> tuple[HeadPose, HeadPose]:
    """Return the weak-perspective pose about the ray to the points' middle, and its mirror image in depth.

    Weighted least squares for a 2 x 3 matrix (POS, DeMenthon and Davis 1995), its rows made orthonormal.
    """
    rays = np.column_stack([normalised_from_pixels(seen.camera, seen.pixels), np.ones(len(seen.pixels))])
    towards = rays.mean(axis=0) / np.linalg.norm(rays.mean(axis=0))
    turn = _turned_to_z(towards)
    turned = rays @ turn.T
    flat = turned[:, :2] / turned[:, 2:]
    shape = np.column_stack([seen.shape, np.ones(len(flat))])
    solution, *_ = np.linalg.lstsq(seen.roots[:, None] * shape, seen.roots[:, None] * flat, rcond=None)
    u, values, vt = np.linalg.svd(solution[:3].T, full_matrices=False)
    rows = u @ vt
    rotation = turn.T @ np.vstack([rows, np.cross(rows[0], rows[1])])
    position = turn.T @ np.append(solution[3], 1.0) / values.mean()
    mirror = np.eye(3) - 2.0 * np.outer(towards, towards)
    mirrored = mirror @ rotation @ np.diag([1.0, 1.0, -1.0])
    return _pose(rotation, position), _pose(mirrored, position)


def _pose(rotation: FloatArray, position: FloatArray) -> HeadPose:
    return HeadPose(position, quaternions_from_matrices(rotation))


def _turned_to_z(direction: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) that takes a unit vector with z > 0 to the z axis, without a turn about it."""
    x, y, z = direction
    axis = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [x, y, z]])
    axis[:2, :2] -= np.outer(direction[:2], direction[:2]) / (1.0 + z)
    return axis


def _descended(seen: _Seen, pose: HeadPose, bound: float) -> tuple[HeadPose, float]:
    """Return the pose of least cost near a start, and its cost."""
    cost, damping = _cost(_lengths(seen, pose), bound), FIRST_DAMPING
    matrix, vector = _normal_equations(seen, pose, bound)
    for _ in range(MOST_STEPS):
        damped = matrix + damping * np.diag(np.diagonal(matrix))
        step = np.asarray(np.linalg.solve(damped, vector), dtype=np.float64)
        moved = pose.moved(step)
        lower = _cost(_lengths(seen, moved), bound)
        if lower < cost:
            done = cost - lower <= CONVERGED * cost + CONVERGED_PX2
            pose, cost, damping = moved, lower, LESS_DAMPING * damping
            if done:
                break
            matrix, vector = _normal_equations(seen, pose, bound)
        elif damping > MOST_DAMPING or step @ vector <= CONVERGED * cost + CONVERGED_PX2:
            break
        else:
            damping *= MORE_DAMPING
    return pose, cost


def _normal_equations(seen: _Seen, pose: HeadPose, bound: float) -> tuple[FloatArray, FloatArray]:
    """Return J^T W J (6, 6) and J^T W e (6,) in the pose's tangent vector."""
    points = pose.points(seen.shape)
    pixels, by_point = pixels_and_jacobian(seen.camera, points)
    lengths = np.linalg.norm(seen.roots[:, None] * (seen.pixels - pixels), axis=1)
    roots = seen.roots * np.sqrt(bound / np.maximum(lengths, bound)) if np.isfinite(bound) else seen.roots
    arms = points - pose.position
    jacobian = np.empty((*by_point.shape[:2], POSE_SIZE))
    jacobian[..., :3] = by_point
    jacobian[..., 3:] = np.cross(arms[:, None], by_point)
    rows = (roots[:, None, None] * jacobian).reshape(-1, POSE_SIZE)
    errors = (roots[:, None] * (seen.pixels - pixels)).ravel()
    return rows.T @ rows, rows.T @ errors


def _lengths(seen: _Seen, pose: HeadPose) -> FloatArray:
    """Return the weighted lengths (n,) of the points' errors; infinite where one is not before the camera."""
    points = pose.points(seen.shape)
    if points[:, 2].min() < NEAREST_MM:
        return np.full(len(points), np.inf)
    pixels = pixels_from_normalised(seen.camera, points[:, :2] / points[:, 2:])
    lengths: FloatArray = np.linalg.norm(seen.roots[:, None] * (seen.pixels - pixels), axis=1)
    return lengths


def _cost(lengths: FloatArray, bound: float) -> float:
    """Return half a sum of squares, beyond the bound growing only as the length does."""
    small = np.minimum(lengths, bound)
    return float(np.sum(small * (lengths - 0.5 * small)))


def _bound(seen: _Seen, pose: HeadPose) -> float:
    """Return where Huber's function ends to be a square, from the median error."""
    lengths = _lengths(seen, pose)
    freedom = np.sqrt(max(1.0 - POSE_SIZE / (2.0 * len(lengths)), 0.1))
    spread = float(np.median(lengths)) / (MEDIAN_LENGTH * freedom)
    return HUBER * max(float(spread), LEAST_ERROR_PX)
