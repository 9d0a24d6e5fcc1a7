"""Forward kinematics of many 22-D hand poses, and its derivative.

A pose is (position mm, unit quaternion xyzw, 15 angles rad); a tangent vector is (position mm, body-frame
rotation vector rad, 15 angles rad), 21 numbers.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.fit.skeleton import (
    HALF,
    INNER_SIZE,
    NO_THUMB,
    THUMB,
    empty_posed,
    place_joints,
    pose_many,
    skeleton_of,
)
from posetrack_cli.hand.model.anatomy import BONE_COUNT, JOINT_NAMES, HandAnatomy


def skinning_transforms(
    anatomy: HandAnatomy, poses: FloatArray, thumb: FloatArray = NO_THUMB
) -> Float32Array:
    """Return camera_T_rest of every bone, which maps vertices of the rest mesh to camera coordinates.

    Args:
        anatomy: the hand.
        poses: (N, 22).
        thumb: (2,) or (N, 2) its inner angles (``hand.fit.skeleton``), rad.

    Returns:
        (N, 16, 3, 4), translations in mm: the palm, then three bones per finger, thumb first.
    """
    bones = np.empty((len(poses), BONE_COUNT, 3, 4), dtype=np.float32)
    pose_many(skeleton_of(anatomy), _own(poses), _inner_with(thumb, len(poses)), empty_posed(), bones)
    return bones


def joint_positions(anatomy: HandAnatomy, poses: FloatArray, thumb: FloatArray = NO_THUMB) -> FloatArray:
    """Return the 21 joints in camera coordinates, mm: (N, 22) -> (N, 21, 3), in the order of JOINT_NAMES.

    The thumb's inner angles (``hand.fit.skeleton``) are (2,) or (N, 2), rad.
    """
    joints = np.empty((len(poses), len(JOINT_NAMES), 3))
    place_joints(skeleton_of(anatomy), _own(poses), _inner_with(thumb, len(poses)), empty_posed(), joints)
    return joints


def _own(poses: FloatArray) -> FloatArray:
    """Return a contiguous, writable copy, as the kernels are compiled for."""
    return np.array(poses, dtype=np.float64, order="C")


def _inner_with(thumb: FloatArray, count: int) -> FloatArray:
    """Return inner numbers (N, 6) without a forearm."""
    inner = np.zeros((count, INNER_SIZE))
    inner[:, THUMB] = thumb
    return inner


def mean_joint_distances(anatomy: HandAnatomy, pose: FloatArray, others: FloatArray) -> FloatArray:
    """Return the mean joint distances (N,) of poses (N, 22) from a pose (22,), mm."""
    joints = joint_positions(anatomy, np.concatenate([pose[None], others]))
    distances: FloatArray = np.linalg.norm(joints[1:] - joints[0], axis=2).mean(axis=1)
    return distances


def joint_set_distance(anatomy: HandAnatomy, pose: FloatArray, other: FloatArray) -> float:
    """Return the distance of two poses' joints as point sets, mm.

    This is the larger of both mean distances from joints of one pose to the nearest joints of the other. It
    is small for a hand fitted back to front or with another pointing finger, whose corresponding joints are
    far apart.
    """
    first, second = joint_positions(anatomy, np.stack([pose, other]))
    apart = np.linalg.norm(first[:, None] - second, axis=2)
    return float(max(apart.min(axis=0).mean(), apart.min(axis=1).mean()))


def joint_jacobian(anatomy: HandAnatomy, poses: FloatArray, thumb: FloatArray = NO_THUMB) -> FloatArray:
    """Return the derivative of the joints by the tangent vector, (N, 22) -> (N, 21, 3, 21).

    Translation moves every joint alike; a body rotation w moves R p by R (w x p); an angle about the
    camera-frame axis u through the joint at c moves a point p beyond it by u x (p - c). The thumb's inner
    angles are (2,) or (N, 2), rad.
    """
    palm = np.ascontiguousarray(np.moveaxis(rotations.matrices_from_quaternions(poses[:, 3:7]), 0, -1))
    angles = _finger_angles(poses[:, 7:], thumb)
    lever, hinges = _turned(palm, _levers(anatomy, angles)), _hinges(anatomy, angles)
    by_component = np.zeros((21, 21, 3, len(poses)))
    by_component[range(3), :, range(3)] = 1.0
    by_component[3:6] = _cross(palm.swapaxes(0, 1)[:, None], lever)
    axes = _turned(palm, np.stack([rate * axis for _, axis, _, _, rate in hinges]))
    # Hinges of joints 2 and 3 that share an angle are added one after the other.
    for is_last in (False, True):
        pairs = [
            (number, 1 + 4 * finger + joint, moved, 6 + column)
            for number, (column, _, finger, joint, rate) in enumerate(hinges)
            for moved in range(2 + 4 * finger + joint, 5 + 4 * finger)
            if (rate == HALF) == is_last
        ]
        hinge, centre, moved, column = np.array(pairs).T
        by_component[column, moved] += _cross(axes[hinge], lever[moved] - lever[centre])
    return by_component.transpose(3, 1, 2, 0)


# Vectors of the arrays below are along the second-last axis and frames along the last, as numpy is fastest
# over long last axes. No kernels are used, because evaluation does without numba.


def _turned(palm: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return vectors (..., 3, N) in camera axes."""
    return sum((palm[:, k] * vectors[..., k, None, :] for k in range(3)), np.zeros(()))


