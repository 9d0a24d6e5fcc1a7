"""The space that hand poses live in: R^3 x SO(3) x R^15, its limits and its noise."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.anatomy import (
    ANGLE_LIMITS,
    ANGLE_NAMES,
    ANGLES,
    POSE_SIZE,
    TANGENT_ANGLES,
    TANGENT_SIZE,
)
from posetrack_cli.hand.config import ComponentSettings
from posetrack_cli.results.layouts import Layout

_ABDUCTIONS = np.array(["abduction" in name for name in ANGLE_NAMES])


class HandSpace:
    """Poses (N, 22) with tangent vectors (N, 21); rotations move in the body frame (hand.md, "State")."""

    def retract(self, x: FloatArray, delta: FloatArray) -> FloatArray:
        """Return x (+) delta: position and angles add, q becomes q exp(delta), unit and w >= 0."""
        out = np.empty_like(x)
        out[:, :3] = x[:, :3] + delta[:, :3]
        turned = rotations.multiply(x[:, 3:7], rotations.exponential(delta[:, 3:6]))
        out[:, 3:7] = rotations.canonical(turned)
        out[:, ANGLES] = x[:, ANGLES] + delta[:, TANGENT_ANGLES]
        return out

    def local(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return y (-) x (..., 21), the tangent vectors that take x (..., 22) to y."""
        out = np.empty((*np.broadcast_shapes(x.shape[:-1], y.shape[:-1]), TANGENT_SIZE))
        np.subtract(y[..., :3], x[..., :3], out=out[..., :3])
        between = rotations.multiply(rotations.conjugate(x[..., 3:7]), y[..., 3:7])
        out[..., 3:6] = rotations.logarithm(between)
        np.subtract(y[..., ANGLES], x[..., ANGLES], out=out[..., TANGENT_ANGLES])
        return out

    def mean(self, x: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the weighted mean (22,); rotations by Markley et al. 2007."""
        out = weights @ x
        out[3:7] = rotations.mean_quaternion(x[:, 3:7], weights)
        return out

    def log_volume(self, delta: FloatArray) -> FloatArray:
        """Return log of (sin(a/2) / (a/2))^2 (...), a the angle turned: what exp does to volume."""
        half_turns = np.sqrt(np.einsum("...i,...i->...", delta[..., 3:6], delta[..., 3:6])) / (2.0 * np.pi)
        log_volume: FloatArray = 2.0 * np.log(np.sinc(half_turns))
        return log_volume


def pose_rates(pose: FloatArray, twist: FloatArray) -> FloatArray:
    """Time derivative (22,) of a pose (22,) that moves with a tangent velocity (21,)."""
    rotation = rotations.quaternion_rate(pose[3:7], twist[3:6])
    return np.concatenate([twist[:3], rotation, twist[6:]])


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
