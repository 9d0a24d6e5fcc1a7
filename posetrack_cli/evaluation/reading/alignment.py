"""Alignment of estimates with ground truth: constant rigid offset, scale, and offsets per joint."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.reading.tracks import Pairs, Track
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.rigid import in_object
from posetrack_cli.geometry.rotations import matrices_from_quaternions
from posetrack_cli.hand.fit.skeleton import thumbs_of
from posetrack_cli.hand.model.anatomy import JOINT_NAMES, HandAnatomy
from posetrack_cli.hand.model.kinematics import skinning_transforms

# Constant rigid offset and scale.
#
# Tracker and ground truth may define the origin, axes and points of a head differently. This is a convention
# rather than an error, and constant over the frames. A single camera does not observe the size of a head, so
# that distances and sizes have a common scale error, which can also be removed.


IDENTITY_NOTE = "no constant offset removed: no frame has ground truth"


LEAST_MOTION_MM = 1.0
"""Minimum RMS motion in body axes; with less, the scale is not observable."""
TELLING_FACTOR, TELLING_SHARE = 0.02, 0.6
"""A scale is noted if it differs from 1 by this much and leaves at most this share of the position error."""


def remove_constant_offset(
    track: Track, truth: Track, pairs: Pairs, points: bool = False, scale: bool = False
) -> tuple[Track, str]:
    """Return the estimate with one constant rigid offset of its model frame removed.

    The offset X = (R_X, x) is multiplied from the right: camera_T_object' = camera_T_object X. Over the pairs

    - R_X minimises sum |R_i R_X - R_true,i|_F^2 = sum |R_X - R_i^T R_true,i|_F^2: the mean of the rotations
      R_i^T R_true,i (Markley et al. 2007, ``rotations.mean_quaternion``);
    - x minimises sum |t_i + R_i x - t_true,i|^2 = sum |x - R_i^T (t_true,i - t_i)|^2: the mean of
      R_i^T (t_true,i - t_i).

    Lost frames are ignored unless all are lost.

    The new origin is another point of the same body: v' = v + R (w x x) in camera axes, w' = R_X^T w in the
    new body axes. Variances are propagated as if position and rotation were uncorrelated, as only diagonals
    are stored: with A = -R [x]_x, var(t') = var t + (A o A) var r and var r' = (R_X^T o R_X^T) var r, where o
    is the element-wise product; likewise for velocities.

    Points keep their positions in camera axes; in the object frame they become X^-1 m. With ``points``, the
    constant offset of each point in that frame, mean over the pairs of m_true - m', is also removed.

    With ``scale``, all lengths of the estimate are first multiplied by the factor s that minimises
    sum |s t_i + R_i x - t_true,i|^2 together with x. With a_i = R_i^T t_i and b_i = R_i^T t_true,i as
    deviations from their means, s = sum a_i . b_i / sum |a_i|^2, and x = mean b - s mean a.

    Args:
        track: estimate with poses.
        truth: ground truth with poses, and with the same points if ``points`` is set.
        pairs: associated rows; without any, nothing is removed.
        points: also remove the constant offset of each point.
        scale: also remove one scale factor.

    Returns:
        The aligned estimate, and a note on what was removed.

    Raises:
        UsageError: a side has no poses, or no points or different ones if ``points`` is set.
    """
    _check(track, truth, points)
    if not len(pairs.estimate):
        return track, IDENTITY_NOTE
    mine, theirs = tracked_pairs(track, pairs)
    if scale:
        return _without_scale(track, truth, mine, theirs)
    turn, shift = _offset(track, truth, mine, theirs)
    aligned = _moved(track, turn, shift)
    note = f"removed constant rigid offset: {_readable(turn, shift)}"
    if not points:
        return aligned, note
    offsets = _point_offsets(aligned, truth, mine, theirs)
    largest = float(np.linalg.norm(offsets, axis=1).max())
    return _with_points_moved(
        aligned, offsets
    ), f"{note}; removed constant offset of each point: up to {largest:.1f} mm"


def common_factor(track: Track, truth: Track, pairs: Pairs) -> str:
    """Return a note if one scale factor explains most of the position error; empty otherwise.

    Args:
        track: estimate with poses.
        truth: ground truth with poses.
        pairs: associated rows.
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
        f"a scale factor of {factor:.3f} would reduce the RMS position error from {kept:.1f} to"
        f" {left:.1f} mm; use --align similarity to remove it"
    )


