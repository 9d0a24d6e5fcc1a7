"""What a face model is learnt from: shapes laid on the mean, near the front, deformed enough."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from scipy.linalg import subspace_angles
from scipy.spatial.transform import Rotation

from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.config import ModelSettings
from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_COUNT, HeadPose
from posetrack_cli.head.tracker.face_learning import (
    FaceLearning,
    new_face,
    off_axis_deg,
    untrained_statistics,
)

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
        face = face.after(shape, EQUAL, pose(), SURE, face.model.mean)
    return face


def test_the_first_frames_average_the_shape() -> None:
    settings = ModelSettings(rigid_frames=120)
    rng = np.random.default_rng(0)
    shapes = [smile(float(strength)) for strength in rng.uniform(-4.0, 4.0, 50)]
    face = learnt(new_face(MEAN_SHAPE, settings), shapes)
    np.testing.assert_allclose(face.model.mean, np.mean(shapes, axis=0), atol=ROUNDING)
    later = learnt(face, [smile(8.0)])
    np.testing.assert_allclose(later.model.mean, 0.98 * face.model.mean + 0.02 * smile(8.0), atol=ROUNDING)
    assert later.model.size == 0 and later.frames == 51


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
    after = face.after(shape, EQUAL, pose(yaw_deg), correlations, MEAN_SHAPE)
    assert after.statistics is face.statistics and after.frames == 1


def test_as_printed_the_first_frames_are_tracked_rigidly_and_learnt_from() -> None:
    """3.4: with the shape found for 120 frames, M'_1 of the mean (3.20), which all clear frames count for."""
    settings = ModelSettings(rigid_phase="printed")
    shapes = [smile(float(strength)) for strength in np.tile([8.0, -8.0], 59)]
    clear = [MEAN_SHAPE, *shapes]  # the first of them is too near the mean for a component
    face = learnt(new_face(MEAN_SHAPE, settings), clear)
    assert face.frames == 119 and face.statistics.learnt == len(shapes)
    np.testing.assert_array_equal(face.model.mean, MEAN_SHAPE)
    assert face.model.size == 0
    later = learnt(face, [MEAN_SHAPE])
    wanted = np.mean([MEAN_SHAPE, *clear, MEAN_SHAPE], axis=0)
    np.testing.assert_allclose(later.model.mean, wanted, atol=ROUNDING)
    assert later.statistics.learnt == len(shapes)
    direction = (smile(1.0) - MEAN_SHAPE).ravel()
    cosine = abs(later.model.basis[..., 0].ravel() @ direction) / np.linalg.norm(direction)
    assert cosine == pytest.approx(1.0, abs=ROUNDING)
    ours = learnt(new_face(MEAN_SHAPE, ModelSettings()), [MEAN_SHAPE, *shapes, MEAN_SHAPE])
    assert ours.statistics.learnt == 0


def test_as_printed_a_rigid_face_stays_the_one_that_was_found() -> None:
    settings = ModelSettings(rigid_phase="printed", kind="rigid", rigid_frames=2)
    face = learnt(new_face(MEAN_SHAPE, settings), [smile(8.0)] * 4)
    np.testing.assert_array_equal(face.model.mean, MEAN_SHAPE)


def test_a_shape_is_laid_on_the_mean_from_a_distance_to_the_model_on() -> None:
    """3.2.3: a shape moved by 2 mm in x is 2 sqrt(K) mm from the model's."""
    moved = smile(8.0) + np.array([2.0, 0.0, 0.0])
    means = {}
    for above_mm in (0.0, 2.0 * np.sqrt(POINT_COUNT) - 0.01, 2.0 * np.sqrt(POINT_COUNT) + 0.01):
        settings = ModelSettings(rigid_frames=0, rigid_phase="printed", align_above_mm=above_mm)
        face = new_face(MEAN_SHAPE, settings).after(moved, EQUAL, pose(), SURE, smile(8.0))
        means[above_mm] = face.statistics.mean
    always, above, below = means.values()
    np.testing.assert_array_equal(always, above)
    np.testing.assert_allclose(always, 0.5 * (MEAN_SHAPE + smile(8.0)), atol=ROUNDING)
    np.testing.assert_allclose(below, 0.5 * (MEAN_SHAPE + moved), atol=ROUNDING)


def test_a_rigid_face_learns_no_deformation() -> None:
    settings = ModelSettings(kind="rigid", rigid_frames=0)
    face = learnt(new_face(MEAN_SHAPE, settings), [smile(10.0)] * 3)
    assert face.model.size == 0
    np.testing.assert_array_equal(face.model.mean, MEAN_SHAPE)


def test_off_axis_is_counted_from_the_direction_to_the_camera() -> None:
    assert off_axis_deg(pose(20.0)) == pytest.approx(20.0)
    beside = pose(0.0, (700.0, 0.0, 700.0))  # it looks along the camera's axis, past it
    assert off_axis_deg(beside) == pytest.approx(45.0)


# CCIPCA against the exact decomposition of the same, or of infinitely many, shapes


SIZE = MEAN_SHAPE.size
DEVIATIONS = np.array([12.0, 7.0, 4.0])
"""mm: each eigenvalue less than half the one before, else a wrong start is forgotten too slowly."""
REST = 1.0
AXES = np.linalg.qr(np.random.default_rng(0).normal(size=(SIZE, SIZE)))[0]


def shapes(count, seed):
    """Faces of known principal axes: three deformations, and a little of everything else."""
    rng = np.random.default_rng(seed)
    sd = np.full(SIZE, REST)
    sd[:3] = DEVIATIONS
    return MEAN_SHAPE + (rng.normal(size=(count, SIZE)) * sd @ AXES.T).reshape(count, -1, 3)


