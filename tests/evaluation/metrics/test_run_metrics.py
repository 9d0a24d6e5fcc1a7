"""What a run says about itself, and what it leaves out."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.evaluation.measuring.measures import Measures
from posetrack_cli.evaluation.measuring.without_truth import (
    EMPTY,
    NO_TIMINGS,
    NO_WEIGHTS,
    NOT_COUNTED,
    particle_count,
    run_metrics,
)
from posetrack_cli.evaluation.reading.tracks import Track
from support.metrics import figures, number
from support.tracks import hand_track

RUN = {"configuration": json.dumps({"filter": {"particles": 512}})}


def measured(track: Track, run: dict[str, str] = RUN) -> Measures:
    measures = Measures("")
    run_metrics(measures, track, run)
    return measures


def test_a_run_by_hand() -> None:
    track = replace(
        hand_track("a", 4, 0.0),
        milliseconds=np.array([10.0, 20.0, 20.0, 30.0]),
        effective_sample_size=np.array([100.0, 200.0, 300.0, 400.0]),
        resampled=np.array([True, False, False, False]),
    )
    measures = measured(track)
    assert figures(measures, "ms_per_frame").median == 20.0
    assert number(measures, "frames_per_s") == pytest.approx(4 / 0.08)
    assert figures(measures, "ess").mean == 250.0
    assert number(measures, "resampling_rate") == 0.25
    assert number(measures, "particles") == 512.0
    assert not measures.absent
    assert not measures.notes


@pytest.mark.parametrize("milliseconds", [None, np.full(4, np.nan)])
def test_a_run_without_timings_says_how_to_get_them(milliseconds: np.ndarray | None) -> None:
    measures = measured(replace(hand_track("a", 4, 0.0), milliseconds=milliseconds))
    assert measures.absent == {"ms_per_frame": NO_TIMINGS, "frames_per_s": NO_TIMINGS}
    assert "--timings" in NO_TIMINGS


def test_frames_without_a_time_are_told() -> None:
    measures = measured(replace(hand_track("a", 3, 0.0), milliseconds=np.array([10.0, np.nan, 30.0])))
    assert figures(measures, "ms_per_frame").mean == 20.0
    assert number(measures, "frames_per_s") == pytest.approx(2 / 0.04)
    assert measures.notes == ["timings cover 2 of 3 frames"]


def test_no_time_at_all_is_no_infinite_speed() -> None:
    measures = measured(replace(hand_track("a", 2, 0.0), milliseconds=np.zeros(2)))
    assert measures.absent == {"frames_per_s": "the recorded times are 0"}


def test_an_optimiser_is_counted_but_has_no_weights() -> None:
    track = replace(
        hand_track("a", 3, 0.0), evaluations=np.array([1600.0, 0.0, 1600.0]), effective_sample_size=None
    )
    measures = measured(
        track, {"configuration": '{"filter":{"kind":"pso","particles":512},"pso":{"particles":64}}'}
    )
    assert figures(measures, "evaluations").mean == pytest.approx(3200 / 3)
    assert measures.absent == {"ess": NO_WEIGHTS}
    assert number(measures, "particles") == 64.0


def test_a_result_that_does_not_count_says_so() -> None:
    assert measured(replace(hand_track("a", 3, 0.0), evaluations=None)).absent == {"evaluations": NOT_COUNTED}


def test_an_empty_result_has_reasons() -> None:
    measures = measured(hand_track("a", 0, 0.0))
    assert set(measures.absent) == {"ms_per_frame", "frames_per_s", "evaluations", "ess", "resampling_rate"}
    assert set(measures.absent.values()) == {EMPTY}


@pytest.mark.parametrize(
    "run",
    [
        {},
        {"configuration": ""},
        {"configuration": "{"},
        {"configuration": "{}"},
        {"configuration": "[1]"},
        {"configuration": '{"filter": null}'},
        {"configuration": '{"filter": {"particles": "many"}}'},
    ],
)
def test_a_run_record_without_particles_is_no_failure(run: dict[str, str]) -> None:
    assert particle_count(run) is None
    assert "particles" in measured(hand_track("a", 2, 0.0), run).absent
