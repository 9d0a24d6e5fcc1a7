"""Whether a hidden truth lies inside the stated covariance.

The error is taken in the tangent space of the estimate, where the variances are stated: mm in camera axes,
rad in the body's axes, angles. Results state the diagonal only, so with e the error and P the covariance::

    NEES = e^T diag(P)^-1 e = sum_i e_i^2 / P_ii

Its mean is the number of entries D when the variances are right, whether errors are correlated or not: every
term has mean 1. (Bar-Shalom, Li and Kirubarajan 2001, section 5.4, state its chi-square distribution, which
holds only for independent Gaussian entries, and that of the mean only for independent frames: tracks have
neither, so no interval is given.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.metrics import pose_errors
from posetrack_cli.evaluation.metrics.measures import Common, Matched, Measures, common_columns, shape_columns
from posetrack_cli.evaluation.metrics.velocity_metrics import NO_VELOCITY, SHAPE, known_frames, velocity_lacks

POSE_AXES = ("x", "y", "z", "about_x", "about_y", "about_z")
"""The entries of a pose in the tangent space."""
ANGLES = "angles"
"""The part of a state that its shape entries are, if they belong to the pose."""
_BLOCKS = {"position": slice(0, 3), "rotation": slice(3, 6), ANGLES: slice(6, None)}
POSE = ("nees", *pose_errors.INTERVALS)
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
        for name, half_width in zip(levels, pose_errors.INTERVALS.values(), strict=True):
            inside = pose_errors.inside_interval(normalised[known], half_width)
            self.measures.share(name, inside)
            for part in self.parts:
                self.measures.share(f"{name}.{part}", inside[:, _columns(part, self.parts)])


def _pose(collected: _Collected, matched: Matched, shapes: Common, reason: str) -> None:
    if not reason and matched.estimate.pose_variance is None:
        reason = "the result has no covariance"
    if reason:
        return collected.measures.lack(reason, *POSE)
    errors = pose_errors.pose_difference(
        matched.of_estimate("position"),
        matched.of_estimate("quaternion"),
        matched.of_truth("position"),
        matched.of_truth("quaternion"),
    )
    errors = np.hstack([errors, _difference(matched, "shape", shapes, 0)])
    normalised = pose_errors.normalised_squares(errors, _variances(matched, "pose_variance", shapes))
    collected.add(POSE, normalised, np.ones(len(matched), dtype=np.bool_))


def _velocity(collected: _Collected, matched: Matched, shapes: Common, reason: str) -> None:
    if not reason and matched.estimate.twist_variance is None:
        reason = "the result has no covariance of velocities"
    if reason:
        return collected.measures.lack(reason, *VELOCITY)
    rigid = slice(0, SHAPE)
    mine, theirs = matched.of_estimate("twist", rigid), matched.of_truth("twist", rigid)
    turns = matched.of_estimate("quaternion"), matched.of_truth("quaternion")
    errors = pose_errors.twist_difference(mine, theirs, *turns)
    errors = np.hstack([errors, _difference(matched, "twist", shapes, SHAPE)])
    known = known_frames(errors)
    if len(known) and not known.any():
        return collected.measures.lack(NO_VELOCITY, *VELOCITY)
    normalised = pose_errors.normalised_squares(errors, _variances(matched, "twist_variance", shapes))
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
