"""Another focal length is found where it can be told, and not where the intrinsics are right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.head.adjustment.adjuster import Adjuster, PersonParameters
from posetrack_cli.head.adjustment.focal_length import ENDS, STEP, FocalCheck, fit_focal_length
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.face.points import HeadPose
from support.bundles import CAMERA, moved_away, noisy, random_bundle

SETTINGS = AdjustmentSettings()


def checked(seed, true_factor, count=30, noise=0.7, offset_mm=0.6):
    """What is said of a camera whose focal length should be multiplied by a factor."""
    seen_by = replace(CAMERA, fx=CAMERA.fx * true_factor, fy=CAMERA.fy * true_factor)
    bundle = noisy(random_bundle(seed, count, seen_by, offset_mm), noise, seed)
    views, _ = moved_away(bundle, seed, 0.5)
    nearer = [
        replace(view, pose=HeadPose(view.pose.position * [1.0, 1.0, 1.0 / true_factor], view.pose.quaternion))
        for view in views
    ]
    mean = PersonParameters(bundle.model.identity_mean, np.zeros((10, 3)))
    return fit_focal_length(nearer, mean, Adjuster(bundle.model, CAMERA, SETTINGS))


@pytest.mark.parametrize("seed", range(6))
def test_raises_no_false_alarm(seed):
    found = checked(seed, 1.0)
    assert found.gain >= 0.0
    assert not found.is_clear


@pytest.mark.parametrize("seed", range(4))
def test_notices_a_focal_length_of_half_the_right_one(seed):
    found = checked(seed, 1.9)
    assert found.is_clear
    assert found.factor > 1.5


def test_finds_the_focal_length_of_noiseless_views_of_the_model_itself():
    """The priors pull at what they are given no reason for: a tenth is left of perspective's weakness."""
    logs = [np.log(checked(seed, 1.3, noise=0.0, offset_mm=0.0).factor / 1.3) for seed in range(4)]
    assert np.abs(logs).max() < 0.15
    assert np.abs(np.mean(logs)) < 0.1


def test_says_nothing_beyond_the_range_it_tries():
    found = checked(5, 2.6)
    assert found.factor == pytest.approx(np.exp(ENDS * STEP))
    assert found.deviation == np.inf
    assert found.is_clear


def test_a_farther_face_and_a_longer_lens_look_alike_without_perspective():
    """What it lives on: from ten times as far the same views say nothing."""
    bundle = random_bundle(6, 20)
    far = replace(CAMERA, fx=CAMERA.fx * 10.0, fy=CAMERA.fy * 10.0)
    poses = [HeadPose(v.pose.position * [1.0, 1.0, 10.0], v.pose.quaternion) for v in bundle.views]
    shapes = [bundle.model.shapes(bundle.person.identity, v.deformation) for v in bundle.views]
    rng = np.random.default_rng(6)
    views = [
        replace(
            v,
            pose=pose,
            pixels=far.pixels_from_points(pose.points(shape))[0] + 0.7 * rng.normal(size=(10, 2)),
        )
        for v, pose, shape in zip(bundle.views, poses, shapes, strict=True)
    ]
    found = fit_focal_length(views, bundle.person, Adjuster(bundle.model, far, SETTINGS))
    assert found.deviation > 0.5
    assert not found.is_clear


def test_the_camera_s_own_focal_length_gains_nothing():
    assert not FocalCheck(1.0, 0.0, 0.1).is_clear
    bundle = random_bundle(7, 10)
    adjuster = Adjuster(bundle.model, CAMERA, SETTINGS)
    best = adjuster.adjust(bundle.views, bundle.person, iterations=30, wide=True)
    found = fit_focal_length(best.views, best.person, adjuster)
    assert 0.0 <= found.gain < 1.0
    assert not FocalCheck(0.6, 12.0, 5e-4).is_clear  # a dip no wider than a step is no curvature
    assert FocalCheck(1.6, 12.0, 0.1).is_clear
