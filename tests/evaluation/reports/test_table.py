"""Tables of evaluations: what stands in them, and how they reach a terminal, a pipe and a log."""

from __future__ import annotations

import io
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.evaluation.measuring.catalogue import CATALOGUE
from posetrack_cli.evaluation.measuring.evaluation import Statistics
from posetrack_cli.evaluation.measuring.measures import Metric
from posetrack_cli.evaluation.reading.alignment import JointOffsets
from posetrack_cli.evaluation.reports.table import Table, closing_lines, shown, tables
from posetrack_cli.evaluation.reports.writing import print_tables
from posetrack_cli.losses import Loss
from support.evaluation import hand_evaluation
from support.terminal import Terminal

FIGURES = Statistics(mean=8.25, sd=2.0, median=7.5, p95=12.0, max=30.0, p5=4.5, count=600)
OTHER = Statistics(mean=4.0, sd=1.0, median=3.5, p95=6.0, max=15.0, p5=2.25, count=600)
TWO = (("a", FIGURES), ("b", OTHER))
SIX = ("x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg")


def evaluation(name: str = "a", figures: Statistics = FIGURES, **changes: object):
    metrics = {
        "ms_per_frame": figures,
        "joint_error_mm": figures,
        "joint_error_mm.wrist": figures,
        "frames_within_20mm": 0.75,
        "coverage": 0.98,
    }
    return hand_evaluation(name, 30, **{"metrics": metrics, "absent": {}, **changes})


def head(name: str):
    metrics = {"coverage": 1.0, **{m: Statistics(i, i / 8, 0, 0, 9, 0, 3) for i, m in enumerate(SIX, 1)}}
    return hand_evaluation(name, 30, subject="head", metrics=metrics, absent={})


def rows(table: Table) -> dict[str, tuple[str, ...]]:
    return {row.label: row.cells for section in table.sections for row in section.rows}


def printed(made: list[Table], width: int | None = None, lines: tuple[str, ...] = ()) -> str:
    out = io.StringIO()
    print_tables(made, lines, out, width)
    return out.getvalue()


def test_one_result_has_a_column_for_each_statistic() -> None:
    (table,) = tables([evaluation()])
    assert table.columns == ("mean/value", "sd", "median", "p95", "max", "p5")
    assert rows(table) == {
        "coverage": ("0.9800", "", "", "", "", ""),
        "joint_error_mm": ("8.250", "2", "7.500", "12", "30", ""),
        "frames_within_20mm": ("0.7500", "", "", "", "", ""),
        "ms_per_frame": ("8.250", "2", "7.500", "12", "30", ""),
    }


@pytest.mark.parametrize("metric", [one for one in CATALOGUE if not one.scalar], ids=lambda one: one.name)
def test_the_5th_percentile_is_shown_where_small_is_bad(metric: Metric) -> None:
    low = metric.better == "higher"
    assert low == (metric.name in {"region_overlap", "confidence", "ess"})
    (table,) = tables([evaluation(metrics={metric.name: FIGURES})])
    assert rows(table)[metric.name][-1] == ("4.500" if low else "")
    (table,) = tables([evaluation(name, figures, metrics={metric.name: figures}) for name, figures in TWO])
    label, cells = (
        ("median / p5", ("7.500 / 4.500", "3.500 / 2.250"))
        if low
        else ("median / p95 / max", ("7.500 / 12 / 30", "3.500 / 6 / 15"))
    )
    assert rows(table)[label] == cells


def test_several_results_have_a_column_each() -> None:
    (table,) = tables([evaluation(), evaluation("b", OTHER)])
    assert table.columns == ("a", "b")
    lines = [(row.label, row.cells) for section in table.sections for row in section.rows]
    assert lines[:3] == [
        ("coverage", ("0.9800", "0.9800")),
        ("joint_error_mm", ("8.250 \u00b1 2", "4 \u00b1 1")),
        ("median / p95 / max", ("7.500 / 12 / 30", "3.500 / 6 / 15")),
    ]


