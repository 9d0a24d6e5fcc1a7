"""Estimates brought to the truth's frame, and joints to its joints."""

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

# Remove what is constant in the difference between an estimate and a truth: where a model's frame sits.
#
# A tracker and a truth may put the origin and the axes of the same head differently, and mark its points
# differently. That is a convention, no error, and it is the same in every frame. One camera does not see how
# large a head is: then all distances and sizes are wrong by one common factor, which can be removed, too.


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


# Remove one constant offset per joint: what two conventions of where a joint is differ by.
#
# Who marks joints on images puts them at other places than a model's centres of rotation: a tip at the nail
# or at the end of the pad, a knuckle on the skin or inside, the wrist nearer to the arm. That is the same in
# every frame as seen from the bone that the joint is the end of, but neither in camera axes, in which the
# hand turns, nor in the palm's, in which the fingers bend. So the bone's axes are the default; the others are
# coarser.


OffsetFrame: TypeAlias = Literal["bone", "palm", "camera"]
AXES: dict[str, str] = {
    "bone": "in the axes of the bone that ends in it",
    "palm": "in the palm's axes",
    "camera": "in camera axes",
}
NO_FRAME = "no constant offset per joint removed: no frame has a truth"
MOST_MM = 25.0
"""As far apart two conventions put a joint; what is farther is an error, and stays one. Two rigs of one hand,
and people who mark joints on the skin or inside, differ by 5 to 20 mm."""
_PALM = 0

Turns: TypeAlias = Callable[[slice], FloatArray]
"""Rotations (n, P, 3, 3) from each joint's frame to camera axes, of some rows of a track."""
BLOCK_FRAMES = 4096


@dataclass(frozen=True, eq=False)
class JointOffsets:
    """What was removed.

    Attributes:
        names: P joints.
        frame: whose axes they are in.
        offsets: (P, 3) mm, truth minus estimate; at zero angles and with the identity rotation every frame's
            axes are the camera's (x towards a right hand's thumb, y to the wrist, z out of its back).
        capped: those whose offset was longer than ``MOST_MM``, of which so much was removed.
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
        """One line for those who read the figures."""
        largest = float(self.lengths.max())
        names = ", ".join(self.capped)
        doubt = f"; of {names} no more, for what is longer is an error, no convention" if names else ""
        return (
            f"one constant offset per joint removed, {AXES[self.frame]}: {self.lengths.mean():.1f} mm on "
            f"average, up to {largest:.1f} mm{doubt}"
        )


def remove_joint_offsets(
    track: Track, truth: Track, pairs: Pairs, anatomy: HandAnatomy, frame: OffsetFrame = "bone"
) -> tuple[Track, JointOffsets | None]:
    """Return the estimate with one constant offset per joint removed.

    With R_ij the rotation of joint j's frame in frame i, as estimated, and over the pairs that are not lost::

        o_j = median_i R_ij^T (p_true,ij - p_ij),        p'_ij = p_ij + R_ij o_j

    The median is taken by component: frames in which the estimate is off, fewer than half, do not pull it. An
    offset longer than ``MOST_MM`` is shortened to it.

    Args:
        track: the estimate of a hand, with pose, finger angles and joints.
        truth: with the same joints.
        pairs: which rows belong together; with none nothing is removed.
        anatomy: of the estimated hand.
        frame: ``bone``: of the bone that the joint is the end of (of the wrist and where the fingers begin
            the palm); ``palm``; or ``camera``.

    Returns:
        The estimate, and what was removed; None where nothing was.

    Raises:
        UsageError: a side has no joints, or the estimate no pose.
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
    shares = np.minimum(1.0, MOST_MM / np.maximum(lengths, 1e-9))
    offsets = JointOffsets(track.point_names, frame, found * shares, capped)
    return replace(track, points=_joints_moved(track, offsets.offsets, turns)), offsets


def _check_joints(track: Track, truth: Track) -> None:
    needed = {"truth": (truth, ("points",)), "result": (track, ("points", "position", "quaternion", "shape"))}
    for side, (one, fields) in needed.items():
        missing = [name for name in fields if getattr(one, name) is None]
        if missing:
            what = f"the {side} has no {' and no '.join(missing)} to remove joints' offsets by"
            raise UsageError(what, where=one.name, hint="leave --joint-offsets out")
    if track.point_names != truth.point_names:
        raise UsageError("truth and result have other joints: no offset per joint", where=truth.name)


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
    """Return for each joint the bone that it is the end of, as ``skinning_transforms`` numbers them."""
    places = np.array([JOINT_NAMES.index(name) for name in names], dtype=np.int64)
    finger, joint = np.divmod(places - 1, 4)
    return np.where((places == 0) | (joint == 0), _PALM, 3 * finger + joint)


def _blocks(rows: int) -> Iterator[slice]:
    """A long track's rotations are many times its size: some frames at a time."""
    return (slice(first, first + BLOCK_FRAMES) for first in range(0, rows, BLOCK_FRAMES))


def _offsets(track: Track, truth: Track, pairs: tuple[IntArray, IntArray], turns: Turns) -> FloatArray:
    """The median (P, 3) of the differences, each in its joint's frame."""
    assert track.points is not None and truth.points is not None
    mine, theirs = pairs
    differences = np.full_like(track.points, np.nan)
    differences[mine] = truth.points[theirs] - track.points[mine]
    for rows in _blocks(len(track)):
        differences[rows] = np.einsum("npji,npj->npi", turns(rows), differences[rows])
    return np.asarray(np.median(differences[mine], axis=0), dtype=np.float64)


def _joints_moved(track: Track, offsets: FloatArray, turns: Turns) -> FloatArray:
    """The joints (N, P, 3) with their offsets."""
    assert track.points is not None
    points = track.points.copy()
    for rows in _blocks(len(track)):
        points[rows] += np.einsum("npij,pj->npi", turns(rows), offsets)
    return points
