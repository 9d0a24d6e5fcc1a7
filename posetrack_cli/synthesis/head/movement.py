"""Head motion (smooth, optionally with sudden turns), and the occluder's motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.synthesis.head.form import MINIMUM_JERK_PEAK, Sway, minimum_jerk, pulse, random_sway
from posetrack_cli.synthesis.head.options import HeadSynthOptions

_D = float(np.pi / 180.0)
MOST_MM = (45.0, 28.0, 55.0)
"""Range of the natural motion: x, y, z."""
MOST_PITCH, MOST_ROLL = 11.0 * _D, 10.0 * _D
"""Range of the natural motion, rad; that of the yaw is an option."""
SLIGHT = 0.2
"""Factor on this range for slight motion."""
FREQUENCIES_HZ = (0.08, 0.33)
BEGIN_S = 1.5
"""Duration of the onset: recordings start with a head at rest that faces the camera."""

TURN_RAD_S = 200.0 * _D
"""Maximum speed of the sudden turns."""
TURN_RAD = 25.0 * _D
"""Sudden turns go from this angle on one side to the same on the other and back."""
TURN_HOLD_S = 0.5
TURN_AT = 0.75
"""Start of the turns, as a fraction of the recording."""
SETTLE_S = 0.8
"""Time before and after the turns in which the smooth motion fades and the head turns aside."""

DIFFERENCE_S = 1e-4
"""Half step of the central differences.

Third derivatives, at most 60 a / d^3 for a move of length a in time d, are below 1e4 rad/s^3, so the error
is below 2e-5 rad/s.
"""

FACING = np.array([1.0, 0.0, 0.0, 0.0])
"""Quaternion of a head that faces the camera: half a turn about x."""


@dataclass(frozen=True, eq=False)
class Movement:
    """Trajectory of a head.

    Attributes:
        origin: (3,) initial position, mm, reference camera.
        sway: of x, y, z (mm), yaw, pitch, roll (rad); None for a still head.
        speed: factor on the rate of time of the smooth motion.
        turn_s: start of the sudden turns, s; None for none.
        roll: rad, clockwise in the image, of the head at rest.
    """

    origin: FloatArray
    sway: Sway | None
    speed: float
    turn_s: float | None
    roll: float = 0.0

    @property
    def rest(self) -> FloatArray:
        """Quaternion of the head at rest, which faces the camera."""
        return rotations.canonical(rotations.multiply(self._rolled, FACING))

    @property
    def _rolled(self) -> FloatArray:
        return rotations.exponential(np.array([0.0, 0.0, self.roll]))

    def poses(self, times: FloatArray) -> FloatArray:
        """Return poses (T, 7) at times (T,): position mm, quaternion x y z w, of ``camera_T_head``.

        R = R_z(roll at rest) R_y(yaw) R_x(pitch) R_z(roll) R_facing.
        """
        values = self._wandering(times)
        values[:, 3] += self._turning(times)
        poses = np.empty((len(times), 7))
        poses[:, :3] = self.origin + values[:, :3]
        pitch, yaw, roll = (rotations.exponential(values[:, i, None] * np.eye(3)[k]) for i, k in _ANGLES)
        turned = rotations.multiply(self._rolled, rotations.multiply(yaw, rotations.multiply(pitch, roll)))
        poses[:, 3:] = rotations.canonical(rotations.multiply(turned, FACING))
        return poses

    def twists(self, times: FloatArray) -> FloatArray:
        """Return velocities (T, 6), mm/s in camera axes, rad/s in the head's, by central differences."""
        before, after = self.poses(times - DIFFERENCE_S), self.poses(times + DIFFERENCE_S)
        turn = rotations.multiply(rotations.conjugate(before[:, 3:]), after[:, 3:])
        change = np.hstack([after[:, :3] - before[:, :3], rotations.logarithm(turn)])
        return change / (2.0 * DIFFERENCE_S)

    @property
    def turn_interval(self) -> tuple[float, float] | None:
        """Start of the first and end of the last sudden turn, s."""
        if self.turn_s is None:
            return None
        return self.turn_s, self.turn_s + 2.0 * turn_time() + TURN_HOLD_S

    def _wandering(self, times: FloatArray) -> FloatArray:
        if self.sway is None:
            return np.zeros((len(times), 6))
        moving = minimum_jerk(times / BEGIN_S)
        if self.turn_interval is not None:
            start, end = self.turn_interval
            moving = moving - pulse(times, start - SETTLE_S, SETTLE_S, end - start, SETTLE_S)
        wandering: FloatArray = moving[:, None] * self.sway(self.speed * times)
        return wandering

    def _turning(self, times: FloatArray) -> FloatArray:
        """Return the yaw (T,) of the sudden turns, rad."""
        if self.turn_interval is None:
            return np.zeros(len(times))
        start, end = self.turn_interval
        aside = pulse(times, start - SETTLE_S, SETTLE_S, end - start, SETTLE_S)
        across = pulse(times, start, turn_time(), TURN_HOLD_S, turn_time())
        return TURN_RAD * (2.0 * across - aside)