def test_what_one_of_several_lacks_is_a_dash() -> None:
    (table,) = tables([evaluation(), evaluation("b", metrics={"coverage": 1.0})])
    assert rows(table)["joint_error_mm"][1] == rows(table)["frames_within_20mm"][1] == "-"


def test_coverage_comes_first_and_all_in_the_catalogue_s_order() -> None:
    every = {metric.name: 1.0 if metric.scalar else FIGURES for metric in reversed(CATALOGUE)}
    table = tables([evaluation(metrics=every)])[0]
    assert list(rows(table)) == [metric.name for metric in CATALOGUE]
    assert table.sections[0].title == "Coverage"


def test_parts_are_shown_when_asked_for_below_their_whole() -> None:
    (table,) = tables([evaluation()], parts=True)
    labels = list(rows(table))
    assert labels[labels.index("joint_error_mm") + 1] == "wrist"
    assert "wrist" not in rows(tables([evaluation()])[0])


def test_heads_have_the_thesis_s_table_too() -> None:
    _, table = tables([head("s1")])
    assert table.columns == ("x mm", "y mm", "z mm", "roll deg", "pitch deg", "yaw deg")
    assert rows(table) == {
        "mean": ("1", "2", "3", "4", "5", "6"),
        "sd": ("0.1250", "0.2500", "0.3750", "0.5000", "0.6250", "0.7500"),
    }
    _, table = tables([head("s1"), head("s2")])
    assert list(rows(table)) == ["s1 mean", "s1 sd", "s2 mean", "s2 sd"]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (1.0, "1"),
        (0.99999, "1.0000"),
        (0.98, "0.9800"),
        (12.345, "12.35"),
        (123.45, "123.5"),
        (99999.5, "100000"),
        (1234.5, "1234"),
        (0.0001234, "0.000123"),
        (-8.25, "-8.250"),
        (300.0, "300"),
        (math.nan, "nan"),
        (math.inf, "inf"),
    ],
)
def test_figures_have_four_digits(value: float, text: str) -> None:
    assert shown(value) == text


@given(st.floats(1e-3, 1e9))
def test_a_shown_figure_is_within_half_a_unit_of_its_fourth_digit(value: float) -> None:
    # four decimals at most: below 1 the last digit shown stands for 1e-4
    unit = max(10.0 ** (math.floor(math.log10(value)) - 3), 1e-4)
    assert abs(float(shown(value)) - value) <= 0.5 * unit * (1 + 1e-9)


def test_lines_below_say_what_holds_for_all_once() -> None:
    first = evaluation(absent={"nees": "no truth", "nees.x": "no truth", "residual_mm": "no recording"})
    second = evaluation("b", notes=("unfinished run",), losses=(Loss("damaged chunks", 2, "byte 7"),))
    assert closing_lines([first, second]) == [
        "renderer: llvmpipe",
        "a: not available (no truth): nees",
        "a: not available (no recording): residual_mm",
        "b: note: unfinished run",
        "b: lost data: damaged chunks: 2, first byte 7",
    ]


def test_what_holds_for_some_is_said_once_with_their_names() -> None:
    plain = evaluation("first")
    others = [evaluation(f"r{index}", absent={"nees": "no truth"}) for index in range(6)]
    assert closing_lines([plain, *others[:3]])[1:] == ["r0, r1, r2: not available (no truth): nees"]
    assert closing_lines([plain, *others])[1:] == ["r0, r1, r2 and 3 more: not available (no truth): nees"]


def test_a_part_that_is_absent_alone_is_said() -> None:
    line = closing_lines([evaluation(absent={"joint_error_mm.wrist": "never seen"}, run={})])
    assert line == ["not available (never seen): joint_error_mm.wrist"]


def test_one_result_fits_into_80_columns() -> None:
    every = {m.name: 1.0 if m.scalar else Statistics(*[9999.5] * 6, count=9) for m in CATALOGUE}
    text = printed(tables([evaluation("r", metrics=every)]))
    assert max(map(len, text.splitlines())) <= 80


