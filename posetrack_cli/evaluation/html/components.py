"""The components of a trajectory that the page can show: estimate, truth and 90 % band."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.metrics.pose_errors import INSIDE_90
from posetrack_cli.evaluation.subjects import KINDS
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.euler import roll_pitch_yaw
from posetrack_cli.results.subject_kind import kind_of


def readable(name: str) -> str:
    """Return a name with spaces."""
    return name.replace("_", " ")


DIFFERENCE_RAD = 1e-6
"""Step of the differences that take variances of rotation vectors to variances of Euler angles."""

DEG = 180.0 / np.pi
AXES = ("x", "y", "z")
EULER = ("roll", "pitch", "yaw")


@dataclass(frozen=True, eq=False)
class Component:
    """One number over time.

    Attributes:
        group: components of one group are shown beside each other.
        label, unit: of its axis.
        estimate: (N,).
        truth: (N,) at the estimate's frames, NaN where there is none; None if it is not known at all.
        half_width: (N,) of the 90 % band; None if no variance is stated.
    """

    group: str
    label: str
    unit: str
    estimate: FloatArray
    truth: FloatArray | None
    half_width: FloatArray | None


def components(evaluation: Evaluation) -> Iterator[Component]:
    """Yield the components that the track has, in the order in which the page lists them."""
    body = KINDS[evaluation.subject].body
    yield from leading_components(evaluation)
    yield from _positions(evaluation, f"{body} position")
    if not KINDS[evaluation.subject].expressions:
        yield from _angles(evaluation, f"{body} rotation")
    yield from _quaternions(evaluation, f"{body} rotation, quaternion")
    yield from _shapes(evaluation)
    yield from _velocities(evaluation, body)


def leading_components(evaluation: Evaluation) -> Iterator[Component]:
    """Yield what a page of a subject with expressions begins with: how it is turned, and what it does."""
    kind = KINDS[evaluation.subject]
    if kind.expressions:
        group = f"{kind.body} angles and expressions"
        yield from _angles(evaluation, group)
        yield from _expressions(evaluation, group, kind.expressions)


def matched_truth(
    evaluation: Evaluation, field: Callable[[Track], FloatArray | None], rows: IntArray | None = None
) -> FloatArray | None:
    """Return a field of the truth at the estimate's frames, NaN where no truth belongs to one.

    Args:
        evaluation: has the truth.
        field: which of its (N, ...) arrays.
        rows: (R,) frames of the estimate; None for all.
    """
    truth, pairs = evaluation.truth, evaluation.pairs
    values = None if truth is None else field(truth)
    if values is None or pairs is None:
        return None
    true_rows = np.full(len(evaluation.track), -1, dtype=np.int64)
    true_rows[pairs.estimate] = pairs.truth
    asked = true_rows if rows is None else true_rows[rows]
    placed = np.full((len(asked), *values.shape[1:]), np.nan)
    placed[asked >= 0] = values[asked[asked >= 0]]
    return placed


def _columns(
    group: str,
    names: tuple[str, ...],
    unit: str,
    estimate: FloatArray,
    truth: FloatArray | None,
    variance: FloatArray | None,
) -> Iterator[Component]:
    """One component per column; a truth with other columns is none."""
    if truth is not None and truth.shape != estimate.shape:
        truth = None
    for i, name in enumerate(names):
        half = None if variance is None else INSIDE_90 * np.sqrt(np.maximum(variance[:, i], 0.0))
        yield Component(group, name, unit, estimate[:, i], None if truth is None else truth[:, i], half)


def _positions(evaluation: Evaluation, group: str) -> Iterator[Component]:
    track = evaluation.track
    if track.position is not None:
        truth = matched_truth(evaluation, lambda other: other.position)
        variance = None if track.pose_variance is None else track.pose_variance[:, :3]
        yield from _columns(group, AXES, "mm", track.position, truth, variance)


def _angles(evaluation: Evaluation, group: str) -> Iterator[Component]:
    track = evaluation.track
    if track.quaternion is None:
        return
    angles_of = kind_of(evaluation.subject).euler_angles
    truth = matched_truth(evaluation, lambda other: other.quaternion)
    angles = _unwrapped(angles_of(track.quaternion)) * DEG
    true_angles = None
    if truth is not None:
        known = np.isfinite(truth).all(axis=1)
        true_angles = np.full_like(angles, np.nan)
        true_angles[known] = _nearest_turn(angles_of(truth[known]) * DEG, angles[known])
    spread = None if track.pose_variance is None else track.pose_variance[:, 3:6]
    variance = None if spread is None else euler_variance(track.quaternion, spread, angles_of) * DEG**2
    yield from _columns(group, EULER, "deg", angles, true_angles, variance)


def _quaternions(evaluation: Evaluation, group: str) -> Iterator[Component]:
    track = evaluation.track
    if track.quaternion is None:
        return
    truth, q = matched_truth(evaluation, lambda other: other.quaternion), _continuous(track.quaternion)
    variance = None if track.pose_variance is None else quaternion_variance(q, track.pose_variance[:, 3:6])
    yield from _columns(group, (*AXES, "w"), "", q, _same_sign(truth, q), variance)


def _expressions(evaluation: Evaluation, group: str, names: tuple[str, ...]) -> Iterator[Component]:
    """Expressions in shares of the full one; ``action_jaw_open`` is called ``jaw open``."""
    track = evaluation.track
    columns = {} if track.numbers is None else dict(zip(track.number_names, track.numbers.T, strict=True))
    for name in names:
        if name in columns:
            deviation = columns.get(f"{name}_sd")
            label = readable(name.partition("_")[2])
            half = None if deviation is None else INSIDE_90 * deviation
            yield Component(group, label, "", columns[name], None, half)


def _shapes(evaluation: Evaluation) -> Iterator[Component]:
    track = evaluation.track
    if track.shape is None:
        return
    truth = matched_truth(evaluation, lambda other: other.shape)
    variance = None if track.pose_variance is None else track.pose_variance[:, 6:]
    yield from _grouped(evaluation, track.shape, truth, variance, "")


def _velocities(evaluation: Evaluation, body: str) -> Iterator[Component]:
    track = evaluation.track
    if track.twist is None:
        return
    twist, variance = track.twist, track.twist_variance
    truth = _true_twists(evaluation)
    if truth is not None and truth.shape != twist.shape:
        truth = None

    def part(columns: slice, scale: float = 1.0) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
        return (
            scale * twist[:, columns],
            None if truth is None else scale * truth[:, columns],
            None if variance is None else scale**2 * variance[:, columns],
        )

    yield from _columns(f"{body} velocity", AXES, "mm/s", *part(slice(0, 3)))
    yield from _columns(f"{body} angular velocity, body axes", AXES, "deg/s", *part(slice(3, 6), DEG))
    yield from _grouped(evaluation, *part(slice(6, None)), " velocities")


def _true_twists(evaluation: Evaluation) -> FloatArray | None:
    """The truth's twists with the angular velocity in the estimate's body axes: R_est^T R_true w_true."""
    twists = matched_truth(evaluation, lambda other: other.twist)
    true_turns = matched_truth(evaluation, lambda other: other.quaternion)
    if twists is not None and true_turns is not None and evaluation.track.quaternion is not None:
        turns = rotations.multiply(rotations.conjugate(evaluation.track.quaternion), true_turns)
        twists[:, 3:6] = rotations.rotate(turns, twists[:, 3:6])
    return twists


def _grouped(
    evaluation: Evaluation,
    values: FloatArray,
    truth: FloatArray | None,
    variance: FloatArray | None,
    suffix: str,
) -> Iterator[Component]:
    """Shape entries: angles in degrees, by what their names begin with, or coefficients without unit."""
    names = evaluation.track.shape_names
    angular = kind_of(evaluation.subject).shape_unit == "rad"
    scale, unit = (DEG, "deg") if angular else (1.0, "")
    if suffix:
        unit = f"{unit or '1'}/s"
    if truth is not None and truth.shape != values.shape:
        truth = None
    for i, name in enumerate(names):
        finger, _, angle = name.partition("_") if angular else ("", "", "")
        group = f"{finger.capitalize()} angle" if angle else "Shape"
        half = None if variance is None else scale * INSIDE_90 * np.sqrt(np.maximum(variance[:, i], 0.0))
        yield Component(
            f"{group}{suffix or ('s' if angle else '')}",
            (angle or name).replace("_", " "),
            unit,
            scale * values[:, i],
            None if truth is None else scale * truth[:, i],
            half,
        )


def euler_variance(
    q: FloatArray, variance: FloatArray, angles_of: Callable[[FloatArray], FloatArray] = roll_pitch_yaw
) -> FloatArray:
    """Return the variances (N, 3), rad^2, of roll, pitch, yaw, to first order.

    var(angle_i) = sum_j (d angle_i / d r_j)^2 var(r_j), r the rotation vector in the body frame, by central
    differences of q exp(r). Near gimbal lock they grow without bound, as the angles' meaning is lost.

    Args:
        q: (N, 4) unit quaternions.
        variance: (N, 3) of the rotation vector, rad^2.
        angles_of: which angles.
    """
    total = np.zeros((len(q), 3))
    for j in range(3):
        turn = rotations.exponential(DIFFERENCE_RAD * np.eye(3)[j])
        ahead = angles_of(rotations.multiply(q, turn))
        behind = angles_of(rotations.multiply(q, rotations.conjugate(turn)))
        difference = np.mod(ahead - behind + np.pi, 2.0 * np.pi) - np.pi
        total += (difference / (2.0 * DIFFERENCE_RAD)) ** 2 * variance[:, j, None]
    return total


def quaternion_variance(q: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the variances (N, 4) of x, y, z, w, to first order: q (1 + r / 2), r the rotation vector."""
    total = np.zeros((len(q), 4))
    for j in range(3):
        total += (0.5 * rotations.multiply(q, np.eye(4)[j])) ** 2 * variance[:, j, None]
    return total


