"""Smooth natural motion (C): a script of hand shapes, turns, sweeps and waves, continuous in time.

Every track runs through its targets by minimum-jerk moves, so position, velocity and acceleration are
continuous. A script is drawn from a random generator; it can then be asked for the pose at any time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.anatomy import ANGLE_NAMES, ANGLES, POSE_SIZE, TANGENT_ANGLES, TANGENT_SIZE
from posetrack_cli.synthesis.hand.shapes import SHAPES, THUMB_ACROSS, coupled, minimum_jerk, varied
from posetrack_cli.synthesis.hand.walk import start_pose

Interval: TypeAlias = tuple[float, float]

_D = float(np.pi / 180.0)
FIRST_HOLD_S = 0.5
DIFFERENCE_S = 1e-5
"""Half the step of the central difference, in the script's time. A move of length a in a time d has a jerk
of at most 60 a / d^3, here 3e5 mm/s^3 and (with the couplings) 2e5 rad/s^3, so the error, step^2 / 6 times
the jerk, is below 1e-5 mm/s and 4e-6 rad/s; rounding adds 1e-13 / step, less than that."""

BOX_MM = np.array([(-110.0, 110.0), (-65.0, 65.0), (-45.0, 120.0)])
"""How far the wrist goes from its first place, x, y, z."""

SHAPE_MOVE_S, SHAPE_HOLD_S = (0.25, 0.65), (0.0, 0.10)
TRAVEL_MM_S, TRAVEL_S, TRAVEL_HOLD_S = (80.0, 330.0), (0.25, 1.5), (0.0, 0.30)
TURN_RAD_S, TURN_S, TURN_HOLD_S = (70.0 * _D, 380.0 * _D), (0.20, 0.9), (0.0, 0.30)
WAVE_EVERY_S, WAVE_S, WAVE_HZ, WAVE_RAD = (2.5, 7.0), (1.2, 2.4), (1.0, 2.0), (10.0 * _D, 22.0 * _D)
SWAY_MM, SWAY_RAD, FINGER_SWAY_RAD, SWAY_HZ = 2.5, 1.0 * _D, 2.0 * _D, (0.4, 1.2)

# How the hand is turned: share of the turns, then sd of pitch, yaw and roll, and size of the yaw (deg).
_TURNS = (
    (0.50, (7.0, 10.0, 9.0), (0.0, 0.0)),  # to the sensor
    (0.28, (8.0, 0.0, 8.0), (35.0, 65.0)),  # to the side
    (0.10, (6.0, 0.0, 6.0), (78.0, 92.0)),  # edge-on
    (0.12, (16.0, 12.0, 25.0), (0.0, 0.0)),  # tilted
)
_MOST_TURNED = _D * np.array([28.0, 95.0, 45.0])  # pitch, yaw, roll


@dataclass(frozen=True)
class Track:
    """Minimum-jerk moves from target to target: x(t) = a_k + (a_{k+1} - a_k) s((t - t_k) / d_k).

    Attributes:
        starts: (K,) when each move starts, s.
        durations: (K,) how long it takes; it ends before the next starts.
        targets: (K + 1, D) where the track rests before the first move and after each.
    """

    starts: FloatArray
    durations: FloatArray
    targets: FloatArray

    def __call__(self, times: FloatArray) -> FloatArray:
        """The values at times (T,): (T, D)."""
        move = np.clip(np.searchsorted(self.starts, times, side="right") - 1, 0, len(self.starts) - 1)
        s = minimum_jerk((times - self.starts[move]) / self.durations[move])
        before, after = self.targets[move], self.targets[move + 1]
        return before + s[:, None] * (after - before)


@dataclass(frozen=True)
class Wave:
    """An oscillation of the roll: amplitude times a smooth window of a sine.

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
        """The roll added at times (T,), rad."""
        since = times - self.start
        ramp = 0.3 * self.duration
        window = minimum_jerk(since / ramp) * minimum_jerk((self.duration - since) / ramp)
        return self.amplitude * window * np.sin(2.0 * np.pi * self.frequency * since)


@dataclass(frozen=True)
class NaturalMotion:
    """A script of natural motion of a right hand.

    Attributes:
        origin: (3,) first position of the wrist, mm.
        fingers: five tracks of three angles, thumb first, rad.
        position: track of the wrist's way from the origin, mm.
        turning: track of pitch, yaw, roll, rad.
        waves: oscillations of the roll.
        sway: (21, 3) amplitude, frequency (Hz) and phase of small sines added to position, turning and
            finger angles: no hand is quite still.
    """

    origin: FloatArray
    fingers: tuple[Track, ...]
    position: Track
    turning: Track
    waves: tuple[Wave, ...]
    sway: FloatArray

    def poses(self, times: FloatArray) -> FloatArray:
        """The poses (T, 22) at times (T,), s.

        The rotation is R_z(roll) R_x(pitch) R_y(yaw): yaw turns the hand about its own length, as the
        forearm does, pitch and roll are the wrist's.
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
        """The velocities (T, 21) in the tangent space, per second, by central differences of ``poses``."""
        before, after = self.poses(times - DIFFERENCE_S), self.poses(times + DIFFERENCE_S)
        return difference(before, after) / (2.0 * DIFFERENCE_S)


def difference(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the tangent vectors second (-) first, (T, 22) twice -> (T, 21), in the first's body frame."""
    tangent = np.empty((len(first), TANGENT_SIZE))
    tangent[:, :3] = second[:, :3] - first[:, :3]
    turn = rotations.multiply(rotations.conjugate(first[:, 3:7]), second[:, 3:7])
    tangent[:, 3:6] = rotations.logarithm(turn)
    tangent[:, TANGENT_ANGLES] = second[:, ANGLES] - first[:, ANGLES]
    return tangent


def natural_motion(duration_s: float, scale: float, rng: np.random.Generator) -> NaturalMotion:
    """Draw a script that lasts at least ``duration_s``.

    It starts with half a second of an open hand before the sensor, its palm on the principal axis.

    Args:
        duration_s: how long, s, in the script's own time.
        scale: of the hand.
        rng: draws a prefix of the same script for a shorter duration, track by track.
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
    """Quaternions (T, 4) of pitch, yaw, roll (T, 3)."""
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
    """Parts (5, 2) of a move in which each finger moves: slightly apart, and the thumb never in the way.

    A thumb that closes over the fingers comes last, one that lay over them goes first.
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
    """A track of three numbers from zero to drawn targets: mean speed, length (s) and hold (s) are drawn."""
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
    """Pitch, yaw, roll (3,), rad."""
    shares = np.array([share for share, _, _ in _TURNS])
    _, spread, sideways = _TURNS[rng.choice(len(_TURNS), p=shares)]
    turn = _D * np.array(spread) * rng.standard_normal(3)
    turn[1] += rng.choice([-1.0, 1.0]) * _D * rng.uniform(*sideways)
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
