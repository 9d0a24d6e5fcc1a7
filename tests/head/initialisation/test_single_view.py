"""The pose of a known shape: exact without noise, else as good as noise allows, and not the mirror image."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.geometry.camera import pixels_and_jacobian
from posetrack_cli.head.face.points import FEATURES
from posetrack_cli.head.initialisation.single_view import pose_near, pose_of
from support.initialisation_scenes import BENT, FISHEYE, PLAIN, head, pixels_of

SURE = np.ones(10)
# mm and rad: the descent ends when a step gains less than 1e-9 squared pixels; one pixel is some 1e-2 rad.
EXACT = 1e-5


def heads():
    """Heads that a camera may see, turned up to 40 degrees, well off the middle of the image."""
    turns = st.floats(-40.0, 40.0)
    sides = st.floats(-0.25, 0.25)
    return st.builds(
        lambda roll, pitch, yaw, x, y, z: head(roll, pitch, yaw, x * z, y * z, z),
        turns, turns, turns, sides, sides, st.floats(300.0, 2000.0),
    )  # fmt: skip


@pytest.mark.parametrize("camera", [PLAIN, BENT, FISHEYE], ids=lambda camera: camera.name)
@given(truth=heads())
def test_exact_pixels_give_the_exact_pose(camera, truth):
    pose, rms = pose_of(pixels_of(truth, camera), SURE, camera, FEATURES)
    np.testing.assert_allclose(truth.difference(pose), 0.0, atol=EXACT)
    assert rms < 1e-3


@pytest.mark.parametrize("camera", [PLAIN, BENT, FISHEYE], ids=lambda camera: camera.name)
def test_from_nearby_the_same_pose_is_found(camera):
    truth = head(5.0, -20.0, 25.0, 60.0, -30.0)
    near = truth.moved(np.array([30.0, -20.0, 40.0, 0.1, -0.2, 0.1]))
    pose = pose_near(near, pixels_of(truth, camera), SURE, camera, FEATURES)
    np.testing.assert_allclose(truth.difference(pose), 0.0, atol=1e-3)  # a descent ends at a thousandth


def test_a_point_that_is_elsewhere_hardly_moves_the_pose_found_from_nearby():
    truth = head(5.0, -20.0, 25.0, 60.0, -30.0)
    pixels = pixels_of(truth, PLAIN)
    pixels[5] += [25.0, -20.0]
    pose = pose_near(truth.moved(np.full(6, 0.05)), pixels, SURE, PLAIN, FEATURES)
    assert np.degrees(np.linalg.norm(truth.difference(pose)[3:])) < 1.0


def test_of_fewer_than_four_points_the_pose_stays():
    truth, near = head(5.0, -20.0, 25.0, 60.0, -30.0), head(0.0, 0.0, 0.0, 0.0, 0.0)
    weights = np.array([1.0, 1.0, 1.0, *[0.0] * 7])
    assert pose_near(near, pixels_of(truth, PLAIN), weights, PLAIN, FEATURES) is near


def information(truth, camera, deviation):
    """J^T J / sigma^2 by central differences of the projection."""
    step = 1e-4

    def pixels(tangent):
        return pixels_and_jacobian(camera, truth.moved(tangent).points(FEATURES))[0].ravel()

    columns = [(pixels(step * e) - pixels(-step * e)) / (2 * step) for e in np.eye(6)]
    jacobian = np.stack(columns, axis=1)
    return jacobian.T @ jacobian / deviation**2


@pytest.mark.parametrize("camera", [PLAIN, BENT], ids=lambda camera: camera.name)
def test_noise_does_what_the_cramer_rao_bound_says(camera):
    """Huber's function at two deviations loses a few per cent; 300 samples tell a deviation to 4 %."""
    truth, deviation, rng = head(5.0, -20.0, 25.0, 60.0, -30.0), 0.2, np.random.default_rng(1)
    clean = pixels_of(truth, camera)
    noisy = (clean + deviation * rng.standard_normal(clean.shape) for _ in range(300))
    errors = [truth.difference(pose_of(pixels, SURE, camera, FEATURES)[0]) for pixels in noisy]
    bound = np.sqrt(np.diagonal(np.linalg.inv(information(truth, camera, deviation))))
    ratios = np.sqrt(np.mean(np.square(errors), axis=0)) / bound
    assert np.all((ratios > 0.85) & (ratios < 1.2)), ratios


def test_the_worse_of_two_mirror_images_is_never_kept():
    """A face a twentieth as deep, so nearly flat: with one descent 3 of these end in the worse one."""
    shape, rng = FEATURES * [1.0, 1.0, 0.05], np.random.default_rng(0)
    for _ in range(60):
        truth = head(*rng.uniform(-25.0, 25.0, 3))
        clean = pixels_of(truth, PLAIN, shape)
        pixels = clean + rng.standard_normal((10, 2))
        _, rms = pose_of(pixels, SURE, PLAIN, shape)
        assert rms <= np.sqrt(np.mean(np.sum((pixels - clean) ** 2, axis=1)))


def test_one_point_that_is_something_else_hardly_matters():
    truth = head(0.0, 10.0, -15.0)
    noise = 0.3 * np.random.default_rng(3).standard_normal((10, 2))
    good = pixels_of(truth) + noise
    bad = good.copy()
    bad[5] += [25.0, 12.0]
    by_good, _ = pose_of(good, SURE, PLAIN, FEATURES)
    by_bad, rms = pose_of(bad, SURE, PLAIN, FEATURES)
    without, _ = pose_of(good, np.where(np.arange(10) == 5, 0.0, 1.0), PLAIN, FEATURES)
    assert np.rad2deg(np.abs(by_good.difference(by_bad)[3:])).max() < 2.0  # 8.7 by least squares
    assert np.abs(by_bad.difference(without))[:2].max() < 1.0  # mm
    assert rms == pytest.approx(np.hypot(25.0, 12.0) / np.sqrt(10.0), rel=0.1)


def test_weights_are_relative():
    truth = head(10.0, 5.0, 20.0)
    pixels = pixels_of(truth) + 0.5 * np.random.default_rng(4).standard_normal((10, 2))
    one, rms = pose_of(pixels, SURE, PLAIN, FEATURES)
    other, same = pose_of(pixels, 7.0 * SURE, PLAIN, FEATURES)
    np.testing.assert_allclose(one.difference(other), 0.0, atol=1e-9)
    assert same == pytest.approx(rms)


def test_points_without_weight_or_pixel_are_left_out():
    truth = head(0.0, -10.0, 10.0)
    pixels = pixels_of(truth)
    pixels[2], pixels[6] = np.nan, 1000.0
    weights = np.where(np.arange(10) == 6, 0.0, 1.0)
    pose, _ = pose_of(pixels, weights, PLAIN, FEATURES)
    np.testing.assert_allclose(truth.difference(pose), 0.0, atol=EXACT)


def test_three_points_are_too_few():
    with pytest.raises(ValueError, match="needs 4 points, found 3"):
        pose_of(pixels_of(head()), np.where(np.arange(10) < 3, 1.0, 0.0), PLAIN, FEATURES)
