"""The head's particle filter: its weights against (3.27) point by point, and that it follows a head."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.head.config import ParticleSettings
from posetrack_cli.head.face.points import rigid_model
from posetrack_cli.head.particles.filter import HeadFilter
from posetrack_cli.head.particles.particles import FRAME_S, HeadMotion, velocity_between
from posetrack_cli.head.particles.scores import ParticleScores
from support.particle_scenes import FACING, cameras, model, observation, pixels

AT_REST = np.zeros(6)
SETTINGS = ParticleSettings()
COEFFICIENTS = np.array([4.0, -2.0])
TOLERANCE = 1e-4
"""Of a correlation, as in test_score_maps."""


def correlation(image, patch, u, v):
    """At the nearest place, from its definition; 0 where the template is not on the image as a whole."""
    column, row = int(np.floor(u - 7.0)), int(np.floor(v - 7.0))
    if not (0 <= column <= image.shape[1] - 16 and 0 <= row <= image.shape[0] - 16):
        return 0.0
    a = image[row : row + 16, column : column + 16].astype(float)
    a, b = a - a.mean(), patch - patch.mean()
    norm = np.sqrt((a * a).sum() * (b * b).sum())
    return float((a * b).sum() / norm) if norm > 1e-6 else 0.0


def started(settings, face, pose=FACING, seed=0):
    used = cameras()
    head = HeadFilter(settings, used)
    return used, head, head.start(pose, face, np.random.default_rng(seed))


def scores(used, seen, particles, deviations):
    asked = ParticleScores(used, between=False)
    asked.observe(seen, particles)
    return asked.missing(deviations)


def missing_one_by_one(used, seen, particles, deviations):
    """2K - c, (3.28), by one projection and one correlation per particle, camera and point."""
    result = []
    for deviation in deviations:
        pose = particles.pose.moved(deviation[:6])
        shape = particles.model.shapes(particles.coefficients + deviation[6:])
        total = 0.0
        for c, camera in enumerate(used):
            if seen.images[c] is None:
                continue
            for k, (u, v) in enumerate(pixels(camera, pose, shape)):
                matched = correlation(seen.images[c], seen.templates[c, k], u, v)
                total += seen.visibility[c, k] * (1.0 - matched)
        result.append(total)
    return np.array(result)


@pytest.mark.parametrize("dropped", [None, 0, 1])
def test_scores_are_one_correlation_per_particle_camera_and_point(dropped):
    face, rng = model(), np.random.default_rng(4)
    used, _, particles = started(ParticleSettings(count=60), face)
    visibility = rng.random((2, 10))
    visibility[0, 3] = visibility[1, 0] = 0.0
    seen = observation(FACING, face.mean, used, visibility)
    if dropped is not None:
        seen = replace(seen, images=[None if c == dropped else i for c, i in enumerate(seen.images)])
    particles = particles.moved_to(FACING, COEFFICIENTS)
    found = scores(used, seen, particles, particles.deviations)
    expected = missing_one_by_one(used, seen, particles, particles.deviations)
    # A pixel at the border between two places may be rounded to either: of 1200 none or one or two are.
    differs = np.abs(found - expected) > TOLERANCE * 20
    assert np.count_nonzero(differs) <= 2
    assert np.ptp(expected) > 1.0, "particles differ"


def test_a_map_that_is_too_small_for_the_second_weighing_is_made_anew():
    face = model()
    used, _, particles = started(ParticleSettings(count=100), face)
    seen = observation(FACING, face.mean, used)
    asked = ParticleScores(used, between=True)
    asked.observe(seen, particles)
    asked.missing(0.1 * particles.deviations)
    after_narrow = asked.missing(5.0 * particles.deviations)
    asked.observe(seen, particles)
    assert after_narrow == pytest.approx(asked.missing(5.0 * particles.deviations), abs=20 * TOLERANCE)


@pytest.mark.parametrize("weighting", ["printed", "patches"])
def test_weights_are_as_printed_or_of_patches_with_noise(weighting):
    """exp(-(2K - c)^2 / (2 3^2)), (3.27), or exp(-(2K - c) / 0.35^2), times the prior of the deformation."""
    face = model()
    settings = ParticleSettings(count=200, weighting=weighting, lookup="nearest", sampling="printed")
    used, head, particles = started(settings, face)
    seen = observation(FACING, face.mean, used)
    filtered = head.step(particles, HeadMotion(AT_REST, FRAME_S, SETTINGS), seen, np.random.default_rng(1))
    after = filtered.particles
    missing = scores(used, seen, after, after.deviations)
    a = after.coefficients + after.deviations[:, 6:]
    misfit = np.square(missing) / 18.0 if weighting == "printed" else missing / 0.35**2
    expected = np.exp(-misfit - 0.5 * np.square(a / face.deviations).sum(axis=1))
    # The reference has moved, and float32 pixels with it: a place between two may be rounded to the other.
    ratio = after.weights / (expected / expected.sum())
    assert np.mean(np.abs(ratio / np.median(ratio) - 1.0) < 5e-3) > 0.95
    assert after.weights.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("sampling", ["weighted", "printed"])
@pytest.mark.parametrize("size", [0, 2])
def test_follows_a_head_that_moves_and_deforms(sampling, size):
    """Twelve frames of some 2 mm and 1 degree each; 0.7 mm is a pixel, depth is ten times less certain."""
    face, rng = model(size), np.random.default_rng(2)
    settings = ParticleSettings(sampling=sampling)
    used, head, particles = started(settings, face)
    velocity = np.array([60.0, -30.0, 30.0, 0.2, 0.5, -0.3])
    pose, found, found_velocity = FACING, FACING, velocity
    truth = COEFFICIENTS[:size] * 0.0
    for _ in range(12):
        pose = pose.moved(velocity * FRAME_S)
        truth = 0.7 * truth + 0.3 * COEFFICIENTS[:size]
        seen = observation(pose, face.shapes(truth), used)
        filtered = head.step(particles, HeadMotion(found_velocity, FRAME_S, settings), seen, rng)
        found_velocity = velocity_between(found, filtered.pose, FRAME_S)
        found, particles = filtered.pose, filtered.particles
    error = pose.difference(found)
    assert np.all(np.abs(error[:2]) < 0.7) and abs(error[2]) < 6.0
    assert np.all(np.abs(error[3:]) < np.deg2rad(2.0))
    assert filtered.coefficients == pytest.approx(truth, abs=2.5)
    assert 1.0 <= filtered.effective_sample_size <= settings.count


def test_a_camera_that_drops_out_is_done_without():
    face, rng = rigid_model(model().mean), np.random.default_rng(3)
    used, head, particles = started(ParticleSettings(), face)
    seen = observation(FACING, face.mean, used)
    alone = replace(seen, images=[seen.images[0], None])
    filtered = head.step(particles, HeadMotion(AT_REST, FRAME_S, SETTINGS), alone, rng)
    assert np.all(np.abs(FACING.difference(filtered.pose)[:2]) < 0.7)
    nothing = replace(seen, images=[None, None])
    blind = head.step(filtered.particles, HeadMotion(AT_REST, FRAME_S, SETTINGS), nothing, rng)
    assert blind.effective_sample_size == pytest.approx(1000.0)


def test_the_same_seed_gives_the_same_particles():
    face, results = model(), []
    for _ in range(2):
        used, head, particles = started(ParticleSettings(count=100), face)
        seen, rng = observation(FACING, face.mean, used), np.random.default_rng(9)
        for _ in range(2):
            filtered = head.step(particles, HeadMotion(AT_REST, FRAME_S, SETTINGS), seen, rng)
            particles = filtered.particles
        results.append(particles.deviations.tolist())
    assert results[0] == results[1]


def test_templates_are_laid_at_as_many_places_for_more_particles():
    """One map per camera and point, or two where the second weighing leaves the first one's: for any N."""
    face = model()
    for count in (100, 5000):
        used, head, particles = started(ParticleSettings(count=count), face)
        seen = observation(FACING, face.mean, used)
        head.step(particles, HeadMotion(AT_REST, FRAME_S, SETTINGS), seen, np.random.default_rng(0))
        assert 20 <= head._scores.maps_made <= 40


