"""Results together: what is added up, what is made anew, and what is not pooled."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from posetrack_cli.evaluation.measuring.catalogue import is_pooled, place_of
from posetrack_cli.evaluation.measuring.evaluation import STEP, Count, Evaluation, distribution, statistics
from posetrack_cli.evaluation.measuring.honesty import JudgedFrames
from posetrack_cli.evaluation.measuring.pooling import make_pools, pool
from posetrack_cli.evaluation.reading.tracks import Coverage
from support.evaluation import hand_evaluation


def judged(right: list[int], confidence: list[float], lost: list[int] | None = None) -> JudgedFrames:
    flags = np.array(right, dtype=np.bool_)
    gone = np.array(lost or [0] * len(right), dtype=np.bool_)
    return JudgedFrames(np.array(confidence), flags, ~flags, gone, "right", "far")


def result(name: str, frames: JudgedFrames | None, **changes: Any) -> Evaluation:
    made: dict[str, Any] = {"judged": frames, "run": {"input.sha256": name}, "metrics": {}, "absent": {}}
    made |= {"distributions": {}, "counts": {}}
    return hand_evaluation(name, 3, **{**made, **changes})


def with_shares(name: str, count: int, of: int, **changes: Any) -> Evaluation:
    counts, metrics = {"inside_90": Count(count, of)}, {"inside_90": count / of}
    return result(name, None, counts=counts, metrics=metrics, **changes)


def test_frames_count_alike_whichever_result_they_are_of() -> None:
    a = result("a", judged([1, 1, 0], [0.9, 0.8, 0.7]), metrics={"frames_wrong": 1 / 3})
    b = result("b", judged([0], [0.95]), metrics={"frames_wrong": 1.0}, absent={"confidence_roc_area": "x"})
    both = pool("both", [a, b])
    assert both.metrics["frames_wrong"] == 0.5
    assert both.judged is not None and len(both.judged.right) == 4
    assert both.metrics["confidence_roc_area"] == 0.5  # 0.7 is below both right ones, 0.95 above
    assert "confidence_roc_area" not in both.absent and both.results == ("a", "b")


def test_shares_are_made_of_their_counts_not_averaged() -> None:
    both = pool("both", [with_shares("a", 9, 10), with_shares("b", 10, 90)])
    assert both.metrics["inside_90"] == pytest.approx(19 / 100)


def test_counts_of_frames_are_added_up() -> None:
    def counted(name: str, *counts: int) -> Evaluation:
        return result(name, None, coverage=Coverage(*counts, True, counts[1]), metrics={"coverage": 1.0})

    both = pool("both", [counted("a", 10, 8, 2, 1, 0, 3, 5), counted("b", 20, 20, 0, 0, 1, 0, 0)])
    assert both.coverage == Coverage(30, 28, 2, 1, 1, 3, 5, True, 28)
    counts = {"coverage": 28 / 33, "frames": 30.0, "lost": 2.0, "matched": 29.0, "missed": 3.0}
    assert {name: both.metrics[name] for name in counts} == pytest.approx(counts)


def test_a_figure_that_one_lacks_is_not_that_of_the_others() -> None:
    a = with_shares("a", 9, 10)
    b = result("b", None, absent={"inside_90": "the ground truth has no rotation"})
    both = pool("both", [a, b])
    assert "inside_90" not in both.metrics
    assert both.absent["inside_90"] == "b: the ground truth has no rotation"
    without = result("b", None, absent={"frames_wrong": "no truth"})
    half = pool("both", [result("a", judged([1], [1.0]), metrics={"frames_wrong": 0.0}), without])
    assert half.judged is None and half.absent["frames_wrong"] == "b: no truth"


def test_only_what_can_be_pooled_is_there() -> None:
    one = pool("a", [hand_evaluation("a", run={})])
    assert all(is_pooled(address) for address in (*one.metrics, *one.absent))
    assert {"coverage", "frames_wrong", "confidence_roc_area", "joint_error_mm"} <= set(one.metrics)
    assert "joint_error_mm.index_tip" not in (*one.metrics, *one.absent)
    places = [place_of(address) for address in one.metrics]
    assert places == sorted(places)


def test_results_of_one_recording_are_compared_and_not_pooled() -> None:
    same = [with_shares(name, 1, 2, run={"input.sha256": "one"}) for name in ("a", "b")]
    (made,) = make_pools([*same, with_shares("c", 1, 2)], {})
    assert not made.metrics and not made.has_pooled_values and made.judged is None
    assert made.absent["inside_90"].startswith(
        "a and b are of the same recording, so the results are not pooled"
    )
    (grouped,) = make_pools([], {"g": same})
    assert grouped.name == "pooled g" and grouped.metrics["inside_90"] == 0.5


def test_kinds_and_tracks_and_groups_are_pooled_apart() -> None:
    hand, other = with_shares("a", 1, 2), with_shares("b", 1, 2)
    head = with_shares("c", 1, 4, subject="head")
    smoothed = [with_shares(name, 3, 4, which="smoothed") for name in ("a smoothed", "b smoothed")]
    made = make_pools([hand, other, head, *smoothed], {"g": [hand, other], "h": [head]})
    assert [(one.name, one.results, one.has_pooled_values) for one in made] == [
        ("pooled hand filtered", ("a", "b"), True),
        ("pooled head filtered", ("c",), False),
        ("pooled hand smoothed", ("a smoothed", "b smoothed"), True),
        ("pooled g", ("a", "b"), True),
        ("pooled h", ("c",), False),
    ]
    assert [one.name for one in make_pools([hand, other], {})] == ["pooled"]
    assert make_pools([], {}) == ()


def with_errors(name: str, errors: np.ndarray, **changes: Any) -> Evaluation:
    summary = statistics(errors)
    return result(
        name,
        None,
        metrics={"joint_error_mm": summary},
        distributions={"joint_error_mm": distribution(errors, summary)},
        **changes,
    )


def test_errors_together_are_those_of_all_frames() -> None:
    """Brute force: the statistics of every value at once; long results weigh more than short ones."""
    rng = np.random.default_rng(5)
    samples = [rng.gamma(2.0, scale, (frames, 21)) for frames, scale in ((3, 40.0), (400, 2.0), (57, 9.0))]
    made = pool("all", [with_errors(name, of) for name, of in zip("abc", samples, strict=True)])
    every = np.concatenate([one.ravel() for one in samples])
    figures, brute = made.metrics["joint_error_mm"], statistics(every)
    assert figures.count == brute.count and figures.max == brute.max
    np.testing.assert_allclose([figures.mean, figures.sd], [brute.mean, brute.sd], rtol=1e-12)
    found, expected = ([of.p5, of.median, of.p95] for of in (figures, brute))
    np.testing.assert_allclose(found, expected, rtol=float(np.expm1(STEP)))
    assert abs(figures.mean - np.mean([one.mean() for one in samples])) > 1.0  # no mean of means


def test_errors_that_one_lacks_are_not_those_of_the_others() -> None:
    a, b = with_errors("a", np.ones(4)), result("b", None, absent={"joint_error_mm": "no truth"})
    made = pool("both", [a, b])
    assert "joint_error_mm" not in made.metrics and made.absent["joint_error_mm"] == "b: no truth"