def _without_scale(track: Track, truth: Track, mine: IntArray, theirs: IntArray) -> tuple[Track, str]:
    """Return the estimate without scale factor and rigid offset, and a note."""
    factor = _factor(*_deviations(track, truth, mine, theirs))
    scaled = track if factor is None else _enlarged(track, factor)
    turn, shift = _offset(scaled, truth, mine, theirs)
    note = (
        "no scale removed: the object hardly moves"
        if factor is None
        else f"removed scale factor: {factor:.4f}"
    )
    return _moved(scaled, turn, shift), f"{note}; removed constant rigid offset: {_readable(turn, shift)}"


def _deviations(
    track: Track, truth: Track, mine: IntArray, theirs: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the positions of both sides in the estimated body axes, minus their means, (M, 3)."""
    inverse = rotations.conjugate(_known(track.quaternion)[mine])
    a = rotations.rotate(inverse, _known(track.position)[mine])
    b = rotations.rotate(inverse, _known(truth.position)[theirs])
    return a - a.mean(axis=0), b - b.mean(axis=0)


def _factor(a: FloatArray, b: FloatArray) -> float | None:
    """Return the least-squares factor from a to b; None if a hardly moves or the factor is not positive."""
    squares = float(np.square(a).sum())
    if squares < len(a) * LEAST_MOTION_MM**2:
        return None
    factor = float((a * b).sum()) / squares
    return factor if factor > 0.0 else None


def _enlarged(track: Track, factor: float) -> Track:
    """Return the track with all lengths in camera axes scaled; angles and shape are unchanged."""
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
    """Return tangent vectors (N, 6 + K) with the linear part scaled."""
    if vectors is None:
        return None
    return np.hstack([factors * vectors[:, :3], vectors[:, 3:]])


def _check(track: Track, truth: Track, points: bool) -> None:
    fields = ("position", "quaternion", *(("points",) if points else ()))
    for side, one in (("ground truth", truth), ("result", track)):
        missing = [name for name in fields if getattr(one, name) is None]
        if missing:
            what = f"cannot align: the {side} has no {' and no '.join(missing)}"
            raise UsageError(what, where=one.name, hint="omit --align")
    if points and track.point_names != truth.point_names:
        raise UsageError("cannot align: ground truth and result have different points", where=truth.name)


def tracked_pairs(track: Track, pairs: Pairs) -> tuple[IntArray, IntArray]:
    """Return the rows of track and ground truth of the pairs that are not lost, or of all if all are lost."""
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
    """Return the track with pose and velocity referred to another frame of the same body."""
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
    """Return tangent vectors (N, 6 + K): add lever times angular part to the linear part, and rotate the
    angular part."""
    if vectors is None:
        return None
    carried = vectors.copy()
    carried[:, :3] += np.einsum("nij,nj->ni", levers, vectors[:, 3:6])
    carried[:, 3:6] = vectors[:, 3:6] @ turn.T
    return carried


def _point_offsets(track: Track, truth: Track, mine: IntArray, theirs: IntArray) -> FloatArray:
    """Return the mean difference m_true - m of each point, (P, 3) mm, each side in its object frame."""
    return np.array(  # one point at a time, as the points dominate the memory of a long track
        [
            (_in_object(truth, theirs, point) - _in_object(track, mine, point)).mean(axis=0)
            for point in range(len(track.point_names))
        ]
    )


def _in_object(track: Track, rows: IntArray, point: int) -> FloatArray:
    """Return a point in the object frame, (M, 3): R^T (p - t)."""
    pose = _known(track.position)[rows], _known(track.quaternion)[rows]
    return in_object(_known(track.points)[rows, point], *pose)


def _with_points_moved(track: Track, offsets: FloatArray) -> Track:
    """Return the track with its points moved by offsets (P, 3) in the object frame."""
    points = _known(track.points).copy()
    for point, offset in enumerate(offsets):
        points[:, point] += rotations.rotate(_known(track.quaternion), offset)
    return replace(track, points=points)


def _known(array: FloatArray | None) -> Any:
    """Return an array that ``_check`` has verified to exist, for type checkers."""
    return array


# Constant offset per joint.
#
# Annotators place joints differently from the centres of rotation of a hand model: fingertips at the nail or
# the end of the pad, knuckles on the skin or inside, the wrist closer to the arm. This offset is constant in
# the axes of the bone that ends in the joint. It is not constant in camera axes, as the hand rotates, nor in
# palm axes, as the fingers bend; these are coarser alternatives.


OffsetFrame: TypeAlias = Literal["bone", "palm", "camera"]
AXES: dict[str, str] = {
    "bone": "in bone axes",
    "palm": "in palm axes",
    "camera": "in camera axes",
}
NO_FRAME = "no joint offsets removed: no frame has ground truth"
MOST_MM = 25.0
"""Maximum removed offset, as larger ones are errors: hand rigs and annotations of joints differ by 5 to
20 mm."""
_PALM = 0

Turns: TypeAlias = Callable[[slice], FloatArray]
"""Rotations (n, P, 3, 3) from the frame of each joint to camera axes, for some rows of a track."""
BLOCK_FRAMES = 4096


@dataclass(frozen=True, eq=False)
class JointOffsets:
    """Removed offsets of joints.

    Attributes:
        names: names of the P joints.
        frame: frame of the offsets.
        offsets: (P, 3) ground truth minus estimate, mm; at zero angles and identity rotation, all frames have
            camera axes (for a right hand, x to the thumb, y to the wrist, z out of the back of the hand).
        capped: joints whose offset was limited to ``MOST_MM``.
    """

    names: tuple[str, ...]
    frame: OffsetFrame
    offsets: FloatArray
    capped: tuple[str, ...] = ()

    @property
    def lengths(self) -> FloatArray:
        """(P,) mm."""
        return np.asarray(np.linalg.norm(self.offsets, axis=1), dtype=np.float64)

    @property
    def note(self) -> str:
        """Note for reports."""
        known = self.lengths[self.lengths > 0.0]
        mean, largest = (float(known.mean()), float(known.max())) if known.size else (0.0, 0.0)
        names = ", ".join(self.capped)
        capped = f"; limited to {MOST_MM:g} mm for {names}, as larger offsets are errors" if names else ""
        return (
            f"removed constant offset of each joint {AXES[self.frame]}: mean {mean:.1f} mm, "
            f"max {largest:.1f} mm{capped}"
        )


def remove_joint_offsets(
    track: Track, truth: Track, pairs: Pairs, anatomy: HandAnatomy, frame: OffsetFrame = "bone"
) -> tuple[Track, JointOffsets | None]:
    """Return the estimate with one constant offset per joint removed.

    With R_ij the estimated rotation of the frame of joint j in frame i, over the pairs that are not lost::

        o_j = median_i R_ij^T (p_true,ij - p_ij),        p'_ij = p_ij + R_ij o_j

    The component-wise median is robust to outliers in fewer than half of the frames. Offsets are limited to
    ``MOST_MM``.

    Args:
        track: estimate of a hand with pose, finger angles and joints.
        truth: ground truth with some or all of the joints.
        pairs: associated rows; without any, nothing is removed.
        anatomy: anatomy of the estimated hand.
        frame: ``bone``, the bone that ends in the joint (the palm for wrist and knuckles); ``palm``; or
            ``camera``.

    Returns:
        The aligned estimate, and the removed offsets; None if nothing was removed.

    Raises:
        UsageError: a side has no joints, or the estimate has no pose.
    """
    _check_joints(track, truth)
    if not len(pairs.estimate):
        return track, None
    turns = _turns(track, anatomy, frame)
    found = _offsets(track, truth, tracked_pairs(track, pairs), turns)
    lengths = np.linalg.norm(found, axis=1, keepdims=True)
    capped = tuple(
        name for name, long in zip(track.point_names, lengths[:, 0] > MOST_MM, strict=True) if long
    )
    shares = np.minimum(1.0, MOST_MM / np.maximum(lengths, 1e-9))  # 1e-9 avoids a division by 0
    offsets = JointOffsets(track.point_names, frame, found * shares, capped)
    return replace(track, points=_joints_moved(track, offsets.offsets, turns)), offsets


def _check_joints(track: Track, truth: Track) -> None:
    needed = {
        "ground truth": (truth, ("points",)),
        "result": (track, ("points", "position", "quaternion", "shape")),
    }
    for side, (one, fields) in needed.items():
        missing = [name for name in fields if getattr(one, name) is None]
        if missing:
            what = f"cannot remove joint offsets: the {side} has no {' and no '.join(missing)}"
            raise UsageError(what, where=one.name, hint="omit --joint-offsets")
    if not set(truth.point_names) <= set(track.point_names):
        raise UsageError(
            "cannot remove joint offsets: ground truth and result have different joints", where=truth.name
        )


def _turns(track: Track, anatomy: HandAnatomy, frame: OffsetFrame) -> Turns:
    assert track.position is not None and track.quaternion is not None and track.shape is not None
    poses = np.hstack([track.position, track.quaternion, track.shape])
    joints = len(track.point_names)
    bones = bone_of_joints(track.point_names)
    thumbs = thumbs_of(track.numbers, len(poses))

    def turns(rows: slice) -> FloatArray:
        if frame == "bone":
            return skinning_transforms(anatomy, poses[rows], thumbs[rows])[:, bones, :, :3].astype(np.float64)
        count = len(poses[rows])
        palm = matrices_from_quaternions(poses[rows, 3:7]) if frame == "palm" else np.eye(3)[None]
        return np.broadcast_to(palm[:, None], (count, joints, 3, 3))

    return turns


def bone_of_joints(names: tuple[str, ...]) -> IntArray:
    """Return the index of the bone that ends in each joint, in the order of ``skinning_transforms``."""
    places = np.array([JOINT_NAMES.index(name) for name in names], dtype=np.int64)
    finger, joint = np.divmod(places - 1, 4)
    return np.where((places == 0) | (joint == 0), _PALM, 3 * finger + joint)


def _blocks(rows: int) -> Iterator[slice]:
    """Split rows into blocks, as the rotations of a long track need many times its memory."""
    return (slice(first, first + BLOCK_FRAMES) for first in range(0, rows, BLOCK_FRAMES))


def _offsets(track: Track, truth: Track, pairs: tuple[IntArray, IntArray], turns: Turns) -> FloatArray:
    """Return the median (P, 3) of the differences in the frame of each joint; 0 without ground truth."""
    assert track.points is not None and truth.points is not None
    mine, theirs = pairs
    columns = [track.point_names.index(name) for name in truth.point_names]
    differences = np.zeros_like(track.points)
    differences[mine[:, None], columns] = truth.points[theirs] - track.points[mine[:, None], columns]
    for rows in _blocks(len(track)):
        differences[rows] = np.einsum("npji,npj->npi", turns(rows), differences[rows])
    return np.asarray(np.median(differences[mine], axis=0), dtype=np.float64)


def _joints_moved(track: Track, offsets: FloatArray, turns: Turns) -> FloatArray:
    """Return the joints (N, P, 3) with their offsets added."""
    assert track.points is not None
    points = track.points.copy()
    for rows in _blocks(len(track)):
        points[rows] += np.einsum("npij,pj->npi", turns(rows), offsets)
    return points
