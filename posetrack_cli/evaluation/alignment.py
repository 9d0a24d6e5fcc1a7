"""Remove what is constant in the difference between an estimate and a truth: where a model's frame sits.

A tracker and a truth may put the origin and the axes of the same head differently, and mark its points
differently. That is a convention, no error, and it is the same in every frame. One camera does not see how
large a head is: then all distances and sizes are wrong by one common factor, which can be removed, too.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.association import Pairs
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.rigid import in_object

IDENTITY_NOTE = "no constant offset removed: no frame has a truth"


LEAST_MOTION_MM = 1.0
"""Root mean square of how a body moves in its own axes: what moves less tells no scale."""
TELLING_FACTOR, TELLING_SHARE = 0.02, 0.6
"""A common factor is remarked if it is so far from 1, and leaves no more than this share of the errors."""


def remove_constant_offset(
    track: Track, truth: Track, pairs: Pairs, points: bool = False, scale: bool = False
) -> tuple[Track, str]:
    """Return the estimate with one constant rigid offset of its model frame removed.

    The offset X = (R_X, x) stands right of every pose: camera_T_object' = camera_T_object X. Over the pairs

    - R_X minimises sum |R_i R_X - R_true,i|_F^2 = sum |R_X - R_i^T R_true,i|_F^2: the mean of the rotations
      R_i^T R_true,i (Markley et al. 2007, ``rotations.mean_quaternion``);
    - x minimises sum |t_i + R_i x - t_true,i|^2 = sum |x - R_i^T (t_true,i - t_i)|^2, as rotations keep
      lengths: the mean of R_i^T (t_true,i - t_i).

    Neither depends on the other, and the two sums never grow. Lost frames say nothing about a convention and
    do not count, unless all are lost.

    The new origin is another point of the same body, so the velocity becomes v' = v + R (w x x) in camera
    axes, w' = R_X^T w in the new body axes. Variances follow as if position and rotation were uncorrelated,
    since only diagonals are stated: with A = -R [x]_x, var(t') = var t + (A o A) var r and
    var r' = (R_X^T o R_X^T) var r, where o multiplies entry by entry; of velocities likewise.

    The points in camera axes stay where they are: in the object's frame they become X^-1 m. With ``points``
    each point's constant offset in that frame, mean over the pairs of m_true - m', is then removed, too.

    With ``scale`` all lengths of the estimate are first multiplied by one factor s, seen from the camera: the
    s that minimises sum |s t_i + R_i x - t_true,i|^2 together with x. With a_i = R_i^T t_i, b_i =
    R_i^T t_true,i and their deviations from the mean it is s = sum a_i . b_i / sum |a_i|^2, and x =
    mean b - s mean a.

    Args:
        track: the estimate, with poses.
        truth: with poses, and with ``points`` the same points.
        pairs: which rows belong together; with none nothing is removed.
        points: whether each point's offset is removed, too.
        scale: whether one factor on all lengths is.

    Returns:
        The aligned estimate, and a note that says what was removed.

    Raises:
        UsageError: a side has no poses, or with ``points`` no points, or other ones.
    """
    _check(track, truth, points)
    if not len(pairs.estimate):
        return track, IDENTITY_NOTE
    mine, theirs = tracked_pairs(track, pairs)
    if scale:
        return _without_scale(track, truth, mine, theirs)
    turn, shift = _offset(track, truth, mine, theirs)
    aligned = _moved(track, turn, shift)
    note = f"one constant rigid offset removed: {_readable(turn, shift)}"
    if not points:
        return aligned, note
    offsets = _point_offsets(aligned, truth, mine, theirs)
    largest = float(np.linalg.norm(offsets, axis=1).max())
    return _with_points_moved(
        aligned, offsets
    ), f"{note}; each point's constant offset, up to {largest:.1f} mm"


def common_factor(track: Track, truth: Track, pairs: Pairs) -> str:
    """Return a remark that one factor on all lengths would explain most position errors; empty if not.

    Args:
        track: the estimate, with poses.
        truth: with poses.
        pairs: which rows belong together.
    """
    if not len(pairs.estimate):
        return ""
    mine, theirs = tracked_pairs(track, pairs)
    a, b = _deviations(track, truth, mine, theirs)
    factor = _factor(a, b)
    if factor is None or abs(factor - 1.0) < TELLING_FACTOR:
        return ""
    kept, left = (float(np.sqrt(np.square(one * a - b).sum(axis=1).mean())) for one in (1.0, factor))
    if left > TELLING_SHARE * kept:
        return ""
    return (
        f"one factor of {factor:.3f} on distance and size would take the position error from {kept:.1f} to"
        f" {left:.1f} mm (root mean square), and points with it: --align similarity removes it"
    )


def _without_scale(track: Track, truth: Track, mine: IntArray, theirs: IntArray) -> tuple[Track, str]:
    """The estimate without one factor and one offset, and a note."""
    factor = _factor(*_deviations(track, truth, mine, theirs))
    scaled = track if factor is None else _enlarged(track, factor)
    turn, shift = _offset(scaled, truth, mine, theirs)
    told = (
        "no scale removed, as the object hardly moves"
        if factor is None
        else f"one scale removed: {factor:.4f}"
    )
    return _moved(scaled, turn, shift), f"{told}; one constant rigid offset: {_readable(turn, shift)}"


def _deviations(
    track: Track, truth: Track, mine: IntArray, theirs: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return both sides' positions in the estimated object's axes, less their means, (M, 3)."""
    inverse = rotations.conjugate(_known(track.quaternion)[mine])
    a = rotations.rotate(inverse, _known(track.position)[mine])
    b = rotations.rotate(inverse, _known(truth.position)[theirs])
    return a - a.mean(axis=0), b - b.mean(axis=0)


def _factor(a: FloatArray, b: FloatArray) -> float | None:
    """Return the best common factor from a to b; None where a hardly moves, or none above 0 is best."""
    squares = float(np.square(a).sum())
    if squares < len(a) * LEAST_MOTION_MM**2:
        return None
    factor = float((a * b).sum()) / squares
    return factor if factor > 0.0 else None


def _enlarged(track: Track, factor: float) -> Track:
    """Return the track with all lengths in camera axes multiplied; angles and shape stay."""
    lengths = np.array([factor] * 3)
    return replace(
        track,
        position=factor * _known(track.position),
        points=None if track.points is None else factor * track.points,
        twist=_times(track.twist, lengths),
        pose_variance=_times(track.pose_variance, lengths**2),
        twist_variance=_times(track.twist_variance, lengths**2),
    )


def _times(vectors: FloatArray | None, factors: FloatArray) -> FloatArray | None:
    """Return tangent vectors (N, 6 + K) with the linear part multiplied."""
    if vectors is None:
        return None
    return np.hstack([factors * vectors[:, :3], vectors[:, 3:]])


def _check(track: Track, truth: Track, points: bool) -> None:
    fields = ("position", "quaternion", *(("points",) if points else ()))
    for side, one in (("truth", truth), ("result", track)):
        missing = [name for name in fields if getattr(one, name) is None]
        if missing:
            what = f"the {side} has no {' and no '.join(missing)} to align by"
            raise UsageError(what, where=one.name, hint="leave --align out")
    if points and track.point_names != truth.point_names:
        raise UsageError("truth and result have other points and cannot be aligned", where=truth.name)


def tracked_pairs(track: Track, pairs: Pairs) -> tuple[IntArray, IntArray]:
    """Return the rows, of track and truth, of the pairs that are not lost, or of all if all are."""
    if track.lost is None or track.lost[pairs.estimate].all():
        return pairs.estimate, pairs.truth
    kept = ~track.lost[pairs.estimate]
    return pairs.estimate[kept], pairs.truth[kept]


def _offset(track: Track, truth: Track, mine: IntArray, theirs: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the offset X: quaternion (4,) and translation (3,), mm."""
    inverse = rotations.conjugate(_known(track.quaternion)[mine])
    turns = rotations.multiply(inverse, _known(truth.quaternion)[theirs])
    shifts = rotations.rotate(inverse, _known(truth.position)[theirs] - _known(track.position)[mine])
    return rotations.mean_quaternion(turns, np.ones(len(turns))), shifts.mean(axis=0)


def _readable(turn: FloatArray, shift: FloatArray) -> str:
    angle = float(np.degrees(rotations.angle_between(np.array(rotations.IDENTITY), turn)))
    x, y, z = np.round(shift, 1) + 0.0  # no -0.0
    return f"{x:.1f} {y:.1f} {z:.1f} mm, {angle:.1f} deg"


def _moved(track: Track, turn: FloatArray, shift: FloatArray) -> Track:
    """Return the track with every pose, and its velocity, taken at another place of the same body."""
    quaternion = _known(track.quaternion)
    back = rotations.matrices_from_quaternions(turn).T
    levers = -rotations.matrices_from_quaternions(quaternion) @ rotations.cross_matrices(shift)  # (N, 3, 3)
    return replace(
        track,
        position=_known(track.position) + rotations.rotate(quaternion, shift),
        quaternion=rotations.canonical(rotations.multiply(quaternion, turn)),
        twist=_carried(track.twist, levers, back),
        pose_variance=_carried(track.pose_variance, levers**2, back**2),
        twist_variance=_carried(track.twist_variance, levers**2, back**2),
    )


def _carried(vectors: FloatArray | None, levers: FloatArray, turn: FloatArray) -> FloatArray | None:
    """Return tangent vectors (N, 6 + K): the linear part plus lever times angular part, the latter turned."""
    if vectors is None:
        return None
    carried = vectors.copy()
    carried[:, :3] += np.einsum("nij,nj->ni", levers, vectors[:, 3:6])
    carried[:, 3:6] = vectors[:, 3:6] @ turn.T
    return carried


def _point_offsets(track: Track, truth: Track, mine: IntArray, theirs: IntArray) -> FloatArray:
    """Return each point's mean difference m_true - m, (P, 3) mm, each side in its object's frame.

    One point at a time: a long track's points are most of its memory.
    """
    return np.array(
        [
            (_in_object(truth, theirs, point) - _in_object(track, mine, point)).mean(axis=0)
            for point in range(len(track.point_names))
        ]
    )


def _in_object(track: Track, rows: IntArray, point: int) -> FloatArray:
    """Return one point in the object's frame, (M, 3): R^T (p - t)."""
    pose = _known(track.position)[rows], _known(track.quaternion)[rows]
    return in_object(_known(track.points)[rows, point], *pose)


def _with_points_moved(track: Track, offsets: FloatArray) -> Track:
    """Return the track with its points moved by offsets (P, 3) in the object's frame."""
    points = _known(track.points).copy()
    for point, offset in enumerate(offsets):
        points[:, point] += rotations.rotate(_known(track.quaternion), offset)
    return replace(track, points=points)


def _known(array: FloatArray | None) -> Any:
    """Return an array that ``_check`` found to be there."""
    return array
