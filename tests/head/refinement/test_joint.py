"""Pose, deformation and residuals together: a known motion is found; the algebra against a dense solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.geometry.least_squares import student_t
from posetrack_cli.head.config import PointSettings, RefinementSettings
from posetrack_cli.head.face.points import ShapeModel, rigid_model
from posetrack_cli.head.face.rig_images import RigImages
from posetrack_cli.head.face.templates import take_templates
from posetrack_cli.head.refinement import refine as refinement
from posetrack_cli.head.refinement.evidence import (
    ComparedFrame,
    gather_evidence,
    make_evidence,
    make_workspace,
)
from posetrack_cli.head.refinement.joint import (
    Face,
    FaceUnknowns,
    Prior,
    descend,
    jacobian,
    point_in_camera,
)
from posetrack_cli.head.refinement.refine import RESIDUAL_MM, refine
from support.textured_face import FACING, SHAPE, stereo, textured_face

MOTION = np.array([1.5, -1.0, 3.0, 0.015, -0.02, 0.01])
FINE_MM, FINE_RAD = 0.1, 0.002
"""A twentieth of a pixel, 700 mm away, is 0.035 mm across and 0.3 mm in depth, shared by ten points."""
SETTINGS = RefinementSettings()
LENSES = {
    "no lens": {},
    "plumb bob": {"distortion": (-0.25, 0.1, 0.002, -0.003, 0.02)},
    "fisheye": {"distortion": (0.05, -0.02, 0.01, 0.003), "distortion_model": "equidistant"},
}


@pytest.fixture(autouse=True)
def _to_the_end(monkeypatch):
    """What is found is looked at, not how soon."""
    monkeypatch.setattr(refinement, "ITERATIONS", 15)


def deforming(seed=5):
    """Two directions of deformation, orthonormal and without rigid motion's main parts."""
    directions = np.random.default_rng(seed).normal(size=(30, 2))
    directions[:12] = 0.0  # eyes stay
    basis = np.linalg.qr(directions)[0].reshape(10, 3, 2)
    return ShapeModel(SHAPE, basis, np.array([8.0, 5.0]))


def moved_and_refined(cameras, model, coefficients, shape=None, settings=SETTINGS, hide=(), **light):
    face = textured_face()
    templates = take_templates(RigImages(cameras, face.render(cameras, FACING, SHAPE)), FACING, SHAPE)
    pose = FACING.moved(MOTION)
    images = face.render(cameras, pose, model.shapes(coefficients) if shape is None else shape, **light)
    images = [None if c in hide else image for c, image in enumerate(images)]
    start = np.zeros(model.size)
    frame = ComparedFrame(RigImages(cameras, images), [templates], None, settings)
    return pose, refine(frame, model, FACING, start)


def assert_pose(found, wanted, factor=1.0):
    away = found.difference(wanted)
    assert np.abs(away[:3]).max() < factor * FINE_MM, away
    assert np.abs(away[3:]).max() < factor * FINE_RAD, away


@pytest.mark.parametrize("lens", LENSES)
def test_a_known_motion_is_found(lens):
    pose, refined = moved_and_refined(stereo(**LENSES[lens]), rigid_model(SHAPE), np.zeros(0))
    assert_pose(refined.pose, pose, 2.0)
    assert refined.correlations.min() > 0.98
    assert np.abs(refined.residuals).max() < 0.5


def test_light_and_noise_change_little():
    light = {"gain": 0.7, "offset": 30.0, "noise": 2.0}
    pose, refined = moved_and_refined(stereo(), rigid_model(SHAPE), np.zeros(0), **light)
    assert_pose(refined.pose, pose, 3.0)


def test_three_cameras_and_one_of_them_without_image():
    cameras = stereo(3)
    pose, refined = moved_and_refined(cameras, rigid_model(SHAPE), np.zeros(0), hide=(0,))
    assert_pose(refined.pose, pose, 2.0)
    assert np.all(np.isnan(refined.correlations[0]))
    assert not refined.visibility[0].any()
    np.testing.assert_array_less(0.98, refined.correlations[1:])


def test_deformation_is_told_from_motion():
    model, coefficients = deforming(), np.array([4.0, -3.0])
    pose, refined = moved_and_refined(stereo(), model, coefficients)
    assert_pose(refined.pose, pose, 3.0)
    np.testing.assert_allclose(refined.coefficients, coefficients, atol=1.0)  # the prior holds them back,
    shape = model.shapes(refined.coefficients) + refined.residuals  # the residuals make up for it
    assert np.abs(shape - model.shapes(coefficients)).max() < 0.6


def test_a_point_off_the_model_becomes_a_residual_and_pulls_little():
    shape = SHAPE.copy()
    shape[5] += [1.2, -1.0, 0.0]
    pose, refined = moved_and_refined(stereo(), rigid_model(SHAPE), np.zeros(0), shape)
    assert_pose(refined.pose, pose, 4.0)
    np.testing.assert_allclose(refined.residuals[5], [1.2, -1.0, 0.0], atol=0.4)  # its prior holds it back
    assert np.abs(np.delete(refined.residuals, 5, axis=0)).max() < 0.5


def test_without_joint_the_pose_stays_and_its_look_is_told():
    settings = SETTINGS.model_copy(update={"joint": False})
    _, refined = moved_and_refined(stereo(), rigid_model(SHAPE), np.zeros(0), settings=settings)
    np.testing.assert_array_equal(refined.pose.position, FACING.position)
    assert 0.0 < np.nanmean(refined.correlations) < 0.95


