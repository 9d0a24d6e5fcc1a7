"""Bones and skin of one pose, their derivatives, and the inner numbers fitted in addition to the pose."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, IntArray
from posetrack_cli.compiled import borrowing, inlined, kernel
from posetrack_cli.geometry.kernels import matrix_product, rotation_matrix
from posetrack_cli.hand.model.anatomy import ARM_BONE, BONE_COUNT, HandAnatomy
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.raster import RestMesh, rest_mesh

# Bones of one pose and derivatives of skin points; compiled. ``hand.model.kinematics`` handles many poses.

HALF = 0.5  # joint 1 bends half as far as joint 2 (paper, appendix A.1)
# finger indices of skin points on the thumb, the palm and the forearm
THUMB_ROW, PALM, ARM = 0, -1, 5


class Skeleton(NamedTuple):
    """Constants of one hand.

    Attributes:
        base_positions: (5, 3) joints 3, hand coordinates, mm.
        base_rotations: (5, 3, 3) hand_R_finger.
        segments: (5, 3) mm.
        rest_origins: (5, 3, 3) joints 3, 2, 1 at zero angles, mm.
        sign: of abductions: -1 for a left hand.
    """

    base_positions: FloatArray
    base_rotations: FloatArray
    segments: FloatArray
    rest_origins: FloatArray
    sign: float


class Posed(NamedTuple):
    """Bones of one pose; written by ``pose_bones``.

    Attributes:
        bones: (17, 3, 4) camera_T_rest, mm; the last is the forearm's.
        axes: (6, 3, 3) hinge axes in camera coordinates. Fingers: flexion, abduction (third unused). Thumb:
            CMC flexion; MCP and IP flexion; CMC and MCP abduction. Forearm: its two swing axes and its
            direction to the elbow; 0 without one.
        centres: (5, 3, 3) joints 3, 2, 1 in camera coordinates, mm.
        tips: (5, 3) mm.
        turns: (6, 3, 3) buffer: rotations of the palm, of a finger's frame and bones.
    """

    bones: FloatArray
    axes: FloatArray
    centres: FloatArray
    tips: FloatArray
    turns: FloatArray


def skeleton_of(anatomy: HandAnatomy) -> Skeleton:
    """Return the constants of a hand."""
    return Skeleton(
        np.ascontiguousarray(anatomy.base_positions),
        np.ascontiguousarray(anatomy.base_rotations),
        np.ascontiguousarray(anatomy.segments),
        np.ascontiguousarray(anatomy.rest_origins),
        -1.0 if anatomy.is_left else 1.0,
    )


def empty_posed() -> Posed:
    """Return empty bones of one pose."""
    bones, axes = np.zeros((BONE_COUNT + 1, 3, 4)), np.zeros((6, 3, 3))
    return Posed(bones, axes, np.zeros((5, 3, 3)), np.zeros((5, 3)), np.zeros((6, 3, 3)))


@borrowing
def _bent(s: float, a: float, t: float, out: FloatArray) -> None:
    """Write Rx(s) Rz(a) Rx(t)."""
    cs, ss, ca, sa, ct, st = np.cos(s), np.sin(s), np.cos(a), np.sin(a), np.cos(t), np.sin(t)
    out[0, 0], out[0, 1], out[0, 2] = ca, -sa * ct, sa * st
    out[1, 0], out[1, 1], out[1, 2] = cs * sa, cs * ca * ct - ss * st, -cs * ca * st - ss * ct
    out[2, 0], out[2, 1], out[2, 2] = ss * sa, ss * ca * ct + cs * st, -ss * ca * st + cs * ct


@borrowing
def _finger_turns(pose: FloatArray, inner: FloatArray, f: int, sign: float, turns: FloatArray) -> None:
    """Write rotations (3, 3, 3) of a finger's bones from rest, in the finger's frame."""
    k, aside, more = 7 + 3 * f, 0.0, 0.0
    if f == THUMB_ROW:
        base, spread, first, second = pose[k], sign * pose[k + 2], 0.0, pose[k + 1]
        aside, more = sign * inner[MCP_ABDUCTION], inner[IP_OFFSET]
    else:
        base, spread, first, second = 0.0, sign * pose[k + 1], pose[k], pose[k + 2]
    _bent(base, spread, first, turns[0])
    _bent(base, spread + aside, first + second, turns[1])
    _bent(base, spread + aside, first + (1.0 + HALF) * second + more, turns[2])


@borrowing
def _finger_axes(
    pose: FloatArray, inner: FloatArray, f: int, sign: float, frame: FloatArray, axes: FloatArray
) -> None:
    """Write hinge axes (3, 3) in camera coordinates; ``frame`` is camera_R_finger."""
    k = 7 + 3 * f
    s, a = (
        (pose[k], sign * (pose[k + 2] + inner[MCP_ABDUCTION]))
        if f == THUMB_ROW
        else (0.0, sign * pose[k + 1])
    )
    cs, ss, ca, sa = np.cos(s), np.sin(s), np.cos(a), np.sin(a)
    for i in range(3):
        x, y, z = frame[i, 0], frame[i, 1], frame[i, 2]
        flexion = ca * x + sa * (cs * y + ss * z)  # Rx(s) Rz(a) e_x
        abduction = sign * (-ss * y + cs * z)  # Rx(s) e_z
        if f == THUMB_ROW:
            axes[0, i], axes[1, i], axes[2, i] = x, flexion, abduction
        else:
            axes[0, i], axes[1, i], axes[2, i] = flexion, abduction, 0.0


@borrowing
def pose_bones(skeleton: Skeleton, pose: FloatArray, inner: FloatArray, posed: Posed) -> None:
    """Write bones, hinge axes and joint centres of one pose (22,) with inner numbers (6,).

    Without a visible forearm its bone collapses into the wrist.
    """
    posed.bones[ARM_BONE, :, :3], posed.axes[ARM] = 0.0, 0.0
    palm, frame, turned, turns = posed.turns[0], posed.turns[1], posed.turns[2], posed.turns[3:]
    rotation_matrix(pose[3:7], palm)
    for i in range(3):
        posed.bones[0, i, 3] = posed.bones[ARM_BONE, i, 3] = pose[i]
        for j in range(3):
            posed.bones[0, i, j] = palm[i, j]
    for f in range(5):
        origin, at = skeleton.base_positions[f], posed.tips[f]
        matrix_product(palm, skeleton.base_rotations[f], frame)
        _finger_turns(pose, inner, f, skeleton.sign, turns)
        _finger_axes(pose, inner, f, skeleton.sign, frame, posed.axes[f])
        for i in range(3):
            at[i] = pose[i] + palm[i, 0] * origin[0] + palm[i, 1] * origin[1] + palm[i, 2] * origin[2]
        for k in range(3):
            matrix_product(frame, turns[k], turned)
            _place_bone(skeleton, f, k, turned, at, posed)
    _place_arm(inner, posed)


@kernel
def pose_many(
    skeleton: Skeleton, poses: FloatArray, inner: FloatArray, posed: Posed, bones: Float32Array
) -> None:
    """Write camera_T_rest (N, B, 3, 4) of poses (N, 22) with inner numbers (N, 6), for a renderer.

    B is 17 with the forearm, 16 without.
    """
    for n in range(len(poses)):
        pose_bones(skeleton, poses[n], inner[n], posed)
        for b in range(bones.shape[1]):  # element by element: assigning slices takes seconds to compile
            for i in range(3):
                for j in range(4):
                    bones[n, b, i, j] = posed.bones[b, i, j]


@kernel
def place_joints(
    skeleton: Skeleton, poses: FloatArray, inner: FloatArray, posed: Posed, joints: FloatArray
) -> None:
    """Write joints (N, 21, 3), mm, of poses (N, 22) with inner numbers (N, 6), in the order of
    ``JOINT_NAMES``."""
    for n in range(len(poses)):
        pose_bones(skeleton, poses[n], inner[n], posed)
        for k in range(3):
            joints[n, 0, k] = poses[n, k]
            for f in range(5):
                for joint in range(3):
                    joints[n, 1 + 4 * f + joint, k] = posed.centres[f, joint, k]
                joints[n, 4 + 4 * f, k] = posed.tips[f, k]


@borrowing
def _place_arm(arm: FloatArray, posed: Posed) -> None:
    """Write the forearm's bone and axes of a posed hand, from inner numbers (6,).

    Its rest coordinates have the wrist at the origin and y towards the elbow; x is as close as possible to
    the palm's. Without a forearm it stays collapsed in the wrist.
    """
    bone, axes = posed.bones[ARM_BONE], posed.axes[ARM]
    if arm[0] == 0.0 and arm[1] == 0.0 and arm[2] == 0.0:
        return
    palm, girth = posed.bones[0], np.exp(arm[3])
    along = palm[0, 0] * arm[0] + palm[1, 0] * arm[1] + palm[2, 0] * arm[2]
    column = 0 if abs(along) < 0.9 else 2  # x is degenerate for an arm along it: use the palm's normal
    if column == 2:
        along = palm[0, 2] * arm[0] + palm[1, 2] * arm[1] + palm[2, 2] * arm[2]
    square = 0.0
    for i in range(3):
        axes[0, i] = palm[i, column] - along * arm[i]
        square += axes[0, i] * axes[0, i]
    for i in range(3):
        axes[0, i] /= np.sqrt(square)
        axes[2, i] = arm[i]
    axes[1, 0] = axes[0, 1] * arm[2] - axes[0, 2] * arm[1]
    axes[1, 1] = axes[0, 2] * arm[0] - axes[0, 0] * arm[2]
    axes[1, 2] = axes[0, 0] * arm[1] - axes[0, 1] * arm[0]
    for i in range(3):
        bone[i, 0], bone[i, 1], bone[i, 2] = girth * axes[0, i], arm[i], girth * axes[1, i]


@borrowing
def _place_bone(skeleton: Skeleton, f: int, k: int, turned: FloatArray, at: FloatArray, posed: Posed) -> None:
    """Write bone k of a finger, ``turned`` camera_R_bone, and move ``at`` from its joint to the next one."""
    base, rest, bone = skeleton.base_rotations[f], skeleton.rest_origins[f, k], posed.bones[1 + 3 * f + k]
    for i in range(3):
        posed.centres[f, k, i], bone[i, 3] = at[i], at[i]
        for j in range(3):  # camera_R_rest = camera_R_bone finger_R_hand
            bone[i, j] = turned[i, 0] * base[j, 0] + turned[i, 1] * base[j, 1] + turned[i, 2] * base[j, 2]
            bone[i, 3] -= bone[i, j] * rest[j]
        at[i] -= turned[i, 1] * skeleton.segments[f, k]


@inlined
def _arm_row(
    posed: Posed, lx: float, ly: float, lz: float, dx: float, dy: float, dz: float, row: FloatArray
) -> None:
    """Write the derivatives of a forearm point at l from the wrist: two swings, and its girth."""
    tx, ty, tz = ly * dz - lz * dy, lz * dx - lx * dz, lx * dy - ly * dx
    first, second, along = posed.axes[ARM, 0], posed.axes[ARM, 1], posed.axes[ARM, 2]
    for k in range(3):
        row[3 + k] = 0.0
    row[6] = first[0] * tx + first[1] * ty + first[2] * tz
    row[7] = second[0] * tx + second[1] * ty + second[2] * tz
    out = lx * along[0] + ly * along[1] + lz * along[2]
    row[8] = lx * dx + ly * dy + lz * dz - out * (along[0] * dx + along[1] * dy + along[2] * dz)


@inlined
def _add_thumb(joint: int, first: float, second: float, aside: float, row: FloatArray) -> None:
    """Add the derivatives of a point beyond a joint of the thumb: CMC, MCP and IP flexion, and abduction."""
    if joint == 0:
        row[6] += first
        row[8] += aside
    elif joint == 1:
        row[7] += second
        row[11] += aside
    else:
        row[7] += HALF * second
        row[10] += second


@inlined
def point_row(
    posed: Posed,
    finger: int,
    reaches: FloatArray,
    n: int,
    px: float,
    py: float,
    pz: float,
    dx: float,
    dy: float,
    dz: float,
    row: FloatArray,
) -> None:
    """Write the derivatives of a skin point along a direction by tangent component: d . dp/dx.

    A point with total skinning weight W on the bones beyond a hinge turns by W times the hinge's angle.

    Args:
        posed: the pose's bones.
        finger: that moves the point, or PALM, or ARM.
        reaches: (M, 3), row n: skinning weight of the finger's bones from joint 3, 2, 1 outwards.
        n: row index.
        px, py, pz: the point, camera coordinates, mm.
        dx, dy, dz: unit direction.
        row: (16,) translation; body rotation; the finger's three angles (0 for the palm), or the forearm's
            two swings and log girth; one entry left for the residual; the thumb's two inner angles.
    """
    palm = posed.bones
    lx, ly, lz = px - palm[0, 0, 3], py - palm[0, 1, 3], pz - palm[0, 2, 3]
    tx, ty, tz = ly * dz - lz * dy, lz * dx - lx * dz, lx * dy - ly * dx
    row[0], row[1], row[2] = dx, dy, dz
    row[10] = row[11] = 0.0
    if finger == ARM:
        _arm_row(posed, lx, ly, lz, dx, dy, dz, row)
        return
    for k in range(3):
        row[3 + k] = palm[0, 0, k] * tx + palm[0, 1, k] * ty + palm[0, 2, k] * tz
        row[6 + k] = 0.0
    if finger == PALM:
        return
    f, axes, centres = finger, posed.axes, posed.centres
    for joint in range(3):
        weight = reaches[n, joint]
        if weight == 0.0:
            break
        lx, ly, lz = px - centres[f, joint, 0], py - centres[f, joint, 1], pz - centres[f, joint, 2]
        tx = weight * (ly * dz - lz * dy)
        ty = weight * (lz * dx - lx * dz)
        tz = weight * (lx * dy - ly * dx)
        first = axes[f, 0, 0] * tx + axes[f, 0, 1] * ty + axes[f, 0, 2] * tz
        second = axes[f, 1, 0] * tx + axes[f, 1, 1] * ty + axes[f, 1, 2] * tz
        if f == THUMB_ROW:
            aside = axes[0, 2, 0] * tx + axes[0, 2, 1] * ty + axes[0, 2, 2] * tz
            _add_thumb(joint, first, second, aside, row)
        elif joint == 0:
            row[6] += first
            row[7] += second
        else:
            row[8] += first if joint == 1 else HALF * first


# Skin with its fingers


class Skin(NamedTuple):
    """A hand's mesh and the fingers that move it.

    Attributes:
        mesh: the mesh.
        fingers: (V,) finger of greatest weight on the vertex, or PALM, or ARM.
        reaches: (V, 3) skinning weight of its bones from joint 3, 2, 1 outwards.
        triangle_fingers: (T,) the same per triangle.
        triangle_reaches: (T, 3).
    """

    mesh: RestMesh
    fingers: IntArray
    reaches: FloatArray
    triangle_fingers: IntArray
    triangle_reaches: FloatArray


def skin_of(mesh: SkinnedMesh) -> Skin:
    """Return a mesh bound to the hand's 16 bones, or 17 with a forearm, as the kernels read it."""
    by_finger = mesh.weights[:, 1:ARM_BONE].reshape(-1, 5, 3)
    outwards = np.cumsum(by_finger[:, :, ::-1], axis=2)[:, :, ::-1]
    fingers, reaches = _strongest(outwards)
    triangle_fingers, triangle_reaches = _strongest(outwards[mesh.triangles].mean(axis=1))
    of_arm: BoolArray = mesh.weights[:, ARM_BONE:].sum(axis=1) > 0.0
    fingers[of_arm], triangle_fingers[of_arm[mesh.triangles[:, 0]]] = ARM, ARM
    return Skin(rest_mesh(mesh), fingers, reaches, triangle_fingers, triangle_reaches)


