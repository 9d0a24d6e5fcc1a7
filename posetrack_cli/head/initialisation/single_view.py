"""Pose of a known shape from its pixels in one image (perspective-n-point) **[ours]**.

The thesis starts its bundle adjustment with a face in the image centre that looks at the camera; here each
frame's pose is estimated first.

A face is nearly planar: under weak perspective a plane and its mirror image in depth look the same, which
confuses up with down and left with right. The optimisation starts from both, and the better result is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.camera import Camera, distortion_jacobian, normalised_from_pixels
from posetrack_cli.geometry.least_squares import damped_step, huber, huber_weight
from posetrack_cli.geometry.rotations import quaternions_from_matrices
from posetrack_cli.head.face.points import POSE_SIZE, HeadPose

LEAST_POINTS = 4
MOST_STEPS = 30
# Convergence: a step lowers the cost by less than this share of it, or by fewer squared pixels.
ROUGHLY, CONVERGED, CONVERGED_PX2 = 1e-3, 1e-6, 1e-9
FIRST_DAMPING, MORE_DAMPING, LESS_DAMPING = 1e-4, 10.0, 0.1
MOST_DAMPING = 1e6
NEAREST_MM = 10.0
"""Minimum distance of a face's points from the camera's plane."""
FARTHEST_MM = 1e6
"""Maximum starting distance: coincident points look like a face at infinity."""
HUBER = 2.0
"""Huber threshold, in standard deviations of a coordinate."""
LEAST_ERROR_PX = 0.05
# The threshold is re-estimated while it decreases, because bounding outliers lowers the median error.
ROUNDS, SETTLED = 4, 0.8
# Median length of a 2D normal vector, in standard deviations of a coordinate.
MEDIAN_LENGTH = 1.177
# Poses closer than this, mm and rad, are the same optimum.
ONE_POSE = np.array([1.0, 1.0, 1.0, 0.01, 0.01, 0.01])


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Weighted points of the least-squares problem.

    Attributes:
        places: (n, 2) normalised coordinates.
        scales: (n, 2, 2) roots of weights times pixels per normalised coordinate, including the lens: error
            lengths are in pixels, to first order.
        roots: (n,) of the weights, the largest is 1.
        shape: (n, 3) mm.
    """

    places: FloatArray
    scales: FloatArray
    roots: FloatArray
    shape: FloatArray

    def starts(self) -> tuple[HeadPose, ...]:
        """Return the weak-perspective pose about the ray to the points' centre, and its mirror image."""
        rays = np.column_stack([self.places, np.ones(len(self.places))])
        towards = rays.mean(axis=0) / np.linalg.norm(rays.mean(axis=0))
        turn = _turned_to_z(towards)
        turned = rays @ turn.T
        flat = turned[:, :2] / turned[:, 2:]
        scale, about_ray, shift = weak_perspective(self.shape, flat, self.roots)
        rotation = turn.T @ about_ray
        position = turn.T @ np.append(shift, 1.0) / max(scale, 1.0 / FARTHEST_MM)
        mirror = np.eye(3) - 2.0 * np.outer(towards, towards)
        mirrored = mirror @ rotation @ np.diag([1.0, 1.0, -1.0])
        return tuple(HeadPose(position, quaternions_from_matrices(one)) for one in (rotation, mirrored))

    def descended(self, pose: HeadPose, bound: float, tolerance: float) -> HeadPose:
        """Return the pose of least cost near a start (Levenberg-Marquardt)."""
        damping = FIRST_DAMPING
        lengths, matrix, vector = self.normal_equations(pose, bound)
        cost = _cost(lengths, bound)
        for _ in range(MOST_STEPS):
            small = tolerance * cost + CONVERGED_PX2
            step = damped_step(matrix, vector, damping)
            moved = pose.moved(step)
            lower = _cost(self.lengths(moved), bound)
            if lower < cost:
                pose, gained, cost, damping = moved, cost - lower, lower, LESS_DAMPING * damping
                if gained <= small:
                    break
                _, matrix, vector = self.normal_equations(pose, bound)
            elif damping > MOST_DAMPING or step @ vector <= small:
                break
            else:
                damping *= MORE_DAMPING
        return pose

    def normal_equations(self, pose: HeadPose, bound: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return error lengths (n,), J^T W J (6, 6) and J^T W e (6,) in the pose's tangent space."""
        arms = self.shape @ pose.rotation.T
        x, y, z = (arms + pose.position).T
        u, v = x / z, y / z
        errors = np.einsum("kij,kj->ki", self.scales, self.places - np.stack([u, v], axis=1))
        lengths = np.sqrt(np.sum(errors**2, axis=1))
        roots = np.sqrt(huber_weight(lengths, bound))
        a, b, c = arms.T
        none = np.zeros_like(z)
        moving = [[none + 1.0, none, -u, -u * b, c + u * a, -b], [none, none + 1.0, -v, -c - v * b, v * a, a]]
        jacobian = np.einsum("kij,jnk->kin", self.scales, np.array(moving) / z)
        rows = (roots[:, None, None] * jacobian).reshape(-1, POSE_SIZE)
        return lengths, rows.T @ rows, rows.T @ (roots[:, None] * errors).ravel()

    def lengths(self, pose: HeadPose) -> FloatArray:
        """Return the weighted error lengths (n,) of the points; infinite if one is behind the camera."""
        points = self.shape @ pose.rotation.T + pose.position
        if points[:, 2].min() < NEAREST_MM:
            return np.full(len(points), np.inf)
        errors = np.einsum("kij,kj->ki", self.scales, self.places - points[:, :2] / points[:, 2:])
        lengths: FloatArray = np.sqrt(np.sum(errors**2, axis=1))
        return lengths

    def bound(self, pose: HeadPose) -> float:
        """Return the Huber threshold from the median error."""
        lengths = self.lengths(pose)
        freedom = np.sqrt(max(1.0 - POSE_SIZE / (2.0 * len(lengths)), 0.1))
        spread = float(np.median(lengths)) / (MEDIAN_LENGTH * freedom)
        return HUBER * max(float(spread), LEAST_ERROR_PX)


def pose_of(
    pixels: FloatArray, weights: FloatArray, camera: Camera, shape: FloatArray
) -> tuple[HeadPose, float]:
    """Fit the pose of a shape to pixels.

    Minimises sum_k h(w_k |m_k - P(R M_k + t)|^2), h Huber's function with its threshold from the median
    error, by Levenberg-Marquardt. The lens is linearised at each pixel.

    Args:
        pixels: (K, 2) with lens distortion.
        weights: (K,) relative; points with weight 0, without a pixel or outside the lens's range are ignored.
        camera: of the image; poses are in its axes.
        shape: (K, 3) in the head's frame, mm.

    Returns:
        The pose, and the weighted RMS distance of the points, pixels.

    Raises:
        ValueError: fewer than four usable points.
    """
    used = _usable(pixels, weights, camera)
    if used.sum() < LEAST_POINTS:
        raise ValueError(f"a pose needs {LEAST_POINTS} points, found {used.sum()}")
    seen = _residuals(pixels[used], weights[used], camera, shape[used])
    poses = [seen.descended(start, np.inf, ROUGHLY) for start in seen.starts()]
    poses.sort(key=lambda pose: _cost(seen.lengths(pose), np.inf))
    if np.all(np.abs(poses[0].difference(poses[1])) <= ONE_POSE):
        poses = poses[:1]
    for _ in range(ROUNDS):
        bound = seen.bound(poses[0])
        poses = [seen.descended(pose, bound, ROUGHLY) for pose in poses]
        poses.sort(key=lambda pose: _cost(seen.lengths(pose), bound))
        if seen.bound(poses[0]) >= SETTLED * bound:
            break
    best = seen.descended(poses[0], bound, CONVERGED)
    return best, float(np.sqrt(np.sum(seen.lengths(best) ** 2) / np.sum(seen.roots**2)))


def pose_near(
    pose: HeadPose, pixels: FloatArray, weights: FloatArray, camera: Camera, shape: FloatArray
) -> HeadPose:
    """Fit the pose of a shape to pixels, starting near a given pose.

    Cost and arguments are those of ``pose_of``; mirror images are not tried. With fewer than four usable
    points the given pose is returned.
    """
    used = _usable(pixels, weights, camera)
    if used.sum() < LEAST_POINTS:
        return pose
    seen = _residuals(pixels[used], weights[used], camera, shape[used])
    for _ in range(ROUNDS):
        pose = seen.descended(pose, seen.bound(pose), ROUGHLY)
    return pose


def _usable(pixels: FloatArray, weights: FloatArray, camera: Camera) -> BoolArray:
    """Return (K,) which points have a weight and a pixel within the lens's range."""
    usable: BoolArray = (weights > 0.0) & np.isfinite(normalised_from_pixels(camera, pixels)).all(axis=1)
    return usable


def _residuals(pixels: FloatArray, weights: FloatArray, camera: Camera, shape: FloatArray) -> _Residuals:
    places, roots = normalised_from_pixels(camera, pixels), np.sqrt(weights / weights.max())
    lens = np.array(distortion_jacobian(camera, *places.T)).reshape(2, 2, -1)
    scales = np.array([camera.fx, camera.fy])[:, None] * np.moveaxis(lens, -1, 0)
    return _Residuals(places, roots[:, None, None] * scales, roots, shape)


def weak_perspective(
    shape: FloatArray, places: FloatArray, roots: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Fit scale, rotation (3, 3) and shift (2,) of a shape under weak perspective.

    Weighted least squares for a 2 x 3 matrix (POS, DeMenthon and Davis 1995), with orthonormalised rows.

    Args:
        shape: (n, 3) mm.
        places: (n, 2) image coordinates; the scale is in their units per mm.
        roots: (n,) square roots of the points' weights.
    """
    columns = np.column_stack([shape, np.ones(len(places))])
    solution, *_ = np.linalg.lstsq(roots[:, None] * columns, roots[:, None] * places, rcond=None)
    u, values, vt = np.linalg.svd(solution[:3].T, full_matrices=False)
    rows = u @ vt
    return float(values.mean()), np.vstack([rows, np.cross(rows[0], rows[1])]), solution[3]


def _turned_to_z(direction: FloatArray) -> FloatArray:
    """Return the smallest rotation (3, 3) from a unit vector with z > 0 to the z axis."""
    x, y, z = direction
    rotation = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [x, y, z]])
    rotation[:2, :2] -= np.outer(direction[:2], direction[:2]) / (1.0 + z)
    return rotation


def _cost(lengths: FloatArray, bound: float) -> float:
    """Return the sum of Huber's function of lengths."""
    return float(np.sum(huber(lengths, bound))) if np.all(np.isfinite(lengths)) else np.inf
