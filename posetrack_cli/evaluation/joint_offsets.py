"""Remove one constant offset per joint: what two conventions of where a joint is differ by.

Who marks joints on images puts them at other places than a model's centres of rotation: a tip at the nail or
at the end of the pad, a knuckle on the skin or inside, the wrist nearer to the arm. That is the same in every
frame as seen from the bone that the joint is the end of, but neither in camera axes, in which the hand turns,
nor in the palm's, in which the fingers bend. So the bone's axes are the default; the others are coarser.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.alignment import tracked_pairs
from posetrack_cli.evaluation.association import Pairs
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry.rotations import matrices_from_quaternions
from posetrack_cli.hand.anatomy import JOINT_NAMES, HandAnatomy
from posetrack_cli.hand.inner import thumbs_of
from posetrack_cli.hand.kinematics import skinning_transforms

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
    _check(track, truth)
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
    return replace(track, points=_moved(track, offsets.offsets, turns)), offsets


def _check(track: Track, truth: Track) -> None:
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


def _moved(track: Track, offsets: FloatArray, turns: Turns) -> FloatArray:
    """The joints (N, P, 3) with their offsets."""
    assert track.points is not None
    points = track.points.copy()
    for rows in _blocks(len(track)):
        points[rows] += np.einsum("npij,pj->npi", turns(rows), offsets)
    return points