def test_in_a_pipe_nothing_is_cut_broken_or_coloured() -> None:
    many = [evaluation(f"result-{index}") for index in range(40)]
    text = printed(tables(many), lines=("x" * 500,))
    assert "\x1b" not in text and "\u2026" not in text
    header = text.splitlines()[0].split()
    assert header == ["Results", *(one.name for one in many)]
    assert "x" * 500 in text


def test_on_a_terminal_columns_that_do_not_fit_go_below() -> None:
    many = [evaluation(f"result-{index}") for index in range(7)]
    text = printed(tables(many), width=80)
    assert max(map(len, text.splitlines())) <= 80
    assert [text.count(one.name) for one in many] == [1] * 7
    assert text.count("joint_error_mm") > 1


def test_on_a_narrow_terminal_no_figure_is_cut() -> None:
    text = printed(tables([evaluation("first result"), evaluation("second result")]), width=30)
    wide = printed(tables([evaluation("first result"), evaluation("second result")]))
    assert "\u2026" not in text
    assert set(text.split()) == set(wide.split())


def test_names_are_no_markup_and_may_be_of_any_script() -> None:
    text = printed(tables([evaluation("[red]x[/red] :smile: \u624b")]))
    assert "[red]x[/red] :smile: \u624b" in text


def test_columns_of_names_of_any_script_end_where_their_figures_do() -> None:
    """Chinese signs take two columns of a terminal, an accent of its own none."""
    wide, accented = 12 * "\u624b", 30 * "e\u0301"
    header, _, *below = printed(tables([evaluation(wide), evaluation(accented)])).splitlines()
    shown = [line for line in below if line.startswith("joint_error_mm ")]
    assert len(header) + len(wide) - accented.count("\u0301") == len(shown[0])


def test_an_output_without_plus_minus_gets_ascii() -> None:
    raw = io.BytesIO()
    out = io.TextIOWrapper(raw, encoding="ascii", errors="backslashreplace")
    print_tables(tables([evaluation(), evaluation("b")]), [], out)
    out.flush()
    assert b"8.250 +- 2" in raw.getvalue()


def test_colours_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    out = Terminal()
    print_tables(tables([evaluation()]), [], out, 80)
    assert out.getvalue().startswith("\x1b[1ma ") and "\x1b[1;36mCoverage\x1b[0m\n" in out.getvalue()
    for name, value in (("NO_COLOR", "1"), ("TERM", "dumb")):
        with monkeypatch.context() as patch:
            patch.setenv(name, value)
            print_tables(tables([evaluation()]), [], out := Terminal(), 80)
            assert out.getvalue() == printed(tables([evaluation()]))


def test_offsets_of_joints_have_a_table_of_their_own() -> None:
    offsets = JointOffsets(("wrist", "thumb_tip"), "bone", np.array([[3.0, -4.0, 0.0], [-0.04, 0.0, 12.06]]))
    (_, one) = tables([hand_evaluation("a", joint_offsets=offsets)])
    assert one.columns == ("x", "y", "z", "norm")
    assert [(row.label, row.cells) for row in one.sections[0].rows] == [
        ("wrist", ("3.0", "-4.0", "0.0", "5.0")),
        ("thumb_tip", ("0.0", "0.0", "12.1", "12.1")),
    ]
    fewer = replace(offsets, names=("wrist",), offsets=offsets.offsets[:1])
    evaluations = [
        hand_evaluation("a", joint_offsets=offsets),
        hand_evaluation("b"),
        hand_evaluation("c", joint_offsets=fewer),
    ]
    (_, several) = tables(evaluations)
    assert several.columns == ("a", "c")
    assert several.sections[0].rows[1].cells == ("0.0 0.0 12.1 12.1", "- - - -")
    assert len(tables([hand_evaluation("a")])) == 1
