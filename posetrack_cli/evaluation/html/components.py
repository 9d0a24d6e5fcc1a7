"""Trajectory components and pictures of the worst frames for the HTML report."""

from __future__ import annotations

import base64
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.measuring.pose_metrics import INSIDE_90
from posetrack_cli.evaluation.measuring.subjects import KINDS
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.evaluation.viewing.frame_choice import APART_NS
from posetrack_cli.evaluation.viewing.pictures import Picture, errors_of
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.rotations import roll_pitch_yaw
from posetrack_cli.results.estimate import kind_of
from posetrack_cli.units import NS_PER_S

# Trajectory components: estimate, ground truth and 90 % band


def readable(name: str) -> str:
    """Return a name with spaces instead of underscores."""
    return name.replace("_", " ")


DIFFERENCE_RAD = 1e-6
"""Step of the numerical derivatives of Euler angles with respect to the rotation vector."""

DEG = 180.0 / np.pi
AXES = ("x", "y", "z")
EULER = ("roll", "pitch", "yaw")


@dataclass(frozen=True, eq=False)
class Component:
    """A scalar component over time.

    Attributes:
        group: components of a group are shown together.
        label, unit: label and unit of the axis.
        estimate: (N,) estimate.
        truth: (N,) ground truth at the frames of the estimate, NaN where missing; None if unknown.
        half_width: (N,) half width of the 90 % band; None without variances.
    """

    group: str
    label: str
    unit: str
    estimate: FloatArray
    truth: FloatArray | None
    half_width: FloatArray | None


def components(evaluation: Evaluation) -> Iterator[Component]:
    """Yield the components of a track in page order."""
    body = KINDS[evaluation.subject].body
    yield from leading_components(evaluation)
    yield from _positions(evaluation, f"{body} position")
    if not KINDS[evaluation.subject].expressions:
        yield from _angles(evaluation, f"{body} rotation")
    yield from _quaternions(evaluation, f"{body} rotation, quaternion")
    yield from _shapes(evaluation)
    yield from _velocities(evaluation, body)


def leading_components(evaluation: Evaluation) -> Iterator[Component]:
    """Yield rotation and expressions, which start the page for subjects with expressions."""
    kind = KINDS[evaluation.subject]
    if kind.expressions:
        group = f"{kind.body} angles and expressions"
        yield from _angles(evaluation, group)
        yield from _expressions(evaluation, group, kind.expressions)


def matched_truth(
    evaluation: Evaluation, field: Callable[[Track], FloatArray | None], rows: IntArray | None = None
) -> FloatArray | None:
    """Return a field of the ground truth at the frames of the estimate; NaN in frames without it.

    Args:
        evaluation: the evaluation.
        field: returns an (N, ...) array of a track.
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
    """Yield a component per column; ground truth with other columns is ignored."""
    if truth is not None and truth.shape != estimate.shape:
        truth = None
    for i, name in enumerate(names):
        # Negative variances, possible in untrusted files, are drawn as 0.
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
    """Yield expressions as shares of their maximum; ``action_jaw_open`` is labelled ``jaw open``."""
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
    """Return the true twists with angular velocity in the estimated body axes: R_est^T R_true w_true."""
    twists = matched_truth(evaluation, lambda other: other.twist)
    true_turns = matched_truth(evaluation, lambda other: other.quaternion)
    if twists is not None and true_turns is not None and evaluation.track.quaternion is not None:
        turns = rotations.multiply(rotations.conjugate(evaluation.track.quaternion), true_turns)
        # matched_truth returns a copy, so the ground truth itself is not modified.
        twists[:, 3:6] = rotations.rotate(turns, twists[:, 3:6])
    return twists


def _grouped(
    evaluation: Evaluation,
    values: FloatArray,
    truth: FloatArray | None,
    variance: FloatArray | None,
    suffix: str,
) -> Iterator[Component]:
    """Yield shape entries: angles in degrees, grouped by finger, or coefficients without unit."""
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
    """Return the variances (N, 3) of roll, pitch and yaw, rad^2, to first order.

    var(angle_i) = sum_j (d angle_i / d r_j)^2 var(r_j) with r the rotation vector in the body frame, by
    central differences of q exp(r). They are unbounded near gimbal lock.

    Args:
        q: (N, 4) unit quaternions.
        variance: (N, 3) variances of the rotation vector, rad^2.
        angles_of: converts quaternions to Euler angles.
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
    """Return the variances (N, 4) of x, y, z, w to first order, from q (1 + r / 2) with rotation vector r."""
    total = np.zeros((len(q), 4))
    for j in range(3):
        total += (0.5 * rotations.multiply(q, np.eye(4)[j])) ** 2 * variance[:, j, None]
    return total


def _unwrapped(angles: FloatArray) -> FloatArray:
    """Return angles (N, 3), rad, unwrapped over time; rows without a value are unchanged."""
    known = np.isfinite(angles).all(axis=1)
    unwrapped = angles.copy()
    unwrapped[known] = np.unwrap(angles[known], axis=0)
    return unwrapped


