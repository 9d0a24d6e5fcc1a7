"""A run says so where its points contradict the focal length, and only there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.adjustment.adjuster import Adjuster, Album, PersonParameters
from posetrack_cli.head.adjustment.focal_length import VIEWS, focal_length_check
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.multilinear.face_model import FaceModel
from posetrack_cli.head.tracker.person import KnownPerson, new_person
from support.bundles import CAMERA, noisy, random_bundle
from support.mono_cases import random_templates

SETTINGS = AdjustmentSettings()
FACTOR = 1.9
"""By which the focal length is too short: beyond doubt in each of four such bundles (test_intrinsics)."""


def seen(seed: int, factor: float, pages: int = VIEWS) -> tuple[KnownPerson, FaceModel]:
    """A person whom a camera of ``factor`` times CAMERA's focal length saw, as CAMERA would place it."""
    by = replace(CAMERA, fx=CAMERA.fx * factor, fy=CAMERA.fy * factor)
    bundle = noisy(random_bundle(seed, pages, by, 0.6), 0.7, seed)
    nearer = [1.0, 1.0, 1.0 / factor]
    views = [
        replace(view, pose=HeadPose(view.pose.position * nearer, view.pose.quaternion))
        for view in bundle.views
    ]
    mean = PersonParameters(bundle.model.identity_mean, np.zeros((10, 3)))
    known = new_person(mean, random_templates(seed), Adjuster(bundle.model, CAMERA, SETTINGS))
    album = Album({(index, 0): ((1.0, view),) for index, view in enumerate(views)})
    return replace(known, album=album), bundle.model


def said(known: KnownPerson, model: FaceModel, camera: Camera = CAMERA, scale: float = 1.0, **settings):
    adjuster = Adjuster(model, camera, SETTINGS.model_copy(update=settings))
    return focal_length_check(known, adjuster, scale)


def test_half_the_focal_length_is_told_in_recorded_pixels() -> None:
    known, model = seen(0, FACTOR)
    (line,) = said(known, model)
    assert line.startswith(f"focal length is {CAMERA.fx:.0f} px, but the points fit ")
    (reduced,) = said(known, model, scale=0.5)  # the images were half as large as recorded
    assert reduced.startswith(f"focal length is {2.0 * CAMERA.fx:.0f} px, but the points fit ")
    better = float(line.split("points fit ")[1].split(" px")[0])
    assert better > 1.5 * CAMERA.fx
    assert float(reduced.split("points fit ")[1].split(" px")[0]) == pytest.approx(2.0 * better, abs=2.0)


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_said_of_the_right_one(seed: int) -> None:
    assert said(*seen(seed, 1.0)) == ()


def test_nothing_is_said_from_few_views_or_of_a_person_who_is_not_adjusted() -> None:
    assert said(*seen(0, FACTOR, pages=VIEWS - 1)) == ()
    known, model = seen(0, FACTOR)
    assert said(known, model, when="start") == ()
