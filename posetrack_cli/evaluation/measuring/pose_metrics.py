"""Errors of pose and velocity, and what stated variances are worth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.measuring.measures import (
    Common,
    Matched,
    Measures,
    common_columns,
    shape_columns,
)
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.rotations import head_roll_pitch_yaw

# Errors of estimated against true poses, points and velocities: arrays in, arrays out.
#
# Frames (M) come first in every array. Positions and points in mm, camera axes; quaternions x y z w; angular
# velocities in rad/s and the body's own axes. Angular errors are returned in degrees.


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


# Metrics of velocities against a truth that has one.
#
# A truth may know the velocity of some frames or of some entries only, the rest is NaN: each metric is over
# the frames that it has both sides of, and a note says when they are not all.


LINEAR_METRIC = "velocity_error_mm_s"
ANGULAR_METRIC = "angular_velocity_error_deg_s"
ANGLES_METRIC = "angle_velocity_error_deg_s"
LINEAR, ANGULAR, SHAPE = slice(0, 3), slice(3, 6), 6
"""Columns of a twist; the shape's begin at 6."""
NO_VELOCITY = "the truth has no velocity"


def velocity_metrics(measures: Measures, matched: Matched, *, angles: bool = False) -> None:
    """Add |v_est - v_true|, |R_est w_est - R_true w_true| and, of angles, |angle' - true angle'|.

    The angular velocities of both sides are in their own body's axes, so they are brought to camera axes
    before they are compared.

    Args:
        measures: where to.
        matched: the frames with a truth.
        angles: whether the shape entries are angles of joints.
    """
    if reason := velocity_lacks(matched):
        return measures.lack(reason, LINEAR_METRIC, ANGULAR_METRIC, *([ANGLES_METRIC] if angles else []))
    _linear(measures, matched)
    _angular(measures, matched)
    if angles:
        _angles(measures, matched)


def velocity_lacks(matched: Matched) -> str:
    """Why velocities cannot be compared at all; empty when they can."""
    if reason := matched.lacks("twist"):
        return reason
    if estimates_no_velocity(matched.estimate):
        return "the run estimates no velocity"
    return NO_VELOCITY if _moves_without_velocity(matched.truth) else ""


def estimates_no_velocity(track: Track) -> bool:
    """Return whether all velocities are exactly 0 and certain, as a filter without velocity writes them."""
    both = (track.twist, track.twist_variance)
    return len(track) > 0 and not any(array is not None and array.any() for array in both)


def _moves_without_velocity(truth: Track) -> bool:
    """Whether all velocities are exactly 0 though the pose changes, as a filter without velocity says."""
    moves = any(
        array is not None and (array != array[:1]).any() for array in (truth.position, truth.quaternion)
    )
    return moves and truth.twist is not None and not truth.twist.any()


def _linear(measures: Measures, matched: Matched) -> None:
    mine, theirs = matched.of_estimate("twist", LINEAR), matched.of_truth("twist", LINEAR)
    _add(measures, LINEAR_METRIC, distances(mine, theirs))


def _angular(measures: Measures, matched: Matched) -> None:
    if reason := matched.lacks("quaternion"):
        return measures.lack(reason, ANGULAR_METRIC)
    mine, theirs = matched.of_estimate("twist", ANGULAR), matched.of_truth("twist", ANGULAR)
    turns = matched.of_estimate("quaternion"), matched.of_truth("quaternion")
    errors = angular_velocity_errors_deg(mine, theirs, *turns)
    _add(measures, ANGULAR_METRIC, errors)


def _angles(measures: Measures, matched: Matched) -> None:
    common = common_columns(matched.estimate.shape_names, matched.truth.shape_names)
    if not common.names:
        return measures.lack("the truth has no finger angles", ANGLES_METRIC)
    mine, theirs = shape_columns(matched, "twist", common, SHAPE)
    errors = np.degrees(np.abs(mine - theirs))
    known = _add(measures, ANGLES_METRIC, errors)
    if known.any():
        measures.summarise_parts(ANGLES_METRIC, errors[known], common.names)


def _add(measures: Measures, address: str, errors: FloatArray) -> BoolArray:
    """Add the errors (M,) or (M, K) of the frames where they are known; return which (M,) these are."""
    known = known_frames(errors)
    if len(known) and not known.any():
        measures.lack(NO_VELOCITY, address)
        return known
    if not known.all():
        measures.notes.append(f"{address} is over the {int(known.sum())} of {len(known)} frames that have it")
    measures.add(address, errors, known)
    return known


def known_frames(errors: FloatArray) -> BoolArray:
    """Return in which frames (M,) all errors, (M,) or (M, K), are known, that is finite."""
    finite: BoolArray = np.isfinite(errors)
    known: BoolArray = np.logical_and.reduce(finite, axis=tuple(range(1, finite.ndim)))
    return known


