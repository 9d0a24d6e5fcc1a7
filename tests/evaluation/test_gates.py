"""Gates: what is a condition, when it fails, and what its line says."""

from __future__ import annotations

import operator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.judging.gates import OPERATORS, check_gate, check_gates, parse_gate, read_gates
from posetrack_cli.evaluation.measuring.catalogue import CATALOGUE, figure_of
from posetrack_cli.evaluation.measuring.evaluation import STATISTIC_NAMES, Evaluation, Statistics
from posetrack_cli.evaluation.measuring.honesty import JudgedFrames
from posetrack_cli.evaluation.measuring.pooling import make_pools
from posetrack_cli.evaluation.reading.tracks import Coverage
from support.evaluation import hand_evaluation

FIGURES = Statistics(mean=8.0, sd=2.0, median=7.5, p95=12.0, max=30.0, p5=4.0, count=600)
NOT_A_NUMBER = float("nan")


def evaluation(name: str = "a", **changes: object):
    metrics = {"coverage": 0.98, "lost": 6.0, "joint_error_mm": FIGURES, "joint_error_mm.index_tip": FIGURES}
    return hand_evaluation(name, 300, **{"metrics": metrics, **changes})


def outcome(text: str, **changes: object):
    return check_gate(parse_gate(text), evaluation(**changes))


@pytest.mark.parametrize(
    ("text", "failed"),
    [
        ("joint_error_mm.mean > 10", False),
        ("joint_error_mm.mean > 7.9", True),
        ("joint_error_mm.mean>8", False),
        ("joint_error_mm.mean>=8", True),
        ("joint_error_mm.sd < 2.0", False),
        ("joint_error_mm.sd <= 2.0", True),
        ("joint_error_mm.median == 7.5", True),
        ("joint_error_mm.median != 7.5", False),
        ("joint_error_mm.index_tip.p95 > 1.1e1", True),
        ("  joint_error_mm.max   >   30.5  ", False),
        ("joint_error_mm.count < 1000", True),
        ("coverage < 0.99", True),
        ("coverage < .98", False),
        ("lost > -1", True),
    ],
)
def test_a_true_condition_fails(text: str, failed: bool) -> None:
    assert outcome(text).failed is failed


@given(st.sampled_from(sorted(OPERATORS)), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_every_sign_is_python_s(sign: str, value: float, limit: float) -> None:
    python = {">": "gt", "<": "lt", ">=": "ge", "<=": "le", "==": "eq", "!=": "ne"}
    measured = SimpleNamespace(
        name="a",
        subject="hand",
        coverage=Coverage(9, 9, 0, 0, 0, 0, 0, True, 9),
        metrics={"particles": value},
    )
    assert check_gate(parse_gate(f"particles {sign} {limit!r}"), measured).failed is getattr(
        operator, python[sign]
    )(value, limit)


def test_the_line_names_result_condition_and_figure() -> None:
    assert outcome("joint_error_mm.mean>7").line == (
        "a: gate 'joint_error_mm.mean > 7' failed: joint_error_mm.mean is 8"
    )
    assert "passed: coverage is 0.98" in outcome("coverage < 0.9").line


def test_a_figure_just_beyond_its_limit_does_not_look_equal_to_it() -> None:
    line = outcome("coverage < 0.99", metrics={"coverage": 0.9899999}).line
    assert line.endswith("coverage is 0.9899999")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"absent": {"joint_error_mm": "no truth"}, "metrics": {"coverage": 1.0}}, "no truth"),
        ({"metrics": {"coverage": 1.0}}, "not measured"),
        (
            {"metrics": {"joint_error_mm": Statistics(*[NOT_A_NUMBER] * 6, count=0)}},
            "the value is nan",
        ),
        (
            {"metrics": {"joint_error_mm": Statistics(float("inf"), 0.0, 0.0, 0.0, float("inf"), 0.0, 3)}},
            "the value is inf",
        ),
        ({"coverage": Coverage(0, 0, 0, 0, 0, 5, 0, True, 0)}, "the result has no estimates"),
        ({"coverage": Coverage(9, 0, 9, 0, 0, 0, 0, True, 0)}, "coverage is 0"),
        ({"subject": "head"}, "not a head metric"),
    ],
)
@pytest.mark.parametrize("sign", sorted(OPERATORS))
def test_what_cannot_be_judged_fails_whatever_the_condition(
    changes: dict[str, object], reason: str, sign: str
) -> None:
    said = outcome(f"joint_error_mm.mean {sign} 10", **changes)
    assert said.failed and said.figure is None
    assert said.line == f"a: gate 'joint_error_mm.mean {sign} 10' could not be evaluated: {reason}"


def test_coverage_0_is_itself_a_figure() -> None:
    nothing = {"coverage": Coverage(9, 0, 9, 0, 0, 0, 0, True, 0), "metrics": {"coverage": 0.0, "lost": 9.0}}
    assert outcome("coverage < 0.99", **nothing).line.endswith("failed: coverage is 0")
    assert outcome("lost > 10", **nothing).failed is False