def test_moving_the_reference_shifts_all_particles():
    face = model()
    _, _, particles = started(ParticleSettings(count=50), face)
    tangent = np.array([5.0, -3.0, 10.0, 0.02, -0.05, 0.01])
    shifted = particles.moved_to(FACING.moved(tangent), COEFFICIENTS)
    assert shifted.deviations is particles.deviations
    middle = FACING.difference(shifted.pose.moved(shifted.deviations.mean(axis=0)[:6]))
    assert middle == pytest.approx(tangent + particles.deviations.mean(axis=0)[:6], abs=1e-3)


def test_about_another_pose_the_hypotheses_stay():
    face = model()
    _, _, particles = started(ParticleSettings(count=50), face)
    mean = np.array([1.0, 2.0, -3.0, 0.05, 0.02, -0.03, 2.0, -1.0])
    moved = particles.about(mean)
    for before, after in zip(particles.deviations, moved.deviations, strict=True):
        one, two = particles.pose.moved(before[:6]), moved.pose.moved(after[:6])
        assert one.difference(two) == pytest.approx(np.zeros(6), abs=1e-10)
    assert moved.coefficients + moved.deviations[:, 6:] == pytest.approx(
        particles.coefficients + particles.deviations[:, 6:]
    )


def test_a_model_that_turned_its_directions_keeps_every_shape():
    """The same space of shapes, other axes and another mean in it: nothing changes but the numbers."""
    face = model(2)
    _, _, particles = started(ParticleSettings(count=50), face)
    particles = particles.moved_to(FACING, COEFFICIENTS)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    mean = face.shapes(np.array([1.0, 2.0]))
    other = replace(face, mean=mean, basis=face.basis @ turn)
    changed = particles.with_model(other)
    before = face.shapes(particles.coefficients + particles.deviations[:, 6:])
    after = other.shapes(changed.coefficients + changed.deviations[:, 6:])
    assert after == pytest.approx(before)
    assert particles.with_model(face) is particles


def test_a_face_that_begins_to_deform_starts_from_its_mean():
    face = model(2)
    _, _, particles = started(ParticleSettings(count=50), rigid_model(face.mean))
    changed = particles.with_model(face)
    assert changed.deviations.shape == (50, 8)
    assert changed.coefficients.tolist() == [0.0, 0.0] and np.all(changed.deviations[:, 6:] == 0.0)


def test_time_must_move_on():
    face = model()
    used, head, particles = started(ParticleSettings(count=10), face)
    seen = observation(FACING, face.mean, used)
    with pytest.raises(FilterError):
        head.step(particles, HeadMotion(AT_REST, 0.0, SETTINGS), seen, np.random.default_rng(0))