# Whether a hidden truth lies inside the stated covariance.
#
# The error is taken in the tangent space of the estimate, where the variances are stated: mm in camera axes,
# rad in the body's axes, angles. Results state the diagonal only, so with e the error and P the covariance::
#
#     NEES = e^T diag(P)^-1 e = sum_i e_i^2 / P_ii
#
# Its mean is the number of entries D when the variances are right, whether errors are correlated or not:
# every term has mean 1. (Bar-Shalom, Li and Kirubarajan 2001, section 5.4, state its chi-square distribution,
# which holds only for independent Gaussian entries, and that of the mean only for independent frames: tracks
# have neither, so no interval is given.)


POSE_AXES = ("x", "y", "z", "about_x", "about_y", "about_z")
"""The entries of a pose in the tangent space."""
ANGLES = "angles"
"""The part of a state that its shape entries are, if they belong to the pose."""
_BLOCKS = {"position": slice(0, 3), "rotation": slice(3, 6), ANGLES: slice(6, None)}
POSE = ("nees", *INTERVALS)
VELOCITY = tuple(f"velocity_{name}" for name in POSE)
NO_SHAPE = Common((), (), (), ())


def covariance_metrics(measures: Measures, matched: Matched, parts: Sequence[str]) -> None:
    """Add NEES and the shares inside 50 % and 90 % intervals, of poses and of velocities.

    Args:
        measures: where to.
        matched: the frames with a truth.
        parts: of the state that are told apart: blocks and, in the state's order, its entries; the shape
            entries are compared if ``ANGLES`` is among them.
    """
    shapes, fields = NO_SHAPE, ["position", "quaternion"]
    if ANGLES in parts:
        fields.append("shape")
        shapes = common_columns(matched.estimate.shape_names, matched.truth.shape_names)
    reason = matched.lacks(*fields)
    if not reason and shapes.lacking:
        reason = f"the truth has no angle {shapes.lacking[0]}"
    collected = _Collected(measures, parts)
    _pose(collected, matched, shapes, reason)
    _velocity(collected, matched, shapes, reason or velocity_lacks(matched))


@dataclass(frozen=True)
class _Collected:
    """Where the metrics go, and the parts that are told apart."""

    measures: Measures
    parts: Sequence[str]

    def add(self, names: Sequence[str], normalised: FloatArray, known: BoolArray) -> None:
        """Add NEES and the shares inside, of the frames (M,) whose normalised squares (M, D) are known."""
        nees, *levels = names
        self.measures.add(nees, normalised.sum(axis=1), known)
        for name, half_width in zip(levels, INTERVALS.values(), strict=True):
            inside = inside_interval(normalised[known], half_width)
            self.measures.share(name, inside)
            for part in self.parts:
                self.measures.share(f"{name}.{part}", inside[:, _columns(part, self.parts)])


def _pose(collected: _Collected, matched: Matched, shapes: Common, reason: str) -> None:
    if not reason and matched.estimate.pose_variance is None:
        reason = "the result has no covariance"
    if reason:
        return collected.measures.lack(reason, *POSE)
    errors = pose_difference(
        matched.of_estimate("position"),
        matched.of_estimate("quaternion"),
        matched.of_truth("position"),
        matched.of_truth("quaternion"),
    )
    errors = np.hstack([errors, _difference(matched, "shape", shapes, 0)])
    normalised = normalised_squares(errors, _variances(matched, "pose_variance", shapes))
    collected.add(POSE, normalised, np.ones(len(matched), dtype=np.bool_))


def _velocity(collected: _Collected, matched: Matched, shapes: Common, reason: str) -> None:
    if not reason and matched.estimate.twist_variance is None:
        reason = "the result has no covariance of velocities"
    if reason:
        return collected.measures.lack(reason, *VELOCITY)
    rigid = slice(0, SHAPE)
    mine, theirs = matched.of_estimate("twist", rigid), matched.of_truth("twist", rigid)
    turns = matched.of_estimate("quaternion"), matched.of_truth("quaternion")
    errors = twist_difference(mine, theirs, *turns)
    errors = np.hstack([errors, _difference(matched, "twist", shapes, SHAPE)])
    known = known_frames(errors)
    if len(known) and not known.any():
        return collected.measures.lack(NO_VELOCITY, *VELOCITY)
    normalised = normalised_squares(errors, _variances(matched, "twist_variance", shapes))
    collected.add(VELOCITY, normalised, known)


def _difference(matched: Matched, name: str, shapes: Common, first: int) -> FloatArray:
    """True minus estimated shape entries (M, K), which begin at column ``first`` of the array."""
    if not shapes.names:
        return np.empty((len(matched), 0))
    mine, theirs = shape_columns(matched, name, shapes, first)
    return theirs - mine


def _variances(matched: Matched, name: str, shapes: Common) -> FloatArray:
    """The stated variances (M, D) of the entries that are compared."""
    variances: FloatArray = matched.of_estimate(name)[:, [*range(6), *(6 + k for k in shapes.estimate)]]
    return variances


def _columns(part: str, parts: Sequence[str]) -> slice:
    """The columns of a part of the state; single entries follow the blocks in the state's order."""
    if part in _BLOCKS:
        return _BLOCKS[part]
    entries = [name for name in parts if name not in _BLOCKS]
    column = entries.index(part)
    return slice(column, column + 1)
