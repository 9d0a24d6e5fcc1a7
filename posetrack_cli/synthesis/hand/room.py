"""The room behind the hand: wall, ceiling, floor and furniture, as one depth image that does not change."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.geometry.camera import Camera

# Normals n and offsets c of planes n . p = c, mm: a wall slightly tilted, ceiling, floor.
PLANES = (
    (np.array([0.05, 0.03, 1.0]), 2750.0),
    (np.array([0.0, 1.0, 0.06]), -1050.0),
    (np.array([0.0, 1.0, 0.0]), 1250.0),
)
# Corners of furniture, mm: a cabinet on the left, a seat on the right.
BOXES = (
    (np.array([-1600.0, 250.0, 2150.0]), np.array([-850.0, 1250.0, 2600.0])),
    (np.array([650.0, 560.0, 2000.0]), np.array([1500.0, 1250.0, 2600.0])),
)


def room_depth(camera: Camera) -> Float32Array:
    """Return the depth z of the room, (height, width), mm: the nearest of all planes and boxes."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([u, v], axis=-1).astype(np.float64)
    rays = camera.points_from_pixels(pixels, np.ones(u.shape))
    depths = [_plane_depth(rays, *plane) for plane in PLANES] + [_box_depth(rays, *box) for box in BOXES]
    return np.asarray(np.min(depths, axis=0), dtype=np.float32)


def _plane_depth(rays: FloatArray, normal: FloatArray, offset: float) -> FloatArray:
    """Depth of a plane along rays (..., 3) with z = 1, infinite where it is not met."""
    slope = rays @ normal
    safe = np.where(slope == 0.0, 1.0, slope)
    depth = np.where(slope == 0.0, np.inf, offset / safe)
    return np.where(depth > 0.0, depth, np.inf)


def _box_depth(rays: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Depth of a box along rays with z = 1 by the slab method, infinite where it is missed."""
    with np.errstate(divide="ignore"):
        first, second = low / rays, high / rays
    enters = np.minimum(first, second).max(axis=-1)
    leaves = np.maximum(first, second).min(axis=-1)
    return np.where((enters <= leaves) & (enters > 0.0), enters, np.inf)
