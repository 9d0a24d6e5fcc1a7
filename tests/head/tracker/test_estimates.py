"""The further numbers of a one-camera result: each under its own name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.errors import ResultError
from posetrack_cli.head.actions import ACTION_NAMES
from posetrack_cli.head.face.points import BROWS, MOUTH, POINT_NAMES, HeadPose
from posetrack_cli.head.subject import (
    MONO_TRACK,
    STEREO_TRACK,
    MonoDiagnostics,
    TrackModel,
    mono_diagnostic_names,
    mono_subject,
)
from posetrack_cli.head.tracker.head_tracker import FaceDescription, lost_estimate
from posetrack_cli.head.tracker.mono import size_and_systematic_variance
from posetrack_cli.head.tracker.person import PRIOR_SD, Size
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.fields import check_estimate
from support.bundles import random_model


def numbers(size: int) -> MonoDiagnostics:
    """All of them different."""
    return MonoDiagnostics(
        np.arange(size) + 0.1,
        np.arange(size) + 0.2,
        2,
        1.125,
        0.03125,
        17,
        0.75,
        0.625,
        0.875,
        0.01 * np.arange(len(POINT_NAMES)),
    )


@given(st.integers(1, 30))
def test_every_number_stands_under_its_name(size: int) -> None:
    one, names = numbers(size), mono_diagnostic_names(size)
    found = dict(zip(names, one.numbers(), strict=True))
    assert len(found) == len(names) == 2 * size + 7 + len(POINT_NAMES) + len(ACTION_NAMES)
    np.testing.assert_array_equal([found[f"identity_{s + 1}"] for s in range(size)], one.identity)
    np.testing.assert_array_equal([found[f"identity_spread_{s + 1}"] for s in range(size)], one.spread)
    np.testing.assert_array_equal([found[f"weight_{name}"] for name in POINT_NAMES], one.weights)
    single = {"person": 2, "size": 1.125, "size_sd": 0.03125, "adjusted_frames": 17}
    single |= {"adjustment_rms_px": 0.75, "skin_share": 0.625, "score": 0.875}
    assert {name: found[name] for name in single} == single


def test_what_is_not_known_is_nan() -> None:
    unknown = np.full(3, np.nan)
    found = dict(zip(mono_diagnostic_names(3), MonoDiagnostics(unknown, unknown).numbers(), strict=True))
    assert {name for name, number in found.items() if not np.isnan(number)} == {"person", "adjusted_frames"}


@pytest.mark.parametrize("identities, deformations", [(10, 5), (3, 1)])
def test_a_subject_fits_what_the_tracker_says(identities: int, deformations: int) -> None:
    model = random_model(0, identities, deformations)
    subject = mono_subject("left", model)
    mean, deviations = model.deformation_mean, model.deformation_deviations
    face = FaceDescription(mean, deviations, numbers(identities).numbers())
    estimate = lost_estimate(Frame(0, 0, (None,)), None, face)
    check_estimate(estimate, subject)
    assert subject.camera_frame == "left" and len(subject.shape_names) == deformations
    more = replace(estimate, numbers=numbers(identities + 1).numbers())
    with pytest.raises(ResultError, match="numbers has the wrong shape"):
        check_estimate(more, subject)


def test_what_a_whole_track_is_wrong_by_grows_with_the_distance() -> None:
    own = np.concatenate([[1.0, 2.0, 3.0], np.radians([2.0, 1.0, 0.5])])
    pose = HeadPose(np.array([10.0, -20.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0]))
    variance = size_and_systematic_variance(pose, own, None)
    np.testing.assert_allclose(
        np.sqrt(variance[:3]), np.hypot(PRIOR_SD * np.array([10.0, 20.0, 700.0]), [1.0, 2.0, 3.0])
    )
    np.testing.assert_allclose(np.degrees(np.sqrt(variance[3:])), [2.0, 1.0, 0.5])
    told = size_and_systematic_variance(pose, own, Size(1.2, 0.01))
    np.testing.assert_allclose(np.sqrt(told[:3]), np.hypot([0.1, 0.2, 7.0], [1.0, 2.0, 3.0]))


@pytest.mark.parametrize("track", [MONO_TRACK, STEREO_TRACK])
def test_raised_brows_make_the_pitch_uncertain(track: TrackModel) -> None:
    raised, smiling = np.zeros((10, 3)), np.zeros((10, 3))
    raised[BROWS, 1], smiling[MOUTH, 1] = 4.0, 4.0
    variance = track.expression_variance(raised)
    assert np.sqrt(variance[3]) == pytest.approx(4.0 * track.pitch_per_brow)
    np.testing.assert_array_equal(variance[[0, 1, 2, 4, 5]], 0.0)
    np.testing.assert_array_equal(track.expression_variance(smiling), 0.0)
