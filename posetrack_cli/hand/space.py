"""What hand poses have beyond ``BodySpace``: limits, motion and its noise, and sums of quaternions."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.filters import FILTERS
from posetrack_cli.filtering.model import Dynamics
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.anatomy import (
    ANGLE_LIMITS,
    ANGLE_NAMES,
    ANGLES,
    POSE_SIZE,
)
from posetrack_cli.hand.config import ComponentSettings, FilterSettings, HandConfig
from posetrack_cli.results.layouts import Layout
from posetrack_cli.tracking.body_space import BodySpace

_ABDUCTIONS = np.array(["abduction" in name for name in ANGLE_NAMES])


def inside_limits(poses: FloatArray) -> FloatArray:
    """The poses (N, 22) with their angles put back to the nearest joint limit."""
    out = poses.copy()
    np.clip(out[:, ANGLES], ANGLE_LIMITS[:, 0], ANGLE_LIMITS[:, 1], out=out[:, ANGLES])
    return out


class AdditiveSpace(BodySpace):
    """Poses whose quaternions add like all other numbers, as the hand paper prints (44), (58) and (62).

    q becomes q + q (w, 0) / 2, its sum with its rate for a rotation vector w, scaled to length 1 again, as
    other quaternions are no rotations. Noise along q itself, which scaling removes, is left out.
    Tangent vectors equal those of ``BodySpace`` to first order.
    """

    def retract(self, x: FloatArray, delta: FloatArray) -> FloatArray:
        """Return x (+) delta: all numbers add, quaternions are scaled to length 1 with w >= 0."""
        half = np.concatenate([0.5 * delta[:, 3:6], np.ones((len(delta), 1))], axis=1)
        out = np.array(x, dtype=np.float64)
        out[:, :3] += delta[:, :3]
        out[:, 3:7] = rotations.canonical(rotations.multiply(x[:, 3:7], half))
        out[:, 7:] += delta[:, 6:]
        return out

    def local(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return y (-) x (..., 6 + K), so that x (+) (y (-) x) is y; half a turn apart it is endless."""
        q = rotations.multiply(rotations.conjugate(x[..., 3:7]), y[..., 3:7])
        w = np.where(np.abs(q[..., 3:]) < LEAST_COSINE, np.copysign(LEAST_COSINE, q[..., 3:]), q[..., 3:])
        return np.concatenate(
            [y[..., :3] - x[..., :3], 2.0 * q[..., :3] / w, y[..., 7:] - x[..., 7:]], axis=-1
        )

    def mean(self, x: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the weighted mean (7 + K,), (62), its quaternion scaled to length 1."""
        out: FloatArray = weights @ x
        out[3:7] = rotations.canonical(out[3:7])
        return out

    def log_volume(self, delta: FloatArray) -> FloatArray:
        """Return log of (1 + |w / 2|^2)^-2 (...): what the sum does to the volume of rotations."""
        squares = 0.25 * np.einsum("...i,...i->...", delta[..., 3:6], delta[..., 3:6])
        log_volume: FloatArray = -2.0 * np.log1p(squares)
        return log_volume


LEAST_COSINE = 1e-9
"""Of half the angle between two rotations: nearer half a turn their tangent vector stays finite."""


def space_of(settings: FilterSettings) -> BodySpace:
    """Return the space that a filter's poses move in."""
    return AdditiveSpace() if settings.rotations == "additive" else BodySpace()


def tangent_vector(components: ComponentSettings) -> FloatArray:
    """One number per kind of component as a tangent vector (21,)."""
    angles = np.where(_ABDUCTIONS, components.abduction_rad, components.flexion_rad)
    return np.concatenate([np.full(3, components.position_mm), np.full(3, components.rotation_rad), angles])


def pose_layout(*shape: int) -> Layout:
    """Return what an array (..., 22) of poses must be."""
    return Layout("float64", (*shape, POSE_SIZE), unit=(3, 7))


def dynamics(config: HandConfig) -> Dynamics:
    """The motion model of eq. (44) with the configuration's noise densities."""
    settings = config.motion
    pose = settings.pose if FILTERS.find(config.filter.kind).has_velocity else settings.pose_alone
    return Dynamics(
        pose_noise=tangent_vector(pose) ** 2,
        velocity_noise=tangent_vector(settings.velocity) ** 2,
        discretisation=config.filter.discretisation,
        constrain=inside_limits if config.filter.joint_limits else None,
        gain=config.filter.gain,
    )
