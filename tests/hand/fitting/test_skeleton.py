"""The compiled bones against ``hand.model.kinematics``, and a skin point's motion against differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.fit.normal_equations import RESIDUAL, ROW, THUMB_PART
from posetrack_cli.hand.fit.skeleton import (
    NO_INNER,
    NO_THUMB,
    PALM,
    THUMB,
    THUMB_ROW,
    Posed,
    empty_posed,
    point_row,
    pose_bones,
    skeleton_of,
)
from posetrack_cli.hand.model.anatomy import BONE_COUNT, HandAnatomy, make_anatomy
from posetrack_cli.hand.model.kinematics import joint_jacobian, joint_positions, skinning_transforms
from posetrack_cli.tracking.velocity import BodySpace
from support.fitting import HANDS, RIGHT
from support.hand import bent, pose_strategy, random_poses

SHAPED = make_anatomy("left", 1.1, (1.1, 0.9, 1.0, 1.05, 0.95), palm=(1.1, 0.9, 1.0), thumb_place=1.3)
ANATOMIES = {"right": HANDS["right"].anatomy, "left": HANDS["left"].anatomy, "shaped": SHAPED}
FLOAT32 = 2.0 * np.finfo(np.float32).eps * 1500.0
"""``skinning_transforms`` are float32, of lengths up to 1.5 m."""
EXACT_MM = 1e-9
each_hand = pytest.mark.parametrize("name", list(ANATOMIES))
SPACE = BodySpace()


def posed(anatomy: HandAnatomy, pose: FloatArray, thumb: FloatArray = NO_THUMB) -> Posed:
    out, inner = empty_posed(), NO_INNER.copy()
    inner[THUMB] = thumb
    pose_bones(skeleton_of(anatomy), pose, inner, out)
    return out


def random_thumb(rng: np.random.Generator) -> FloatArray:
    thumb: FloatArray = 0.3 * rng.standard_normal(2)
    return thumb


@each_hand
@given(pose=pose_strategy(), ip=st.floats(-0.6, 0.6), abduction=st.floats(-0.6, 0.6))
@settings(max_examples=40)
def test_bones_are_those_of_the_kinematics(name: str, pose: FloatArray, ip: float, abduction: float) -> None:
    anatomy, thumb = ANATOMIES[name], np.array([ip, abduction])
    found, joints = posed(anatomy, pose, thumb), joint_positions(anatomy, pose[None], thumb)[0]
    np.testing.assert_allclose(
        found.bones[:BONE_COUNT], skinning_transforms(anatomy, pose[None], thumb)[0], atol=FLOAT32
    )
    np.testing.assert_allclose(
        found.centres.reshape(15, 3), joints[1:].reshape(5, 4, 3)[:, :3].reshape(15, 3)
    )
    np.testing.assert_allclose(found.tips, joints[4::4], atol=EXACT_MM)


@each_hand
def test_axes_are_unit_vectors_across_their_joints(name: str) -> None:
    for pose in random_poses(20, seed=2):
        axes = posed(ANATOMIES[name], pose).axes[:5]
        lengths = np.linalg.norm(axes, axis=2)
        np.testing.assert_allclose(lengths[0], 1.0)
        np.testing.assert_allclose(lengths[1:, :2], 1.0)
        np.testing.assert_allclose((axes[1:, 0] * axes[1:, 1]).sum(axis=1), 0.0, atol=1e-12)


def whole_row(row: FloatArray, finger: int) -> FloatArray:
    """A row (12,) as a derivative by all of the tangent vector, then by the thumb's inner angles (23,)."""
    out = np.zeros(23)
    out[:6] = row[:6]
    if finger != PALM:
        out[6 + 3 * finger : 9 + 3 * finger] = row[6:9]
    if finger == THUMB_ROW:
        out[21:] = row[THUMB_PART : THUMB_PART + 2]
    return out


def row_of(
    found: Posed, finger: int, reaches: FloatArray, point: FloatArray, along: FloatArray
) -> FloatArray:
    row = np.full(ROW, np.nan)
    row[RESIDUAL] = 0.5
    point_row(found, finger, reaches[None], 0, *point, *along, row)
    assert row[RESIDUAL] == 0.5
    return whole_row(row, finger)


@each_hand
def test_rows_of_joints_are_their_jacobian(name: str) -> None:
    """Joint k of a finger is moved by all hinges before it, and by none after."""
    anatomy, rng = ANATOMIES[name], np.random.default_rng(3)
    for pose in random_poses(10, seed=4):
        thumb = random_thumb(rng)
        found, joints = posed(anatomy, pose, thumb), joint_positions(anatomy, pose[None], thumb)[0]
        jacobian = joint_jacobian(anatomy, pose[None], thumb)[0]
        for finger in range(5):
            for k in range(1, 4):
                joint, along = 1 + 4 * finger + k, rng.standard_normal(3)
                reaches = (np.arange(3) < k).astype(np.float64)
                expected = along @ jacobian[joint]
                row = row_of(found, finger, reaches, joints[joint], along)
                np.testing.assert_allclose(row[:21], expected, atol=1e-9 * 1500.0)


@each_hand
@pytest.mark.parametrize("bone", range(16))
def test_rows_of_rigid_points_are_central_differences(name: str, bone: int) -> None:
    """A point that one bone alone moves, of palm and fingers, by every angle, the thumb's inner ones too."""
    anatomy, rng, step = ANATOMIES[name], np.random.default_rng(bone), 1e-6
    finger, reaches = (PALM, np.zeros(3)) if bone == 0 else ((bone - 1) // 3, np.zeros(3))
    if bone > 0:
        reaches[: 1 + (bone - 1) % 3] = 1.0
    for pose in random_poses(5, seed=bone):
        rest, along, thumb = 60.0 * rng.standard_normal(3), rng.standard_normal(3), random_thumb(rng)

        def at(
            delta: FloatArray, pose: FloatArray = pose, rest: FloatArray = rest, thumb: FloatArray = thumb
        ) -> FloatArray:
            there = SPACE.retract(pose[None], delta[None, :21])[0]
            moved = posed(anatomy, there, thumb + delta[21:]).bones[bone]
            return moved[:, :3] @ rest + moved[:, 3]

        expected = [along @ (at(d) - at(-d)) / (2.0 * step) for d in step * np.eye(23)]
        row = row_of(posed(anatomy, pose, thumb), finger, reaches, at(np.zeros(23)), along)
        # differences of coordinates below 1500 mm, two roundings each, over 2 steps; lengths below 4
        np.testing.assert_allclose(row, expected, atol=4.0 * 4.0 * 1500.0 * 2.3e-16 / (2.0 * step) + 1e-6)


def test_a_point_between_two_bones_moves_by_its_share() -> None:
    """Half of the weight beyond a hinge turns a point half as far about it."""
    found = posed(RIGHT.anatomy, bent(index_pip_flexion=0.4))
    point, along = found.tips[1], np.array([0.0, 0.0, 1.0])
    whole, half = (row_of(found, 1, np.array([1.0, w, 0.0]), point, along) for w in (1.0, 0.5))
    hinge = 6 + 3 * 1 + 2
    assert half[hinge] == pytest.approx(0.5 * whole[hinge])
    np.testing.assert_allclose(half[:hinge], whole[:hinge])
