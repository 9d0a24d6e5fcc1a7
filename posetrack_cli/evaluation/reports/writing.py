"""Report output: terminal tables, JUnit XML, Markdown, and the texts of all reports."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import get_terminal_size
from typing import TextIO
from unicodedata import combining, east_asian_width
from xml.etree import ElementTree as ET

from posetrack_cli.evaluation.html.rows_page import RowsPage
from posetrack_cli.evaluation.judging.assessment import Assessment, stated_options
from posetrack_cli.evaluation.judging.gates import GateOutcome, gates_line
from posetrack_cli.evaluation.judging.rows import ResultRow, ResultSet, heading, worst_first
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.reports.report_files import csv_report, csv_rows, curve_report, json_report
from posetrack_cli.evaluation.reports.table import (
    ABSENT,
    MOST_SHOWN,
    NEW,
    Table,
    shown,
    shown_change,
    total_lines,
)
from posetrack_cli.losses import loss_line
from posetrack_cli.text import one_line


@dataclass(frozen=True)
class Reports:
    """Paths of the text reports; None for reports that are not requested.

    Attributes:
        json, csv, curve: see ``report_files``.
        junit: see ``junit``.
        markdown: see ``markdown``.
    """

    json: Path | None = None
    csv: Path | None = None
    curve: Path | None = None
    junit: Path | None = None
    markdown: Path | None = None


def report_texts(
    found: Assessment, options: EvalOptions, reports: Reports, most: int = MOST_SHOWN
) -> Iterator[tuple[Path, str]]:
    """Yield path and text of each requested report.

    Args:
        found: the assessment.
        options: evaluation options.
        reports: paths of the reports.
        most: maximum number of results in the Markdown report, worst first; 0 for all.

    Raises:
        UsageError: a curve is requested, and no result has one.
    """
    if reports.json is not None:
        shown = worst_first(found.sets) if found.rows else found.evaluations
        stated = stated_options(options)
        text = json_report(shown, stated, found.comparison, found.outcomes, found.pools, rows=found.rows)
        yield reports.json, text
    if reports.csv is not None:
        in_columns = csv_report(found.evaluations, found.comparison, found.pools) if not found.rows else ""
        yield reports.csv, csv_rows(found.sets) if found.rows else in_columns
    if reports.curve is not None:
        yield reports.curve, curve_report(found.evaluations)
    if reports.junit is not None:
        yield reports.junit, junit_report(found.outcomes)
    if reports.markdown is not None:
        yield reports.markdown, markdown_report(found.sets, found.outcomes, found.notes, most)


def rows_page_of(found: Assessment) -> RowsPage:
    """Return the content of the HTML page with a row per result."""
    return RowsPage(found.sets, found.outcomes, found.notes, found.comparison)


# JUnit XML, which GitLab, Jenkins and GitHub actions display as test results


SUITE = "posetrack eval"
# Characters that XML 1.0 forbids, C1 controls, and lone surrogates, which stand for bytes that are not UTF-8.
_FORBIDDEN = re.compile("[^\t\n\x20-\x7e\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_report(outcomes: Sequence[GateOutcome], suite: str = SUITE) -> str:
    """Return a JUnit document with one test case per outcome.

    ``classname`` is the name of the result, ``name`` the title of the gate, which does not change from run to
    run. The type of a failure is ``failed``, or ``not judged`` without a value. The document contains no
    times, so that equal outcomes give equal text.

    Args:
        outcomes: outcomes of gates and baselines.
        suite: name of the test suite.
    """
    counts = {"tests": str(len(outcomes)), "failures": str(sum(one.failed for one in outcomes))}
    counts |= {"errors": "0"}
    top = ET.Element("testsuites", {"name": _allowed(suite), **counts})
    tests = ET.SubElement(top, "testsuite", {"name": _allowed(suite), **counts, "skipped": "0"})
    for one in outcomes:
        names = {"classname": _allowed(one.result), "name": _allowed(one.title or one.gate)}
        test = ET.SubElement(tests, "testcase", names)
        if one.failed:
            kind = "not judged" if one.figure is None else "failed"
            failure = ET.SubElement(test, "failure", {"message": _allowed(one.reason), "type": kind})
            failure.text = _allowed(one.line)
    ET.indent(top, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(top, encoding="unicode") + "\n"


def _allowed(text: str) -> str:
    """Return text without forbidden characters."""
    return _FORBIDDEN.sub("", text)


# Tables on a terminal or in a pipe


PIPE_WIDTH = 1_000_000
"""Width without a terminal: tables are not wrapped."""
BETWEEN = 2
"""Spaces between columns."""

_BOLD = "\x1b[1m"
_BOLD_CYAN = "\x1b[1;36m"
_RESET = "\x1b[0m"


def print_tables(
    tables: Iterable[Table], lines: Iterable[str], file: TextIO, width: int | None = None
) -> None:
    """Print tables and the lines below them, with colours on a terminal.

    A table that is too wide is split into blocks of columns; nothing is truncated.

    Args:
        tables: tables to print.
        lines: closing lines.
        file: output stream.
        width: width in characters; defaults to that of the terminal, or no limit.
    """
    is_terminal = file.isatty()
    available = width or (get_terminal_size().columns if is_terminal else PIPE_WIDTH)
    coloured = is_terminal and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
    plain = (file.encoding or "utf-8").lower() not in ("utf-8", "utf8")  # no plus-minus sign
    for table in tables:
        rows = list(_rows(table, plain))
        widths = [max(map(_width, column)) for column in zip(*(texts for _, texts in rows), strict=True)]
        for piece in _pieces(widths, available):
            for style, texts in rows:
                line = _line([texts[at] for at in piece], [widths[at] for at in piece])
                file.write(f"{style}{line}{_RESET}\n" if coloured and style else f"{line}\n")
            file.write("\n")
    for line in lines:
        file.write(f"{_shown(line, plain)}\n")


def _rows(table: Table, plain: bool) -> Iterator[tuple[str, list[str]]]:
    """Yield style and texts of each row, the header first; all rows have the same number of texts."""
    rows = [(_BOLD, [table.title, *table.columns])]
    for section in table.sections:
        if section.title:
            rows.append((_BOLD_CYAN, [section.title, *[""] * len(table.columns)]))
        rows += [("", ["  " * row.indent + row.label, *row.cells]) for row in section.rows]
    for style, texts in rows:
        yield style, [_shown(text, plain) for text in texts]


def _pieces(widths: Sequence[int], limit: int) -> Iterator[list[int]]:
    """Yield the column indices of each block: the labels, and as many other columns as fit."""
    piece = [0]
    for at in range(1, len(widths)):
        if len(piece) > 1 and sum(widths[one] + BETWEEN for one in [*piece, at]) - BETWEEN > limit:
            yield piece
            piece = [0]
        piece.append(at)
    if len(piece) > 1:
        yield piece


def _line(texts: Sequence[str], widths: Sequence[int]) -> str:
    """Return a line with the label left-aligned and the other texts right-aligned."""
    gaps = [" " * (width - _width(text)) for text, width in zip(texts, widths, strict=True)]
    others = [" " * BETWEEN + gap + text for text, gap in zip(texts[1:], gaps[1:], strict=True)]
    return "".join([texts[0], gaps[0], *others]).rstrip()


def _width(text: str) -> int:
    """Return the width of a text on a terminal."""
    return sum(0 if combining(char) else 2 if east_asian_width(char) in "WF" else 1 for char in text)


def _shown(text: str, plain: bool) -> str:
    """Return text on one line without control characters, and without the sign +- if ``plain``."""
    safe = one_line(text).expandtabs()  # names come from files, which are untrusted
    return safe.replace("\u00b1", "+-") if plain else safe


# Markdown, as displayed in job summaries of GitHub and GitLab


MOST_FAILED = 100
"""Maximum number of failed gates in the report, as GitHub limits job summaries to 1 MiB."""


def markdown_report(
    sets: Sequence[ResultSet],
    outcomes: Sequence[GateOutcome] = (),
    notes: Sequence[str] = (),
    most: int = MOST_SHOWN,
) -> str:
    """Return the Markdown report: failed gates, pooled values and results, with changes to the baseline.

    Args:
        sets: the results.
        outcomes: outcomes of gates and baseline.
        notes: limitations of the comparison with the baseline.
        most: maximum number of results, worst first; 0 for all.
    """
    failed = [one for one in outcomes if one.failed]
    lines = [f"## {_heading_of(sets, outcomes, failed)}", ""]
    if failed:
        rows = [_failure(one) for one in failed[:MOST_FAILED]]
        lines += _table(("failed gate", "result", "reason"), rows, numbers=False)
        if len(failed) > MOST_FAILED:
            lines += [f"{len(failed) - MOST_FAILED} more failed.", ""]
    lines += [f"- {code(note)}" for note in notes] + ([""] if notes else [])
    for one in sets:
        title = f": {code(one.title)}" if one.title else ""
        if len(one.rows) > 1:
            lines += [f"### All {len(one.rows)} results{title}", "", *_totals(one)]
        lines += [f"### {_heading(one, most)}{title}", "", *_results(one, most)]
    lost = [row.measured for one in sets for row in one.rows]
    lines += _losses(of for of in lost if isinstance(of, Evaluation))
    return "\n".join(lines).rstrip("\n") + "\n"


def _heading_of(
    sets: Sequence[ResultSet], outcomes: Sequence[GateOutcome], failed: Sequence[GateOutcome]
) -> str:
    count = sum(len(one.rows) for one in sets)
    of = f"{count} result{'' if count == 1 else 's'}"
    if not outcomes:
        return f"posetrack eval: {of}"
    sign = "\u274c" if failed else "\u2705"
    return f"{sign} posetrack eval: {gates_line(outcomes)}, {of}"


def _failure(one: GateOutcome) -> tuple[str, ...]:
    why = one.reason if one.figure is not None else f"could not be evaluated: {one.reason}"
    return code(one.gate), code(one.result), code(why)


def _totals(results: ResultSet) -> Iterator[str]:
    """Yield the lines of the table of pooled values."""
    row = results.total
    figures = [
        figure
        for figure in dict.fromkeys((*results.figures, *results.further))
        if row.value(figure) is not None
    ]
    columns = ("metric", "value", *(("baseline", "change") if row.baseline is not None else ()))
    if figures:
        yield from _table(columns, [(code(figure), *_now_and_then(row, figure)) for figure in figures])
    yield from (f"- {code(line)}" for line in total_lines(results))
    yield ""


def _now_and_then(row: ResultRow, figure: str) -> tuple[str, ...]:
    now, change = row.value(figure), row.change(figure)
    cells = (ABSENT if now is None else shown(now),)
    if row.baseline is None:
        return cells
    then = ABSENT if now is None or change is None else shown(now - change)
    return (*cells, then, shown_change(row, figure))


def _heading(results: ResultSet, most: int) -> str:
    count = len(results.rows)
    return f"Worst {most} of {count} results" if most and count > most else "Results, worst first"


def _results(results: ResultSet, most: int) -> Iterator[str]:
    columns = ["result", *(" ".join(filter(None, heading(figure))) for figure in results.figures)]
    columns += ["failed"] if results.judged else []
    rows = []
    for one in results.rows[:most] if most else results.rows:
        cells = [code(one.name), *(_cell(one, figure, results) for figure in results.figures)]
        rows.append((*cells, *([str(one.failed)] if results.judged else [])))
    yield from _table(columns, rows)


def _cell(row: ResultRow, figure: str, results: ResultSet) -> str:
    value = row.value(figure)
    text = ABSENT if value is None else shown(value)
    if not results.compared or figure == "frames":
        return text
    change = shown_change(row, figure)
    # "new" is shown once per row, in the column that ranks the rows.
    has_change = change not in (ABSENT, "0") and (change != NEW or figure == results.worst_by)
    return f"{text} ({change})" if has_change else text


def _losses(evaluations: Iterable[Evaluation]) -> list[str]:
    lines = [f"- {code(one.name)}: {code(loss_line(one.losses))}" for one in evaluations if one.losses]
    more = [f"- and {len(lines) - MOST_FAILED} more"] if len(lines) > MOST_FAILED else []
    return ["### Unreadable data", "", *lines[:MOST_FAILED], *more] if lines else []


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]], numbers: bool = True) -> list[str]:
    """Return the lines of a table; with ``numbers``, all columns but the first are right-aligned."""
    sign = " ---: |" if numbers else " --- |"
    lines = [f"| {' | '.join(columns)} |", f"| --- |{sign * (len(columns) - 1)}"]
    return [*lines, *(f"| {' | '.join(cells)} |" for cells in rows), ""]


def code(text: str) -> str:
    """Return text as an inline code span, so that names from files are not interpreted as Markdown."""
    shown_text = one_line(text).replace("|", "\\|")
    runs = [len(run) for run in re.findall("`+", shown_text)]
    fence = "`" * (max(runs, default=0) + 1)
    padding = " " if shown_text.startswith("`") or shown_text.endswith("`") else ""
    return f"{fence}{padding}{shown_text}{padding}{fence}" if shown_text.strip() else "` `"
