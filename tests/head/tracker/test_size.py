"""How large a head is, told from elsewhere: the posterior of one number, and what it does to a track."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.head.config import PersonSettings
from posetrack_cli.head.face.points import MEAN_SHAPE, HeadPose
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.tracker.mono import interpupillary_distance
from posetrack_cli.head.tracker.person import (
    CORNERS_OUTSIDE_MM,
    PupilDistance,
    Size,
    pupil_distance,
    scaled_pose,
)
from support.mono_scene import CAMERA, FEW, MODEL, Scene

SEEN = pupil_distance(MEAN_SHAPE)
ONWARDS = np.array([1.0, 0.0, 0.0, 0.0])
"""Looks at the camera."""


@given(st.floats(45.0, 80.0), st.floats(0.1, 5.0), st.floats(0.005, 0.2))
def test_the_size_is_the_posterior_of_prior_and_measurement(told: float, sd: float, prior: float) -> None:
    """Against both densities multiplied on a grid of log c."""
    size = PupilDistance(told, sd, prior).size_of(MEAN_SHAPE)
    log_c, step = np.linspace(-1.5, 1.5, 60_001, retstep=True)
    log_p = -0.5 * (log_c / prior) ** 2 - 0.5 * ((np.log(told / SEEN) - log_c) / (sd / told)) ** 2
    p = np.exp(log_p - log_p.max())
    mean = float(p @ log_c / p.sum())
    assert np.log(size.factor) == pytest.approx(mean, abs=step)
    assert size.sd == pytest.approx(np.sqrt(p @ (log_c - mean) ** 2 / p.sum()), rel=0.01, abs=step)


def test_an_exact_distance_is_taken_and_a_size_known_before_stays() -> None:
    exact = PupilDistance(1.1 * SEEN, 1e-9).size_of(MEAN_SHAPE)
    assert exact == pytest.approx((1.1, 0.0), abs=1e-9)
    assert PupilDistance(1.1 * SEEN, 1.0, 0.0).size_of(MEAN_SHAPE) == (1.0, 0.0)


def test_pupils_are_midway_between_the_corners_as_the_statistics_have_them() -> None:
    """Those of the mean face are 63.0 mm apart; what is followed lies beside."""
    assert pytest.approx(63.0 - CORNERS_OUTSIDE_MM) == SEEN
    assert pupil_distance(np.zeros((10, 3))) > 0.0  # of which there is still a logarithm


def test_a_larger_head_farther_away_looks_the_same() -> None:
    shape, pose = MODEL.of_person(MODEL.identity_mean), HeadPose(np.array([30.0, -20.0, 700.0]), ONWARDS)
    larger = Size(1.07, 0.01).scale_shape(shape)
    a = 0.5 * shape.deviations
    here, there = pose.points(shape.shapes(a)), scaled_pose(pose, 1.07).points(larger.shapes(a))
    one, other = (project((CAMERA,), points).pixels for points in (here, there))
    np.testing.assert_allclose(one, other)


def test_what_is_told_must_be_somebodys() -> None:
    assert interpupillary_distance(PersonSettings()) is None
    told = interpupillary_distance(PersonSettings(interpupillary_mm=61.0, interpupillary_sd_mm=3.0))
    assert told == PupilDistance(61.0, float(np.hypot(3.0, 1.1)), 0.035)
    likely = PupilDistance(SEEN, 1.0)
    assert likely.warnings(MEAN_SHAPE) == ()
    (line,) = replace(likely, distance_mm=1.15 * SEEN).warnings(MEAN_SHAPE)
    assert "interpupillary distance 70 mm, but the most likely face has 61 mm" in line


def test_a_told_distance_scales_a_track_and_narrows_its_depth() -> None:
    """Everything but the length of things is as without: pixels, angles, coefficients."""
    mean = MODEL.of_person(MODEL.identity_mean).mean
    told = PersonSettings(interpupillary_mm=1.1 * pupil_distance(mean), interpupillary_sd_mm=0.0)
    config, size = FEW.model_copy(update={"person": told}), interpupillary_distance(told).size_of(mean)
    plain, sized = Scene(), Scene(config=config)
    for index in range(FEW.start.frames + 6):
        one, other = plain.step(index), sized.step(index)
        seen = [project((CAMERA,), estimate.points).pixels[0] for estimate in (one, other)]
        np.testing.assert_allclose(*seen, atol=0.3)  # particles spread by millimetres, of either size
        shape = sized.state.person.shape.mean if sized.state.people else size.factor * mean
        assert pupil_distance(shape) == pytest.approx(size.factor * pupil_distance(mean), abs=0.2)
        assert other.position[2] / one.position[2] == pytest.approx(size.factor, abs=0.01)
    sds = [np.sqrt(estimate.pose_variance[2]) for estimate in (one, other)]
    assert sds[0] > 0.035 * one.position[2] and sds[1] < 0.6 * sds[0]  # 24 mm
    names = dict(zip(sized.subject.number_names, other.numbers, strict=True))
    assert names["size"] == pytest.approx(sized.state.person.factor) and names["size_sd"] == pytest.approx(
        size.sd
    )
