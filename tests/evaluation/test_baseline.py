"""Regression against an earlier report."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.judging.baseline import FLOOR, check_baseline, read_baseline
from posetrack_cli.evaluation.measuring.evaluation import Statistics, distribution, statistics
from posetrack_cli.evaluation.measuring.pooling import make_pools
from posetrack_cli.evaluation.reading.tracks import Coverage
from posetrack_cli.evaluation.reports.report_files import json_report
from support.evaluation import hand_evaluation
from support.rows import result

OPTIONS = {"tolerance_ms": 5.0, "time_offset_s": 0.0, "align": "none"}


def measured(name: str = "a", error: float = 10.0, share: float = 0.9, **changes: object):
    metrics = {
        "coverage": share,
        "joint_error_mm": Statistics(error, 1.0, error, error, error, error, 9),
        "ms_per_frame": Statistics(50.0, 1.0, 50.0, 50.0, 50.0, 50.0, 9),
    }
    return hand_evaluation(name, 30, **{"metrics": metrics, "absent": {}, **changes})


def stored(folder: Path, *evaluations, **options: object) -> Path:
    path = folder / "baseline.json"
    path.write_text(json_report(evaluations, {**OPTIONS, **options}))
    return path


def failed(path: Path, *evaluations, tolerance: float = 0.05) -> list[str]:
    check = check_baseline(read_baseline(path), evaluations, tolerance, OPTIONS)
    return [outcome.line for outcome in check.outcomes if outcome.failed]


def test_the_same_figures_pass(tmp_path: Path) -> None:
    check = check_baseline(read_baseline(stored(tmp_path, measured())), [measured()], 0.0, OPTIONS)
    assert not any(outcome.failed for outcome in check.outcomes)
    assert len(check.outcomes) == 3 and check.notes == ()  # coverage, mean and 95th percentile; never speed


def test_the_limit_of_an_error_is_relative(tmp_path: Path) -> None:
    path = stored(tmp_path, measured(error=10.0))
    assert failed(path, measured(error=10.5 + 0.9 * FLOOR)) == []
    lines = failed(path, measured(error=10.6))
    assert len(lines) == 2  # mean and 95th percentile are the same here
    gate = "joint_error_mm.mean > 10.51 (baseline 10, tolerance 0.05)"
    assert lines[0] == f"a: gate '{gate}' failed: joint_error_mm.mean is 10.6"


def test_the_limit_of_a_share_is_absolute(tmp_path: Path) -> None:
    path = stored(tmp_path, measured(share=0.9))
    assert failed(path, measured(share=0.851)) == []
    assert "coverage < 0.85 (baseline 0.9" in failed(path, measured(share=0.849))[0]


def test_better_is_no_regression(tmp_path: Path) -> None:
    assert failed(stored(tmp_path, measured()), measured(error=1.0, share=1.0)) == []


def test_rounding_is_no_regression(tmp_path: Path) -> None:
    assert failed(stored(tmp_path, measured(error=0.0)), measured(error=0.001)) == []
    assert failed(stored(tmp_path, measured(error=0.0)), measured(error=0.02)) != []


@given(st.floats(0.1, 500), st.floats(0, 1), st.floats(0, 2))
def test_a_figure_fails_exactly_beyond_its_limit(error: float, tolerance: float, factor: float) -> None:
    report = read_baseline_of(measured(error=error))
    now = measured(error=error * factor)
    check = check_baseline(report, [now], tolerance)
    mean = next(o for o in check.outcomes if o.gate.startswith("joint_error_mm.mean"))
    assert mean.failed is (error * factor > error * (1 + tolerance) + FLOOR)


def read_baseline_of(*evaluations):
    from posetrack_cli.evaluation.judging.baseline import StoredReport

    return StoredReport.model_validate_json(json_report(evaluations, OPTIONS))


def test_results_are_found_by_name(tmp_path: Path) -> None:
    path = stored(tmp_path, measured("a", 10.0), measured("b", 20.0))
    assert failed(path, measured("b", 20.0), measured("a", 10.0)) == []
    assert all(line.startswith("a: ") for line in failed(path, measured("b", 20.0), measured("a", 20.0)))
    assert len(failed(path, measured("a", 20.0))) == 2


def test_the_only_one_is_compared_with_the_only_one(tmp_path: Path) -> None:
    assert len(failed(stored(tmp_path, measured("old name", 10.0)), measured("new name", 20.0))) == 2


def test_a_result_that_the_baseline_has_not_cannot_be_judged(tmp_path: Path) -> None:
    assert failed(stored(tmp_path, measured("a"), measured("b")), measured("c")) == [
        "c: gate 'baseline' could not be evaluated: no result with this name in the baseline, which has: a, b"
    ]


def test_a_figure_that_is_gone_cannot_be_judged(tmp_path: Path) -> None:
    blind = measured(metrics={"coverage": 1.0}, absent={"joint_error_mm": "no truth"})
    lines = failed(stored(tmp_path, measured()), blind)
    assert len(lines) == 2 and all(line.endswith("could not be evaluated: no truth") for line in lines)


def test_a_baseline_without_any_key_figure_cannot_judge(tmp_path: Path) -> None:
    path = stored(tmp_path, measured(metrics={"frames": 30.0}))
    assert failed(path, measured()) == [
        "a: gate 'baseline' could not be evaluated: the baseline has none of the key figures"
    ]


def test_what_makes_the_two_less_comparable_is_noted(tmp_path: Path) -> None:
    before = measured(
        metrics={"coverage": 1.0}, coverage=Coverage(20, 20, 0, 0, 20, 0, 0, False, 0), absent={}
    )
    path = stored(tmp_path, before, align="rigid")
    check = check_baseline(read_baseline(path), [measured(share=1.0)], 0.05, OPTIONS)
    assert list(check.notes) == [
        "align is none, rigid in the baseline",
        "a: 30 frames, 20 in the baseline",
        "a: the baseline was evaluated without ground truth",
        "a: not compared, missing in the baseline: joint_error_mm.mean, joint_error_mm.p95",
    ]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"{", "not an evaluation report"),
        (b"", "not an evaluation report"),
        (b"[]", "not an evaluation report"),
        (b"\xff\xfe", "not an evaluation report"),
        (
            b'{"format": "posetrack.eval/2", "results": 7}',
            "unsupported format of the baseline, found posetrack.eval/2, expected",
        ),
        (b'{"format": "posetrack.eval/1"}', "found results: Field required"),
        (b'{"results": []}', "found format: Field required"),
    ],
)
def test_what_is_no_baseline_is_one_line(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "baseline.json"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=said) as error:
        read_baseline(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_a_missing_baseline(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="baseline cannot be read, found No such file"):
        read_baseline(tmp_path / "none.json")


def checked(path: Path, *members, tolerance: float = 0.05):
    return check_baseline(read_baseline(path), members, tolerance, OPTIONS, make_pools(members, {}))


def stored_set(folder: Path, *members) -> Path:
    path = folder / "baseline.json"
    path.write_text(json_report(members, OPTIONS, pools=make_pools(members, {}), rows=True))
    return path


def with_errors(name: str, errors: list[float], **changes: object):
    """A result with so many joint errors, and no other key figure than coverage."""
    values = np.array(errors)
    summary = statistics(values)
    return result(
        name,
        1.0,
        metrics={"coverage": 1.0, "joint_error_mm": summary},
        distributions={"joint_error_mm": distribution(values, summary)},
        **changes,
    )


def test_a_set_is_compared_result_by_result_and_together(tmp_path: Path) -> None:
    path = stored_set(tmp_path, with_errors("a", [10.0] * 99), with_errors("b", [2.0]))
    check = checked(path, with_errors("b", [8.0]), with_errors("a", [10.0] * 99))
    failed = [outcome for outcome in check.outcomes if outcome.failed]
    assert {(one.result, one.title) for one in failed} == {
        ("b", "baseline: joint_error_mm.mean"),
        ("b", "baseline: joint_error_mm.p95"),
    }
    of_all = [outcome for outcome in check.outcomes if outcome.result == "pooled"]
    assert {one.title for one in of_all} == {
        "baseline: pooled.coverage",
        "baseline: pooled.joint_error_mm.mean",
        "baseline: pooled.joint_error_mm.p95",
    }
    assert check.notes == () and set(check.matched) == {"a", "b", "pooled"}


def test_all_together_fail_where_each_alone_passes_only_by_what_is_pooled(tmp_path: Path) -> None:
    """Frames move from the good recording to the bad one: each is as good as before, all together are not."""
    path = stored_set(tmp_path, with_errors("good", [1.0] * 90), with_errors("bad", [20.0] * 10))
    check = checked(path, with_errors("good", [1.0] * 10), with_errors("bad", [20.0] * 90))
    assert {outcome.result for outcome in check.outcomes if outcome.failed} == {"pooled"}


def test_new_results_are_told_and_missing_ones_fail(tmp_path: Path) -> None:
    old = [with_errors(name, [error]) for name, error in (("a", 1.0), ("b", 2.0), ("gone", 3.0))]
    now = [with_errors(name, [error]) for name, error in (("a", 1.0), ("b", 2.0), ("new", 90.0))]
    check = checked(stored_set(tmp_path, *old), *now)
    (line,) = [outcome.line for outcome in check.outcomes if outcome.failed]
    assert line.startswith("gone: gate 'baseline' could not be evaluated: result of the baseline is missing")
    assert check.notes == (
        "1 new result, not compared: new",
        "pooled: compared by means and coverage over the 2 results in the baseline",
    )


def test_sets_that_differ_are_compared_by_the_frames_of_what_both_have(tmp_path: Path) -> None:
    path = stored_set(
        tmp_path, with_errors("a", [1.0] * 9), with_errors("b", [11.0]), with_errors("c", [99.0])
    )
    now = [with_errors("a", [1.0] * 9), with_errors("b", [21.0]), with_errors("d", [500.0])]
    check = checked(path, *now)
    (mean,) = [one for one in check.outcomes if one.title == "baseline: pooled.joint_error_mm.mean"]
    assert mean.figure == pytest.approx((9 * 1.0 + 21.0) / 10) and mean.failed
    assert "(baseline 2, " in mean.gate
    assert not any(one.title == "baseline: pooled.joint_error_mm.p95" for one in check.outcomes)


def test_a_set_without_any_result_of_the_baseline_fails(tmp_path: Path) -> None:
    check = checked(stored_set(tmp_path, measured("a"), measured("b")), measured("x"), measured("y"))
    assert [one.result for one in check.outcomes if one.failed] == ["x", "y"]


def test_a_baseline_of_before_errors_were_pooled_serves(tmp_path: Path) -> None:
    old = [with_errors(name, [error]) for name, error in (("a", 1.0), ("b", 2.0))]
    path = tmp_path / "baseline.json"
    report = json.loads(json_report(old, OPTIONS, pools=make_pools(old, {})))
    report["pooled"] = [{**one, "metrics": {"coverage": {"value": 1.0}}} for one in report["pooled"]]
    path.write_text(json.dumps(report))
    check = checked(path, with_errors("a", [1.0]), with_errors("b", [9.0]))
    assert ("pooled", True) in {(one.result, one.failed) for one in check.outcomes}


@pytest.mark.parametrize("number", ["1" + "0" * 400, "true", '"7"', "null", "[1]"])
def test_what_is_no_number_in_a_baseline_is_no_figure(tmp_path: Path, number: str) -> None:
    path = stored_set(tmp_path, with_errors("a", [1.0]), with_errors("b", [1.0]))
    path.write_text(path.read_text().replace('"mean": 1.0', f'"mean": {number}'))
    check = checked(path, with_errors("a", [1.0]), with_errors("b", [1.0]))
    assert not any("mean" in one.title for one in check.outcomes)
