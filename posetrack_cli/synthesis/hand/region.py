"""Where a synthetic hand may be: joint limits, a box before the camera, a cone of orientations.

Motions that would leave are reflected. Angles and positions fold back at the border like light at a
mirror; an orientation beyond the cone folds back along its own rotation axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.anatomy import ANGLE_LIMITS, POSE_SIZE

START_Z_MM = 650.0
PALM_CENTRE_MM = 55.0
"""How far the middle of an average palm lies above the wrist, mm."""


@dataclass(frozen=True)
class Region:
    """Limits of a right hand's pose.

    Attributes:
        low, high: (3,) corners of the box of wrist positions, mm.
        cone: largest angle of the rotation from the rest orientation, rad.
        margin: how far the finger angles stay inside the joint limits, rad.
    """

    low: FloatArray
    high: FloatArray
    cone: float
    margin: float = 1e-9

    @property
    def angle_limits(self) -> FloatArray:
        """(15, 2) limits of the finger angles, rad."""
        limits: FloatArray = ANGLE_LIMITS + np.array([self.margin, -self.margin])
        return limits


def start_pose(scale: float) -> FloatArray:
    """Return the (22,) pose with the palm's middle on the principal axis, towards the sensor, straight."""
    pose = np.zeros(POSE_SIZE)
    pose[:3] = 0.0, PALM_CENTRE_MM * scale, START_Z_MM
    pose[6] = 1.0
    return pose


def walk_region(scale: float) -> Region:
    """Return the limits of the random walks: a box of 180 x 180 x 290 mm and 70 degrees.

    An outstretched hand of any allowed scale stays inside a Kinect's image everywhere in it.
    """
    centre = start_pose(scale)[:2]
    low = np.array([centre[0] - 90.0, centre[1] - 90.0, 560.0])
    high = np.array([centre[0] + 90.0, centre[1] + 90.0, 850.0])
    return Region(low, high, np.deg2rad(70.0))


def folded(values: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Reflect values at both ends of an interval, as often as needed.

    Returns:
        The values inside [low, high], and 1 or -1 where the direction of motion is kept or reversed.
    """
    width = high - low
    phase = np.mod(values - low, 2.0 * width)
    back = phase > width
    inside = low + np.where(back, 2.0 * width - phase, phase)
    return np.clip(inside, low, high), np.where(back, -1.0, 1.0)  # clip: rounding may leave by an ulp


def folded_rotation(quaternion: FloatArray, cone: float) -> tuple[FloatArray, FloatArray | None]:
    """Reflect a rotation (4,) at the border of the cone.

    Returns:
        The quaternion inside, and the unit rotation axis (3,) if it was outside, else None. Along that
        axis, and only there, the angular velocity changes the angle: d|r|/dt = axis . omega.
    """
    vector = rotations.logarithm(quaternion)
    angle = float(np.linalg.norm(vector))
    if angle <= cone:
        return quaternion, None
    axis = vector / angle
    inside, _ = folded(np.array(angle), np.array(0.0), np.array(cone))
    return rotations.exponential(axis * inside), axis
