"""The probability that a head's estimate is right: its signs, its laws, and what is said at a run's end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_COUNT, HeadPose, rigid_model
from posetrack_cli.head.particles.particles import HeadParticles
from posetrack_cli.head.subject import SIGN_NAMES
from posetrack_cli.head.tracker import mono
from posetrack_cli.head.tracker.frame_tracker import (
    MONO,
    MONO_WITH_SKIN,
    NO_RECORD,
    NO_SIGNS,
    STEREO,
    FrameFit,
    TrackRecord,
    TrackState,
    confidence_signs,
    initial_fit,
    track_warnings,
)
from posetrack_cli.results.estimate import Status
from posetrack_cli.tracking.confidence import Regression
from support.mono_scene import FEW, Scene

REGRESSIONS = (MONO, MONO_WITH_SKIN, STEREO)
CAMERA, DISTANCE_MM = Camera(640, 480, 900.0, 900.0, 319.5, 239.5), 630.0


def fit_of(beside_mm: float = 0.63, weight: float = 0.6) -> FrameFit:
    """A face whose points all lie so far beside the model's."""
    pose = HeadPose(np.array([0.0, 0.0, DISTANCE_MM]), np.array([1.0, 0.0, 0.0, 0.0]))
    particles = HeadParticles(pose, np.zeros(0), np.zeros((1, 6)), np.ones(1), rigid_model(MEAN_SHAPE))
    shape = MEAN_SHAPE + beside_mm * np.array([0.6, -0.8, 0.0])
    track = TrackState(0, pose, np.zeros(6), particles, shape, None)
    return initial_fit(track, weight, np.zeros((1, POINT_COUNT, 2)))


def test_signs_are_what_is_stated() -> None:
    """1 % of the eyes' distance; eyes 90 px apart; at rest; .4 unseen; .2 of the skin not found."""
    fit = fit_of()
    signs = confidence_signs(None, fit, replace(fit, unmatched=0.2), CAMERA)
    np.testing.assert_allclose(signs, [np.log(1.4), np.log(80 / 90), np.log(0.2), 0.4, 0.2], rtol=1e-6)
    assert len(signs) == len(SIGN_NAMES) == len(NO_SIGNS)
    assert confidence_signs(None, fit, fit, CAMERA)[-1] == 0.0, "no skin was looked for"


def test_a_small_face_tells_less() -> None:
    small, smaller = (
        confidence_signs(None, fit_of(), fit_of(), replace(CAMERA, fx=focal, fy=focal))
        for focal in (250.0, 200.0)
    )
    assert (small[1], smaller[1]) == pytest.approx((np.log(80 / 25), np.log(80 / 20)))
    larger = confidence_signs(None, fit_of(), fit_of(), CAMERA)
    for regression in REGRESSIONS:
        assert (
            regression.probability(smaller) < regression.probability(small) < regression.probability(larger)
        )


def test_points_that_no_camera_sees_do_not_tell() -> None:
    fit = fit_of()
    shape, pixels = fit.track.shape.copy(), fit.pixels.copy()
    shape[3], pixels[0, 3] = 100.0, np.nan
    hidden = replace(fit, track=replace(fit.track, shape=shape), pixels=pixels)
    one, other = (confidence_signs(None, which, which, CAMERA) for which in (hidden, fit))
    np.testing.assert_allclose(one, other)
    unseen = replace(fit, weights=np.zeros(POINT_COUNT))
    none = confidence_signs(None, unseen, unseen, CAMERA)
    assert (none[0], none[3]) == pytest.approx((np.log(100.4), 1.0))  # as far off as eyes are apart


