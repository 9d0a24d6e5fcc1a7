"""The synthetic sensor: a Kinect v2's camera, range and noise of readings."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import Float32Array, ImageArray
from posetrack_cli.geometry.camera import Camera

CAMERA = Camera(width=512, height=424, fx=365.0, fy=365.0, cx=255.5, cy=211.5, name="camera")
"""A Kinect v2 with its principal point in the middle, so that a mirrored scene gives a mirrored image."""

RANGE_MM = (500.0, 4500.0)
"""Nearest and farthest reading."""

NEAR_SD_MM, SD_PER_M2 = 0.96, 0.086
CORNER_FACTOR = 2.5


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
