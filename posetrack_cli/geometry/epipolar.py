"""Epipolar geometry of two cameras, and what it tells about images in the wrong order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import normalised_from_pixels, undistorted_pixels
from posetrack_cli.geometry.rigid import composed, inverse

CLEARLY_BETTER = 3.0
"""Exchanged images fit clearly better if their epipolar error is so many times smaller."""
EPIPOLAR_LIMIT_PX = 2.0
"""What careless clicks and a fair calibration stay below: smaller errors are no reason to doubt an order."""


@dataclass(frozen=True)
class CameraPair:
    """Two calibrated cameras.

    Attributes:
        first, second: with their places.
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

        E = [t]x R between them is the same for normalised coordinates: p2^T E p1 = 0.
        """
        rotation, (x, y, z) = self.transform
        essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ rotation
        inverses = np.linalg.inv(self.second.matrix).T, np.linalg.inv(self.first.matrix)
        matrix: FloatArray = inverses[0] @ essential @ inverses[1]
        return matrix

    def epipolar_errors(self, pixels: FloatArray, others: FloatArray) -> FloatArray:
        """Return Sampson's distances (...) of distorted pixels (..., 2) in the first and the second image."""
        flat = undistorted_pixels(self.first, pixels), undistorted_pixels(self.second, others)
        return sampson_distance(self.fundamental, *flat)

    def in_front(self, pixels: FloatArray, others: FloatArray) -> BoolArray:
        """Return whether the rays of pixels (..., 2) in both images come nearest in front of both cameras.

        The depths z1, z2 minimise |R z1 r1 + t - z2 r2|^2.
        """
        rotation, t = self.transform
        one = _homogeneous(normalised_from_pixels(self.first, pixels)) @ rotation.T
        two = _homogeneous(normalised_from_pixels(self.second, others))
        aa, bb, ab = np.sum(one * one, -1), np.sum(two * two, -1), np.sum(one * two, -1)
        at, bt = one @ t, two @ t
        determinant = aa * bb - ab * ab  # never negative; signs suffice
        in_front: BoolArray = (ab * bt - bb * at > 0.0) & (aa * bt - ab * at > 0.0) & (determinant > 0.0)
        return in_front


def sampson_distance(fundamental: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Return Sampson's distance, pixels: to first order, how far the four coordinates are from a true pair.

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
    """How well points found in every image fit the calibration when the images are dealt out in some order.

    Attributes:
        order: which image each camera gets; (0, 1, ...) is as recorded.
        error_px: median Sampson distance over points and pairs of cameras, pixels.
        in_front: fraction of points and pairs that meet in front of both cameras.
    """

    order: tuple[int, ...]
    error_px: float
    in_front: float

    @property
    def is_possible(self) -> bool:
        """Whether most points lie in front of the cameras."""
        return self.in_front > 0.5


def order_fit(cameras: Sequence[Camera], pixels: FloatArray, order: tuple[int, ...]) -> OrderFit:
    """Return how points (C, K, 2), NaN where not found, fit if camera c sees image ``order[c]``."""
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
    """Return the order of images that fits the calibration clearly better than the one recorded, if any does.

    The epipolar error tells, or where it cannot (parallel cameras: both orders lie on the same lines) the
    side on which the points would be. The search is over all C! orders.

    Args:
        cameras: C of them.
        pixels: (C, K, 2) distorted pixels of the same K points, found in each image independently; NaN where
            a point was not found.
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
