"""The paper's synthetic motions: a random walk of the pose (A) and of pose and velocity (B).

Both stay within a region: joint limits, a box before the camera, a cone of orientations. Motions that would
leave are reflected. Angles and positions fold back at the border like light at a mirror; an orientation
beyond the cone folds back along its own rotation axis.
"""

from __future__ import annotations

from dataclasses import dataclass

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

_D = float(np.pi / 180.0)
_ABDUCTIONS = np.array([name.endswith("abduction") for name in ANGLE_NAMES])

START_Z_MM = 650.0
PALM_CENTRE_MM = 55.0
"""How far the middle of an average palm lies above the wrist, mm."""


@dataclass(frozen=True)
class Densities:
    """Square roots of the diagonal of a noise density Q, in the tangent space.

    Attributes:
        position: mm per unit.
        rotation: rad per unit.
        flexion, abduction: of the finger angles, rad per unit.
            The unit is sqrt(s) for Q^n and s sqrt(s) for Q^l.
    """

    position: float
    rotation: float
    flexion: float
    abduction: float

    def vector(self) -> FloatArray:
        """(21,) sqrt(diag Q)."""
        sd = np.empty(TANGENT_SIZE)
        sd[:3], sd[3:6] = self.position, self.rotation
        sd[TANGENT_ANGLES] = np.where(_ABDUCTIONS, self.abduction, self.flexion)
        return sd


@dataclass(frozen=True)
class WalkNoise:
    """The noise of eqs. (66) and (67). The paper prints no values; these are [ours].

    A moves per frame at 30 Hz by the median of real motion: 4 mm, 2.8 deg, MCP and PIP 2.5 deg. B
    reaches that after about three seconds, for its velocity starts at zero and is a random walk too.

    Attributes:
        walk: sqrt(Q^n) of motion A.
        pose: sqrt(Q^n) of motion B.
        velocity: sqrt(Q^l) of motion B.
    """

    walk: Densities = Densities(14.0, 10.0 * _D, 20.0 * _D, 6.0 * _D)
    pose: Densities = Densities(2.0, 1.5 * _D, 3.0 * _D, 1.0 * _D)
    velocity: Densities = Densities(70.0, 45.0 * _D, 70.0 * _D, 20.0 * _D)


def retracted(pose: FloatArray, tangent: FloatArray) -> FloatArray:
    """Return pose (+) tangent, (22,) and (21,): the rotation is turned in the body's frame."""
    moved = np.empty_like(pose)
    moved[:3] = pose[:3] + tangent[:3]
    moved[3:7] = rotations.canonical(rotations.multiply(pose[3:7], rotations.exponential(tangent[3:6])))
    moved[ANGLES] = pose[ANGLES] + tangent[TANGENT_ANGLES]
    return moved


def pose_walk(
    start: FloatArray, seconds: FloatArray, density: FloatArray, region: Region, rng: np.random.Generator
) -> FloatArray:
    """Motion A: x_t = x_{t-1} (+) w, w ~ N(0, dt Q^n), reflected at the region's border (66).

    Args:
        start: (22,) first pose.
        seconds: (T,) instants.
        density: (21,) sqrt(diag Q^n).
        region: where the hand may be.
        rng: draws 21 numbers a step.

    Returns:
        (T, 22) poses. A random walk has no velocity.
    """
    poses = np.empty((len(seconds), len(start)))
    poses[0] = start
    for t, dt in enumerate(np.diff(seconds), start=1):
        noise = np.sqrt(dt) * density * rng.standard_normal(TANGENT_SIZE)
        poses[t], _ = reflected(retracted(poses[t - 1], noise), np.zeros(TANGENT_SIZE), region)
    return poses


def velocity_walk(
    start: FloatArray,
    seconds: FloatArray,
    pose_density: FloatArray,
    velocity_density: FloatArray,
    region: Region,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Motion B: x^n_t = x^n_{t-1} (+) (dt x^l_{t-1} + w^n), x^l_t = x^l_{t-1} + w^l (67).

    At the region's border the pose is reflected and that component of the velocity reversed.

    Args:
        start: (22,) first pose; the first velocity is zero.
        seconds: (T,) instants.
        pose_density: (21,) sqrt(diag Q^n).
        velocity_density: (21,) sqrt(diag Q^l).
        region: where the hand may be.
        rng: draws 42 numbers a step.

    Returns:
        (T, 22) poses and (T, 21) velocities in the tangent space, per second.
    """
    poses, twists = np.empty((len(seconds), len(start))), np.zeros((len(seconds), TANGENT_SIZE))
    poses[0] = start
    for t, dt in enumerate(np.diff(seconds), start=1):
        pose_noise, velocity_noise = np.sqrt(dt) * rng.standard_normal((2, TANGENT_SIZE))
        moved = retracted(poses[t - 1], dt * twists[t - 1] + pose_density * pose_noise)
        twist = twists[t - 1] + velocity_density * velocity_noise
        poses[t], twists[t] = reflected(moved, twist, region)
    return poses, twists


def reflected(pose: FloatArray, twist: FloatArray, region: Region) -> tuple[FloatArray, FloatArray]:
    """Return pose and velocity, reflected where the pose had left the region."""
    pose, twist = pose.copy(), twist.copy()
    pose[:3], sign = folded(pose[:3], region.low, region.high)
    twist[:3] *= sign
    pose[3:7], axis = folded_rotation(pose[3:7], region.cone)
    if axis is not None:
        outwards = max(0.0, float(axis @ twist[3:6]))
        twist[3:6] -= 2.0 * outwards * axis
    pose[ANGLES], sign = folded(pose[ANGLES], *region.angle_limits.T)
    twist[TANGENT_ANGLES] *= sign
    return pose, twist


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
