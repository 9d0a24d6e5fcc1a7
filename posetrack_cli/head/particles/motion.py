"""How a head moves between two frames: constant velocity, and adaptive diffusion (thesis, 3.3.1).

    s_t = s_{t-1} + tau v_{t-1} + omega                                                           (3.26)
    sd(omega) = max(floor, gain |v| tau0) sqrt(tau / tau0),    tau0 = 1/30 s

The thesis has the diffusion grow with the velocity (Oka et al. 2005) and gives no constants; floor and gain
are ours, and so is that noise is a density: one step of 2 tau spreads as two of tau do **[ours]**.
"""

from __future__ import annotations

import math

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.errors import check_time_step
from posetrack_cli.head.config import ParticleSettings
from posetrack_cli.head.face.pose import HeadPose

FRAME_S = 1.0 / 30.0
"""tau0, the thesis's time between frames, that floors and gain belong to."""


def predicted_pose(pose: HeadPose, velocity: FloatArray, dt: float, settings: ParticleSettings) -> HeadPose:
    """Return the pose after dt seconds of constant velocity (6,), mm/s and rad/s, camera axes.

    Raises:
        FilterError: dt is not > 0.
    """
    return pose.moved(_limited(velocity, settings) * _predicted_time(dt, settings))


def velocity_between(before: HeadPose, after: HeadPose, dt: float) -> FloatArray:
    """Return v = (x_t - x_{t-1}) / tau, (6,), mm/s and rad/s in camera axes; (3.31).

    Raises:
        FilterError: dt is not > 0.
    """
    check_time_step(dt)
    return before.difference(after) / dt


def pose_diffusion(velocity: FloatArray, dt: float, settings: ParticleSettings) -> FloatArray:
    """Return the standard deviations (6,) of omega's pose part, mm and rad.

    Args:
        velocity: (6,) per second, camera axes.
        dt: s.
        settings: floors and gain.

    Raises:
        FilterError: dt is not > 0.
    """
    floor = np.array([*settings.floor_mm, *settings.floor_rad])
    frame: FloatArray = np.maximum(floor, settings.gain * FRAME_S * np.abs(_limited(velocity, settings)))
    return frame * math.sqrt(_predicted_time(dt, settings) / FRAME_S)


def deformation_diffusion(deviations: FloatArray, dt: float, settings: ParticleSettings) -> FloatArray:
    """Return kappa mu (B,), mm, of deviations mu (B,), for a step of dt seconds.

    Raises:
        FilterError: dt is not > 0.
    """
    frames = _predicted_time(dt, settings) / FRAME_S
    return settings.kappa * math.sqrt(frames) * deviations


def _limited(velocity: FloatArray, settings: ParticleSettings) -> FloatArray:
    """Return the velocity (6,), its components no larger than those of any head **[ours]**."""
    limits = np.repeat([settings.speed_mm_s, settings.speed_rad_s], 3)
    return np.clip(velocity, -limits, limits)


def _predicted_time(dt: float, settings: ParticleSettings) -> float:
    check_time_step(dt)
    return min(dt, settings.gap_max_s)