def test_unsteady_is_what_turns_otherwise_than_before() -> None:
    """By 0.3 rad/s within 1/30 s: 0.57 deg; at its velocity a head is steady, however fast."""
    fit = replace(fit_of(), dt=1 / 30)
    fast = replace(fit.track, velocity=np.array([0.0, 0.0, 0.0, 2.0, 0.0, 0.0]))
    faster = replace(fit, track=replace(fast, velocity=1.15 * fast.velocity))
    for before, now, off_deg in ((fast, faster, np.degrees(0.01)), (fast, replace(fit, track=fast), 0.0)):
        unsteady = confidence_signs(before, now, now, CAMERA)[2]
        assert np.exp(unsteady) == pytest.approx(off_deg + 0.2)


def test_a_lower_frame_rate_predicts_worse_without_being_unsteady() -> None:
    """Over four frame intervals, a prediction may be off by twice as much: 1.15 deg count as 0.57 deg."""
    turning = replace(fit_of().track, velocity=np.array([0.0, 0.0, 0.0, 0.15, 0.0, 0.0]))
    fit = replace(fit_of(), dt=4 / 30, track=turning)
    assert np.exp(confidence_signs(None, fit, fit, CAMERA)[2]) == pytest.approx(np.degrees(0.01) + 0.2)


@pytest.mark.parametrize("regression", REGRESSIONS)
def test_worse_signs_are_never_more_probable(regression: Regression) -> None:
    good = np.array([np.log(0.7), 0.0, np.log(0.4), 0.25, 0.15])
    assert regression.probability(good) > 0.9
    assert regression.probability(np.array([np.log(4.0), 1.1, np.log(5.0), 0.7, 0.8])) < 0.2
    assert np.all(regression.weights <= 0.0)


def test_a_frame_that_is_more_probably_wrong_is_not_tracked(monkeypatch: pytest.MonkeyPatch) -> None:
    """It says its pose all the same, goes on from there, and the run says how many such frames there were."""
    scene = Scene()
    plain = [scene.step(index) for index in range(FEW.start.frames + 4)]
    monkeypatch.setattr(mono, "MONO", Regression(-3.0, np.zeros(5)))
    doubtful = Scene()
    found = [doubtful.step(index) for index in range(FEW.start.frames + 4)]
    assert {one.status for one in plain} == {Status.TRACKING}
    assert {one.status for one in found} == {Status.LOST}
    assert {one.confidence for one in found} == {Regression(-3.0, np.zeros(5)).probability(np.zeros(5))}
    for one, other in zip(plain, found, strict=True):
        np.testing.assert_array_equal(one.position, other.position)
        np.testing.assert_array_equal(one.quaternion, other.quaternion)
    (line,) = doubtful.tracker.remarks(doubtful.state)
    assert line.startswith("9 of 9 frames have low confidence (below 0.5): ")
    assert scene.tracker.remarks(scene.state) == ()


def test_signs_are_among_the_numbers_of_a_frame() -> None:
    scene = Scene()
    names = scene.subject.number_names
    estimate = [scene.step(index) for index in range(8)][-1]
    told = dict(zip(names, estimate.numbers, strict=True))
    signs = np.array([told[name] for name in SIGN_NAMES])
    assert estimate.confidence == MONO.probability(signs)
    lost = [scene.step(index, blank=True) for index in range(8, 12)][-1]
    assert np.isnan(dict(zip(names, lost.numbers, strict=True))["sign_misfit"])


def test_a_track_is_recorded() -> None:
    record = NO_RECORD
    for index in range(10):
        record = record.tracked(index, doubtful=index == 4)
    for gone_ns in (33, 66):
        record = record.missed(gone_ns)
    record = record.tracked(12, doubtful=False).missed(40)
    assert record == TrackRecord(frames=14, doubtful=1, gap_ns=66, gap_frame=9, last_frame=12)


def test_a_good_track_has_nothing_to_be_said() -> None:
    good = TrackRecord(frames=100, doubtful=10, gap_ns=900_000_000, gap_frame=3, last_frame=99)
    assert track_warnings(good) == ()
    (line,) = track_warnings(good._replace(doubtful=11, gap_ns=2_100_000_000))
    assert "11 of 100 frames have low confidence" in line
    assert "no face for 2.1 s after frame 3: inspect them with posetrack view" in line
