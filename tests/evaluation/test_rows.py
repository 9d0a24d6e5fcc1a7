"""Many results as rows: their order, their columns, their total, and the table of text."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.evaluation.judging.gates import check_gates, parse_gate
from posetrack_cli.evaluation.judging.rows import GateReport, heading, result_sets, worst_first
from posetrack_cli.evaluation.measuring.pooling import make_pools
from posetrack_cli.evaluation.reading.tracks import Coverage
from posetrack_cli.evaluation.reports.report_files import csv_rows
from posetrack_cli.evaluation.reports.table import MOST_LINES, fewer, row_lines, row_table, total_lines
from support.html import head_evaluation
from support.rows import Before, result, result_set


def test_the_worst_stands_first_and_what_cannot_be_measured_before_it() -> None:
    empty = result("empty", 1.0, metrics={}, coverage=Coverage(0, 0, 0, 0, 0, 0, 0, True, 0))
    blind = result("blind", 1.0, metrics={"coverage": 1.0}, absent={"joint_error_mm": "no truth"})
    lost = replace(blind, name="lost", coverage=Coverage(4, 1, 3, 0, 0, 0, 0, False, 0))
    members = [result("good", 2.0), blind, result("bad", 9.0), lost, empty, result("fair", 5.0)]
    names = [row.name for row in result_set(members).rows]
    assert names == ["empty", "lost", "blind", "bad", "fair", "good"]
    assert [one.name for one in worst_first([result_set(members)])] == names


def test_the_columns_are_those_that_a_result_has() -> None:
    found = result_set([result("a", 2.0), result("b", 3.0)])
    assert found.figures == ("frames", "coverage", "joint_error_mm.mean", "joint_error_mm.p95")
    assert found.worst_by == "joint_error_mm.mean"
    blind = {
        "metrics": {"coverage": 1.0, "frames": 4.0, "jitter_mm": result("c", 1.0).metrics["joint_error_mm"]}
    }
    unknown = result_set([result(name, 1.0, **blind) for name in "ab"])
    assert unknown.figures == ("frames", "coverage", "jitter_mm.mean") and unknown.worst_by == "coverage"


def test_hands_and_heads_are_sets_of_their_own() -> None:
    members = [result("a", 2.0), head_evaluation(name="head")]
    sets = result_sets(members, make_pools(members, {}), GateReport())
    assert [(one.title, [row.name for row in one.rows]) for one in sets] == [
        ("hand", ["a"]),
        ("head", ["head"]),
    ]


def test_a_table_has_a_row_for_each_and_a_total_of_all_frames() -> None:
    members = [result("a", 2.0), result("b", 8.0)]
    outcomes = check_gates([parse_gate("joint_error_mm.mean > 5")], members)
    table = row_table(result_set(members, outcomes, {"a": Before(1.5), "b": Before(8.0)}))
    assert table.columns == ("frames", "coverage", "joint error", "change", "joint error", "gates")
    (section,) = table.sections
    below, first, second, total = section.rows
    assert below.cells == ("", "", "mean, mm", "mm", "p95, mm", "failed")
    assert (first.label, first.cells[2:4], first.cells[-1]) == ("b", ("8", "0"), "1")
    assert (second.label, second.cells[2:4], second.cells[-1]) == ("a", ("2", "+0.5000"), "0")
    p95 = np.percentile([1.0, 1.5, 2.5, 3.0, 4.0, 6.0, 10.0, 12.0], 95)
    assert total.label == "TOTAL of 2" and total.cells[:4] == ("8", "1", "5", "-")
    assert float(total.cells[4]) == pytest.approx(p95, abs=0.005)  # two digits are shown
    assert len({len(row.cells) for row in section.rows} | {len(table.columns)}) == 1


def test_a_result_that_the_baseline_has_not_is_new() -> None:
    table = row_table(result_set([result("a", 2.0), result("b", 8.0)], earlier={"a": Before(2.0)}))
    cells = {row.label: row.cells[3] for row in table.sections[0].rows}
    assert cells["b"] == "new" and cells["a"] == "0" and cells["TOTAL of 2"] == "-"


def test_as_many_rows_as_are_asked_for_are_shown_and_the_rest_is_told() -> None:
    found = result_set([result(f"r{place}", float(place + 1)) for place in range(9)])
    labels = [row.label for row in row_table(found, 3).sections[0].rows]
    assert labels == ["", "r8", "r7", "r6", "TOTAL of 9"]
    assert any(line.startswith("showing the worst 3 of 9 results") for line in row_lines([found], 3))
    assert len(row_table(found, 0).sections[0].rows) == 11
    assert not any("are shown" in line for line in row_lines([found], 0))


def test_without_a_total_the_reason_is_told() -> None:
    same = [result(name, 2.0, run={"input.sha256": "one"}) for name in "ab"]
    found = result_set(same)
    assert set(row_table(found).sections[0].rows[-1].cells) == {"-"}
    (line,) = total_lines(found)
    assert line.startswith(
        "no total for frames, coverage, joint_error_mm.mean, joint_error_mm.p95: a and b are"
    )
    assert line in row_lines([found])


def test_a_column_that_one_lacks_has_no_total_and_says_why() -> None:
    blind = result("b", 1.0, metrics={"coverage": 1.0}, absent={"joint_error_mm": "no truth"})
    found = result_set([result("a", 2.0), replace(blind, distributions={})])
    assert row_table(found).sections[0].rows[-1].cells == ("8", "1", "-", "-")
    assert total_lines(found) == ["no total for joint_error_mm.mean, joint_error_mm.p95: b: no truth"]


def test_of_many_lines_some_are_shown() -> None:
    assert fewer(["a"] * MOST_LINES) == ["a"] * MOST_LINES
    many = fewer([str(place) for place in range(100)])
    assert len(many) == MOST_LINES and many[-1].startswith(f"{100 - MOST_LINES + 1} more notes")


def test_csv_has_a_line_for_each_result_and_the_total() -> None:
    blind = result("blind", 1.0, metrics={"coverage": 0.5, "frames": 4.0}, absent={"joint_error_mm": "no"})
    blind = replace(blind, distributions={})
    members = [result("a", 2.0), result('b,"\n', 8.0), blind]
    header, *lines = csv.reader(csv_rows([result_set(members)]).splitlines(keepends=True))
    assert {len(line) for line in lines} == {len(header)} and len(set(header)) == len(header)
    table = {line[0]: dict(zip(header, line, strict=True)) for line in lines}
    assert list(table) == ["blind", 'b,"\\n', "a", "pooled"]
    assert float(table["a"]["joint_error_mm.mean"]) == 2.0 and table["blind"]["joint_error_mm.mean"] == ""
    assert table["pooled"]["frames"] == "12.0" and table["pooled"]["joint_error_mm.mean"] == ""


def test_headings_are_two_short_lines() -> None:
    assert heading("joint_error_mm.p95") == ("joint error", "p95, mm")
    assert heading("frames_wrong") == ("wrong", "frames") and heading("coverage") == ("coverage", "")