def test_a_part_is_as_absent_as_its_metric() -> None:
    said = outcome(
        "joint_error_mm.wrist.mean > 1", metrics={"coverage": 1.0}, absent={"joint_error_mm": "no truth"}
    )
    assert said.reason == "no truth"


def test_every_gate_meets_every_result() -> None:
    gates = [parse_gate("coverage < 0.99"), parse_gate("joint_error_mm.mean > 10")]
    results = [evaluation(name=name) for name in ("a", "b", "c")]
    outcomes = check_gates(gates, results)
    assert [(one.gate, one.result) for one in outcomes] == [
        (gate.text, result.name) for gate in gates for result in results
    ]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "joint_eror_mm.mean > 10",
            r"unknown metric 'joint_eror_mm'; did you mean 'joint_error_mm'\?.*wrist_position",
        ),
        (
            "joint_error_mm > 10",
            "lacks a statistic, expected one of joint_error_mm.mean, .*joint_error_mm.max",
        ),
        ("joint_error_mm.index_tip > 10", "expected one of joint_error_mm.index_tip.mean"),
        ("joint_error_mm.indextip.p95 > 10", "did you mean 'index_tip'"),
        ("joint_error_mm.p99 > 10", "did you mean 'p95'"),
        (
            "coverage.mean < 0.99",
            "metric 'coverage' has no 'mean'; it is a single number without parts or statistics",
        ),
        ("coverage < 99%", "found 99%; shares are numbers from 0 to 1; write 0.99"),
        ("joint_error_mm.mean > 10mm", "plain number without unit"),
        ("joint_error_mm.mean > 10,5", "with a decimal point"),
        ("joint_error_mm.mean > ten", "is not a number, found ten; e.g."),
        ("joint_error_mm.mean > inf", "is not finite"),
        ("joint_error_mm.mean > nan", "is not finite"),
        ("coverage = 1", r"invalid condition '.*', expected METRIC.*; write == for equality"),
        ("coverage", r"invalid condition '.*', expected METRIC.* > >= < <= == !=.*e.g."),
        ("", "invalid condition"),
        ("> 10", "invalid condition"),
        ("coverage <", "invalid condition.*e.g."),
        ("0 < coverage < 1", "one condition per --fail-if"),
        ("9 > ess.mean > 1", "one condition per --fail-if"),
        ("coverage => 1", "invalid condition"),
    ],
)
def test_what_is_no_condition_is_one_line_that_helps(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said) as error:
        parse_gate(text)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("metric", CATALOGUE, ids=lambda metric: metric.name)
def test_every_metric_can_be_gated(metric) -> None:
    for statistic in ("",) if metric.scalar else STATISTIC_NAMES:
        text = f"{metric.name}{'.' if statistic else ''}{statistic} > 1"
        assert parse_gate(text).text == text


def test_a_file_of_gates(tmp_path: Path) -> None:
    path = tmp_path / "gates.txt"
    path.write_text("\ufeff# accuracy\njoint_error_mm.mean > 10\n\n  coverage < 0.99  # all frames\r\n")
    assert [gate.text for gate in read_gates(path)] == ["joint_error_mm.mean > 10", "coverage < 0.99"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"coverage < 0.99\n\njoint_eror_mm.mean > 1\n", r"gates.txt:3: unknown metric 'joint_eror_mm'"),
        (b"# nothing\n\n", "gates.txt: gate file is empty"),
        (b"\xff\xfe\x00", "not UTF-8"),
    ],
)
def test_a_bad_file_of_gates_names_file_and_line(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "gates.txt"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=said):
        read_gates(path)


def test_a_missing_file_of_gates(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"none.txt: gate file cannot be read, found No such file"):
        read_gates(tmp_path / "none.txt")


def test_a_misspelt_feature_point_shows_when_the_points_are_known() -> None:
    points = {"point_error_mm": FIGURES, "point_error_mm.nose_tip": FIGURES}
    head = evaluation(subject="head", metrics={"coverage": 1.0, **points})
    assert check_gates([parse_gate("point_error_mm.nose_tip.mean > 1")], [head])[0].failed
    with pytest.raises(UsageError, match="did you mean 'nose_tip'"):
        check_gates([parse_gate("point_error_mm.nosetip.mean > 1")], [head])


def test_a_known_part_that_no_result_has_fails_with_its_reason() -> None:
    """A joint or a point is no misspelling where only the truth lacks it, or is not there at all."""
    without = evaluation(absent={"joint_error_mm.thumb_tip": "the ground truth has no thumb_tip"})
    (outcome,) = check_gates([parse_gate("joint_error_mm.thumb_tip.mean > 1")], [without])
    assert outcome.failed and outcome.reason == "the ground truth has no thumb_tip"
    head = evaluation(subject="head", metrics={"coverage": 1.0}, absent={"point_error_mm": "no truth"})
    (outcome,) = check_gates([parse_gate("point_error_mm.nose_tip.mean > 1")], [head])
    assert outcome.failed and outcome.reason == "no truth"


