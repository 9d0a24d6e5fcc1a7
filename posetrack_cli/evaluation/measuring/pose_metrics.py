"""Pose and velocity errors, and covariance consistency."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.evaluation.measuring.measures import (
    Common,
    Matched,
    Measures,
    absolute_deg,
    common_columns,
    rows_of,
    shape_difference,
)
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.rotations import head_roll_pitch_yaw

# Errors of poses, points and velocities as array functions.
#
# The first axis is the frame (M). Positions and points in mm, camera axes; quaternions x y z w; angular
# velocities in rad/s, body axes. Angular errors are returned in degrees.


INSIDE_50, INSIDE_90 = 0.6744897501960817, 1.6448536269514722
"""Half widths of the 50 % and 90 % intervals of a normal distribution, in standard deviations."""
INTERVALS = {"inside_50": INSIDE_50, "inside_90": INSIDE_90}
"""Half widths of the intervals, by metric."""

ROUNDING = 1e-9
"""Errors up to this size, mm or rad, are rounding errors and count as 0, even if the stored variance is 0."""


def distances(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Return |a - b| of vectors (..., 3)."""
    # Avoids the temporary arrays of np.linalg.norm, which matter for long tracks.
    difference = estimate - truth
    lengths: FloatArray = np.sqrt(np.einsum("...i,...i->...", difference, difference))
    return lengths


def distances_by_point(points: Iterator[tuple[FloatArray, FloatArray]], frames: int) -> FloatArray:
    """Return the distances (M, P) between P pairs of points (M, 3), which are processed one at a time."""
    columns = [distances(estimate, truth) for estimate, truth in points]
    found: FloatArray = np.empty((len(columns), frames))
    for row in reversed(range(len(found))):
        found[row] = columns.pop()  # freed once it is copied
    return found.T


