"""Hand motion: random walks of pose and velocity (A, B), natural motion (C)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.model.anatomy import (
    ANGLE_LIMITS,
    ANGLE_NAMES,
    ANGLES,
    POSE_SIZE,
    TANGENT_ANGLES,
    TANGENT_SIZE,
)
from posetrack_cli.hand.model.kinematics import mirrored_poses
from posetrack_cli.synthesis.hand.options import SynthOptions
from posetrack_cli.synthesis.hand.shapes import SHAPES, THUMB_ACROSS, coupled, minimum_jerk, varied

# Motion of a recording: poses, and velocities if defined

_MIRRORED_TWIST = np.r_[-1.0, 1.0, 1.0, 1.0, -1.0, -1.0, np.ones(15)]


@dataclass(frozen=True)
class Motion:
    """Motion of a hand.

    Attributes:
        poses: (T, 22).
        twists: (T, 21) velocities in the tangent space, per second; None for a walk without velocity.
    """

    poses: FloatArray
    twists: FloatArray | None

    def mirrored(self) -> Motion:
        """Return the motion of the other hand, mirrored by x -> -x.

        Rotation vectors are axial: the component along the mirror's normal is kept, the others change sign.
        """
        twists = None if self.twists is None else self.twists * _MIRRORED_TWIST
        return Motion(mirrored_poses(self.poses), twists)


def make_motion(
    options: SynthOptions, seconds: FloatArray, rng: np.random.Generator, noise: WalkNoise | None = None
) -> Motion:
    """Draw the motion at instants (T,) since the first frame.

    Args:
        options: motion, speed, side and scale are used.
        seconds: (T,) increasing, starting at 0.
        rng: random stream of the motion.
        noise: noise of the walks A and B.
    """
    motion = _right_motion(options, seconds, rng, noise or WalkNoise())
    return motion.mirrored() if options.side == "left" else motion


def _right_motion(
    options: SynthOptions, seconds: FloatArray, rng: np.random.Generator, noise: WalkNoise
) -> Motion:
    if options.motion == "C":
        times = options.speed * seconds
        script = natural_motion(float(times[-1]), options.scale, rng)
        return Motion(script.poses(times), options.speed * script.twists(times))
    start, region = _walk_start(options.scale), walk_region(options.scale)
    if options.motion == "A":
        density = options.speed * noise.walk.vector()
        return Motion(pose_walk(start, seconds, density, region, rng), None)
    densities = (options.speed * noise.pose.vector(), options.speed * noise.velocity.vector())
    return Motion(*velocity_walk(start, seconds, *densities, region, rng))


def _walk_start(scale: float) -> FloatArray:
    pose = start_pose(scale)
    pose[ANGLES] = SHAPES["open"]
    return pose


# The paper's synthetic motions: random walks of the pose (A) and of pose and velocity (B).
#
# Both are confined to a region: joint limits, a box in front of the camera, a cone of orientations. Angles
# and positions are reflected at its border, orientations along their rotation axis.

_D = float(np.pi / 180.0)
_ABDUCTIONS = np.array([name.endswith("abduction") for name in ANGLE_NAMES])

START_Z_MM = 650.0
PALM_CENTRE_MM = 55.0
"""Distance from the wrist to the centre of an average palm, mm."""


@dataclass(frozen=True)
class Densities:
    """Square roots of the diagonal of a noise density Q, in the tangent space.

    The unit of time is sqrt(s) for Q^n and s sqrt(s) for Q^l.

    Attributes:
        position: mm per unit.
        rotation: rad per unit.
        flexion, abduction: finger angles, rad per unit.
    """

    position: float
    rotation: float
    flexion: float
    abduction: float

    def vector(self) -> FloatArray:
        """Return sqrt(diag Q), (21,)."""
        sd = np.empty(TANGENT_SIZE)
        sd[:3], sd[3:6] = self.position, self.rotation
        sd[TANGENT_ANGLES] = np.where(_ABDUCTIONS, self.abduction, self.flexion)
        return sd


@dataclass(frozen=True)
class WalkNoise:
    """Noise of eqs. (66) and (67). The paper gives no values; these are [ours].

    At 30 Hz, A moves per frame by the median of real motion: 4 mm, 2.8 deg, MCP and PIP 2.5 deg. B reaches
    this after about three seconds, as its velocity starts at zero and is a random walk.

    Attributes:
        walk: sqrt(Q^n) of motion A.
        pose: sqrt(Q^n) of motion B.
        velocity: sqrt(Q^l) of motion B.
    """

    walk: Densities = Densities(14.0, 10.0 * _D, 20.0 * _D, 6.0 * _D)
    pose: Densities = Densities(2.0, 1.5 * _D, 3.0 * _D, 1.0 * _D)
    velocity: Densities = Densities(70.0, 45.0 * _D, 70.0 * _D, 20.0 * _D)


def retracted(pose: FloatArray, tangent: FloatArray) -> FloatArray:
    """Return pose (+) tangent, (22,) and (21,), with the rotation in the body frame."""
    moved = np.empty_like(pose)
    moved[:3] = pose[:3] + tangent[:3]
    moved[3:7] = rotations.canonical(rotations.multiply(pose[3:7], rotations.exponential(tangent[3:6])))
    moved[ANGLES] = pose[ANGLES] + tangent[TANGENT_ANGLES]
    return moved


def pose_walk(
    start: FloatArray, seconds: FloatArray, density: FloatArray, region: Region, rng: np.random.Generator
) -> FloatArray:
    """Return motion A: x_t = x_{t-1} (+) w, w ~ N(0, dt Q^n), reflected at the region's border (66).

    Args:
        start: (22,) first pose.
        seconds: (T,) instants.
        density: (21,) sqrt(diag Q^n).
        region: limits of the pose.
        rng: draws 21 numbers per step.

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
    """Return motion B: x^n_t = x^n_{t-1} (+) (dt x^l_{t-1} + w^n), x^l_t = x^l_{t-1} + w^l (67).

    At the region's border the pose is reflected and that component of the velocity reversed.

    Args:
        start: (22,) first pose; the first velocity is zero.
        seconds: (T,) instants.
        pose_density: (21,) sqrt(diag Q^n).
        velocity_density: (21,) sqrt(diag Q^l).
        region: limits of the pose.
        rng: draws 42 numbers per step.

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
    """Return pose and velocity, reflected where the pose has left the region."""
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
        cone: maximum rotation angle from the rest orientation, rad.
        margin: margin of the finger angles to the joint limits, rad.
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
    """Return the pose (22,) of a straight hand that faces the sensor, its palm on the principal axis."""
    pose = np.zeros(POSE_SIZE)
    pose[:3] = 0.0, PALM_CENTRE_MM * scale, START_Z_MM
    pose[6] = 1.0
    return pose


def walk_region(scale: float) -> Region:
    """Return the limits of the random walks: a box of 180 x 180 x 290 mm and 70 degrees.

    An outstretched hand of any allowed scale stays inside a Kinect's image within them.
    """
    centre = start_pose(scale)[:2]
    low = np.array([centre[0] - 90.0, centre[1] - 90.0, 560.0])
    high = np.array([centre[0] + 90.0, centre[1] + 90.0, 850.0])
    return Region(low, high, np.deg2rad(70.0))


def folded(values: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Reflect values at both ends of an interval, as often as needed.

    Returns:
        The values in [low, high], and 1 or -1 where the direction of motion is kept or reversed.
    """
    width = high - low
    phase = np.mod(values - low, 2.0 * width)
    back = phase > width
    inside = low + np.where(back, 2.0 * width - phase, phase)
    return np.clip(inside, low, high), np.where(back, -1.0, 1.0)  # clip removes rounding errors of an ulp