_ANGLES = ((4, 0), (3, 1), (5, 2))  # (index, axis): pitch about x, yaw about y, roll about z


def turn_time() -> float:
    """Return the duration of one sudden turn, s."""
    return MINIMUM_JERK_PEAK * 2.0 * TURN_RAD / TURN_RAD_S


def make_movement(options: HeadSynthOptions, rng: np.random.Generator) -> Movement:
    """Draw the trajectory for these options."""
    most = np.array([*MOST_MM, options.yaw_range * _D, MOST_PITCH, MOST_ROLL]) * _nearness(options)
    sway = random_sway(most * (SLIGHT if options.motion == "slight" else 1.0), FREQUENCIES_HZ, rng)
    turn = TURN_AT * options.duration_s if options.motion == "turn" else None
    origin = np.array([0.0, 0.0, options.distance_mm])
    still = options.motion == "still"
    return Movement(origin, None if still else sway, options.speed, turn, options.roll * _D)


def _nearness(options: HeadSynthOptions) -> FloatArray:
    """Return factors (6,) that keep a near head in the image."""
    return np.array([*(3 * [min(options.distance_mm / 700.0, 1.5)]), 1.0, 1.0, 1.0])


OCCLUDED_PART = 0.45
"""Arrival of the occluder, as a fraction of the recording."""
COME_S, STAY_S = 0.35, 1.0
AWAY_MM, COVERING_MM, BEFORE_MM = 520.0, 52.0, 150.0
"""Offsets of the occluder's centre from the head: sideways when away, sideways when covering, forwards."""


@dataclass(frozen=True)
class Occluder:
    """Trajectory of an object that covers half of the face from ``start_s``; side 1 is the image's right."""

    start_s: float
    side: float

    @property
    def interval(self) -> tuple[float, float]:
        """Interval in which any part of the face may be covered, s."""
        return self.start_s - COME_S, self.start_s + STAY_S + COME_S

    def place(self, seconds: float, head: FloatArray) -> FloatArray:
        """Return the centre (3,) of the occluder, mm, reference axes, for a head at (3,)."""
        near = float(pulse(np.array([seconds]), self.start_s - COME_S, COME_S, STAY_S, COME_S)[0])
        aside = AWAY_MM * head[2] / 700.0 + near * (COVERING_MM - AWAY_MM * head[2] / 700.0)
        place: FloatArray = head + np.array([self.side * aside, 0.0, -BEFORE_MM])
        return place


def make_occluder(options: HeadSynthOptions, rng: np.random.Generator) -> Occluder | None:
    """Return the occluder's trajectory, or None; the side is always drawn, to keep the stream aligned."""
    side = 1.0 if rng.random() < 0.5 else -1.0
    return Occluder(OCCLUDED_PART * options.duration_s, side) if options.occlusion else None
