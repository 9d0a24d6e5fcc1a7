"""Rigid transforms and multi-view geometry: triangulation, epipolar geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.errors import PosetrackError
from posetrack_cli.geometry.camera import (
    IN_PLACE,
    Camera,
    in_camera_axes,
    normalised_from_pixels,
    pixels_and_jacobian,
    pixels_from_points,
    undistorted_pixels,
)
from posetrack_cli.geometry.rotations import conjugate, rotate

# Rigid transforms, mm: object poses, relative camera poses, alignment of point sets.
#
# A pose ``camera_T_object`` is a position t and the quaternion of R: p = R m + t maps object to camera axes;
# leading axes broadcast. Transforms between cameras are matrices (3, 4), [R | t], mapping p to R p + t.


def in_camera(points: FloatArray, position: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Return p = R m + t (..., 3) for points m (..., 3) in object axes; unit quaternions (..., 4)."""
    return rotate(quaternion, points) + position


def in_object(points: FloatArray, position: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Return m = R^T (p - t) (..., 3) for points p (..., 3) in camera axes."""
    return rotate(conjugate(quaternion), points - position)


ROUNDED = 1e-3
"""Tolerance of rotation matrices, which files may round to three decimals."""


def inverse(transform: FloatArray) -> FloatArray:
    """Return [R^T | -R^T t] of a transform (3, 4)."""
    rotation = transform[:, :3].T
    return np.column_stack([rotation, -rotation @ transform[:, 3]])


def composed(after: FloatArray, before: FloatArray) -> FloatArray:
    """Return the transform (3, 4) that applies ``before``, then ``after``."""
    rotation = after[:, :3] @ before[:, :3]
    return np.column_stack([rotation, after[:, :3] @ before[:, 3] + after[:, 3]])


def rotation_from_rows(values: Sequence[float], where: object) -> FloatArray:
    """Return the rotation matrix (3, 3) nearest to nine numbers in row order.

    Raises:
        PosetrackError: the deviation from a rotation exceeds rounding to three decimals.
    """
    matrix = np.array(values, dtype=float).reshape(3, 3)
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 2.0:
        raise _no_rotation(matrix, where)
    u, _, vt = np.linalg.svd(matrix)
    nearest: FloatArray = u @ vt
    if np.linalg.det(nearest) < 0 or np.abs(nearest - matrix).max() > ROUNDED:
        raise _no_rotation(matrix, where)
    return nearest


def placed(camera: Camera, camera_T_reference: FloatArray) -> Camera:
    """Return the camera with another pose."""
    rows = tuple(tuple(float(value) + 0.0 for value in row) for row in camera_T_reference)  # no -0.0
    return replace(camera, camera_T_reference=rows)


def relative_to(reference: Camera, cameras: Sequence[Camera]) -> tuple[Camera, ...]:
    """Return the cameras with their poses relative to ``reference``."""
    from_reference = inverse(np.array(reference.camera_T_reference))
    return tuple(
        replace(camera, camera_T_reference=IN_PLACE)
        if camera == reference
        else placed(camera, composed(np.array(camera.camera_T_reference), from_reference))
        for camera in cameras
    )


def _no_rotation(matrix: FloatArray, where: object) -> PosetrackError:
    found = ", ".join(f"{value:g}" for value in matrix.ravel())
    return PosetrackError(
        "is not a rotation", where=where, found=found, expected="nine numbers, orthonormal rows"
    )


def rigid_alignment(
    source: FloatArray, target: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return R (..., 3, 3) and t (..., 3) that minimise sum_k w_k |R a_k + t - b_k|^2 (Kabsch 1976).

    With both sets centred at their weighted means, H = sum_k w_k a_k b_k^T = U S V^T and R = V D U^T, with
    D = diag(1, 1, det(V U^T)) to exclude reflections.

    Args:
        source: (..., K, 3) a.
        target: (..., K, 3) b.
        weights: (..., K) w >= 0, not all zero.
    """
    share = weights / weights.sum(axis=-1, keepdims=True)
    from_middle, to_middle = share[..., None, :] @ source, share[..., None, :] @ target
    covariance = _transposed(source - from_middle) @ (share[..., None] * (target - to_middle))
    U, _, Vt = np.linalg.svd(covariance)
    turn = np.broadcast_to(np.eye(3), covariance.shape).copy()
    turn[..., 2, 2] = np.sign(np.linalg.det(_transposed(Vt) @ _transposed(U)))
    R: FloatArray = _transposed(Vt) @ turn @ _transposed(U)
    return R, to_middle[..., 0, :] - (R @ _transposed(from_middle))[..., 0]


def _transposed(matrices: FloatArray) -> FloatArray:
    return np.swapaxes(matrices, -1, -2)


# Triangulation from two or more calibrated cameras

STEPS = 5
"""Gauss-Newton steps; from the linear solution two suffice for errors of a few pixels."""


def triangulate(
    cameras: Sequence[Camera], pixels: FloatArray, seen: BoolArray | None = None, *, refine: bool = True
) -> tuple[FloatArray, BoolArray]:
    """Return the points with the smallest reprojection error.

    Linear solution on undistorted rays, then Gauss-Newton on the squared distance to the distorted pixels,
    which is the maximum likelihood estimate for equal Gaussian noise in all images.

    Args:
        cameras: C >= 2 cameras.
        pixels: (C, ..., 2) distorted pixels of each point; NaN where it is not visible.
        seen: (C, ...) pixels to use; None for all finite ones.
        refine: whether to refine the linear solution.

    Returns:
        (..., 3) points in the reference camera's axes, mm, and (...) whether at least two cameras with
        different rays see the point in front of them. Invalid points are 0.
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
    """Return distances (C, ...), px, between projections of points (..., 3) and pixels (C, ..., 2).

    Points are in the reference axes. Infinite where a point is behind the camera or outside the lens's
    range.
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
    """Return the points nearest to all rays, least squares of (I - r r^T)(R p + t) = 0, r the unit ray."""
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
    """Refine by Gauss-Newton on sum |projection - pixel|^2; skip steps to behind a camera."""
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


# Epipolar geometry, and detection of images assigned to the wrong cameras

CLEARLY_BETTER = 3.0
"""Factor by which the epipolar error of exchanged images must be smaller."""
EPIPOLAR_LIMIT_PX = 2.0
"""Error of careless clicks or a fair calibration; up to this, the recorded order is accepted."""


@dataclass(frozen=True)
class CameraPair:
    """Two calibrated cameras.

    Attributes:
        first, second: the cameras, with their poses.
    """

    first: Camera
    second: Camera

    @property
    def transform(self) -> tuple[FloatArray, FloatArray]:
        """R (3, 3) and t (3,) mm with p_second = R p_first + t."""
        back = inverse(np.array(self.first.camera_T_reference))
        transform = composed(np.array(self.second.camera_T_reference), back)
        return transform[:, :3], transform[:, 3]

    @property
    def fundamental(self) -> FloatArray:
        """F (3, 3): u_second^T F u_first = 0 for undistorted pixels (u, v, 1) of one point.

        For normalised coordinates, p2^T E p1 = 0 with E = [t]x R.
        """
        rotation, (x, y, z) = self.transform
        essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ rotation
        inverses = np.linalg.inv(self.second.matrix).T, np.linalg.inv(self.first.matrix)
        matrix: FloatArray = inverses[0] @ essential @ inverses[1]
        return matrix

    def epipolar_errors(self, pixels: FloatArray, others: FloatArray) -> FloatArray:
        """Return Sampson distances (...) of distorted pixels (..., 2) in the first and the second image."""
        flat = undistorted_pixels(self.first, pixels), undistorted_pixels(self.second, others)
        return sampson_distance(self.fundamental, *flat)

    def in_front(self, pixels: FloatArray, others: FloatArray) -> BoolArray:
        """Return whether the rays of pixels (..., 2) in both images are closest in front of both cameras.

        The depths z1, z2 minimise |R z1 r1 + t - z2 r2|^2.
        """
        rotation, t = self.transform
        one = _homogeneous(normalised_from_pixels(self.first, pixels)) @ rotation.T
        two = _homogeneous(normalised_from_pixels(self.second, others))
        aa, bb, ab = np.sum(one * one, -1), np.sum(two * two, -1), np.sum(one * two, -1)
        at, bt = one @ t, two @ t
        determinant = aa * bb - ab * ab  # >= 0, so the numerators' signs are those of the depths
        in_front: BoolArray = (ab * bt - bb * at > 0.0) & (aa * bt - ab * at > 0.0) & (determinant > 0.0)
        return in_front


def sampson_distance(fundamental: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the Sampson distance, px: first-order distance of the four coordinates to a valid pair.

    d = |u2^T F u1| / sqrt((F u1)_1^2 + (F u1)_2^2 + (F^T u2)_1^2 + (F^T u2)_2^2).

    Args:
        fundamental: (3, 3) of ``CameraPair``.
        first, second: (..., 2) undistorted pixels of one point in either image.
    """
    one, two = _homogeneous(first), _homogeneous(second)
    line_two, line_one = one @ fundamental.T, two @ fundamental
    product = np.abs(np.sum(two * line_two, axis=-1))
    squares = np.sum(line_two[..., :2] ** 2 + line_one[..., :2] ** 2, axis=-1)
    distance: FloatArray = product / np.sqrt(np.maximum(squares, np.finfo(np.float64).tiny))
    return distance


@dataclass(frozen=True)
class OrderFit:
    """Agreement of detected points with the calibration for one assignment of images to cameras.

    Attributes:
        order: image index of each camera; (0, 1, ...) is as recorded.
        error_px: median Sampson distance over points and pairs of cameras, pixels.
        in_front: fraction of points and pairs whose rays meet in front of both cameras.
    """

    order: tuple[int, ...]
    error_px: float
    in_front: float

    @property
    def is_possible(self) -> bool:
        """Whether most points are in front of the cameras."""
        return self.in_front > 0.5


def order_fit(cameras: Sequence[Camera], pixels: FloatArray, order: tuple[int, ...]) -> OrderFit:
    """Return the fit of points (C, K, 2), NaN where not detected, if camera c has image ``order[c]``."""
    errors, in_front = [], []
    for i, j in combinations(range(len(cameras)), 2):
        pair = CameraPair(cameras[i], cameras[j])
        first, second = pixels[order[i]], pixels[order[j]]
        found = np.isfinite(first).all(axis=-1) & np.isfinite(second).all(axis=-1)
        errors.append(pair.epipolar_errors(first[found], second[found]))
        in_front.append(pair.in_front(first[found], second[found]))
    every = np.concatenate(errors)
    if not every.size:
        return OrderFit(order, np.inf, 0.0)
    return OrderFit(order, float(np.median(every)), float(np.mean(np.concatenate(in_front))))


def better_order(cameras: Sequence[Camera], pixels: FloatArray) -> OrderFit | None:
    """Return the order of images that fits the calibration clearly better than the recorded one, or None.

    The criterion is the epipolar error or, where it is ambiguous (parallel cameras: both orders have the
    same epipolar lines), whether points lie in front of the cameras. All C! orders are tested.

    Args:
        cameras: C cameras.
        pixels: (C, K, 2) distorted pixels of the same K points, detected independently in each image; NaN
            where a point was not detected.
    """
    as_recorded, *others = [order_fit(cameras, pixels, order) for order in permutations(range(len(cameras)))]
    limit = as_recorded.error_px / CLEARLY_BETTER
    if as_recorded.is_possible and as_recorded.error_px <= EPIPOLAR_LIMIT_PX:
        return None
    if not as_recorded.is_possible:
        limit = max(limit, EPIPOLAR_LIMIT_PX)
    fitting = [fit for fit in others if fit.is_possible and fit.error_px <= limit]
    return min(fitting, key=lambda fit: fit.error_px, default=None)


def _homogeneous(pixels: FloatArray) -> FloatArray:
    return np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
