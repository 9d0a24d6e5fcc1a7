"""The summary of a job, read as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from markdown_it.token import Token

from posetrack_cli.evaluation.judging.gates import check_gates, parse_gate
from posetrack_cli.evaluation.reports.writing import MOST_FAILED, code, markdown_report
from posetrack_cli.text import one_line
from support.html import NASTY
from support.rows import Before, result, result_set


def parsed(text: str) -> list[Token]:
    return MarkdownIt("commonmark", {"html": True}).enable("table").parse(text)


def tables(text: str) -> list[list[list[str]]]:
    """Every table as rows of the plain text of its cells."""
    found: list[list[list[str]]] = []
    for token, inner in zip(parsed(text), parsed(text)[1:], strict=False):
        if token.type == "table_open":
            found.append([])
        elif token.type == "tr_open":
            found[-1].append([])
        elif token.type in ("td_open", "th_open"):
            found[-1][-1].append("".join(one.content for one in inner.children or []))
    return found


def kinds(tokens: Sequence[Token]) -> set[str]:
    return {one.type for token in tokens for one in (token, *(token.children or []))}


def test_what_failed_stands_first_then_the_total_then_each_result() -> None:
    members = [result("a", 2.0), result("b", 8.0)]
    outcomes = check_gates([parse_gate("joint_error_mm.mean > 5")], members)
    found = result_set(members, outcomes, {"a": Before(1.5), "b": Before(8.0), "pooled": Before(4.0)})
    text = markdown_report([found], outcomes, ["1 result is new"])
    failed, totals, rows = tables(text)
    assert text.startswith("## \u274c posetrack eval: 1 of 2 gates failed, 2 results\n")
    assert failed[1:] == [["joint_error_mm.mean > 5", "b", "joint_error_mm.mean is 8"]]
    assert ["joint_error_mm.mean", "5", "4", "+1"] in totals
    assert [row[0] for row in rows] == ["result", "b", "a"]
    assert rows[2][3] == "2 (+0.5000)" and rows[1][3] == "8" and rows[1][-1] == "1"
    assert "1 result is new" in text


def test_gates_that_passed_and_results_alone() -> None:
    members = [result("a", 2.0)]
    outcomes = check_gates([parse_gate("coverage < 0.5")], members)
    assert markdown_report([result_set(members, outcomes)], outcomes).startswith(
        "## \u2705 posetrack eval: all 1 gates passed, 1 result\n"
    )
    assert markdown_report([result_set(members)]).startswith("## posetrack eval: 1 result\n")


def test_long_lists_are_cut_and_say_so() -> None:
    members = [result(f"r{place}", float(place + 1)) for place in range(MOST_FAILED + 7)]
    outcomes = check_gates([parse_gate("coverage == 1")], members)
    text = markdown_report([result_set(members, outcomes)], outcomes, most=5)
    failed, _, rows = tables(text)
    assert len(failed) == MOST_FAILED + 1 and "7 more failed" in text
    assert len(rows) == 6 and f"Worst 5 of {len(members)} results" in text


def test_hostile_names_are_shown_and_not_obeyed() -> None:
    names = [
        NASTY,
        "a|b",
        "`x`",
        "``",
        "[l](http://evil)",
        "![i](x)",
        "@me #1",
        "\x1b[31m\nnew",
        "\\",
        "a\\|b",
    ]
    members = [result(name, float(place + 1)) for place, name in enumerate(reversed(names))]
    outcomes = check_gates([parse_gate("coverage == 1")], members)
    text = markdown_report([result_set(members, outcomes)], outcomes, [f"new: {name}" for name in names])
    tokens = parsed(text)
    assert not kinds(tokens) & {"html_inline", "html_block", "link_open", "image", "em_open", "strong_open"}
    _, _, rows = tables(text)
    assert {len(row) for row in rows} == {len(rows[0])}
    assert [row[0] for row in rows[1:]] == [one_line(name) for name in names]


@given(st.text(st.characters(), min_size=1))
def test_code_shows_any_text_as_it_is(name: str) -> None:
    (_, inline, _), *_ = [parsed(code(name))]
    (only,) = inline.children
    assert only.type == "code_inline"
    shown = one_line(name).replace("|", "\\|")  # a pipe is escaped for tables, where the sign is taken off
    assert only.content.strip() == shown.strip()


def test_without_a_total_the_reason_is_told() -> None:
    same = [result(name, 2.0, run={"input.sha256": "one"}) for name in "ab"]
    text = markdown_report([result_set(same)])
    assert "- `no total for frames, coverage, " in text and len(tables(text)) == 1
