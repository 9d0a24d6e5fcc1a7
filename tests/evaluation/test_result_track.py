"""A result's own trajectory."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import ResultError
from posetrack_cli.evaluation.reading.tracks import Track, track_of_result
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.reader import read_result
from support.truth import FRAME_NS, HAND, HEAD, estimates, write_result


def track(tmp_path: Path, own: list[Estimate], subject: Subject = HAND) -> Track:
    return track_of_result(read_result(write_result(tmp_path / "r.mcap", subject, own)), "mine")


@pytest.mark.parametrize("subject", [HAND, HEAD], ids=["hand", "head"])
def test_every_array_is_the_estimates_own(tmp_path: Path, subject: Subject) -> None:
    own = estimates(subject, 7)
    found: Any = track(tmp_path, own, subject)
    assert (found.name, found.subject, len(found)) == ("mine", subject.name, 7)
    assert found.shape_names == subject.shape_names
    assert (found.point_names, found.point_parents) == (subject.point_names, subject.point_parents)
    arrays = {field.name for field in fields(Estimate)} & {field.name for field in fields(Track)}
    assert len(arrays) == 16
    for name in arrays:
        expected = [getattr(one, name) for one in own]
        if all(value is None for value in expected) and name not in ("cost", "milliseconds"):
            assert getattr(found, name) is None
            continue
        expected = [np.nan if value is None else value for value in expected]
        np.testing.assert_array_equal(getattr(found, name), expected, err_msg=name)


def test_status_says_what_is_lost_and_what_was_found_anew(tmp_path: Path) -> None:
    own = estimates(HAND, 4, lost=(1,))
    own[2] = replace(own[2], status=Status.REINITIALISED)
    found: Any = track(tmp_path, own)
    assert found.lost.tolist() == [False, True, False, False]
    assert found.reinitialised.tolist() == [False, False, True, False]


def test_a_velocity_that_no_frame_has_is_none(tmp_path: Path) -> None:
    found = track(tmp_path, estimates(HAND, 3, velocity=False))
    assert found.twist is None and found.twist_variance is None and found.pose_variance is not None


def test_a_velocity_that_some_frames_have_is_nan_in_the_others(tmp_path: Path) -> None:
    mixed = [*estimates(HAND, 2, velocity=False), *estimates(HAND, 4)[2:]]
    found: Any = track(tmp_path, mixed)
    assert np.isnan(found.twist).all(axis=1).tolist() == [True, True, False, False]


def test_what_an_optimiser_does_not_know_is_none(tmp_path: Path) -> None:
    unknown = {"pose_variance": None, "effective_sample_size": None}
    own = [replace(one, **unknown, evaluations=1600) for one in estimates(HAND, 3, velocity=False)]
    found: Any = track(tmp_path, own)
    assert found.pose_variance is None and found.effective_sample_size is None
    assert found.evaluations.tolist() == [1600.0] * 3


def test_an_empty_result_is_an_empty_track(tmp_path: Path) -> None:
    found: Any = track(tmp_path, [])
    assert len(found) == 0
    assert found.points.shape == (0, 21, 3) and found.twist.shape == (0, 21) and found.lost.shape == (0,)


def test_a_subject_without_points_has_none(tmp_path: Path) -> None:
    bare = Subject("head", "camera", (), (), ())
    assert track(tmp_path, estimates(bare, 3), bare).points is None


def test_stamps_that_go_back_name_the_result(tmp_path: Path) -> None:
    own = estimates(HAND, 4)
    own[2] = replace(own[2], stamp_ns=5)
    with pytest.raises(
        ResultError, match=f"mine, row 2: stamps are not sorted, found 5 ns after {FRAME_NS} ns"
    ):
        track(tmp_path, own)


def test_what_a_killed_writer_left_is_a_track(tmp_path: Path) -> None:
    own = estimates(HAND, 40)
    path = write_result(tmp_path / "r.mcap", HAND, own)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    result = read_result(path)
    found: Any = track_of_result(result, "cut")
    assert 10 <= len(found) < 40 and result.losses
    np.testing.assert_array_equal(found.points, [one.points for one in own[: len(found)]])