def folded_rotation(quaternion: FloatArray, cone: float) -> tuple[FloatArray, FloatArray | None]:
    """Reflect a rotation (4,) at the border of the cone.

    Returns:
        The quaternion inside, and the unit rotation axis (3,) if it was outside, else None. Only the
        angular velocity along that axis changes the angle: d|r|/dt = axis . omega.
    """
    vector = rotations.logarithm(quaternion)
    angle = float(np.linalg.norm(vector))
    if angle <= cone:
        return quaternion, None
    axis = vector / angle
    inside, _ = folded(np.array(angle), np.array(0.0), np.array(cone))
    return rotations.exponential(axis * inside), axis


# Natural motion (C): a random script of hand shapes, turns, sweeps and waves, continuous in time.
#
# Tracks connect their targets by minimum-jerk moves, so position, velocity and acceleration are continuous.
# The script gives the pose at any time.

Interval: TypeAlias = tuple[float, float]

_NATURAL_D = float(np.pi / 180.0)
FIRST_HOLD_S = 0.5
DIFFERENCE_S = 1e-5
"""Half step of the central difference, in script time.

A move of length a in time d has a jerk of at most 60 a / d^3, here 3e5 mm/s^3 and (with the couplings) 2e5
rad/s^3. The error, step^2 / 6 times the jerk, is below 1e-5 mm/s and 4e-6 rad/s; rounding adds less, 1e-13
/ step.
"""

