"""Forward kinematics of the 22-D hand for many poses at once, and its derivative.

A pose is (position mm, unit quaternion xyzw, 15 angles rad); a tangent vector is (position mm, body-frame
rotation vector rad, 15 angles rad), 21 numbers (hand.md, "State").
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.anatomy import BONE_COUNT, HandAnatomy
from posetrack_cli.hand.inner import NO_THUMB

HALF_RULE = 0.5  # joint 1 bends half as far as joint 2 (paper, appendix A.1)


def _chain_turns(angles: FloatArray, inner: FloatArray, sign: float) -> FloatArray:
    """Turns of all finger bones from rest in their finger's frame, (N, 15) -> (5, 3, N, 9).

    A finger bends about one axis behind its abduction: Rz(abduction) Rx(sum of flexions). The thumb
    bends at the CMC first: Rx(CMC) Rz(abduction), then Rz(its MCP's abduction) Rx(flexion) from the MCP on.
    The thumb's inner angles (``hand.inner``) are (2,) or (N, 2).
    """
    by_angle = angles.T.reshape(5, 3, -1)
    thumb, fingers = by_angle[0], by_angle[1:]
    a, t = np.zeros_like(by_angle), np.zeros_like(by_angle)
    a[0] = sign * thumb[2]
    a[0, 1:] += sign * inner[..., 1]
    t[0, 1], t[0, 2] = thumb[1], (1.0 + HALF_RULE) * thumb[1] + inner[..., 0]
    a[1:] = sign * fingers[:, 1:2]
    t[1:, 0] = fingers[:, 0]
    t[1:, 1] = fingers[:, 0] + fingers[:, 2]
    t[1:, 2] = fingers[:, 0] + (1.0 + HALF_RULE) * fingers[:, 2]
    turns = _spread_and_bend(a, t)
    _bend_base(turns[0], thumb[0])
    return turns


def _spread_and_bend(a: FloatArray, t: FloatArray) -> FloatArray:
    """Rz(a) Rx(t), flattened by rows: (...) -> (..., 9)."""
    ca, sa, ct, st = np.cos(a), np.sin(a), np.cos(t), np.sin(t)
    turn = np.empty((*a.shape, 9))
    turn[..., 0], turn[..., 1], turn[..., 2] = ca, -sa * ct, sa * st
    turn[..., 3], turn[..., 4], turn[..., 5] = sa, ca * ct, -ca * st
    turn[..., 6], turn[..., 7], turn[..., 8] = 0.0, st, ct
    return turn


def _bend_base(turns: FloatArray, s: FloatArray) -> None:
    """Premultiply flattened turns (..., N, 9) by Rx(s), s (N,), in place."""
    cs, ss = np.cos(s)[:, None], np.sin(s)[:, None]
    middle, last = turns[..., 3:6].copy(), turns[..., 6:9].copy()
    turns[..., 3:6] = cs * middle - ss * last
    turns[..., 6:9] = ss * middle + cs * last


def _finger_chain(
    anatomy: HandAnatomy, angles: FloatArray, thumb: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """In hand coordinates: chain values (5, 3, N, 15), see chain_matrix, and bone ends (5, 3, N, 3)."""
    sign = -1.0 if anatomy.is_left else 1.0
    values = _chain_turns(angles, thumb, sign) @ anatomy.chain_matrix
    ends = anatomy.base_positions[:, None, None] - np.cumsum(values[..., 9:12], axis=1)
    return values, ends


def skinning_transforms(
    anatomy: HandAnatomy, poses: FloatArray, thumb: FloatArray = NO_THUMB
) -> Float32Array:
    """camera_T_rest of every bone: takes a vertex of the rest mesh to camera coordinates.

    Args:
        anatomy: the hand.
        poses: (N, 22).
        thumb: (2,) or (N, 2) its inner angles (``hand.inner``), rad.

    Returns:
        (N, 16, 3, 4), translations in mm: the palm, then three bones a finger, thumb first.
    """
    values, ends = _finger_chain(anatomy, poses[:, 7:], thumb)
    n = poses.shape[0]
    bones = np.empty((n, 3, 5, 3, 4))
    bones[..., :3] = values[..., :9].reshape(5, 3, n, 3, 3).transpose(2, 3, 0, 1, 4)
    offsets = -values[..., 12:]
    offsets[:, 0] += anatomy.base_positions[:, None]
    offsets[:, 1:] += ends[:, :2]
    bones[..., 3] = offsets.transpose(2, 3, 0, 1)
    palm = rotations.matrices_from_quaternions(poses[:, 3:7])
    posed = (palm @ bones.reshape(n, 3, 60)).reshape(n, 3, 15, 4)
    posed[..., 3] += poses[:, :3, None]
    out = np.empty((n, BONE_COUNT, 3, 4), dtype=np.float32)
    out[:, 0, :, :3], out[:, 0, :, 3] = palm, poses[:, :3]
    out[:, 1:] = posed.transpose(0, 2, 1, 3)
    return out


def joint_positions(anatomy: HandAnatomy, poses: FloatArray, thumb: FloatArray = NO_THUMB) -> FloatArray:
    """The 21 joints in camera coordinates, mm: (N, 22) -> (N, 21, 3), in the order of JOINT_NAMES.

    The thumb's inner angles (``hand.inner``) are (2,) or (N, 2), rad.
    """
    _, ends = _finger_chain(anatomy, poses[:, 7:], thumb)
    n = poses.shape[0]
    local = np.empty((n, 5, 4, 3))
    local[:, :, 0] = anatomy.base_positions
    local[:, :, 1:] = ends.transpose(2, 0, 1, 3)
    palm = rotations.matrices_from_quaternions(poses[:, 3:7])
    out = np.empty((n, 21, 3))
    out[:, 0] = poses[:, :3]
    out[:, 1:] = local.reshape(n, 20, 3) @ np.swapaxes(palm, 1, 2) + poses[:, None, :3]
    return out


def mean_joint_distances(anatomy: HandAnatomy, pose: FloatArray, others: FloatArray) -> FloatArray:
    """How far the joints of other poses (N, 22) are from those of a pose (22,), on average, mm: (N,)."""
    joints = joint_positions(anatomy, np.concatenate([pose[None], others]))
    distances: FloatArray = np.linalg.norm(joints[1:] - joints[0], axis=2).mean(axis=1)
    return distances


def joint_set_distance(anatomy: HandAnatomy, pose: FloatArray, other: FloatArray) -> float:
    """How far apart the joints of two poses (22,) lie, whichever joints these are, mm.

    The mean distance from a joint of one to the nearest of the other, the larger one of both ways. A hand
    that is explained with its palm pulled back to the elbow and its fingers open, or with another finger
    than the one that points, lies where it does; its joints do not.
    """
    first, second = joint_positions(anatomy, np.stack([pose, other]))
    apart = np.linalg.norm(first[:, None] - second, axis=2)
    return float(max(apart.min(axis=0).mean(), apart.min(axis=1).mean()))


def joint_jacobian(anatomy: HandAnatomy, poses: FloatArray, thumb: FloatArray = NO_THUMB) -> FloatArray:
    """Derivative of the joints by the tangent vector, (N, 22) -> (N, 21, 3, 21).

    Translation moves every joint alike; a body rotation w moves R p by R (w x p); an angle about the
    camera-frame axis u through the joint at c moves a point p beyond it by u x (p - c). The thumb's inner
    angles are (2,) or (N, 2), rad.
    """
    n = poses.shape[0]
    palm = rotations.matrices_from_quaternions(poses[:, 3:7])
    joints = joint_positions(anatomy, poses, thumb)
    jacobian = np.zeros((n, 21, 3, 21))
    jacobian[..., 0:3] = np.eye(3)
    lever = joints - poses[:, None, :3]
    for k in range(3):
        jacobian[..., 3 + k] = np.cross(palm[:, None, :, k], lever)
    for column, axis, finger, joint, rate in _hinges(anatomy, poses[:, 7:], thumb):
        first = 1 + 4 * finger + joint
        beyond = slice(first + 1, 5 + 4 * finger)
        turned = np.einsum("nij,nj->ni", palm, axis)
        reach = joints[:, beyond] - joints[:, first : first + 1]
        jacobian[:, beyond, :, 6 + column] += rate * np.cross(turned[:, None], reach)
    return jacobian


def _hinges(
    anatomy: HandAnatomy, angles: FloatArray, thumb: FloatArray
) -> list[tuple[int, FloatArray, int, int, float]]:
    """All hinges: (angle index, axis in hand coordinates (N, 3), finger, joint 0..2, rate)."""
    sign = -1.0 if anatomy.is_left else 1.0
    base = anatomy.base_rotations
    zero = np.zeros(angles.shape[0])
    hinges = []
    for f in range(5):
        k = 3 * f
        cmc, abduction = (angles[:, 0], angles[:, 2]) if f == 0 else (zero, angles[:, k + 1])
        spread_here = abduction + thumb[..., 1] if f == 0 else abduction  # where it flexes: at the MCP
        turn = _spread_and_bend(np.stack([sign * spread_here, zero]), np.zeros((2, len(zero))))
        _bend_base(turn, cmc)
        flexion = turn[0, :, 0::3] @ base[f].T  # the x axis after the abduction
        spread = sign * (turn[1, :, 2::3] @ base[f].T)  # the z axis before it
        if f == 0:
            first = np.broadcast_to(base[0][:, 0], flexion.shape)
            hinges += [(0, first, 0, 0, 1.0), (1, flexion, 0, 1, 1.0), (1, flexion, 0, 2, HALF_RULE)]
            hinges += [(2, spread, 0, 0, 1.0)]
        else:
            hinges += [(k, flexion, f, 0, 1.0), (k + 1, spread, f, 0, 1.0)]
            hinges += [(k + 2, flexion, f, 1, 1.0), (k + 2, flexion, f, 2, HALF_RULE)]
    return hinges


def mirrored_poses(poses: FloatArray) -> FloatArray:
    """The poses of the other hand seen in a mirror x -> -x: (N, 22) -> (N, 22)."""
    out = poses.copy()
    out[:, 0] *= -1.0
    out[:, 4:6] *= -1.0  # reflecting a rotation negates the components of its axis along the mirror
    return out
