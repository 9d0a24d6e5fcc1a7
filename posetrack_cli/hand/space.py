"""What hand poses have beyond ``BodySpace``: their limits and their noise."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.anatomy import (
    ANGLE_LIMITS,
    ANGLE_NAMES,
    ANGLES,
    POSE_SIZE,
)
from posetrack_cli.hand.config import ComponentSettings
from posetrack_cli.results.layouts import Layout

_ABDUCTIONS = np.array(["abduction" in name for name in ANGLE_NAMES])


def inside_limits(poses: FloatArray) -> FloatArray:
    """The poses (N, 22) with their angles put back to the nearest joint limit."""
    out = poses.copy()
    np.clip(out[:, ANGLES], ANGLE_LIMITS[:, 0], ANGLE_LIMITS[:, 1], out=out[:, ANGLES])
    return out


def tangent_vector(components: ComponentSettings) -> FloatArray:
    """One number per kind of component as a tangent vector (21,)."""
    angles = np.where(_ABDUCTIONS, components.abduction_rad, components.flexion_rad)
    return np.concatenate([np.full(3, components.position_mm), np.full(3, components.rotation_rad), angles])


def pose_layout(*shape: int) -> Layout:
    """Return what an array (..., 22) of poses must be."""
    return Layout("float64", (*shape, POSE_SIZE), unit=(3, 7))
