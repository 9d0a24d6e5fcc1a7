"""How large people are taken for: right on average over people, which nearest shapes are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.adjustment.adjuster import Adjuster, offset_deviations
from posetrack_cli.head.adjustment.likely_size import (
    OFFSETS_SHARE,
    likely_size,
    of_likely_size,
)
from posetrack_cli.head.adjustment.views import PersonParameters
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.multilinear.face_model import load_face_model
from support.bundles import CAMERA, random_view

MODEL, SETTINGS = load_face_model(), AdjustmentSettings()
SHAPE_NUMBERS = 23
"""What images tell of ten points: three each, less turn, place and size."""
PEOPLE = 120
"""Sizes spread by 4.2 %, so the mean of so many is known to 0.4 %; nearest shapes are 2 % too small."""


def person(rng: np.random.Generator) -> PersonParameters:
    """One of those whom the statistics tell of."""
    who = MODEL.identity_mean + MODEL.identity_deviations * rng.standard_normal(MODEL.identity_size)
    beside = OFFSETS_SHARE * offset_deviations(SETTINGS.offset_mm) * rng.standard_normal((10, 3))
    return PersonParameters(who, beside)


def mean_shape(one: PersonParameters) -> FloatArray:
    return MODEL.of_person(one.identity, one.offsets).mean


def test_shapes_are_multiplied_by_their_size_on_average() -> None:
    """Whatever size a shape is shown in, the factor brings it to the same one, which is nobody's bias."""
    rng, ratios = np.random.default_rng(4), []
    for _ in range(400):
        true = mean_shape(person(rng))
        sizes = [
            shown * likely_size(shown * true, SHAPE_NUMBERS, MODEL, SETTINGS) for shown in (0.9, 1.0, 1.2)
        ]
        assert np.ptp(sizes) < 1e-9
        ratios.append(np.log(sizes[0]))
    spread = float(np.std(ratios))
    assert abs(np.mean(ratios)) < 4.0 * spread / np.sqrt(len(ratios))
    assert 0.03 < spread < 0.055  # a shape says little of its size


def test_nearest_shapes_are_too_small() -> None:
    """Without the volume the same people are too small, by n over the squared length of the mean."""
    rng = np.random.default_rng(5)
    nearest = [np.log(likely_size(mean_shape(person(rng)), 0.0, MODEL, SETTINGS)) for _ in range(400)]
    assert np.mean(nearest) < -0.02


def test_adjusted_people_are_as_large_as_people_are() -> None:
    """The whole way, from pixels: seen from many sides with a quarter pixel of noise."""
    rng, sizes, before = np.random.default_rng(6), [], []
    adjuster = Adjuster(MODEL, CAMERA, SETTINGS).over_recording
    for _ in range(PEOPLE):
        true = person(rng)
        seen = [random_view(rng, MODEL, true, CAMERA, index, 1.0) for index in range(16)]
        views = [replace(view, pixels=view.pixels + rng.normal(0.0, 0.25, (10, 2))) for view in seen]
        start = PersonParameters(MODEL.identity_mean, np.zeros((10, 3)))
        adjusted = adjuster.adjust(views, start, iterations=12, wide=True)
        likely, larger = of_likely_size(adjusted, MODEL, SETTINGS)
        nearest = scale(mean_shape(true), mean_shape(adjusted.person))
        assert scale(mean_shape(adjusted.person), mean_shape(likely)) == pytest.approx(1.0 / larger, rel=1e-9)
        sizes.append(np.log(nearest / larger))
        before.append(np.log(nearest))
        assert 15.0 < adjusted.determined < SHAPE_NUMBERS + 1.0
    known = np.std(sizes) / np.sqrt(PEOPLE)
    assert np.mean(before) > 3.0 * known  # too small before ...
    assert abs(np.mean(sizes)) < 3.0 * known  # ... and no longer


def scale(one: FloatArray, other: FloatArray) -> float:
    """How many times larger one shape is, by the spread of its points."""
    lengths = [np.linalg.norm(shape - shape.mean(axis=0)) for shape in (one, other)]
    return float(lengths[0] / lengths[1])