BOX_MM = np.array([(-110.0, 110.0), (-65.0, 65.0), (-45.0, 120.0)])
"""Range of the wrist relative to its start, x, y, z."""

SHAPE_MOVE_S, SHAPE_HOLD_S = (0.25, 0.65), (0.0, 0.10)
TRAVEL_MM_S, TRAVEL_S, TRAVEL_HOLD_S = (80.0, 330.0), (0.25, 1.5), (0.0, 0.30)
TURN_RAD_S, TURN_S, TURN_HOLD_S = (70.0 * _NATURAL_D, 380.0 * _NATURAL_D), (0.20, 0.9), (0.0, 0.30)
WAVE_EVERY_S, WAVE_S, WAVE_HZ, WAVE_RAD = (
    (2.5, 7.0),
    (1.2, 2.4),
    (1.0, 2.0),
    (10.0 * _NATURAL_D, 22.0 * _NATURAL_D),
)
SWAY_MM, SWAY_RAD, FINGER_SWAY_RAD, SWAY_HZ = 2.5, 1.0 * _NATURAL_D, 2.0 * _NATURAL_D, (0.4, 1.2)

# Hand orientations: share, sd of pitch, yaw and roll, range of additional yaw (deg).
_TURNS = (
    (0.50, (7.0, 10.0, 9.0), (0.0, 0.0)),  # to the sensor
    (0.28, (8.0, 0.0, 8.0), (35.0, 65.0)),  # to the side
    (0.10, (6.0, 0.0, 6.0), (78.0, 92.0)),  # edge-on
    (0.12, (16.0, 12.0, 25.0), (0.0, 0.0)),  # tilted
)
_MOST_TURNED = _NATURAL_D * np.array([28.0, 95.0, 45.0])  # pitch, yaw, roll


@dataclass(frozen=True)
class Track:
    """Minimum-jerk moves between targets: x(t) = a_k + (a_{k+1} - a_k) s((t - t_k) / d_k).

    Attributes:
        starts: (K,) start of each move, s.
        durations: (K,) duration of each move, which ends before the next starts.
        targets: (K + 1, D) resting values before the first move and after each.
    """

    starts: FloatArray
    durations: FloatArray
    targets: FloatArray

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return values (T, D) at times (T,)."""
        move = np.clip(np.searchsorted(self.starts, times, side="right") - 1, 0, len(self.starts) - 1)
        s = minimum_jerk((times - self.starts[move]) / self.durations[move])
        before, after = self.targets[move], self.targets[move + 1]
        return before + s[:, None] * (after - before)


@dataclass(frozen=True)
class Wave:
    """Oscillation of the roll: a sine in a smooth window.

    Attributes:
        start, duration: s.
        frequency: Hz.
        amplitude: rad.
    """

    start: float
    duration: float
    frequency: float
    amplitude: float

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the additional roll at times (T,), rad."""
        since = times - self.start
        ramp = 0.3 * self.duration
        window = minimum_jerk(since / ramp) * minimum_jerk((self.duration - since) / ramp)
        return self.amplitude * window * np.sin(2.0 * np.pi * self.frequency * since)