def _strongest(outwards: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return for reaches (M, 5, 3) the finger of most weight (M,), or PALM, and its reaches (M, 3)."""
    finger = outwards[:, :, 0].argmax(axis=1)
    reach = np.take_along_axis(outwards, finger[:, None, None], axis=1)[:, 0]
    return np.where(reach[:, 0] > 0.0, finger, PALM).astype(np.int64), np.ascontiguousarray(reach)


# Inner numbers **[ours]**
#
# Six numbers of a frame in addition to the pose's 22. They are marginalised in the likelihood of the pose,
# and all particles of a frame share them:
#
#     0:3    forearm: unit direction from wrist to elbow, camera axes; 0 without a forearm
#     3      forearm: logarithm of its girth's factor
#     4      thumb: flexion of its last joint (IP) beyond the half of the MCP's that the pose gives it, rad
#     5      thumb: abduction of its MCP, rad, with the sign of the CMC's


INNER_SIZE = 6
FOREARM, THUMB = slice(0, 4), slice(4, INNER_SIZE)
LOG_GIRTH, IP_OFFSET, MCP_ABDUCTION = 3, 4, 5
NO_INNER: FloatArray = np.zeros(INNER_SIZE)
NO_THUMB: FloatArray = np.zeros(2)
RELAXED_INNER: FloatArray = np.array([0.0, 0.0, 0.0, 0.0, np.deg2rad(14.0), 0.0])
"""(6,) prior before any frame: the last joint of a resting thumb bends more than half of its MCP (17 degrees,
sd 13, over people 640 to 753)."""

FOREARM_NUMBERS = ("forearm_x", "forearm_y", "forearm_z", "forearm_girth")
"""Unit direction from wrist to elbow, camera axes, and girth relative to that expected from the hand's wrist;
NaN without a forearm."""
THUMB_NUMBERS = ("thumb_ip_offset", "thumb_mcp_abduction")
"""The thumb's two inner angles, rad."""
INNER_NUMBERS = (*FOREARM_NUMBERS, *THUMB_NUMBERS)


def inner_numbers(inner: FloatArray) -> FloatArray:
    """Return the values of ``INNER_NUMBERS`` (6,) for inner numbers (6,); NaN without a forearm."""
    arm = np.append(inner[:3], np.exp(inner[LOG_GIRTH])) if inner[:3].any() else np.full(4, np.nan)
    return np.concatenate([arm, inner[THUMB]])


def inner_of(numbers: FloatArray | None) -> FloatArray:
    """Return the inner numbers (6,) for values of ``inner_numbers``; 0 for missing ones.

    Args:
        numbers: at least (6,); (4,) from a result with a forearm only; or shorter from one with neither.
    """
    inner = NO_INNER.copy()
    if numbers is None or len(numbers) < len(FOREARM_NUMBERS):
        return inner
    arm = numbers[FOREARM]
    if np.isfinite(arm).all() and arm[3] > 0.0:
        inner[FOREARM] = np.append(arm[:3], np.log(arm[3]))
    inner[THUMB] = thumbs_of(numbers[None], 1)[0]
    return inner


def thumbs_of(numbers: FloatArray | None, count: int) -> FloatArray:
    """Return the thumbs' inner angles (count, 2), rad, for numbers (count, M) as in ``inner_of``."""
    if numbers is None or numbers.shape[1] < INNER_SIZE:
        return np.zeros((count, len(NO_THUMB)))
    thumbs = numbers[:, THUMB]
    return np.where(np.isfinite(thumbs), thumbs, 0.0)
