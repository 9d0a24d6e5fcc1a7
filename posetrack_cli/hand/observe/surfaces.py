"""Surfaces in a depth image: neighbouring readings without a jump of depth between them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.port import Window

_BESIDE = np.ones((3, 3), np.uint8)
_NOISE_MM = 6.0
_STEEPEST = 3.0
"""Neighbours parted by more depth than so many pixel distances, and noise, are of two surfaces."""
_FAR_MM = np.float32(1e9)
_ACROSS_PX = 5
"""About how many missing pixels part a surface from one behind it."""


def points_of(depth: Float32Array, window: Window, camera: Camera) -> Float32Array:
    """The points (h, w, 3) that the pixels of a window show, camera axes, mm; (0, 0, 0) without a reading."""
    across = ((window.columns() - camera.cx) / camera.fx).astype(np.float32)
    down = ((window.rows() - camera.cy) / camera.fy).astype(np.float32)
    points = np.empty((*depth.shape, 3), dtype=np.float32)
    np.multiply(depth, across, out=points[..., 0])
    np.multiply(depth, down[:, None], out=points[..., 1])
    points[..., 2] = depth
    return points


def along(points: Float32Array, origin: FloatArray, direction: FloatArray) -> Float32Array:
    """How far points (h, w, 3) lie from an origin along a unit vector, mm (h, w)."""
    x, y, z = direction.astype(np.float32)
    distance: Float32Array = x * points[..., 0]
    distance += y * points[..., 1]
    distance += z * points[..., 2]
    distance -= np.float32(origin @ direction)
    return distance


def pixel_mm(z: float | FloatArray | Float32Array, window: Window, camera: Camera) -> FloatArray:
    """The distance of neighbouring pixels of a window on a surface that faces the camera at depth z, mm."""
    per_mm = window.step / float(np.sqrt(camera.fx * camera.fy))
    return np.multiply(z, per_mm, dtype=np.float64)


def jump_mm(apart: Float32Array) -> Float32Array:
    """The step in depth that parts surfaces, mm: more than noise, and than a slope over that distance."""
    return np.asarray(_NOISE_MM + _STEEPEST * apart, dtype=np.float32)


def without_pinholes(depth: Float32Array, jump: Float32Array | float) -> Float32Array:
    """Depth with single missing readings bridged where the readings around them are of one surface."""
    farthest = cv2.dilate(depth, _BESIDE)
    nearest = nearest_around(depth, 3)
    bridged = (depth <= 0) & (farthest > 0) & (farthest - nearest < jump)
    return np.where(bridged, farthest, depth)


def links(depth: Float32Array, jump: Float32Array | float) -> tuple[BoolArray, BoolArray]:
    """Which neighbours are of one surface: both read, and their depths differ by less than a jump.

    Args:
        depth: (h, w) mm, 0 = no reading.
        jump: mm, one for all or (h, w).

    Returns:
        (h, w - 1) of pixels and their right neighbours, (h - 1, w) of pixels and those below.
    """
    read = depth > 0
    jumps = np.broadcast_to(jump, depth.shape)
    right = read[:, :-1] & read[:, 1:] & (np.abs(np.diff(depth, axis=1)) < jumps[:, :-1])
    below = read[:-1] & read[1:] & (np.abs(np.diff(depth, axis=0)) < jumps[:-1])
    return right, below


def surface_labels(depth: Float32Array, jump: Float32Array | float) -> tuple[int, ImageArray]:
    """Number the surfaces of a depth image.

    Args:
        depth: (h, w) mm, 0 = no reading.
        jump: neighbours whose depths differ by less are of one surface, mm, one for all or (h, w).

    Returns:
        How many numbers there are, and (h, w) int32: 0 without a reading, else the surface's number.
    """
    right, below = links(depth, jump)
    # OpenCV links all neighbours of a mask: in a grid twice as fine the links are pixels of their own.
    height, width = depth.shape
    fine = np.zeros((2 * height - 1, 2 * width - 1), dtype=np.uint8)
    fine[::2, ::2] = depth > 0
    fine[::2, 1::2] = right
    fine[1::2, ::2] = below
    count, labels = cv2.connectedComponents(fine, connectivity=4, ltype=cv2.CV_32S)
    return count, labels[::2, ::2]


def rims(depth: Float32Array, jump: Float32Array | float) -> BoolArray:
    """(h, w) which readings have a neighbour that is not of their surface, or no reading beside them."""
    right, below = links(depth, jump)
    rim = np.zeros(depth.shape, dtype=np.bool_)
    rim[:, :-1] |= ~right
    rim[:, 1:] |= ~right
    rim[:-1] |= ~below
    rim[1:] |= ~below
    return rim & (depth > 0)


def nearest_around(depth: Float32Array, size: int) -> Float32Array:
    """The nearest reading (h, w) in a square around each pixel; far away where there is none."""
    read = np.where(depth > 0, depth, _FAR_MM)
    return np.asarray(cv2.erode(read, np.ones((size, size), np.uint8)), dtype=np.float32)


def behind_others(depth: Float32Array, step: Float32Array) -> BoolArray:
    """Return which readings (h, w) have one beside them that is nearer by more than a step (h, w), mm."""
    behind: BoolArray = nearest_around(depth, _ACROSS_PX) < depth - step
    return behind


def extent_mm(points: FloatArray, pixel_mm: float) -> float:
    """Return the largest extent of pixels' points (P, 3), along the axis of their largest variance.

    It is the same whatever the direction in the image, and the size of the pixels, which reach half of
    ``pixel_mm`` beyond their middles.
    """
    offset = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(offset.T @ offset)
    return float(np.ptp(offset @ axes[:, -1])) + pixel_mm


@dataclass(frozen=True, eq=False)
class View:
    """What a window shows.

    Attributes:
        window: which pixels.
        camera: whose.
        depth: (h, w) readings, mm, 0 = none.
        points: (h, w, 3) mm, camera axes.
        apart: (h, w) distance of neighbouring pixels that face the camera, mm.
    """

    window: Window
    camera: Camera
    depth: Float32Array
    points: Float32Array
    apart: Float32Array

    @classmethod
    def of(cls, depth: Float32Array, window: Window, camera: Camera) -> View:
        """A window of a camera with its readings (h, w), mm."""
        apart = pixel_mm(depth, window, camera).astype(np.float32)
        return cls(window, camera, depth, points_of(depth, window, camera), apart)