def _unwrapped(angles: FloatArray) -> FloatArray:
    """Return angles (N, 3), rad, by whole turns such that neighbours do not jump; rows without value stay."""
    known = np.isfinite(angles).all(axis=1)
    unwrapped = angles.copy()
    unwrapped[known] = np.unwrap(angles[known], axis=0)
    return unwrapped


def _nearest_turn(angles: FloatArray, near: FloatArray) -> FloatArray:
    """Return the same angles, deg, by whole turns as near as possible to others."""
    nearest: FloatArray = angles + 360.0 * np.rint((near - angles) / 360.0)
    return nearest


def _continuous(q: FloatArray) -> FloatArray:
    """Return the same rotations with signs such that neighbours do not jump from q to -q."""
    if not len(q):
        return q
    turns = np.where(np.einsum("ni,ni->n", q[1:], q[:-1]) < 0.0, -1.0, 1.0)
    continuous: FloatArray = q * np.concatenate([[1.0], np.cumprod(turns)])[:, None]
    return continuous


def _same_sign(truth: FloatArray | None, q: FloatArray) -> FloatArray | None:
    """Return true quaternions with the signs of the estimated ones."""
    if truth is None:
        return None
    signed: FloatArray = truth * np.where(np.einsum("ni,ni->n", truth, q) < 0.0, -1.0, 1.0)[:, None]
    return signed
