"""Errors of estimated against true poses, points and velocities: arrays in, arrays out.

Frames (M) come first in every array. Positions and points in mm, camera axes; quaternions x y z w; angular
velocities in rad/s and the body's own axes. Angular errors are returned in degrees.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.euler import head_roll_pitch_yaw

INSIDE_50, INSIDE_90 = 0.6744897501960817, 1.6448536269514722
"""Half widths of the 50 % and the 90 % interval of a normal distribution, in standard deviations."""
INTERVALS = {"inside_50": INSIDE_50, "inside_90": INSIDE_90}
"""Half widths of the intervals whose shares are counted, by metric."""

ROUNDING = 1e-9
"""Errors this small, mm or rad, come from arithmetic: an estimate that claims certainty is right then."""


def distances(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Return |a - b| of vectors (..., 3)."""
    difference = estimate - truth
    lengths: FloatArray = np.sqrt(np.einsum("...i,...i->...", difference, difference))
    return lengths


def distances_by_point(points: Iterator[tuple[FloatArray, FloatArray]], frames: int) -> FloatArray:
    """Return the distances (M, P) between points, given as P pairs of (M, 3): one at a time in memory."""
    columns = [distances(estimate, truth) for estimate, truth in points]
    return np.stack(columns).T if columns else np.empty((frames, 0))


def rotation_errors_deg(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the angle (M,), 0 to 180 deg, of q_est^-1 q_true: symmetric, and the same for q and -q."""
    return np.degrees(rotations.angle_between(estimate, truth))


def euler_errors_deg(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the absolute differences (M, 3) of roll, pitch, yaw of heads, deg, the short way round."""
    difference = np.degrees(head_roll_pitch_yaw(estimate) - head_roll_pitch_yaw(truth))
    return np.abs(np.mod(difference + 180.0, 360.0) - 180.0)


def angular_velocity_errors_deg(
    estimate: FloatArray, truth: FloatArray, quaternion: FloatArray, true_quaternion: FloatArray
) -> FloatArray:
    """Return |R_est w_est - R_true w_true|, (M,) deg/s: each side's velocity (M, 3) in camera axes."""
    mine = rotations.rotate(quaternion, estimate)
    theirs = rotations.rotate(true_quaternion, truth)
    return np.degrees(distances(mine, theirs))


def pose_difference(
    position: FloatArray, quaternion: FloatArray, true_position: FloatArray, true_quaternion: FloatArray
) -> FloatArray:
    """Return (t_true - t_est; log(q_est^-1 q_true)), (M, 6): the truth in the estimate's tangent space."""
    turn = rotations.logarithm(rotations.multiply(rotations.conjugate(quaternion), true_quaternion))
    return np.hstack([true_position - position, turn])


def twist_difference(
    twist: FloatArray, true_twist: FloatArray, quaternion: FloatArray, true_quaternion: FloatArray
) -> FloatArray:
    """Return (v_true - v_est; R_est^T R_true w_true - w_est), (M, 6), from twists (M, 6)."""
    turn = rotations.multiply(rotations.conjugate(quaternion), true_quaternion)
    angular = rotations.rotate(turn, true_twist[:, 3:]) - twist[:, 3:]
    return np.hstack([true_twist[:, :3] - twist[:, :3], angular])


def normalised_squares(errors: FloatArray, variances: FloatArray) -> FloatArray:
    """Return e^2 / variance, (M, D): 0 where a certain entry is right, infinite where it is wrong.

    An error up to ``ROUNDING`` counts as none.
    """
    squares = np.where(np.abs(errors) <= ROUNDING, 0.0, errors) ** 2
    with np.errstate(divide="ignore", over="ignore"):
        np.divide(squares, variances, out=squares, where=squares != 0.0)
    return squares


def inside_interval(normalised: FloatArray, half_width: float = INSIDE_90) -> BoolArray:
    """Return which entries lie within so many standard deviations, from their normalised squares."""
    inside: BoolArray = normalised <= half_width**2
    return inside


def share_below(values: FloatArray, thresholds: FloatArray, due: int) -> FloatArray:
    """Return for each threshold D the number of values below D over ``due``; NaN when nothing is due."""
    below = np.searchsorted(np.sort(values), thresholds, side="left")
    return below / due if due else np.full(len(thresholds), np.nan)
