"""Focal length and principal point from skin that turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rotations import exponential, multiply
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.lens.estimation import FirstLook, posterior
from posetrack_cli.head.lens.profile import INDEPENDENT, Change, log_likelihoods
from posetrack_cli.head.skin.equations import SkinPrior, observations
from posetrack_cli.head.skin.map import MatchedSkin, SkinMap

TRUE = Camera(481, 371, 1000.0, 1000.0, 240.0, 185.0)
FACING = np.array([1.0, 0.0, 0.0, 0.0])  # x y z w: half a turn about x


def skin_of(camera: Camera, assumed: Camera, turn_deg: float, views: int = 12) -> MatchedSkin:
    """Exact places of a curved face that turns by an angle to both sides, matched with an assumed camera."""
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.uniform(-60.0, 60.0, (60, 2)), np.zeros(60)])
    points[:, 2] = 30.0 - np.sum(points[:, :2] ** 2, axis=1) / 120.0 + rng.normal(0.0, 5.0, 60)
    angles = np.radians(turn_deg) * np.sin(np.linspace(0.0, 5.0, views))
    tilts = np.radians(turn_deg) / 3 * np.cos(np.linspace(0.0, 7.0, views))
    turns = exponential(np.column_stack([tilts, angles, 0 * angles]))
    depths = 700.0 + 60.0 * np.sin(np.linspace(0.0, 3.0, views))
    position = np.column_stack([80.0 * angles, 40.0 * tilts, depths])
    poses = HeadPose(position, multiply(turns, np.tile(FACING, (views, 1))))
    seen = np.einsum("nij,kj->nki", poses.rotation, points) + poses.position[:, None]
    pixels = seen[..., :2] / seen[..., 2:] * camera.fx + [camera.cx, camera.cy]
    rays = (pixels - [assumed.cx, assumed.cy]) / assumed.fx
    nearer = HeadPose(position * [1.0, 1.0, assumed.fx / camera.fx], poses.quaternion)
    index = np.indices((views, len(points))).reshape(2, -1)
    observed = observations(index[0], index[1], rays.reshape(-1, 2), len(points))
    crops = np.zeros((views, 1, 1, 1), np.uint8)
    found = SkinMap(np.arange(views), crops, nearer, np.zeros(len(points), int), points[:, :2], points, 0.0)
    return MatchedSkin(found, observed, SkinPrior(nearer, points))


@pytest.mark.parametrize("factor", [0.6, 1.5])
def test_turning_skin_shows_the_focal_length(factor: float) -> None:
    assumed = replace(TRUE, fx=factor * TRUE.fx, fy=factor * TRUE.fy)
    logs = np.arange(-0.8, 0.81, 0.1)
    changes = [Change(one, np.zeros(2)) for one in logs]
    found = log_likelihoods(skin_of(TRUE, assumed, 25.0), assumed, changes)
    # the true value is between two of the grid's
    assert abs(logs[np.argmax(found)] + np.log(factor)) <= 0.1


def test_a_posterior_is_near_the_truth_and_sure_of_a_turning_face_only() -> None:
    """The image is of no camera's size: a crop, 60 px beside the middle."""
    crop = replace(TRUE, cx=TRUE.cx + 60.0)
    assumed = replace(TRUE, fx=770.0, fy=770.0)
    lenses = []
    for turn_deg in (25.0, 0.5):
        skin = skin_of(crop, assumed, turn_deg)
        poses = [skin.map.poses.of_frame(i) for i in range(len(skin.map.stamps))]
        lenses.append(posterior(FirstLook(assumed, poses, (skin, assumed))))
    turning, still = lenses
    assert abs(np.log(turning.camera.fx / crop.fx)) < 2.0 * turning.focal_sd < 0.5
    assert abs(turning.camera.cx - crop.cx) < 2.0 * turning.centre_sd_px[0]
    assert abs(turning.camera.cy - crop.cy) < 2.0 * turning.centre_sd_px[1]
    assert still.focal_sd > 1.5 * turning.focal_sd


def test_without_a_face_the_prior_remains() -> None:
    lens = posterior(FirstLook(TRUE, [], None))
    assert (lens.camera.cx, lens.camera.cy) == pytest.approx((TRUE.cx, TRUE.cy))
    assert lens.focal_sd > 0.4


def test_many_matches_count_as_few() -> None:
    """Costs of N observations are scaled as if there were ``INDEPENDENT``."""
    skin = skin_of(TRUE, TRUE, 25.0)
    twice = observations(
        np.repeat(skin.observed.views, 2), np.repeat(owners(skin), 2), np.repeat(skin.observed.rays, 2, 0), 60
    )
    assert len(skin.observed.views) > INDEPENDENT
    changes = [Change(one, np.zeros(2)) for one in (-0.2, 0.0, 0.2)]
    one, two = (log_likelihoods(each, TRUE, changes) for each in (skin, skin._replace(observed=twice)))
    np.testing.assert_allclose(one - one.max(), two - two.max(), rtol=0.3, atol=0.1)


def owners(skin: MatchedSkin) -> np.ndarray:
    return np.repeat(np.arange(len(skin.map.points)), np.diff(skin.observed.first))