def rotation_errors_deg(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the angle (M,) of q_est^-1 q_true, 0 to 180 deg; symmetric, and invariant to the sign of q."""
    return np.degrees(rotations.angle_between(estimate, truth))


def euler_errors_deg(estimate: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the absolute differences (M, 3) of head roll, pitch and yaw, deg, wrapped to 0 to 180."""
    difference = np.degrees(head_roll_pitch_yaw(estimate) - head_roll_pitch_yaw(truth))
    return np.abs(np.mod(difference + 180.0, 360.0) - 180.0)


def angular_velocity_errors_deg(
    estimate: FloatArray, truth: FloatArray, quaternion: FloatArray, true_quaternion: FloatArray
) -> FloatArray:
    """Return |R_est w_est - R_true w_true|, (M,) deg/s, from velocities (M, 3) in body axes."""
    mine = rotations.rotate(quaternion, estimate)
    theirs = rotations.rotate(true_quaternion, truth)
    return np.degrees(distances(mine, theirs))


def pose_difference(
    position: FloatArray, quaternion: FloatArray, true_position: FloatArray, true_quaternion: FloatArray
) -> FloatArray:
    """Return (t_true - t_est; log(q_est^-1 q_true)), (M, 6): the error in the estimate's tangent space."""
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
    """Return e^2 / variance, (M, D); infinite if the variance is 0 and the error exceeds ``ROUNDING``."""
    squares = np.where(np.abs(errors) <= ROUNDING, 0.0, errors) ** 2
    with np.errstate(divide="ignore", over="ignore"):
        np.divide(squares, variances, out=squares, where=squares != 0.0)
    return squares


def inside_interval(normalised: FloatArray, half_width: float = INSIDE_90) -> BoolArray:
    """Return which entries, given as normalised squares, are within ``half_width`` standard deviations."""
    inside: BoolArray = normalised <= half_width**2
    return inside


def share_below(values: FloatArray, thresholds: FloatArray, due: int) -> FloatArray:
    """Return the number of values below each threshold divided by ``due``; NaN if ``due`` is 0."""
    below = np.searchsorted(np.sort(values), thresholds, side="left")
    return below / due if due else np.full(len(thresholds), np.nan)


# Velocities against ground truth. It may lack velocities of some frames or entries (NaN): each metric covers
# the frames where both sides are known, and a note states how many if not all.


LINEAR_METRIC = "velocity_error_mm_s"
ANGULAR_METRIC = "angular_velocity_error_deg_s"
ANGLES_METRIC = "angle_velocity_error_deg_s"
LINEAR, ANGULAR, SHAPE = slice(0, 3), slice(3, 6), 6
"""Columns of a twist; those of the shape start at 6."""
NO_VELOCITY = "the ground truth has no velocity"


def velocity_metrics(measures: Measures, matched: Matched, *, angles: bool = False) -> None:
    """Add |v_est - v_true|, |R_est w_est - R_true w_true| and, for angles, |angle' - true angle'|.

    Angular velocities are transformed from body to camera axes before comparison.

    Args:
        measures: collector.
        matched: the frames with ground truth.
        angles: whether the shape entries are joint angles.
    """
    if reason := velocity_lacks(matched):
        return measures.lack(reason, LINEAR_METRIC, ANGULAR_METRIC, *([ANGLES_METRIC] if angles else []))
    _linear(measures, matched)
    _angular(measures, matched)
    if angles:
        _angles(measures, matched)


def velocity_lacks(matched: Matched) -> str:
    """Return why velocities cannot be compared; empty if they can."""
    if reason := matched.lacks("twist"):
        return reason
    if estimates_no_velocity(matched.estimate):
        return "the run does not estimate velocities"
    return NO_VELOCITY if _moves_without_velocity(matched.truth) else ""


def estimates_no_velocity(track: Track) -> bool:
    """Whether all velocities and their variances are exactly 0, as written by filters without velocity."""
    both = (track.twist, track.twist_variance)
    return len(track) > 0 and not any(array is not None and array.any() for array in both)


def _moves_without_velocity(truth: Track) -> bool:
    """Whether all velocities are exactly 0 although the pose changes: ground truth without velocities."""
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
        return measures.lack("the ground truth has no finger angles", ANGLES_METRIC)
    errors = absolute_deg(shape_difference(matched, "twist", common, SHAPE))
    known = _add(measures, ANGLES_METRIC, errors)
    if known.any():
        measures.summarise_parts(ANGLES_METRIC, rows_of(errors, np.flatnonzero(known)), common.names)


def _add(measures: Measures, address: str, errors: FloatArray) -> BoolArray:
    """Add errors (M,) or (M, K) of the frames where all are known; return the mask (M,) of these frames."""
    known = known_frames(errors)
    if len(known) and not known.any():
        measures.lack(NO_VELOCITY, address)
        return known
    if not known.all():
        measures.notes.append(f"{address} covers {int(known.sum())} of {len(known)} frames")
    measures.add(address, errors, known)
    return known


def known_frames(errors: FloatArray) -> BoolArray:
    """Return the mask (M,) of frames in which all errors, (M,) or (M, K), are finite."""
    finite: BoolArray = np.isfinite(errors)
    known: BoolArray = np.logical_and.reduce(finite, axis=tuple(range(1, finite.ndim)))
    return known


# Covariance consistency.
#
# The error e is taken in the tangent space of the estimate, where the variances are defined: mm in camera
# axes, rad in body axes, angles. Results store only the diagonal of the covariance P::
#
#     NEES = e^T diag(P)^-1 e = sum_i e_i^2 / P_ii
#
# If the variances are right, each term has mean 1, so the mean NEES is the number of entries D, even if the
# errors are correlated. The chi-square distribution (Bar-Shalom, Li and Kirubarajan 2001, section 5.4)
# requires independent Gaussian entries, and that of the mean independent frames. Tracks have neither, so no
# confidence interval is reported.


POSE_AXES = ("x", "y", "z", "about_x", "about_y", "about_z")
"""Entries of a pose in the tangent space."""
ANGLES = "angles"
"""Name of the part of a state with the shape entries, for subjects whose pose includes them."""
_BLOCKS = {"position": slice(0, 3), "rotation": slice(3, 6), ANGLES: slice(6, None)}
POSE = ("nees", *INTERVALS)
VELOCITY = tuple(f"velocity_{name}" for name in POSE)
NO_SHAPE = Common((), (), (), ())
BLOCK_FRAMES = 4096
"""Number of frames whose errors are in memory at a time."""


def covariance_metrics(measures: Measures, matched: Matched, parts: Sequence[str]) -> None:
    """Add NEES and the shares inside 50 % and 90 % intervals, for poses and velocities.

    Args:
        measures: collector.
        matched: the frames with ground truth.
        parts: parts of the state to report: blocks and, in the order of the state, its entries; the shape
            entries are included if ``ANGLES`` is among them.
    """
    shapes, fields = NO_SHAPE, ["position", "quaternion"]
    if ANGLES in parts:
        fields.append("shape")
        shapes = common_columns(matched.estimate.shape_names, matched.truth.shape_names)
    reason = matched.lacks(*fields)
    if not reason and shapes.lacking:
        reason = f"the ground truth has no angle {shapes.lacking[0]}"
    collected = _Collected(measures, parts)
    _pose(collected, matched, shapes, reason)
    _velocity(collected, matched, shapes, reason or velocity_lacks(matched))


@dataclass(frozen=True)
class _Collected:
    """Collector of covariance metrics for these parts of the state."""

    measures: Measures
    parts: Sequence[str]

    def add(self, names: Sequence[str], blocks: Iterator[tuple[FloatArray, FloatArray]]) -> None:
        """Add NEES and shares inside the intervals from errors and variances (n, D) of consecutive frames."""
        nees, *levels = names
        known: list[BoolArray] = [np.empty(0, dtype=np.bool_)]
        sums: list[FloatArray] = [np.empty(0)]
        inside: dict[str, list[IntArray]] = {name: [] for name in levels}
        for off, variance in blocks:
            known.append(known_frames(off))
            normalised = normalised_squares(off, variance)
            sums.append(normalised.sum(axis=1))
            for name, half_width in zip(levels, INTERVALS.values(), strict=True):
                inside[name].append(inside_interval(normalised[known[-1]], half_width).sum(axis=0))
        of_frames = np.concatenate(known)
        if len(of_frames) and not of_frames.any():
            return self.measures.lack(NO_VELOCITY, *names)
        self.measures.add(nees, np.concatenate(sums), of_frames)
        for name, counts in inside.items():
            self._shares(name, np.sum(counts, axis=0), int(of_frames.sum()))

    def _shares(self, name: str, inside: IntArray, frames: int) -> None:
        """Add the share of a level, overall and by part, from counts (D,) of entries inside."""
        for part in ("", *self.parts):
            address = f"{name}.{part}" if part else name
            of_part = np.atleast_1d(inside)[_columns(part, self.parts) if part else slice(None)]
            self.measures.add_share(address, int(of_part.sum()), frames * of_part.size)


def _pose(collected: _Collected, matched: Matched, shapes: Common, reason: str) -> None:
    if not reason and matched.estimate.pose_variance is None:
        reason = "the result has no covariance"
    if reason:
        return collected.measures.lack(reason, *POSE)

    def errors(part: Matched) -> FloatArray:
        mine, theirs = ((side("position"), side("quaternion")) for side in (part.of_estimate, part.of_truth))
        return np.hstack([pose_difference(*mine, *theirs), shape_difference(part, "shape", shapes)])

    collected.add(POSE, _in_blocks(matched, errors, "pose_variance", shapes))


def _velocity(collected: _Collected, matched: Matched, shapes: Common, reason: str) -> None:
    if not reason and matched.estimate.twist_variance is None:
        reason = "the result has no velocity covariance"
    if reason:
        return collected.measures.lack(reason, *VELOCITY)
    rigid = slice(0, SHAPE)

    def errors(part: Matched) -> FloatArray:
        twists = part.of_estimate("twist", rigid), part.of_truth("twist", rigid)
        off = twist_difference(*twists, part.of_estimate("quaternion"), part.of_truth("quaternion"))
        return np.hstack([off, shape_difference(part, "twist", shapes, SHAPE)])

    collected.add(VELOCITY, _in_blocks(matched, errors, "twist_variance", shapes))


def _in_blocks(
    matched: Matched, errors: Callable[[Matched], FloatArray], variance: str, shapes: Common
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield errors and stored variances, both (n, D), of consecutive frames."""
    for part in matched.blocks(BLOCK_FRAMES):
        yield errors(part), _variances(part, variance, shapes)


def _variances(matched: Matched, name: str, shapes: Common) -> FloatArray:
    """Return the stored variances (M, D) of the compared entries."""
    variances: FloatArray = matched.of_estimate(name)[:, [*range(6), *(6 + k for k in shapes.estimate)]]
    return variances


def _columns(part: str, parts: Sequence[str]) -> slice:
    """Return the columns of a part of the state, a block or a single entry."""
    if part in _BLOCKS:
        return _BLOCKS[part]
    entries = [name for name in parts if name not in _BLOCKS]
    column = entries.index(part)
    return slice(column, column + 1)
