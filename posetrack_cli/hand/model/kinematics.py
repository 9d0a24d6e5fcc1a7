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


def _spread_and_bend(a: FloatArray, t: FloatArray) -> FloatArray:
    """Return Rz(a) Rx(t), flattened by rows: (...) -> (..., 9)."""
    ca, sa, ct, st = np.cos(a), np.sin(a), np.cos(t), np.sin(t)
    turn = np.empty((*a.shape, 9))
    turn[..., 0], turn[..., 1], turn[..., 2] = ca, -sa * ct, sa * st
    turn[..., 3], turn[..., 4], turn[..., 5] = sa, ca * ct, -ca * st
    turn[..., 6], turn[..., 7], turn[..., 8] = 0.0, st, ct
    return turn


def _bend_base(turns: FloatArray, s: FloatArray) -> None:
    """Premultiply flattened rotations (..., N, 9) by Rx(s), s (N,), in place."""
    cs, ss = np.cos(s)[..., None], np.sin(s)[..., None]
    middle, last = turns[..., 3:6].copy(), turns[..., 6:9].copy()
    turns[..., 3:6] = cs * middle - ss * last
    turns[..., 6:9] = ss * middle + cs * last


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
    palm = rotations.matrices_from_quaternions(poses[:, 3:7])
    lever = _levers(anatomy, poses[:, 7:], thumb) @ palm.swapaxes(1, 2)
    by_component = np.zeros((len(poses), 21, 21, 3))
    by_component[:, range(3), :, range(3)] = 1.0
    by_component[:, 3:6] = _cross(palm.swapaxes(1, 2)[:, :, None], lever[:, None])
    hinges = _hinges(anatomy, poses[:, 7:], thumb)
    turned = np.stack([rate * axis for _, axis, _, _, rate in hinges], axis=1) @ palm.swapaxes(1, 2)
    # Hinges of joints 2 and 3 that share an angle are added one after the other.
    for is_last in (False, True):
        pairs = [
            (number, 1 + 4 * finger + joint, moved, 6 + column)
            for number, (column, _, finger, joint, rate) in enumerate(hinges)
            for moved in range(2 + 4 * finger + joint, 5 + 4 * finger)
            if (rate == HALF) == is_last
        ]
        hinge, centre, moved, column = np.array(pairs).T
        reach = np.take(lever, moved, axis=1) - np.take(lever, centre, axis=1)
        by_component[:, column, moved] += _cross(turned[:, hinge], reach)
    return np.moveaxis(by_component, 1, -1)


def _cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the cross products of vectors (..., 3), in a fifth of the time of ``np.cross``."""
    x, y, z = (first[..., k] for k in range(3))
    u, v, w = (second[..., k] for k in range(3))
    out = np.empty(np.broadcast_shapes(first.shape, second.shape))
    out[..., 0], out[..., 1], out[..., 2] = y * w - z * v, z * u - x * w, x * v - y * u
    return out


def _levers(anatomy: HandAnatomy, angles: FloatArray, thumb: FloatArray) -> FloatArray:
    """Return the joints in hand coordinates, mm: (N, 15) -> (N, 21, 3), as ``place_joints`` without kernels.

    A bone points along -Rx(s) Rz(a) Rx(t) e_y of its finger's frame.
    """
    first, aside, second = np.moveaxis(angles.reshape(-1, 5, 3), 2, 0)
    base, more, further = np.zeros((3, *first.shape))
    base[:, 0], more[:, 0], further[:, 0] = first[:, 0], thumb[..., 0], thumb[..., 1]
    first, aside, second = (np.array(one) for one in (first, aside, second))
    first[:, 0], aside[:, 0], second[:, 0] = 0.0, second[:, 0], aside[:, 0].copy()
    sign = -1.0 if anatomy.is_left else 1.0
    levers = np.zeros((len(angles), 5, 4, 3))
    levers[:, :, 0] = anatomy.base_positions
    bends = (first, first + second, first + (1.0 + HALF) * second + more)
    for k, (a, t) in enumerate(zip((aside, aside + further, aside + further), bends, strict=True)):
        bent = _spread_and_bend(sign * a, t)
        _bend_base(bent, base)
        along = (anatomy.base_rotations @ bent[..., 1::3, None])[..., 0]
        levers[:, :, k + 1] = levers[:, :, k] - along * anatomy.segments[:, k, None]
    return np.concatenate([np.zeros((len(angles), 1, 3)), levers.reshape(-1, 20, 3)], axis=1)


def _hinges(
    anatomy: HandAnatomy, angles: FloatArray, thumb: FloatArray
) -> list[tuple[int, FloatArray, int, int, float]]:
    """Return all hinges: (angle index, axis in hand coordinates (N, 3), finger, joint 0..2, rate)."""
    sign = -1.0 if anatomy.is_left else 1.0
    base = anatomy.base_rotations
    zero = np.zeros(angles.shape[0])
    hinges = []
    for f in range(5):
        k = 3 * f
        cmc, abduction = (angles[:, 0], angles[:, 2]) if f == 0 else (zero, angles[:, k + 1])
        spread_here = (
            abduction + thumb[..., 1] if f == 0 else abduction
        )  # the thumb flexes at the MCP, after its abduction there
        turn = _spread_and_bend(np.stack([sign * spread_here, zero]), np.zeros((2, len(zero))))
        _bend_base(turn, cmc)
        flexion = turn[0, :, 0::3] @ base[f].T  # the x axis after the abduction
        spread = sign * (turn[1, :, 2::3] @ base[f].T)  # the z axis before it
        if f == 0:
            first = np.broadcast_to(base[0][:, 0], flexion.shape)
            hinges += [(0, first, 0, 0, 1.0), (1, flexion, 0, 1, 1.0), (1, flexion, 0, 2, HALF)]
            hinges += [(2, spread, 0, 0, 1.0)]
        else:
            hinges += [(k, flexion, f, 0, 1.0), (k + 1, spread, f, 0, 1.0)]
            hinges += [(k + 2, flexion, f, 1, 1.0), (k + 2, flexion, f, 2, HALF)]
    return hinges


def mirrored_poses(poses: FloatArray) -> FloatArray:
    """Return the poses of the mirrored hand, x -> -x: (N, 22) -> (N, 22)."""
    out = poses.copy()
    out[:, 0] *= -1.0
    out[:, 4:6] *= -1.0  # reflecting a rotation negates the components of its axis along the mirror
    return out
