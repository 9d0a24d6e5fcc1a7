"""Export of a hand track to BVH, the animation format of Blender and motion editors.

BVH (Biovision hierarchy; Meredith and Maddock, "Motion capture file formats explained", 2001) stores a
skeleton by the offset of each joint from its parent, then for every frame the rotation R of each joint in the
axes of its parent: ``p = p_parent + G_parent offset``, ``G = G_parent R``. It has no units, axes, lost frames
or times other than a fixed step. We write:

- metres, Blender's unit, with y up as its importer expects: camera axes after half a turn about x;
- a rest skeleton with all angles 0: a flat hand, fingers up, palm to the viewer;
- frames of a fixed rate (``results.export.table``), interpolated where there is no estimate.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.hand.fit.skeleton import thumbs_of
from posetrack_cli.hand.model.anatomy import (
    ANGLE_NAMES,
    ANGLES,
    BONE_COUNT,
    JOINT_NAMES,
    JOINT_PARENTS,
    POSE_SIZE,
    HandAnatomy,
)
from posetrack_cli.hand.model.kinematics import joint_positions, skinning_transforms
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.export.source import ExportSource
from posetrack_cli.results.export.table import FixedRate, fixed_rate
from posetrack_cli.results.fields import NUMBERS
from posetrack_cli.units import METRES_PER_MM

SUBJECT = "hand"
FIELDS = ("stamp_ns", "position", "quaternion", "shape", "points")
"""Required columns; inner numbers are added if the result has them."""
Y_UP: FloatArray = np.array([1.0, -1.0, -1.0])
"""Half a turn about x, from camera axes to y up, z towards the viewer."""
SAME_HAND_MM = 0.01
"""Tolerance of joints between track and skeleton: rounding, far below the difference of two hands."""

_WRIST_ORDER = ("Y", "X", "Z")
_FINGER_ORDER = ("X", "Y", "Z")
"""Outermost first. A finger bends about x and hardly twists about y, which keeps the middle angle away from
90 degrees, where Euler angles jump."""
_FRAMES_AT_ONCE = 1000


def bvh_text(source: ExportSource, anatomy: HandAnatomy) -> tuple[FixedRate, Iterator[str]]:
    """Return the frames of a hand track, and its BVH in pieces.

    Args:
        source: a hand track.
        anatomy: of the tracked hand.

    Raises:
        UsageError: see ``check_hand``.
        ResultError: the track is of another hand, or see ``results.export.table``.
    """
    check_hand(source, "BVH")
    where = source.where
    further = (NUMBERS,) if source.result.subject.number_names else ()
    columns = source.columns(FIELDS + further)
    rate = fixed_rate(columns["stamp_ns"], where)
    poses = _poses(columns)
    thumbs = thumbs_of(columns.get(NUMBERS), len(poses))
    off = np.abs(joint_positions(anatomy, poses, thumbs) - columns["points"]).max(initial=0.0)
    if not off <= SAME_HAND_MM:  # also refuses NaN
        expected = "the joints of the hand that the run tracked"
        raise ResultError(
            "track is of another hand", where=where, found=f"joints off by {off:.3g} mm", expected=expected
        )
    poses = _filled(poses, rate)
    return rate, _pieces(anatomy, rate, poses, _interpolated(thumbs, rate))


def check_hand(source: ExportSource, format_name: str) -> None:
    """Raise UsageError unless a track has our hand's joints and angles, for a format that needs them."""
    subject = source.result.subject
    if (subject.name, subject.point_names, subject.shape_names) != (SUBJECT, JOINT_NAMES, ANGLE_NAMES):
        what = f"{format_name} requires a result of posetrack hand run, not of a {subject.name}"
        raise UsageError(what, where=source.result.path, hint="use --format tum for poses, c3d for points")


def _poses(columns: Columns) -> FloatArray:
    poses = np.empty((len(columns["stamp_ns"]), POSE_SIZE))
    poses[:, :3], poses[:, 3:7], poses[:, ANGLES] = (
        columns[name] for name in ("position", "quaternion", "shape")
    )
    return poses


