"""The synthetic sensor: a Kinect v2's camera, range, noise, and missing readings beside edges of depth.

Beside an edge, on the farther side, light of both surfaces mixes and the projector's is shaded, so the
reading is given up. What was measured is the missing fraction 1 to 8 px outside a hand's edge
(``MISSING_FRACTIONS``, hand.md). The fractions hold on average over all directions of an edge; where the
holes are is correlated: they come in patches, and more of them on the side where the projector casts its
shadow.
"""

from __future__ import annotations

import functools

import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera

CAMERA = Camera(width=512, height=424, fx=365.0, fy=365.0, cx=255.5, cy=211.5, name="camera")
"""A Kinect v2 with its principal point in the middle, so that a mirrored scene gives a mirrored image."""

RANGE_MM = (500.0, 4500.0)
"""Nearest and farthest reading."""

NEAR_SD_MM, SD_PER_M2 = 0.96, 0.086
CORNER_FACTOR = 2.5

MISSING_FRACTIONS = (0.82, 0.65, 0.37, 0.30, 0.24, 0.21, 0.18, 0.16)
REACH_PX = 12.0
"""[ours]: beyond the measured 8 px the fraction falls linearly, to none at this distance."""

JUMP_MM = 40.0
"""Smallest step of depth that is an edge."""

FULL_JUMP_MM = 200.0
"""[ours]: the measured edges were steps of 300 mm and more. Beside a smaller step than this the holes reach
less far: the distance counts FULL_JUMP_MM / step times. So fingers before the palm keep their rim."""

PATCH_PX = 2.5
SHADOW_SHARE = 0.55
"""Share of the variance that depends on the side of the edge; the rest is in patches."""
SHADOW_SIDE = -1.0
"""Sign of the image's x direction in which the projector's shadow falls: to the left."""


def noise_sd(depth: Float32Array, camera: Camera) -> Float32Array:
    """Return the standard deviation of the readings of a depth image (height, width), mm.

    sd(z, r) = (0.96 + 0.086 z^2) (1 + 1.5 r^2), z in metres, r the distance from the principal point
    relative to the farthest corner's. [ours], fitted to what was measured on a Kinect v2 (hand.md): 1.5 mm
    at the centre and 3 to 4.5 mm in the corners at 2.2 to 3 m. At 0.65 m it is 1 mm.
    """
    metres = depth * np.float32(1e-3)
    near = np.float32(NEAR_SD_MM) + np.float32(SD_PER_M2) * metres * metres
    sd: Float32Array = near * _radial_factor(camera)
    return sd


def noisy(depth: Float32Array, camera: Camera, rng: np.random.Generator) -> Float32Array:
    """Return the readings (height, width) of a depth image: noise added, out of range missing, mm.

    Args:
        depth: mm, 0 where there is nothing.
        camera: whose image it is.
        rng: draws one number a pixel.
    """
    noise = rng.standard_normal(depth.shape, dtype=np.float32)
    readings = depth + noise * noise_sd(depth, camera)
    low, high = RANGE_MM
    readings[(depth < low) | (readings < low) | (readings > high)] = 0.0
    return readings


def quantised(depth: Float32Array) -> ImageArray:
    """Return the depth as the sensor stores it: (height, width) uint16, whole millimetres."""
    return np.rint(depth).astype(np.uint16)


def _radial_factor(camera: Camera) -> Float32Array:
    x = np.arange(camera.width) - camera.cx
    y = np.arange(camera.height) - camera.cy
    corner = np.max(np.abs(x)) ** 2 + np.max(np.abs(y)) ** 2
    r2 = (x[None, :] ** 2 + y[:, None] ** 2) / corner
    return np.asarray(1.0 + (CORNER_FACTOR - 1.0) * r2, dtype=np.float32)


