"""Particles' points on images, against OpenCV and against poses that are moved one by one."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posetrack_cli.geometry.camera import in_camera_axes
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.particles.particles import HeadParticles
from posetrack_cli.head.particles.score_maps import BEHIND, recentre
from posetrack_cli.head.particles.scores import ParticleProjection
from support.particle_scenes import FACING, LENS, cameras, model

COEFFICIENTS = np.array([3.0, -2.0])
SPREAD = np.array([20.0, 20.0, 40.0, 0.3, 0.3, 0.3, 5.0, 3.0])
PIXEL_TOLERANCE = 2e-3
"""float32 has 3e-5 px at 600 px; 30 operations, and a lens, on the way."""


def about(coefficients, face):
    """A particle at FACING with a deformation."""
    return HeadParticles(FACING, coefficients, np.zeros((1, 6 + len(coefficients))), np.ones(1), face)


def deviations(count=50, seed=1, spread=SPREAD):
    return spread * np.random.default_rng(seed).normal(size=(count, len(spread)))


@pytest.mark.parametrize(
    "distortion, lens",
    [((), "plumb_bob"), (LENS, "plumb_bob"), ((*LENS, 0.02, -0.01, 0.003), "rational_polynomial")],
)
def test_pixels_agree_with_opencv(distortion, lens):
    used, face = cameras(distortion, lens), model()
    projection = ParticleProjection(used)
    projection.set_reference(about(COEFFICIENTS, face))
    moved = deviations()
    projection.set_particles(moved)
    for c, camera in enumerate(used):
        u, v = projection.pixels(c)
        for n, deviation in enumerate(moved):
            points = FACING.moved(deviation[:6]).points(face.shapes(COEFFICIENTS + deviation[6:]))
            transform = np.array(camera.camera_T_reference)
            turn = cv2.Rodrigues(transform[:, :3])[0]
            expected, _ = cv2.projectPoints(
                points, turn, transform[:, 3], camera.matrix, np.array(distortion)
            )
            assert np.stack([u[:, n], v[:, n]], axis=-1) == pytest.approx(expected[:, 0], abs=PIXEL_TOLERANCE)


def test_other_numbers_of_particles_and_coefficients_follow_each_other():
    projection, (camera, _) = ParticleProjection(cameras()), cameras()
    for size, count in ((0, 5), (2, 7), (2, 3), (1, 3)):
        face = model(size)
        projection.set_reference(about(np.zeros(size), face))
        projection.set_particles(np.zeros((count, 6 + size)))
        u, v = projection.pixels(0)
        expected, _ = camera.pixels_from_points(in_camera_axes(camera, FACING.points(face.mean)))
        assert u.shape == v.shape == (10, count)
        assert np.stack([u[:, -1], v[:, -1]], axis=-1) == pytest.approx(expected, abs=PIXEL_TOLERANCE)


def test_points_behind_a_camera_are_on_no_image():
    projection = ParticleProjection(cameras())
    projection.set_reference(about(np.zeros(0), model(0)))
    projection.set_particles(np.array([[0.0, 0.0, -2000.0, 0.0, 0.0, 0.0]]))
    u, v = projection.pixels(0)
    assert np.all(u == BEHIND) and np.all(v == BEHIND)


@pytest.mark.parametrize("spread", [1e-9, 1e-3, 0.05, 0.5, 2.0])
def test_recentred_deviations_are_the_same_poses(spread):
    """Small and large turns, up to the half turn that a tangent vector can tell."""
    scale = np.array([5.0, 5.0, 5.0, spread, spread, spread])
    away = deviations(40, 2, scale)
    away[:, 3:] *= np.minimum(1.0, 3.0 / np.linalg.norm(away[:, 3:], axis=1, keepdims=True))
    mean = deviations(1, 3, scale)[0] / 2.0
    moved, centre = away.copy(), FACING.moved(mean)
    recentre(moved, mean)
    for before, after in zip(away, moved, strict=True):
        expected, found = FACING.moved(before), centre.moved(after)
        assert found.position == pytest.approx(expected.position)
        assert abs(found.quaternion @ expected.quaternion) == pytest.approx(1.0, abs=1e-13)
        assert np.linalg.norm(expected.difference(found)[3:]) < 1e-11
        assert np.linalg.norm(after[3:]) <= np.pi + 1e-12


def test_recentring_on_itself_is_nothing():
    mean = deviations(1, 4)[0]
    moved = mean[None].copy()
    recentre(moved, mean)
    assert moved[0, :6] == pytest.approx(np.zeros(6), abs=1e-12)
    assert isinstance(FACING.moved(moved[0, :6]), HeadPose)