def _nearest_turn(angles: FloatArray, near: FloatArray) -> FloatArray:
    """Return angles, deg, shifted by full turns to be closest to other angles."""
    nearest: FloatArray = angles + 360.0 * np.rint((near - angles) / 360.0)
    return nearest


def _continuous(q: FloatArray) -> FloatArray:
    """Return the quaternions with signs that are continuous over time."""
    if not len(q):
        return q
    turns = np.where(np.einsum("ni,ni->n", q[1:], q[:-1]) < 0.0, -1.0, 1.0)
    continuous: FloatArray = q * np.concatenate([[1.0], np.cumprod(turns)])[:, None]
    return continuous


def _same_sign(truth: FloatArray | None, q: FloatArray) -> FloatArray | None:
    """Return the true quaternions in the hemisphere of the estimated ones."""
    if truth is None:
        return None
    signed: FloatArray = truth * np.where(np.einsum("ni,ni->n", truth, q) < 0.0, -1.0, 1.0)[:, None]
    return signed


# Pictures of the worst frames


MOST_BYTES = 3_500_000
"""Limit of the size of all pictures: 4.7 MB as base64, half of a page of 10 MB."""


NO_FRAMES = "No pictures: the result has no frames."
NOT_DRAWN = "No pictures were drawn."
NO_ROOM = "No pictures: the size limit is used up by other results."

WIDE = 1.5
"""Aspect ratio above which pictures get more space."""
# Offset of width and height in a PNG file.
_PNG_SIZE_AT = 16

Pictures: TypeAlias = Mapping[str, Sequence[Picture] | str]
"""Pictures by result name, worst first; or the reason why there are none."""


@dataclass(frozen=True, eq=False)
class Gallery:
    """Pictures that fit on the page.

    Attributes:
        pictures: pictures by result name.
        missing: reasons why there are none, by result name.
        dropped: number of pictures left out because of the size limit.
    """

    pictures: Mapping[str, Sequence[Picture]]
    missing: Mapping[str, str]
    dropped: int


def fitting(evaluations: Sequence[Evaluation], pictures: Pictures) -> Gallery:
    """Select pictures within ``MOST_BYTES``, taking the first of each result, then the second, and so on."""
    given = {one.name: pictures.get(one.name, ()) for one in evaluations}
    drawn = {name: () if isinstance(found, str) else found for name, found in given.items()}
    kept: dict[str, list[Picture]] = {name: [] for name in drawn}
    rest = MOST_BYTES
    for _, name, picture in sorted(
        ((place, name, one) for name, found in drawn.items() for place, one in enumerate(found)),
        key=lambda entry: entry[0],
    ):
        if len(picture.png) <= rest:
            kept[name].append(picture)
            rest -= len(picture.png)
    missing = {one.name: _reason(one, given[one.name]) for one in evaluations if not kept[one.name]}
    return Gallery(kept, missing, sum(map(len, drawn.values())) - sum(map(len, kept.values())))


def _reason(evaluation: Evaluation, given: Sequence[Picture] | str) -> str:
    if isinstance(given, str):
        return f"No pictures: {given.rstrip('.')}."
    if given:
        return NO_ROOM
    return NOT_DRAWN if evaluation.coverage.frames else NO_FRAMES


@dataclass(frozen=True)
class Figure:
    """An embedded picture.

    Attributes:
        source: data URL of the image.
        caption: caption.
        frame_index: frame number in the recording.
        width, height: size, px.
    """

    source: str
    caption: str
    frame_index: int
    width: int
    height: int


@dataclass(frozen=True)
class Group:
    """Pictures of a result.

    Attributes:
        name: name of the result.
        pictures: pictures, worst first.
        missing: reason why there are none.
        chosen_by: description of the ranking.
    """

    name: str
    pictures: tuple[Figure, ...]
    missing: str
    chosen_by: str

    @property
    def is_wide(self) -> bool:
        """Whether the pictures are wide, such as those with several panels."""
        return any(one.width > WIDE * one.height for one in self.pictures)


def groups(evaluations: Sequence[Evaluation], gallery: Gallery) -> list[Group]:
    """Return the pictures of each result; the page shows those of the selected result."""
    return [
        Group(
            one.name,
            tuple(map(_figure, gallery.pictures[one.name])),
            gallery.missing.get(one.name, ""),
            chosen_by(one),
        )
        for one in evaluations
    ]


def chosen_by(evaluation: Evaluation) -> str:
    """Return a description of how the worst frames are selected."""
    _, error = errors_of(evaluation)
    order = (
        f"Sorted by {error}"
        if error
        else "No ground truth: lost frames first, then those with the lowest confidence"
    )
    truth = "" if evaluation.truth is None else " Ground truth is drawn in green."
    return f"{order}; at least {APART_NS / NS_PER_S:g} s apart.{truth}"


def _figure(picture: Picture) -> Figure:
    width, height = struct.unpack_from(">II", picture.png, _PNG_SIZE_AT)
    return Figure(data_url(picture.png), picture.caption, picture.frame_index, width, height)


DATA_URL = "data:image/png;base64,"


def data_url(png: bytes) -> str:
    """Return a PNG file as a data URL."""
    return DATA_URL + base64.b64encode(png).decode("ascii")
