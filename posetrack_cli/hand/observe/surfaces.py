"""Surfaces in a depth image: connected readings without a depth jump between neighbours."""

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
"""Neighbours belong to two surfaces if their depths differ by more than this slope and noise."""
_FAR_MM = np.float32(1e9)
_ACROSS_PX = 5
"""Width of the search for a nearer surface, so that a few missing pixels are bridged."""


def points_of(depth: Float32Array, window: Window, camera: Camera) -> Float32Array:
    """Return the points (h, w, 3) of a window's pixels, camera axes, mm; (0, 0, 0) without a reading."""
    across = ((window.columns() - camera.cx) / camera.fx).astype(np.float32)
    down = ((window.rows() - camera.cy) / camera.fy).astype(np.float32)
    points = np.empty((*depth.shape, 3), dtype=np.float32)
    np.multiply(depth, across, out=points[..., 0])
    np.multiply(depth, down[:, None], out=points[..., 1])
    points[..., 2] = depth
    return points


def along(points: Float32Array, origin: FloatArray, direction: FloatArray) -> Float32Array:
    """Return the coordinate (h, w) of points (h, w, 3) along a unit vector from an origin, mm."""
    x, y, z = direction.astype(np.float32)
    distance: Float32Array = x * points[..., 0]
    distance += y * points[..., 1]
    distance += z * points[..., 2]
    distance -= np.float32(origin @ direction)
    return distance


def pixel_mm(z: float | FloatArray | Float32Array, window: Window, camera: Camera) -> FloatArray:
    """Return the distance of neighbouring pixels on a surface facing the camera at depth z, mm."""
    per_mm = window.step / float(np.sqrt(camera.fx * camera.fy))
    return np.multiply(z, per_mm, dtype=np.float64)


def jump_mm(apart: Float32Array) -> Float32Array:
    """Return the depth step between two surfaces, mm: above noise, and above a slope between neighbours."""
    return np.asarray(_NOISE_MM + _STEEPEST * apart, dtype=np.float32)


def without_pinholes(depth: Float32Array, jump: Float32Array | float) -> Float32Array:
    """Fill single missing readings inside one surface."""
    farthest = cv2.dilate(depth, _BESIDE)
    nearest = nearest_around(depth, 3)
    bridged = (depth <= 0) & (farthest > 0) & (farthest - nearest < jump)
    return np.where(bridged, farthest, depth)


def links(depth: Float32Array, jump: Float32Array | float) -> tuple[BoolArray, BoolArray]:
    """Return which neighbours belong to one surface: both read, with a depth difference below a jump.

    Args:
        depth: (h, w) mm, 0 = no reading.
        jump: mm, a scalar or (h, w).

    Returns:
        (h, w - 1) of pixels and their right neighbours, (h - 1, w) of pixels and those below.
    """
    read = depth > 0
    jumps = np.broadcast_to(jump, depth.shape)
    right = read[:, :-1] & read[:, 1:] & (np.abs(np.diff(depth, axis=1)) < jumps[:, :-1])
    below = read[:-1] & read[1:] & (np.abs(np.diff(depth, axis=0)) < jumps[:-1])
    return right, below


def surface_labels(depth: Float32Array, jump: Float32Array | float) -> tuple[int, ImageArray]:
    """Label the surfaces of a depth image.

    Args:
        depth: (h, w) mm, 0 = no reading.
        jump: depth difference between surfaces, mm, a scalar or (h, w).

    Returns:
        The number of labels, and (h, w) int32 labels; 0 without a reading.
    """
    right, below = links(depth, jump)
    # OpenCV connects all neighbours in a mask, so links become pixels of a grid twice as fine
    height, width = depth.shape
    fine = np.zeros((2 * height - 1, 2 * width - 1), dtype=np.uint8)
    fine[::2, ::2] = depth > 0
    fine[::2, 1::2] = right
    fine[1::2, ::2] = below
    count, labels = cv2.connectedComponents(fine, connectivity=4, ltype=cv2.CV_32S)
    return count, labels[::2, ::2]


def rims(depth: Float32Array, jump: Float32Array | float) -> BoolArray:
    """Return the mask (h, w) of readings with a neighbour of another surface or without a reading."""
    right, below = links(depth, jump)
    rim = np.zeros(depth.shape, dtype=np.bool_)
    rim[:, :-1] |= ~right
    rim[:, 1:] |= ~right
    rim[:-1] |= ~below
    rim[1:] |= ~below
    return rim & (depth > 0)


def nearest_around(depth: Float32Array, size: int) -> Float32Array:
    """Return the nearest reading (h, w) in a square around each pixel; a large depth without one."""
    read = np.where(depth > 0, depth, _FAR_MM)
    return np.asarray(cv2.erode(read, np.ones((size, size), np.uint8)), dtype=np.float32)


def behind_others(depth: Float32Array, step: Float32Array) -> BoolArray:
    """Return the mask (h, w) of readings behind a neighbour by more than a step (h, w), mm."""
    behind: BoolArray = nearest_around(depth, _ACROSS_PX) < depth - step
    return behind


def extent_mm(points: FloatArray, pixel_mm: float) -> float:
    """Return the largest extent of pixels' points (P, 3), along their principal axis.

    It includes half a pixel, ``pixel_mm``, at both ends, so it does not depend on direction and resolution.
    """
    offset = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(offset.T @ offset)
    return float(np.ptp(offset @ axes[:, -1])) + pixel_mm


@dataclass(frozen=True, eq=False)
class View:
    """A window with its points.

    Attributes:
        window: its pixels.
        camera: its camera.
        depth: (h, w) readings, mm, 0 = none.
        points: (h, w, 3) mm, camera axes.
        apart: (h, w) distance of neighbouring pixels on a surface facing the camera, mm.
    """

    window: Window
    camera: Camera
    depth: Float32Array
    points: Float32Array
    apart: Float32Array

    @classmethod
    def of(cls, depth: Float32Array, window: Window, camera: Camera) -> View:
        """Return the view of a window's readings (h, w), mm."""
        apart = pixel_mm(depth, window, camera).astype(np.float32)
        return cls(window, camera, depth, points_of(depth, window, camera), apart)
