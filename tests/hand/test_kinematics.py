"""Forward kinematics against a chain of scipy rotations written out joint by joint, and its derivative."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation

from posetrack_cli.hand.model.anatomy import FINGERS, JOINT_NAMES, MIRROR, HandAnatomy, make_anatomy
from posetrack_cli.hand.model.kinematics import (
    joint_jacobian,
    joint_positions,
    mirrored_poses,
    skinning_transforms,
)
from posetrack_cli.tracking.velocity import BodySpace
from support.hand import REST, bent, pose_strategy, random_poses

ROUNDING_MM = 1e-9
"""Lengths below 1e3 mm, a few dozen operations in float64."""
FLOAT32_MM = 1e-3
"""Transforms are handed over in float32: 1e3 mm times 1.2e-7, several terms."""

ANATOMIES = {
    "right": make_anatomy("right"),
    "left": make_anatomy("left"),
    "child": make_anatomy("left", 0.7, (1.1, 0.9, 1.0, 1.05, 0.8)),
}
relaxed = settings(deadline=None, max_examples=40)


def chain_by_hand(anatomy: HandAnatomy, pose: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Joints (21, 3) and 16 bone transforms (3, 4), one rotation after the other."""
    palm, origin = Rotation.from_quat(pose[3:7]), pose[:3]
    spread = -1.0 if anatomy.is_left else 1.0  # about z, towards the thumb
    about = Rotation.from_euler
    joints, bones = [origin], [np.column_stack([palm.as_matrix(), origin])]
    for f in range(5):
        first, second, third = pose[7 + 3 * f : 10 + 3 * f]
        if f == 0:  # CMC x, z; MCP x; IP half of MCP x
            turns = [
                about("x", first) * about("z", spread * third),
                about("x", second),
                about("x", second / 2),
            ]
        else:  # MCP z, x; PIP x; DIP half of PIP
            turns = [
                about("z", spread * second) * about("x", first),
                about("x", third),
                about("x", third / 2),
            ]
        base = Rotation.from_matrix(anatomy.base_rotations[f])
        at, rest_at = anatomy.base_positions[f], anatomy.base_positions[f]
        frame = base
        joints.append(palm.apply(at) + origin)
        for turn, length in zip(turns, anatomy.segments[f], strict=True):
            frame = frame * turn
            whole = palm * frame * base.inv()
            bones.append(np.column_stack([whole.as_matrix(), palm.apply(at) + origin - whole.apply(rest_at)]))
            at = at + frame.apply([0.0, -length, 0.0])
            rest_at = rest_at + base.apply([0.0, -length, 0.0])
            joints.append(palm.apply(at) + origin)
    return np.array(joints), bones


@pytest.mark.parametrize("name", ANATOMIES)
def test_joints_and_bones_are_those_of_the_chain_by_hand(name: str) -> None:
    anatomy, poses = ANATOMIES[name], random_poses(20)
    joints, transforms = joint_positions(anatomy, poses), skinning_transforms(anatomy, poses)
    for n, pose in enumerate(poses):
        expected, bones = chain_by_hand(anatomy, pose)
        np.testing.assert_allclose(joints[n], expected, atol=ROUNDING_MM)
        np.testing.assert_allclose(transforms[n], bones, atol=FLOAT32_MM)
        # rotations are of size 1: their own bound
        np.testing.assert_allclose(transforms[n, :, :, :3], np.array(bones)[:, :, :3], atol=1e-6)


@relaxed
@given(pose_strategy())
def test_no_pose_stretches_a_bone(pose: np.ndarray) -> None:
    for anatomy in ANATOMIES.values():
        fingers = joint_positions(anatomy, pose[None])[0, 1:].reshape(5, 4, 3)
        lengths = np.linalg.norm(np.diff(fingers, axis=1), axis=-1)
        np.testing.assert_allclose(lengths, anatomy.segments, atol=ROUNDING_MM)


@relaxed
@given(pose_strategy())
def test_the_left_hand_is_the_right_one_in_a_mirror(pose: np.ndarray) -> None:
    right = joint_positions(ANATOMIES["right"], pose[None])
    left = joint_positions(ANATOMIES["left"], mirrored_poses(pose[None]))
    np.testing.assert_allclose(left, right * MIRROR, atol=ROUNDING_MM)
    np.testing.assert_array_equal(mirrored_poses(mirrored_poses(pose[None]))[0], pose)


@relaxed
@given(pose_strategy())
def test_bones_carry_the_rest_joints_to_the_joints(pose: np.ndarray) -> None:
    anatomy = ANATOMIES["child"]
    rest = joint_positions(anatomy, REST[None])[0, 1:].reshape(5, 4, 3)
    joints = joint_positions(anatomy, pose[None])[0, 1:].reshape(5, 4, 3)
    bones = skinning_transforms(anatomy, pose[None])[0].astype(float)

    def carried(bone: int, point: np.ndarray) -> np.ndarray:
        return bones[bone, :, :3] @ point + bones[bone, :, 3]

    for f in range(5):
        np.testing.assert_allclose(carried(0, rest[f, 0]), joints[f, 0], atol=FLOAT32_MM)
        for k in range(3):  # each segment carries both of its ends
            for end in (k, k + 1):
                np.testing.assert_allclose(
                    carried(1 + 3 * f + k, rest[f, end]), joints[f, end], atol=FLOAT32_MM
                )


@pytest.mark.parametrize("finger", FINGERS)
def test_joint_1_bends_half_as_far_as_joint_2(finger: str) -> None:
    angle = "mcp" if finger == "thumb" else "pip"
    joints = joint_positions(ANATOMIES["right"], bent(**{f"{finger}_{angle}_flexion": 1.0})[None])[0]
    chain = np.array([p for name, p in zip(JOINT_NAMES, joints, strict=True) if name.startswith(finger)])
    along = np.diff(chain, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    bends = np.arccos(np.einsum("ki,ki->k", along[1:], along[:-1]))
    np.testing.assert_allclose(bends, [1.0, 0.5], atol=1e-9)


@pytest.mark.parametrize("name", ANATOMIES)
def test_the_jacobian_is_the_derivative_along_the_tangent(name: str) -> None:
    anatomy, poses, space, h = ANATOMIES[name], random_poses(6, seed=3), BodySpace(), 1e-5
    jacobian = joint_jacobian(anatomy, poses)
    for k in range(21):
        step = np.zeros((len(poses), 21))
        step[:, k] = h
        ahead, behind = (joint_positions(anatomy, space.retract(poses, s)) for s in (step, -step))
        # truncated at reach (1.5)^3 h^2 / 6 < 200 * 3.4 * 1e-10 / 6; rounded at 1e3 eps 8 / h = 2e-7 mm
        tolerance = 200 * 3.4 * h**2 / 6 + 8e3 * np.finfo(float).eps / h
        np.testing.assert_allclose(jacobian[..., k], (ahead - behind) / (2 * h), atol=tolerance)
