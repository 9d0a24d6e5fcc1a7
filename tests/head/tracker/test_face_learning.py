"""What a face model is learnt from: shapes laid on the mean, near the front, deformed enough."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posetrack_cli.geometry.euler import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.config import ModelSettings
from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_COUNT
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.head.tracker.face_learning import FaceLearning, new_face, off_axis_deg

ROUNDING = 1e-9  # mm, of numbers below 100
SURE, EQUAL = np.ones(POINT_COUNT), np.ones(POINT_COUNT)
AFTER_REST = ModelSettings(rigid_frames=0)


def pose(yaw_deg: float = 0.0, position: tuple[float, float, float] = (0.0, 0.0, 700.0)) -> HeadPose:
    angles = np.radians([0.0, 0.0, yaw_deg])
    return HeadPose(np.array(position), head_quaternion_from_roll_pitch_yaw(angles))


def smile(strength_mm: float) -> np.ndarray:
    """The mean face, the mouth corners apart by that much more: no part of it is rigid motion."""
    shape = MEAN_SHAPE.copy()
    shape[4, 0] -= 0.5 * strength_mm
    shape[5, 0] += 0.5 * strength_mm
    return shape


def learnt(face: FaceLearning, shapes: list[np.ndarray]) -> FaceLearning:
    for shape in shapes:
        face = face.after(shape, EQUAL, pose(), SURE)
    return face


def test_the_first_frames_average_the_shape() -> None:
    settings = ModelSettings(rigid_frames=120, mean_rate=0.1)
    rng = np.random.default_rng(0)
    shapes = [smile(float(strength)) for strength in rng.uniform(-4.0, 4.0, 10)]
    face = learnt(new_face(MEAN_SHAPE, settings), shapes)
    np.testing.assert_allclose(face.model.mean, np.mean(shapes, axis=0), atol=ROUNDING)
    later = learnt(face, [smile(8.0)])
    np.testing.assert_allclose(later.model.mean, 0.9 * face.model.mean + 0.1 * smile(8.0), atol=ROUNDING)
    assert later.model.size == 0 and later.frames == 11


@pytest.mark.parametrize("rigid_frames", [0, 120])
def test_what_the_pose_is_wrong_by_is_not_learnt(rigid_frames: int) -> None:
    settings = ModelSettings(rigid_frames=rigid_frames)
    turn = Rotation.from_euler("xyz", [3.0, -4.0, 2.0], degrees=True).as_matrix()
    shapes = [smile(float(strength)) for strength in (6.0, -6.0, 8.0)]
    moved = [shape @ turn.T + [1.0, -2.0, 3.0] for shape in shapes]
    plain = learnt(new_face(MEAN_SHAPE, settings), shapes)
    turned = learnt(new_face(MEAN_SHAPE, settings), moved)
    np.testing.assert_allclose(turned.model.mean, plain.model.mean, atol=ROUNDING)
    np.testing.assert_allclose(turned.model.deviations, plain.model.deviations, atol=ROUNDING)


def test_a_deformation_that_recurs_becomes_the_first_component() -> None:
    rng = np.random.default_rng(1)
    strengths = 10.0 * rng.choice([-1.0, 1.0], 200)
    face = learnt(new_face(MEAN_SHAPE, AFTER_REST), [smile(float(strength)) for strength in strengths])
    direction = (smile(1.0) - MEAN_SHAPE).ravel()
    cosine = abs(face.model.basis[..., 0].ravel() @ direction) / np.linalg.norm(direction)
    assert cosine > 0.999
    # sd of +-5 mm in each corner: |deformation| = 10 / sqrt(2); CCIPCA's first samples are off by 1 / t each
    assert face.model.deviations[0] == pytest.approx(10.0 / np.sqrt(2.0), rel=0.1)


@pytest.mark.parametrize(
    ("shape", "yaw_deg", "correlation"),
    [
        (smile(10.0), 30.0, 1.0),  # turned away
        (smile(10.0), 0.0, 0.4),  # one point is not what it was
        (smile(10.0), 0.0, np.nan),  # or not seen
        (smile(1.0), 0.0, 1.0),  # hardly deformed
        (smile(200.0), 0.0, 1.0),  # no face
    ],
)
def test_other_frames_teach_nothing(shape: np.ndarray, yaw_deg: float, correlation: float) -> None:
    correlations = SURE.copy()
    correlations[7] = correlation
    face = new_face(MEAN_SHAPE, AFTER_REST)
    after = face.after(shape, EQUAL, pose(yaw_deg), correlations)
    assert after.statistics is face.statistics and after.frames == 1


def test_a_rigid_face_learns_no_deformation() -> None:
    settings = ModelSettings(kind="rigid", rigid_frames=0)
    face = learnt(new_face(MEAN_SHAPE, settings), [smile(10.0)] * 3)
    assert face.model.size == 0
    np.testing.assert_array_equal(face.model.mean, MEAN_SHAPE)


def test_off_axis_is_counted_from_the_direction_to_the_camera() -> None:
    assert off_axis_deg(pose(20.0)) == pytest.approx(20.0)
    beside = pose(0.0, (700.0, 0.0, 700.0))  # it looks along the camera's axis, past it
    assert off_axis_deg(beside) == pytest.approx(45.0)
