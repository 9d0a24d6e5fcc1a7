"""Random people seen in random poses, for tests of the adjustment."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.geometry.camera import Camera, pixels_from_points
from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.adjustment.adjuster import PersonParameters, PointView
from posetrack_cli.head.config import AdjustmentSettings, PointSettings
from posetrack_cli.head.face.points import MEAN_SHAPE, SHAPE_SD, HeadPose
from posetrack_cli.head.multilinear.face_model import FaceModel

CAMERA = Camera(640, 480, 700.0, 702.0, 321.0, 238.0)
LENSES = {
    "no lens": CAMERA,
    "plumb bob": replace(CAMERA, distortion=(-0.25, 0.1, 0.002, -0.003, 0.02)),
    "fisheye": replace(CAMERA, distortion=(0.05, -0.02, 0.01, 0.003), distortion_model="equidistant"),
}
UNIT_SD = PointSettings(eyes=1.0, mouth=1.0, nostrils=1.0, brows=1.0)
FREE = AdjustmentSettings(prior=0.0, offsets=False, huber=1e6, bound=1e6, pixel_sd=UNIT_SD)
"""Least squares without priors, robustness, offsets or bounds about the mean face."""


def random_model(seed: int, identities: int = 10, deformations: int = 5) -> FaceModel:
    """A face model in which one deviation of s moves points by about 1 mm, one of a by about 2."""
    rng = np.random.default_rng(seed)
    core = 1.6 * rng.normal(size=(10, 3, identities, deformations)) * SHAPE_SD[:, :, None, None]
    identity_sd = 0.3 * rng.uniform(0.7, 1.3, identities)
    deformation_sd = 0.3 * rng.uniform(0.7, 1.3, deformations)
    identity_mean, deformation_mean = rng.normal(size=identities), rng.normal(size=deformations)
    identity_mean /= 2.0 * np.linalg.norm(identity_mean)
    deformation_mean /= np.linalg.norm(deformation_mean)
    return FaceModel(MEAN_SHAPE.copy(), core, identity_mean, identity_sd, deformation_mean, deformation_sd)


@dataclass(frozen=True)
class Bundle:
    """Views at the truth, and the person."""

    model: FaceModel
    camera: Camera
    views: tuple[PointView, ...]
    person: PersonParameters


def random_pose(rng: np.random.Generator) -> HeadPose:
    """600 to 900 mm away, yaw and pitch up to 35 degrees, roll up to 15."""
    position = np.array([*rng.uniform(-90.0, 90.0, 2), rng.uniform(600.0, 900.0)])
    angles = np.radians([15.0, 35.0, 35.0]) * rng.uniform(-1.0, 1.0, 3)
    return HeadPose(position, head_quaternion_from_roll_pitch_yaw(angles))


def random_bundle(
    seed: int,
    count: int = 5,
    camera: Camera = CAMERA,
    offset_mm: float = 0.0,
    model: FaceModel | None = None,
    spread: float = 1.8,
) -> Bundle:
    """Views of a random person, without noise; parameters are normal, clipped to ``spread`` deviations."""
    rng = np.random.default_rng(seed)
    model = random_model(seed) if model is None else model
    identity = model.identity_mean + np.clip(rng.normal(size=model.identity_size), -spread, spread) * (
        model.identity_deviations
    )
    person = PersonParameters(identity, offset_mm * rng.normal(size=(10, 3)))
    views = tuple(random_view(rng, model, person, camera, i, spread) for i in range(count))
    return Bundle(model, camera, views, person)


def random_view(
    rng: np.random.Generator,
    model: FaceModel,
    person: PersonParameters,
    camera: Camera,
    index: int,
    spread: float,
) -> PointView:
    """One view of a person, its points where they are seen."""
    whitened = np.clip(rng.normal(size=model.deformation_size), -spread, spread)
    deformation = model.deformation_mean + whitened * model.deformation_deviations
    pose = random_pose(rng)
    points = pose.points(model.shapes(person.identity, deformation) + person.offsets)
    pixels, valid = pixels_from_points(camera, points)
    assert valid.all()
    return PointView(index, pixels, np.ones(10), pose, deformation)


def noisy(bundle: Bundle, sd: float, seed: int) -> Bundle:
    """The same with Gaussian noise on every pixel."""
    rng = np.random.default_rng([seed, 1])
    views = tuple(
        replace(view, pixels=view.pixels + sd * rng.normal(size=view.pixels.shape)) for view in bundle.views
    )
    return replace(bundle, views=views)


def moved_away(
    bundle: Bundle, seed: int, amount: float = 1.0
) -> tuple[tuple[PointView, ...], PersonParameters]:
    """A start off the truth: ``amount`` times (8 mm, 0.06 rad, 0.4 sigma)."""
    rng = np.random.default_rng([seed, 2])
    model = bundle.model

    def away(view: PointView) -> PointView:
        tangent = rng.uniform(-1.0, 1.0, 6) * [8.0, 8.0, 20.0, 0.06, 0.06, 0.06] * amount
        change = 0.4 * amount * rng.uniform(-1.0, 1.0, model.deformation_size) * model.deformation_deviations
        return replace(view, pose=view.pose.moved(tangent), deformation=view.deformation + change)

    change = 0.4 * amount * rng.uniform(-1.0, 1.0, model.identity_size) * model.identity_deviations
    views = tuple(away(view) for view in bundle.views)
    return views, PersonParameters(bundle.person.identity + change, np.zeros((10, 3)))
