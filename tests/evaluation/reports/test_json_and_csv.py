"""JSON and CSV of evaluations, and tables of comparisons."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.evaluation.judging.comparing import compare, compare_groups
from posetrack_cli.evaluation.judging.gates import check_gates, parse_gate
from posetrack_cli.evaluation.measuring.evaluation import Statistics, statistics
from posetrack_cli.evaluation.measuring.pooling import make_pools
from posetrack_cli.evaluation.reports.report_files import FORMAT, HEADER, csv_report, json_report
from posetrack_cli.evaluation.reports.table import comparison_lines, comparison_tables, shown_p
from posetrack_cli.losses import Loss
from support.evaluation import hand_evaluation

NAN = float("nan")
OPTIONS = {"tolerance_ms": 5.0, "align": "none"}


def with_run(name: str, recording: str = "aa", **changes: object):
    return hand_evaluation(name, 120, run={"input.sha256": recording, "seed": "1"}, **changes)


def loaded(*evaluations, **more):
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    return json.loads(json_report(evaluations, OPTIONS, **more), parse_constant=refuse)


def test_json_holds_everything() -> None:
    one = with_run("a", notes=("a note",), losses=(Loss("damaged chunks", 1, "byte 9"),))
    report = loaded(one)
    assert report["format"] == FORMAT == "posetrack.eval/1"
    assert report["options"] == OPTIONS
    (result,) = report["results"]
    figures = one.metrics["joint_error_mm"]
    assert isinstance(figures, Statistics)
    assert result["metrics"]["joint_error_mm"] == {
        "unit": "mm",
        "mean": figures.mean,
        "sd": figures.sd,
        "median": figures.median,
        "p95": figures.p95,
        "max": figures.max,
        "p5": figures.p5,
        "count": figures.count,
    }
    assert result["metrics"]["coverage"] == {"unit": "", "value": 1.0}
    assert list(result["metrics"]) == list(one.metrics)
    assert result["coverage"]["frames"] == 120 and result["coverage"]["share"] == 1.0
    assert result["absent"] == one.absent and result["run"] == one.run
    assert result["notes"] == ["a note"]
    assert result["losses"] == [{"what": "damaged chunks", "count": 1, "first": "byte 9"}]
    assert one.curve is not None
    assert result["curve"]["share"] == one.curve.share.tolist()
    assert (result["name"], result["file"], result["subject"]) == ("a", "a.mcap", "hand")


def test_what_json_cannot_hold_is_null() -> None:
    metrics = {"joint_error_mm": Statistics(NAN, 0.0, NAN, NAN, math.inf, NAN, 0), "coverage": NAN}
    result = loaded(hand_evaluation("a", metrics=metrics, curve=None))["results"][0]
    assert result["metrics"]["coverage"]["value"] is None
    assert result["metrics"]["joint_error_mm"]["mean"] is result["metrics"]["joint_error_mm"]["max"] is None
    assert result["curve"] is None


def test_json_has_gates_and_comparison() -> None:
    a, b = with_run("a"), with_run("b", error_mm=9.0)
    comparison = compare([a, b])
    gates = check_gates([parse_gate("coverage < 0.9"), parse_gate("nees.mean > 5")], [a])
    report = loaded(a, b, comparison=comparison, gates=gates)
    assert comparison is not None
    difference = report["comparison"]["differences"][0]
    expected = comparison.differences[0]
    assert (difference["figure"], difference["first"], difference["second"]) == ("joint_error_mm", "a", "b")
    assert difference["low"] == expected.paired.low and difference["count"] == 4
    assert [(gate["failed"], gate["figure"]) for gate in report["gates"]] == [(False, 1.0), (True, None)]


def test_json_has_what_confidence_says_and_the_pools() -> None:
    a, b = with_run("a"), with_run("b", recording="bb", error_mm=9.0)
    pools = make_pools([a, b], {})
    report = loaded(a, replace(b, judged=None), pools=pools)
    told, none = (result["honesty"] for result in report["results"])
    assert none is None and a.judged is not None
    assert told["right_if"] == a.judged.right_if and told["far_if"] == a.judged.far_if
    bins = told["reliability"]
    assert [one["count"] for one in bins] == [0, 0, 0, 0, 0, 0, 30, 0, 90, 0]
    assert (bins[6]["low"], bins[6]["high"], bins[6]["confidence"]) == (0.6, 0.7, pytest.approx(0.65))
    assert bins[8]["right"] == a.judged.right[a.judged.confidence == 0.85].mean() and bins[0]["right"] is None
    assert told["roc"]["confidence"] == [None, 0.85, 0.65]  # nothing is above all of them
    assert told["roc"]["right_kept"][-1] == told["roc"]["wrong_kept"][-1] == 1.0
    (pooled,) = report["pooled"]
    assert (pooled["name"], pooled["results"], pooled["subject"]) == ("pooled", ["a", "b"], "hand")
    assert pooled["metrics"]["frames_wrong"]["value"] == pools[0].metrics["frames_wrong"]
    assert [one["count"] for one in pooled["honesty"]["reliability"]][6::2] == [60, 180]
    assert pooled["coverage"]["frames"] == 240 and pooled["absent"] == dict(pools[0].absent)


def test_the_same_results_give_the_same_bytes() -> None:
    assert json_report([with_run("a")], OPTIONS) == json_report([with_run("a")], OPTIONS)


def test_names_of_any_script_stay_readable() -> None:
    text = json_report([with_run("\u624b")], OPTIONS)
    assert "\u624b" in text
    assert json.loads(text)["results"][0]["name"] == "\u624b"


def test_a_name_of_bytes_that_are_no_text_is_still_json() -> None:
    one = replace(with_run("a"), name="a\udcff")
    text = json_report([one], OPTIONS).encode("utf-8", "backslashreplace")
    assert json.loads(text)["results"][0]["name"] == "a\udcff"


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_csv_has_one_figure_a_line() -> None:
    one = with_run('a,"b"')
    lines = rows(csv_report([one]))
    assert tuple(lines[0]) == HEADER
    found = {(r["metric"], r["part"], r["statistic"]): (float(r["value"]), r["unit"]) for r in lines}
    tip = one.metrics["joint_error_mm.index_tip"]
    assert isinstance(tip, Statistics)
    assert found["joint_error_mm", "index_tip", "p95"] == (tip.p95, "mm")
    assert found["joint_error_mm", "index_tip", "count"] == (120.0, "")
    assert found["coverage", "", ""] == (1.0, "")
    assert {r["result"] for r in lines} == {'a,"b"'}
    statistics_found = sum(isinstance(value, Statistics) for value in one.metrics.values())
    assert len(lines) == 7 * statistics_found + (len(one.metrics) - statistics_found)


def test_csv_has_lines_of_pools_of_several_results() -> None:
    a, b = with_run("a"), with_run("b", recording="bb")
    lines = rows(csv_report([a, b], pools=make_pools([a, b], {})))
    assert ["pooled", "frames_wrong", "", "", "0.5", ""] in [list(line.values()) for line in lines]
    assert {line["result"] for line in rows(csv_report([a], pools=make_pools([a], {})))} == {"a"}


def test_csv_shows_what_is_no_number() -> None:
    lines = rows(csv_report([hand_evaluation("a", metrics={"gaps": NAN, "largest_gap_s": math.inf})]))
    assert [(r["metric"], r["value"]) for r in lines] == [("gaps", "nan"), ("largest_gap_s", "inf")]


def test_csv_has_the_differences_too() -> None:
    comparison = compare_groups({"rbpf": [with_run("a")], "pf": [with_run("b", error_mm=9.0)]})
    lines = [r for r in rows(csv_report([], comparison)) if r["metric"] == "joint_error_mm"]
    assert {r["result"] for r in lines} == {"pf - rbpf"}
    found = {r["statistic"]: r["value"] for r in lines}
    assert float(found["mean.difference"]) == comparison.differences[1].paired.difference
    assert found["mean.pairs"] == "1" and found["mean.low"] == "nan"


def test_the_table_of_differences() -> None:
    values = np.zeros(120)
    a = with_run("a", series={"joint_error_mm": values + 5.0})
    b = with_run("b", series={"joint_error_mm": values + 7.5})
    comparison = compare([a, b])
    assert comparison is not None
    (table,) = comparison_tables(comparison)
    assert table.title == "b - a"
    assert table.columns == ("difference", "95 % CI low", "high", "p", "pairs")
    (row,) = table.sections[0].rows
    assert (row.label, row.cells) == ("joint_error_mm", ("2.500", "2.500", "2.500", "0.12", "4"))
    lines = comparison_lines(comparison)
    assert lines[0].startswith("pairs: one second of a recording; p: two-sided Wilcoxon signed-rank test")
    assert lines[1] == "b - a: too few data: p >= 0.125 with 4 differing pairs"


def test_one_pair_has_a_difference_and_no_interval() -> None:
    comparison = compare_groups({"rbpf": [with_run("a")], "pf": [with_run("b", error_mm=9.0)]})
    _, differences = comparison_tables(comparison)
    cells = {row.label: row.cells for row in differences.sections[0].rows}["joint_error_mm.mean"]
    assert float(cells[0]) > 0 and cells[1:] == ("-", "-", "1", "1")
    assert any(
        "too few data: p >= 1 with 1 differing pair: " in line for line in comparison_lines(comparison)
    )


def test_differences_of_parts_are_shown_when_asked_for() -> None:
    fine, coarse = np.linspace(1.0, 2.0, 120), np.linspace(3.0, 5.0, 120)
    names = ("finger_error_mm", "finger_error_mm.thumb")
    a = with_run("a", series=dict.fromkeys(names, fine))
    b = with_run("b", series={names[0]: coarse, names[1]: fine})
    comparison = compare([a, b])
    assert comparison is not None
    labels = [
        [row.label for row in comparison_tables(comparison, parts=parts)[0].sections[0].rows]
        for parts in (False, True)
    ]
    assert labels == [["finger_error_mm"], list(names)]
    assert comparison_lines(comparison, parts=True)[1:3] == [
        "b - a: too few data: p >= 0.125 with 4 differing pairs: finger_error_mm",
        "b - a: no pair differs: finger_error_mm.thumb",
    ]


def test_groups_have_a_table_of_their_own() -> None:
    def of(name: str, recording: str, error: float):
        metrics = {"coverage": 1.0, "joint_error_mm": statistics([error])}
        return with_run(name, recording, metrics=metrics, absent={})

    comparison = compare_groups(
        {"rbpf": [of("a", "p", 4.0), of("b", "q", 6.0)], "pf": [of("c", "p", 8.0), of("d", "q", 8.0)]}
    )
    groups, differences = comparison_tables(comparison)
    assert groups.columns == ("rbpf", "pf")
    shown = {row.label: row.cells for row in groups.sections[0].rows}
    assert shown["results"] == ("2", "2")
    assert shown["joint_error_mm.mean"] == ("5 \u00b1 1", "8 \u00b1 0")
    assert list(shown)[1] == "coverage"
    row = differences.sections[0].rows[1]
    assert row.cells[0] == "3" and row.cells[4] == "2"


@pytest.mark.parametrize(
    ("p", "text"), [(1.0, "1"), (0.0312, "0.031"), (0.0001, "0.0001"), (9e-5, "<0.0001")]
)
def test_p_values(p: float, text: str) -> None:
    assert shown_p(p) == text