def test_figures_are_found_by_address() -> None:
    assert figure_of(evaluation(), "joint_error_mm.p95").value == 12.0
    assert figure_of(evaluation(), "coverage").value == 0.98
    assert figure_of(evaluation(), "nees.mean").reason == "not measured"
    np.testing.assert_equal(figure_of(evaluation(), "joint_error_mm.index_tip.count").value, 600.0)


def pooled_evaluation(name: str, right: list[bool], confidence: list[float]) -> Evaluation:
    no = np.zeros(len(right), dtype=np.bool_)
    judged = JudgedFrames(np.array(confidence), np.array(right), no, no, "right", "far")
    run = {"input.sha256": name}
    return hand_evaluation(name, 4, metrics={"confidence_roc_area": 1.0}, judged=judged, run=run)


def test_a_pooled_gate_is_about_the_results_together() -> None:
    a = pooled_evaluation("a", [True, False], [0.9, 0.8])
    b = pooled_evaluation("b", [True, False], [0.3, 0.2])  # each tells its own apart: together 3 of 4 pairs
    gates = [parse_gate("pooled.confidence_roc_area < 0.8"), parse_gate("confidence_roc_area < 0.8")]
    outcomes = check_gates(gates, [a, b], make_pools([a, b], {}))
    assert [(one.result, one.failed, one.figure) for one in outcomes] == [
        ("pooled", True, 0.75),
        ("a", False, 1.0),
        ("b", False, 1.0),
    ]
    line = "pooled: gate 'pooled.confidence_roc_area < 0.8' failed: pooled.confidence_roc_area is 0.75"
    assert outcomes[0].line == line


def test_a_pooled_gate_that_a_result_has_no_frames_for_cannot_be_judged() -> None:
    a = pooled_evaluation("a", [True, False], [0.9, 0.8])
    b = replace(a, name="b", run={}, judged=None, metrics={}, absent={"confidence_roc_area": "no truth"})
    (outcome,) = check_gates([parse_gate("pooled.confidence_roc_area < 0")], [a, b], make_pools([a, b], {}))
    assert outcome.failed and outcome.figure is None and outcome.reason == "b: no truth"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pooled.frames_per_s < 10", "'frames_per_s' is not pooled, expected one of "),
        (
            "pooled.joint_error_mm.index_tip.mean > 10",
            "parts of 'joint_error_mm' are not pooled",
        ),
        ("p95(pooled.coverage) < 1", "'pooled.coverage' is a single value, not one per result"),
        ("p99(coverage) < 1", r"invalid statistic over results 'p99\(coverage\)', expected one of mean"),
        ("p95(coverage < 1", "invalid statistic over results"),
        ("p95(joint_error_mm) > 1", "lacks a statistic, expected one of joint_error_mm.mean"),
        ("p95(joint_eror_mm.mean) > 1", "did you mean 'joint_error_mm'"),
        ("pooled.confidence_roc_are < 1", "did you mean 'confidence_roc_area'"),
        ("pooled > 1", "unknown metric 'pooled'"),
    ],
)
def test_what_is_not_pooled_is_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        parse_gate(text)


def with_mean(name: str, mean: float, **changes: Any) -> Evaluation:
    figures = Statistics(mean, 1.0, mean, mean, mean, mean, 4)
    run = {"input.sha256": name}
    return evaluation(name=name, metrics={"coverage": 1.0, "joint_error_mm": figures}, run=run, **changes)


def test_a_gate_over_results_is_about_their_figures() -> None:
    members = [with_mean(f"r{place}", float(place)) for place in range(1, 22)]  # 1, 2, ..., 21 mm
    gates = [parse_gate("p95(joint_error_mm.mean) > 19.5"), parse_gate("count(coverage) < 21")]
    outcomes = check_gates(gates, members, make_pools(members, {}))
    assert [(one.result, one.failed, one.figure) for one in outcomes] == [
        ("pooled", True, 20.0),
        ("pooled", False, 21.0),
    ]
    assert outcomes[0].line == (
        "pooled: gate 'p95(joint_error_mm.mean) > 19.5' failed: "
        "p95(joint_error_mm.mean) over 21 results is 20"
    )


def test_a_gate_over_results_of_which_one_has_no_figure_cannot_be_judged() -> None:
    blind = [with_mean(name, 1.0, absent={}) for name in "bc"]
    blind = [replace(one, metrics={"coverage": 1.0}, absent={"joint_error_mm": "no truth"}) for one in blind]
    members = [with_mean("a", 1.0), *blind]
    (outcome,) = check_gates([parse_gate("max(joint_error_mm.mean) > 99")], members, make_pools(members, {}))
    assert outcome.failed and outcome.figure is None
    assert outcome.reason == "b: no truth, and 1 more without it"


def test_a_pooled_error_is_that_of_all_frames() -> None:
    a, b = hand_evaluation("a", 30, 2.0, run={}), hand_evaluation("b", 300, 20.0, run={})
    gate = parse_gate("pooled.joint_error_mm.mean > 0")
    (outcome,) = check_gates([gate], [a, b], make_pools([a, b], {}))
    means = [one.metrics["joint_error_mm"].mean for one in (a, b)]
    assert outcome.figure == pytest.approx((30 * means[0] + 300 * means[1]) / 330)