def _filled(poses: FloatArray, rate: FixedRate) -> FloatArray:
    """Return the pose of each frame, interpolated without an estimate."""
    known, frames = np.flatnonzero(rate.known), np.arange(len(rate.rows))
    stated = poses[rate.rows[known]]
    if len(known) == len(frames):
        return stated
    out = _interpolated(poses, rate)
    out[:, 3:7] = Slerp(known, Rotation.from_quat(stated[:, 3:7]))(frames).as_quat()
    return out


def _interpolated(numbers: FloatArray, rate: FixedRate) -> FloatArray:
    """Return estimates' numbers (N, K) at each frame (F, K), interpolated without an estimate."""
    known, frames = np.flatnonzero(rate.known), np.arange(len(rate.rows))
    return np.stack([np.interp(frames, known, column) for column in numbers[rate.rows[known]].T], axis=1)


def _pieces(anatomy: HandAnatomy, rate: FixedRate, poses: FloatArray, thumbs: FloatArray) -> Iterator[str]:
    yield "HIERARCHY\n" + "\n".join(_joint(_offsets(anatomy), 0, "")) + "\n"
    yield f"MOTION\nFrames: {len(poses)}\nFrame Time: {1.0 / rate.rate_hz:.9f}\n"
    channels = _channels(anatomy, poses, thumbs)
    for first in range(0, len(poses), _FRAMES_AT_ONCE):
        yield "".join(f"{_numbers(row)}\n" for row in channels[first : first + _FRAMES_AT_ONCE])


def _numbers(values: FloatArray) -> str:
    """Format values to 1e-6 (micrometres, microdegrees), without minus zero."""
    return " ".join(f"{value:.6f}" for value in (values.round(6) + 0.0).tolist())


def _offsets(anatomy: HandAnatomy) -> FloatArray:
    """Return the offset of each joint (21, 3) from its parent at rest, in metres, y up."""
    rest = np.zeros((1, POSE_SIZE))
    rest[0, 6] = 1.0
    joints = joint_positions(anatomy, rest)[0]
    parents = np.array(JOINT_PARENTS)
    offsets = joints - np.where(parents[:, None] < 0, 0.0, joints[parents])
    return np.asarray(METRES_PER_MM * offsets * Y_UP)


def _joint(offsets: FloatArray, joint: int, indent: str) -> Iterator[str]:
    """Yield the lines of a joint and its descendants; a fingertip is an unnamed end site."""
    children = [child for child, parent in enumerate(JOINT_PARENTS) if parent == joint]
    inner = indent + "\t"
    kind = "End Site" if not children else f"{'JOINT' if joint else 'ROOT'} {JOINT_NAMES[joint]}"
    yield from (f"{indent}{kind}", f"{indent}{{")
    yield f"{inner}OFFSET {_numbers(offsets[joint])}"
    if children:
        names = [f"{axis}rotation" for axis in (_FINGER_ORDER if joint else _WRIST_ORDER)]
        if not joint:
            names = [*(f"{axis}position" for axis in "XYZ"), *names]
        yield f"{inner}CHANNELS {len(names)} {' '.join(names)}"
    for child in children:
        yield from _joint(offsets, child, inner)
    yield f"{indent}}}"


def _channels(anatomy: HandAnatomy, poses: FloatArray, thumbs: FloatArray) -> FloatArray:
    """Return channels (F, 51) in the skeleton's order: wrist position, then every bone's angles, deg."""
    turns = skinning_transforms(anatomy, poses, thumbs)[..., :3].astype(np.float64)
    turns *= Y_UP[:, None] * Y_UP  # the same rotation in the other axes
    local = turns.copy()
    for bone in range(1, BONE_COUNT):
        parent = 0 if bone % 3 == 1 else bone - 1
        local[:, bone] = np.swapaxes(turns[:, parent], 1, 2) @ turns[:, bone]
    orders = ["".join(_FINGER_ORDER if bone else _WRIST_ORDER) for bone in range(BONE_COUNT)]
    angles = [
        Rotation.from_matrix(local[:, bone]).as_euler(order, degrees=True)
        for bone, order in enumerate(orders)
    ]
    continued = np.unwrap(np.concatenate(angles, axis=1), period=360.0, axis=0)
    return np.concatenate([METRES_PER_MM * poses[:, :3] * Y_UP, continued], axis=1)
