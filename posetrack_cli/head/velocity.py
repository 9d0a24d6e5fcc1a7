"""What the velocities of heads are estimated with."""

from __future__ import annotations

import numpy as np

from posetrack_cli.head.config import HeadVelocitySettings
from posetrack_cli.tracking.velocity import VelocityModel

START_SD = (200.0, 2.0)
"""Of a head's velocity where a track begins, mm/s and rad/s: as of a hand's."""


def velocity_model(settings: HeadVelocitySettings) -> VelocityModel:
    """Return the model of the six entries of a head's pose."""
    acceleration = settings.acceleration_mm, settings.acceleration_rad
    pose_sd = settings.pose_mm, settings.pose_rad
    return VelocityModel(*(np.repeat(numbers, 3) for numbers in (acceleration, pose_sd, START_SD)))