def learned_of(samples, components=3, mean_count=0):
    state = untrained_statistics(MEAN_SHAPE, components, mean_count)
    for sample in samples:
        state = state.updated(sample)
    return state


def angle(model, axes):
    """Largest principal angle, rad, between a model's directions and some axes (3K, B)."""
    return float(subspace_angles(model.basis.reshape(SIZE, -1), axes).max())


def test_the_angle_falls_as_the_square_root_of_time():
    """Root mean square over 12 recordings; the sample covariance's own angle falls like this too."""
    times, squares = (250, 1000, 4000), np.zeros(3)
    for seed in range(12):
        samples, state, done = shapes(times[-1], seed), untrained_statistics(MEAN_SHAPE, 3), 0
        for i, time in enumerate(times):
            for sample in samples[done:time]:
                state = state.updated(sample)
            done = time
            squares[i] += angle(state.model, AXES[:, :3]) ** 2
    slope = np.polyfit(np.log(times), 0.5 * np.log(squares), 1)[0]
    assert slope == pytest.approx(-0.5, abs=0.1)


def test_agrees_with_the_exact_decomposition_of_the_same_shapes():
    samples = shapes(4000, 21)
    exact = samples.reshape(len(samples), -1) - samples.reshape(len(samples), -1).mean(axis=0)
    _, values, rows = np.linalg.svd(exact, full_matrices=False)
    model = learned_of(samples).model
    # Both are off the true axes by about this, sqrt(ab / n) / (a - b) for variances a and b (Anderson 1963).
    a, b, freedom = DEVIATIONS[2] ** 2, REST**2, SIZE - 3
    expected = np.sqrt(freedom * a * b / len(samples)) / (a - b)
    assert angle(model, rows[:3].T) < 2.0 * expected
    assert angle(model, AXES[:, :3]) < 2.0 * expected
    assert model.deviations == pytest.approx(values[:3] / np.sqrt(len(samples)), rel=0.05)
    assert model.mean == pytest.approx(samples.mean(axis=0))


def test_one_update_by_hand():
    """A mean that counts for one shape and two numbers that move: (3.20), then (3.24) and (3.25)."""
    mean = np.zeros((1, 3))
    state = untrained_statistics(mean, 2, mean_count=1).updated(np.array([[6.0, 0.0, 0.0]]))
    assert state.mean.ravel().tolist() == [3.0, 0.0, 0.0]  # (0 + 6) / 2
    assert state.components.tolist() == [
        [9.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
    ]  # u |u|, u = 6 - 3; nothing is left
    state = state.updated(np.array([[3.0, 6.0, 0.0]]))
    assert state.mean.ravel().tolist() == [3.0, 2.0, 0.0]  # u = (0, 4, 0)
    assert state.components.tolist() == [[4.5, 0.0, 0.0], [0.0, 8.0, 0.0]]  # 9 / 2 + 0; 4 * 4 / 2
    assert state.eigenvalues.tolist() == [8.0, 4.5]
    assert state.variance == 12.5  # (9 + 16) / 2
    assert state.contribution.tolist() == pytest.approx([0.64, 1.0])
    assert state.model.deviations == pytest.approx(np.sqrt([8.0, 4.5]))
    assert state.model.basis[0, :, 0].tolist() == [0.0, 1.0, 0.0]


def test_as_printed_the_first_shape_is_the_mean():
    samples = shapes(2, 3)
    first = learned_of(samples[:1])
    assert first.mean == pytest.approx(samples[0])
    assert first.model.size == 0 and first.contribution.tolist() == [0.0, 0.0, 0.0]
    assert learned_of(samples).model.size == 1


def test_the_model_is_orthonormal_and_descending_at_any_time():
    state = untrained_statistics(MEAN_SHAPE, 5, mean_count=120)
    for sample in shapes(40, 5):
        state = state.updated(sample)
        flat = state.model.basis.reshape(SIZE, -1)
        assert flat.T @ flat == pytest.approx(np.eye(state.model.size), abs=1e-9)
        assert np.all(np.diff(state.model.deviations) <= 0.0)
        assert np.all(np.diff(state.contribution) >= 0.0) and state.contribution[-1] <= 1.0


def test_a_new_deformation_lowers_the_contribution_until_it_is_learnt():
    """Figure 3.10: a dip when another deformation appears."""
    rng, axes = np.random.default_rng(8), AXES[:, :4].T.reshape(4, -1, 3)

    def faces(count, used):
        return MEAN_SHAPE + np.tensordot(rng.normal(size=(count, used)) * 8.0, axes[:used], axes=1)

    before = learned_of(faces(300, 1), components=2)
    dip = learnt_on(before, faces(20, 4))
    assert before.contribution[-1] > 0.99
    assert dip.contribution[-1] < before.contribution[-1] - 0.02
    assert learnt_on(dip, faces(1500, 2)).contribution[-1] > dip.contribution[-1]


def learnt_on(state, samples):
    for sample in samples:
        state = state.updated(sample)
    return state


def test_equal_shapes_teach_nothing():
    state = learned_of([MEAN_SHAPE] * 5, mean_count=10)
    assert state.model.size == 0 and state.variance == 0.0


def test_an_update_costs_the_same_at_any_time():
    """The lines of Python that run are as many after 5000 shapes as after 10, and no array has grown."""
    samples = shapes(5010, 1)
    early = learned_of(samples[:10])
    late = learnt_on(early, samples[10:])
    assert lines_run(early, samples[0]) == lines_run(late, samples[0])
    assert late.components.shape == early.components.shape and late.mean.shape == early.mean.shape


def lines_run(state, sample):
    count = 0

    def trace(frame, event, argument):
        nonlocal count
        count += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        state.updated(sample)
    finally:
        sys.settrace(before)
    return count
