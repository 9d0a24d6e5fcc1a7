"""What needs no truth, on tracks short enough to work out by hand, and on noise whose strength is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.measuring import without_truth
from posetrack_cli.evaluation.measuring.evaluation import Statistics, Value
from posetrack_cli.evaluation.measuring.measures import Measures
from posetrack_cli.evaluation.measuring.without_truth import jitter
from posetrack_cli.evaluation.reading.tracks import Track
from support.tracks import hand_track

FRAME_NS = 33_333_333


def point_track(points: FloatArray, stamp_ns: list[int] | None = None) -> Track:
    """A track of points (N, P, 3) alone, at 30 Hz unless stamps are given."""
    frames, count = points.shape[:2]
    stamps = [i * FRAME_NS for i in range(frames)] if stamp_ns is None else stamp_ns
    names = tuple(f"p{i}" for i in range(count))
    return Track(
        "a", "head", (), names, (-1,) * count, stamp_ns=np.array(stamps, dtype=np.int64), points=points
    )


def along_x(*x: float) -> FloatArray:
    """One point on the x axis."""
    points = np.zeros((len(x), 1, 3))
    points[:, 0, 0] = x
    return points


def consistency_metrics(track: Track) -> dict[str, Value]:
    measures = Measures("")
    without_truth.consistency_metrics(measures, track)
    return measures.metrics


def values_of(track: Track) -> FloatArray:
    values = jitter(track)
    assert values is not None and len(values) == len(track)
    return values[~np.isnan(values)]


def statistics_of(track: Track, name: str) -> Statistics:
    value = consistency_metrics(track)[name]
    assert isinstance(value, Statistics)
    return value


def test_jitter_by_hand() -> None:
    # 0 0 6 0 0: second differences 6, -12, 6
    expected = np.array([6.0, 12.0, 6.0]) / math.sqrt(6.0)
    np.testing.assert_allclose(values_of(point_track(along_x(0, 0, 6, 0, 0))), expected, rtol=1e-12)
    figures = statistics_of(point_track(along_x(0, 0, 6, 0, 0)), "jitter_mm")
    assert figures.count == 3
    assert figures.mean == pytest.approx(8.0 / math.sqrt(6.0))
    assert figures.max == pytest.approx(12.0 / math.sqrt(6.0))


def test_jitter_is_of_the_middle_of_three_frames_in_a_row() -> None:
    stamps = [FRAME_NS * k for k in (0, 1, 2, 3, 6, 7, 8)]  # two frames are missing after the fourth
    values = jitter(point_track(along_x(0, 0, 6, 6, 6, 6, 0), stamps))
    nan, one = math.nan, 6.0 / math.sqrt(6.0)
    np.testing.assert_allclose(values, [nan, one, one, nan, nan, one, nan], rtol=1e-12)


def test_jitter_is_a_mean_over_points_of_lengths() -> None:
    points = np.zeros((3, 2, 3))
    points[1, 0] = [3.0, 0.0, 4.0]  # second difference of length 10; the other point rests
    np.testing.assert_allclose(values_of(point_track(points)), [5.0 / math.sqrt(6.0)], rtol=1e-12)


def test_a_track_without_points_shakes_at_its_position() -> None:
    track = replace(point_track(along_x(0, 0, 6, 0, 0)), points=None, position=along_x(0, 0, 6, 0, 0)[:, 0])
    np.testing.assert_allclose(values_of(track), values_of(point_track(along_x(0, 0, 6, 0, 0))))
    assert jitter(replace(track, position=None)) is None


def test_a_finger_that_shakes_on_a_hand_that_rests_is_seen() -> None:
    shaking = point_track(along_x(0, 0, 6, 0, 0))
    np.testing.assert_array_equal(
        values_of(replace(shaking, position=np.zeros((5, 3)))), values_of(shaking), "the origin rests"
    )


def test_white_noise_gives_its_own_strength() -> None:
    """E|.|^2 = 3 s^2; neighbours are correlated, so 40,000 values count as some 10,000: 4 sd are 4 %."""
    sd, frames = 2.5, 40_000
    rng = np.random.default_rng(1)
    noise = sd * rng.standard_normal((frames, 1, 3))
    steady = np.array([3.0, -1.0, 2.0]) * np.arange(frames)[:, None, None]
    squared = (values_of(point_track(noise + steady)) ** 2).mean()
    assert squared == pytest.approx(3 * sd**2, rel=0.04)


def test_white_noise_gives_its_own_strength_at_uneven_stamps() -> None:
    sd, frames = 2.5, 40_000
    rng = np.random.default_rng(2)
    stamps = np.arange(frames) * FRAME_NS + rng.integers(-6_000_000, 6_000_000, frames)
    steady = np.array([300.0, -100.0, 200.0]) * (stamps * 1e-9)[:, None, None]
    points = steady + sd * rng.standard_normal((frames, 1, 3))
    squared = (values_of(point_track(points, stamps.tolist())) ** 2).mean()
    assert squared == pytest.approx(3 * sd**2, rel=0.04)


@settings(deadline=None)
@given(st.lists(st.integers(-9, 9), min_size=3, max_size=40))
def test_a_constant_velocity_does_not_shake_whatever_the_stamps(shifts_ms: list[int]) -> None:
    stamps = [i * FRAME_NS + 1_000_000 * shift for i, shift in enumerate(shifts_ms)]
    points = np.array([[[700.0, -300.0, 20.0]]]) * (np.array(stamps) * 1e-9)[:, None, None]
    assert np.all(values_of(point_track(points, stamps)) < 1e-9)


def test_jitter_leaves_out_what_spans_a_gap() -> None:
    # at 0 1 2 | 5 6 7 frames: two rows of three, nothing across the gap where the point jumps
    stamps = [i * FRAME_NS for i in (0, 1, 2, 5, 6, 7)]
    track = point_track(along_x(0, 6, 0, 900, 900, 900), stamps)
    np.testing.assert_allclose(values_of(track), [12.0 / math.sqrt(6.0), 0.0])


def test_gaps_by_hand() -> None:
    # intervals in frames: 1 1 3 1 2 1 1.5; median 1: longer than 1.5 are 3 and 2
    ends = np.cumsum([0, 2, 2, 6, 2, 4, 2, 3]) * 10_000_000
    metrics = consistency_metrics(point_track(np.zeros((8, 1, 3)), ends.tolist()))
    assert metrics["gaps"] == 2.0
    assert metrics["largest_gap_s"] == pytest.approx(0.06, abs=1e-15)


def test_status_changes_by_hand() -> None:
    track = hand_track("a", 8, 1.0)
    lost = np.array([0, 0, 1, 1, 0, 0, 1, 0], dtype=np.bool_)
    found = np.array([0, 0, 0, 0, 1, 0, 0, 0], dtype=np.bool_)
    # tracking, lost, reinitialised, tracking, lost, tracking: five changes
    metrics = consistency_metrics(replace(track, lost=lost, reinitialised=found))
    assert metrics["status_changes"] == 5.0
    assert consistency_metrics(track)["status_changes"] == 0.0


def test_cost_and_confidence_over_the_frames_that_have_one() -> None:
    track = hand_track("a", 4, 1.0)
    cost, confidence = np.array([2.0, np.nan, 4.0, np.nan]), np.array([0.0, 0.5, 1.0, 0.5])
    track = replace(track, cost=cost, confidence=confidence)
    figures = statistics_of(track, "cost_mm")
    assert (figures.mean, figures.sd, figures.max, figures.count) == (3.0, 1.0, 4.0, 2)
    assert statistics_of(track, "confidence").mean == 0.5
    assert "cost_mm" not in consistency_metrics(replace(track, cost=np.full(4, np.nan)))


@pytest.mark.parametrize(
    ("frames", "known"),
    [
        (0, set()),
        (1, {"cost_mm", "confidence", "status_changes"}),
        (2, {"cost_mm", "confidence", "status_changes", "gaps", "largest_gap_s"}),
        (3, {"cost_mm", "confidence", "status_changes", "gaps", "largest_gap_s", "jitter_mm"}),
    ],
)
def test_what_few_frames_do_not_tell_is_left_out(frames: int, known: set[str]) -> None:
    assert set(consistency_metrics(hand_track("a", frames, 1.0))) == known


def test_two_frames_have_no_gap() -> None:
    assert consistency_metrics(point_track(np.zeros((2, 1, 3)), [0, 10**9])) == {
        "gaps": 0.0,
        "largest_gap_s": 1.0,
    }


def test_a_track_without_status_has_no_changes_of_it() -> None:
    track = hand_track("a", 4, 1.0)
    assert consistency_metrics(track)["status_changes"] == 0.0
    for missing in ("lost", "reinitialised"):
        assert "status_changes" not in consistency_metrics(replace(track, **{missing: None}))