@dataclass(frozen=True)
class NaturalMotion:
    """Script of natural motion of a right hand.

    Attributes:
        origin: (3,) first position of the wrist, mm.
        fingers: five tracks of three angles, thumb first, rad.
        position: track of the wrist's displacement, mm.
        turning: track of pitch, yaw, roll, rad.
        waves: oscillations of the roll.
        sway: (21, 3) amplitude, frequency (Hz) and phase of small sines added to position, turning and
            finger angles, as no hand is completely still.
    """

    origin: FloatArray
    fingers: tuple[Track, ...]
    position: Track
    turning: Track
    waves: tuple[Wave, ...]
    sway: FloatArray

    def poses(self, times: FloatArray) -> FloatArray:
        """Return poses (T, 22) at times (T,), s.

        The rotation is R_z(roll) R_x(pitch) R_y(yaw): yaw rotates the hand about its length, as the forearm
        does; pitch and roll are the wrist's.
        """
        poses = np.empty((len(times), POSE_SIZE))
        amplitude, frequency, phase = self.sway.T
        sway = amplitude * np.sin(2.0 * np.pi * frequency * times[:, None] + phase)
        poses[:, :3] = self.origin + self.position(times) + sway[:, :3]
        turning = self.turning(times) + sway[:, 3:6]
        turning[:, 2] += sum((wave(times) for wave in self.waves), start=np.zeros(len(times)))
        poses[:, 3:7] = _turned(turning)
        poses[:, ANGLES] = coupled(np.hstack([track(times) for track in self.fingers]) + sway[:, 6:])
        return poses

    def twists(self, times: FloatArray) -> FloatArray:
        """Return velocities (T, 21) in the tangent space, per second, by central differences of ``poses``."""
        before, after = self.poses(times - DIFFERENCE_S), self.poses(times + DIFFERENCE_S)
        return difference(before, after) / (2.0 * DIFFERENCE_S)