def _cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the cross products of vectors (..., 3, N)."""
    x, y, z = (first[..., k, :] for k in range(3))
    u, v, w = (second[..., k, :] for k in range(3))
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-2)


def _finger_angles(angles: FloatArray, thumb: FloatArray) -> dict[str, FloatArray]:
    """Return the angles (N, 15) by meaning, (5, N) each; those of the thumb have another order."""
    first, aside, second = angles.T.reshape(5, 3, -1).swapaxes(0, 1).copy()
    base, more, further = np.zeros((3, *first.shape))
    base[0], more[0], further[0] = first[0], thumb[..., 0], thumb[..., 1]
    first[0], aside[0], second[0] = 0.0, second[0].copy(), aside[0].copy()
    return {"base": base, "first": first, "aside": aside, "second": second, "more": more, "further": further}


def _levers(anatomy: HandAnatomy, angles: dict[str, FloatArray]) -> FloatArray:
    """Return the joints in hand coordinates, mm, (21, 3, N).

    A bone points along -Rx(s) Rz(a) Rx(t) e_y of its finger's frame.
    """
    first, aside, second = angles["first"], angles["aside"], angles["second"]
    cs, ss = np.cos(angles["base"]), np.sin(angles["base"])
    levers = np.zeros((5, 4, 3, first.shape[1]))
    levers[:, 0] = anatomy.base_positions[..., None]
    bends = (first, first + second, first + (1.0 + HALF) * second + angles["more"])
    beyond = aside + angles["further"]
    sign = -1.0 if anatomy.is_left else 1.0
    for k, (a, t) in enumerate(zip((aside, beyond, beyond), bends, strict=True)):
        ct, st = np.cos(t), np.sin(t)
        ahead = np.cos(a) * ct
        along = np.stack([-sign * np.sin(a) * ct, cs * ahead - ss * st, ss * ahead + cs * st], axis=1)
        levers[:, k + 1] = levers[:, k] - anatomy.base_rotations @ along * anatomy.segments[:, k, None, None]
    return np.concatenate([np.zeros((1, *levers.shape[2:])), levers.reshape(20, 3, -1)])


def _hinges(
    anatomy: HandAnatomy, angles: dict[str, FloatArray]
) -> list[tuple[int, FloatArray, int, int, float]]:
    """Return all hinges: (angle index, axis in hand coordinates (3, N), finger, joint 0..2, rate)."""
    sign = -1.0 if anatomy.is_left else 1.0
    cs, ss = np.cos(angles["base"]), np.sin(angles["base"])
    aside = sign * (angles["aside"] + angles["further"])  # the thumb flexes at the MCP, after its abduction
    ca, sa = np.cos(aside), np.sin(aside)
    flexions = anatomy.base_rotations @ np.stack([ca, cs * sa, ss * sa], axis=1)  # x axes after the abduction
    spreads = sign * anatomy.base_rotations @ np.stack([0.0 * ss, -ss, cs], axis=1)  # z axes before it
    first = np.broadcast_to(anatomy.base_rotations[0, :, :1], flexions[0].shape)
    hinges = [(0, first, 0, 0, 1.0), (1, flexions[0], 0, 1, 1.0), (1, flexions[0], 0, 2, HALF)]
    hinges += [(2, spreads[0], 0, 0, 1.0)]
    for f in range(1, 5):
        k, flexion = 3 * f, flexions[f]
        hinges += [(k, flexion, f, 0, 1.0), (k + 1, spreads[f], f, 0, 1.0)]
        hinges += [(k + 2, flexion, f, 1, 1.0), (k + 2, flexion, f, 2, HALF)]
    return hinges


def mirrored_poses(poses: FloatArray) -> FloatArray:
    """Return the poses of the mirrored hand, x -> -x: (N, 22) -> (N, 22)."""
    out = poses.copy()
    out[:, 0] *= -1.0
    out[:, 4:6] *= -1.0  # reflecting a rotation negates the components of its axis along the mirror
    return out