def missing_beside_edges(
    depth: Float32Array, rng: np.random.Generator, *, mirrored: bool = False
) -> BoolArray:
    """Return which readings (height, width) of a depth image are missing beside its edges.

    A pixel at distance x from the nearest edge is missing where U < f(x): f interpolates the measured
    fractions and U is uniform, U = F(g), with g = a sqrt(2) s cos(direction) + sqrt(1 - a^2) n, n a smooth
    Gaussian field of patches, the direction that from the edge to the pixel and F the distribution of g
    over all directions.

    Args:
        depth: mm, 0 where there is nothing.
        rng: draws one number a pixel.
        mirrored: whether the sensor's projector is on the other side.
    """
    patches = _patches(depth.shape, rng)
    rows, columns, distance, cosine = _band(depth)
    side = -SHADOW_SIDE if mirrored else SHADOW_SIDE
    field = np.sqrt(1.0 - SHADOW_SHARE) * patches[rows, columns] + (
        np.sqrt(2.0 * SHADOW_SHARE) * side * cosine
    )
    missing = np.zeros(depth.shape, dtype=np.bool_)
    missing[rows, columns] = _uniform_of(-field) < missing_fraction(distance)
    return missing


def missing_fraction(distance: FloatArray) -> FloatArray:
    """Return the fraction of missing readings at a distance from an edge, px; 1 is the first pixel."""
    count = len(MISSING_FRACTIONS)
    return np.interp(distance, [*range(1, count + 1), REACH_PX], [*MISSING_FRACTIONS, 0.0])


def _band(depth: Float32Array) -> tuple[ImageArray, ImageArray, FloatArray, FloatArray]:
    """The pixels on the farther side of edges, as far as holes may reach.

    Returns:
        (P,) rows, columns, distance from the nearest edge as far as it counts, px, and the cosine of the
        direction from that edge to the pixel with the image's x axis.
    """
    import cv2

    edge = _nearer_side(depth)
    if not edge.any():
        return np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros(0)
    distance, labels = cv2.distanceTransformWithLabels(
        (~edge).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero((distance > 0.0) & (distance < REACH_PX) & (depth > 0.0))
    edge_rows, edge_columns = np.nonzero(edge)
    pixel_of_label = np.zeros(len(edge_rows) + 1, dtype=np.int64)
    pixel_of_label[labels[edge_rows, edge_columns]] = np.arange(len(edge_rows))
    nearest = pixel_of_label[labels[rows, columns]]
    jump = depth[rows, columns] - depth[edge_rows[nearest], edge_columns[nearest]]
    offset_x, offset_y = columns - edge_columns[nearest], rows - edge_rows[nearest]
    far = jump > JUMP_MM
    pixels = np.hypot(offset_x, offset_y)
    counted = pixels * np.maximum(1.0, FULL_JUMP_MM / np.maximum(jump, JUMP_MM))
    return rows[far], columns[far], counted[far], (offset_x / pixels)[far]


def _nearer_side(depth: Float32Array) -> BoolArray:
    """The pixels (height, width) with a neighbour that is farther by a jump."""
    edge = np.zeros(depth.shape, dtype=np.bool_)
    across, down = np.diff(depth, axis=1), np.diff(depth, axis=0)
    edge[:, :-1] |= across > JUMP_MM
    edge[:, 1:] |= across < -JUMP_MM
    edge[:-1] |= down > JUMP_MM
    edge[1:] |= down < -JUMP_MM
    return edge & (depth > 0.0)


def _patches(shape: tuple[int, ...], rng: np.random.Generator) -> Float32Array:
    """A Gaussian field of unit variance, smooth over some pixels."""
    import cv2

    size = 2 * round(3.0 * PATCH_PX) + 1
    kernel = cv2.getGaussianKernel(size, PATCH_PX)
    noise = rng.standard_normal(shape, dtype=np.float32)
    smooth = cv2.sepFilter2D(noise, cv2.CV_32F, kernel, kernel)
    unit: Float32Array = smooth / np.float32(np.sum(kernel**2))  # sd after both passes is sum k^2
    return unit


def _uniform_of(field: FloatArray) -> FloatArray:
    grid, probability = _distribution()
    return np.interp(field, grid, probability)


@functools.cache
def _distribution() -> tuple[FloatArray, FloatArray]:
    """F(g) of the field over all directions and patches, tabulated: F(g) = mean of Phi over the circle."""
    from scipy.special import ndtr

    grid = np.linspace(-6.0, 6.0, 601)
    cosines = np.cos((np.arange(64) + 0.5) * (2.0 * np.pi / 64))
    shift = np.sqrt(2.0 * SHADOW_SHARE) * cosines
    probability = ndtr((grid[:, None] - shift) / np.sqrt(1.0 - SHADOW_SHARE)).mean(axis=1)
    return grid, probability