def test_images_that_show_nothing_leave_everything_where_it_was():
    cameras = stereo()
    images = textured_face().render(cameras, FACING, SHAPE)
    templates = take_templates(RigImages(cameras, images), FACING, SHAPE)
    blank = [np.full_like(image, 90) for image in images]
    frame = ComparedFrame(RigImages(cameras, blank), [templates], None, SETTINGS)
    refined = refine(frame, deforming(), FACING, np.zeros(2))
    np.testing.assert_allclose(refined.pose.position, FACING.position)
    np.testing.assert_array_equal(refined.coefficients, 0.0)
    assert np.all(np.isnan(refined.correlations))


def state_at(pose, coefficients, residuals):
    unknowns = pose.rotation.copy(), pose.position.copy(), coefficients.copy(), residuals.copy()
    return FaceUnknowns(*unknowns, np.zeros(6), np.empty((2, 10)))


def problem():
    """A face somewhere near, with coefficients and residuals that are not zero."""
    cameras, model = stereo(), deforming()
    images = textured_face().render(cameras, FACING, SHAPE)
    templates = take_templates(RigImages(cameras, images), FACING, SHAPE)
    frame = ComparedFrame(RigImages(cameras, images), [templates], templates, SETTINGS)
    scene, _ = frame.scene(FACING, SHAPE)
    face = Face(model.mean, np.ascontiguousarray(model.basis), model.deviations**-2)
    prior = Prior(RESIDUAL_MM, 4.0, np.array([50.0] * 3 + [0.5] * 3) ** -2)
    residuals = np.random.default_rng(2).normal(size=(10, 3))
    pose = FACING.moved(0.5 * MOTION)
    return scene, face, prior, pose, np.array([1.0, -0.5]), residuals


def test_jacobian_of_a_point_is_the_difference_of_moved_poses():
    _, face, _, pose, coefficients, residuals = problem()
    state, arm, T, h = state_at(pose, coefficients, residuals), np.empty(3), np.empty((3, 8)), 1e-5
    model = ShapeModel(face.mean, face.basis, np.ones(2))
    for k in (0, 5):
        point_in_camera(face, state, k, arm)
        jacobian(face, state, k, arm, T)
        for n, step in enumerate(h * np.eye(8)):
            ahead, behind = (
                pose.moved(sign * step[:6]).points(model.shapes(coefficients + sign * step[6:]) + residuals)[
                    k
                ]
                for sign in (1, -1)
            )
            np.testing.assert_allclose(T[:, n], (ahead - behind) / (2 * h), atol=1e-6)


def test_one_step_is_the_dense_solution_of_all_unknowns():
    scene, face, prior, pose, coefficients, residuals = problem()
    H, g = dense_equations(scene, face, prior, pose, coefficients, residuals)
    step = np.linalg.solve(H, -g)
    state = state_at(pose, coefficients, residuals)
    descend(scene, face, prior, 1, state)
    np.testing.assert_allclose(state.moved, step[:6], atol=1e-9)
    np.testing.assert_allclose(state.coefficients - coefficients, step[6:8], atol=1e-9)
    wanted = residuals + step[8:].reshape(10, 3) @ pose.rotation  # camera axes to the head's
    np.testing.assert_allclose(state.residuals, wanted, atol=1e-9)
    np.testing.assert_allclose(state.rotation, pose.moved(step[:6]).rotation, atol=1e-12)


def dense_equations(scene, face, prior, pose, coefficients, residuals):
    """Normal equations of (pose, a, all residuals), 6 + B + 3K unknowns, put together the plain way."""
    size = 6 + 2
    H, g = np.zeros((size + 30, size + 30)), np.zeros(size + 30)
    H[:size, :size] = np.diag(np.concatenate([prior.pose, face.precisions]))
    g[6:size] = face.precisions * coefficients
    state, arm, T = state_at(pose, coefficients, residuals), np.empty(3), np.empty((3, size))
    evidence, work = make_evidence(2), make_workspace(2)
    for k in range(10):
        point_in_camera(face, state, k, arm)
        jacobian(face, state, k, arm, T)
        gather_evidence(scene, k, arm + pose.position, work, evidence)
        rows = np.zeros((3, size + 30))
        rows[:, :size] = T
        rows[:, size + 3 * k : size + 3 * k + 3] = np.eye(3)
        H += rows.T @ evidence.hessian @ rows
        g += rows.T @ evidence.gradient
        weight = student_t(residuals[k] @ residuals[k], 3.0, prior.freedom, prior.scales[k])
        own = slice(size + 3 * k, size + 3 * k + 3)
        H[own, own] += weight * np.eye(3)
        g[own] += weight * pose.rotation @ residuals[k]
    return H, g


def test_each_kind_of_point_has_its_number():
    values = PointSettings(eyes=1.0, mouth=2.0, nostrils=3.0, brows=4.0).values
    assert values.tolist() == [1.0] * 4 + [2.0] * 2 + [3.0] * 2 + [4.0] * 2


def test_an_unknown_previous_frame_is_no_template():
    """With a set of the frame before in which nothing was seen, results are those without it."""
    cameras, face = stereo(), textured_face()
    templates = take_templates(RigImages(cameras, face.render(cameras, FACING, SHAPE)), FACING, SHAPE)
    blind = replace(templates, seen=np.zeros_like(templates.seen))
    images = RigImages(cameras, face.render(cameras, FACING.moved(MOTION), SHAPE))
    frames = [ComparedFrame(images, [templates], one, SETTINGS) for one in (None, blind)]
    a, b = (refine(frame, rigid_model(SHAPE), FACING, np.zeros(0)) for frame in frames)
    np.testing.assert_array_equal(a.pose.position, b.pose.position)