def difference(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return tangent vectors second (-) first (T, 21) of poses (T, 22), in the first's body frame."""
    tangent = np.empty((len(first), TANGENT_SIZE))
    tangent[:, :3] = second[:, :3] - first[:, :3]
    turn = rotations.multiply(rotations.conjugate(first[:, 3:7]), second[:, 3:7])
    tangent[:, 3:6] = rotations.logarithm(turn)
    tangent[:, TANGENT_ANGLES] = second[:, ANGLES] - first[:, ANGLES]
    return tangent


def natural_motion(duration_s: float, scale: float, rng: np.random.Generator) -> NaturalMotion:
    """Draw a script that lasts at least ``duration_s``.

    It starts with half a second of an open hand in front of the sensor, its palm on the principal axis.

    Args:
        duration_s: duration, s, in script time.
        scale: scale of the hand.
        rng: random generator; shorter durations give prefixes of the same script, track by track.
    """
    streams = rng.spawn(5)
    return NaturalMotion(
        start_pose(scale)[:3],
        _finger_tracks(duration_s, streams[0]),
        _position_track(duration_s, streams[1]),
        _turning_track(duration_s, streams[2]),
        _waves(duration_s, streams[3]),
        _sway(streams[4]),
    )


def _turned(turning: FloatArray) -> FloatArray:
    """Return quaternions (T, 4) of pitch, yaw, roll (T, 3)."""
    pitch, yaw, roll = (rotations.exponential(turning[:, k, None] * np.eye(3)[k]) for k in range(3))
    return rotations.canonical(rotations.multiply(roll, rotations.multiply(pitch, yaw)))


def _finger_tracks(duration_s: float, rng: np.random.Generator) -> tuple[Track, ...]:
    names, t = ["open"], FIRST_HOLD_S
    targets = [SHAPES["open"]]
    starts: list[FloatArray] = []
    durations: list[FloatArray] = []
    while t < duration_s or not starts:
        choices = [name for name in SHAPES if name != names[-1]]
        name = choices[rng.integers(len(choices))]
        length = rng.uniform(*SHAPE_MOVE_S)
        windows = _finger_windows(names[-1], name, rng)
        starts.append(t + length * windows[:, 0])
        durations.append(length * (windows[:, 1] - windows[:, 0]))
        targets.append(varied(name, rng))
        names.append(name)
        t += length + rng.uniform(*SHAPE_HOLD_S)
    by_finger = np.array(targets).reshape(-1, 5, 3)
    return tuple(Track(np.array(starts)[:, f], np.array(durations)[:, f], by_finger[:, f]) for f in range(5))


def _finger_windows(before: str, after: str, rng: np.random.Generator) -> FloatArray:
    """Return the part (5, 2) of a move in which each finger moves, with slight random offsets.

    To keep the thumb out of the way, a thumb that closes over the fingers moves last, one that covers them
    first.
    """
    windows = np.stack([rng.uniform(0.0, 0.15, 5), rng.uniform(0.85, 1.0, 5)], axis=1)
    if before in THUMB_ACROSS:
        windows[:, 0] += 0.25
        windows[0] = 0.0, 1.0 if after in THUMB_ACROSS else 0.55
    elif after in THUMB_ACROSS:
        windows[:, 1] -= 0.25
        windows[0] = 0.45, 1.0
    return windows


def _position_track(duration_s: float, rng: np.random.Generator) -> Track:
    def place() -> FloatArray:
        return np.asarray(rng.uniform(*BOX_MM.T), dtype=np.float64)

    return _wandering(duration_s, rng, place, TRAVEL_MM_S, TRAVEL_S, TRAVEL_HOLD_S)


def _turning_track(duration_s: float, rng: np.random.Generator) -> Track:
    def turn() -> FloatArray:
        return _drawn_turn(rng)

    return _wandering(duration_s, rng, turn, TURN_RAD_S, TURN_S, TURN_HOLD_S)


def _wandering(
    duration_s: float,
    rng: np.random.Generator,
    target: Callable[[], FloatArray],
    speed: Interval,
    length: Interval,
    hold: Interval,
) -> Track:
    """Draw a track of three numbers from zero, with random mean speeds, durations (s) and holds (s)."""
    t, targets = FIRST_HOLD_S, [np.zeros(3)]
    starts: list[float] = []
    durations: list[float] = []
    while t < duration_s or not starts:
        targets.append(target())
        way = float(np.linalg.norm(targets[-1] - targets[-2]))
        starts.append(t)
        durations.append(min(max(way / rng.uniform(*speed), length[0]), length[1]))
        t += durations[-1] + rng.uniform(*hold)
    return Track(np.array(starts), np.array(durations), np.array(targets))


def _drawn_turn(rng: np.random.Generator) -> FloatArray:
    """Draw pitch, yaw, roll (3,), rad."""
    shares = np.array([share for share, _, _ in _TURNS])
    _, spread, sideways = _TURNS[rng.choice(len(_TURNS), p=shares)]
    turn = _NATURAL_D * np.array(spread) * rng.standard_normal(3)
    turn[1] += rng.choice([-1.0, 1.0]) * _NATURAL_D * rng.uniform(*sideways)
    return np.clip(turn, -_MOST_TURNED, _MOST_TURNED)


def _waves(duration_s: float, rng: np.random.Generator) -> tuple[Wave, ...]:
    waves = []
    t = FIRST_HOLD_S + rng.uniform(*WAVE_EVERY_S)
    while t < duration_s:
        waves.append(Wave(t, rng.uniform(*WAVE_S), rng.uniform(*WAVE_HZ), rng.uniform(*WAVE_RAD)))
        t += waves[-1].duration + rng.uniform(*WAVE_EVERY_S)
    return tuple(waves)


def _sway(rng: np.random.Generator) -> FloatArray:
    amplitude = np.repeat([SWAY_MM, SWAY_RAD, FINGER_SWAY_RAD], [3, 3, len(ANGLE_NAMES)])
    count = len(amplitude)
    phase = rng.uniform(0.0, 2.0 * np.pi, count)
    return np.stack([amplitude, rng.uniform(*SWAY_HZ, count), phase], axis=1)
