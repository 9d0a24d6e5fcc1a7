"""What gates, a baseline and results say, as Markdown: the summary of a job, as GitHub and GitLab show it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.gates import GateOutcome, gates_line
from posetrack_cli.evaluation.reports.row_table import MOST_SHOWN, NEW, shown_change, total_lines
from posetrack_cli.evaluation.reports.table import ABSENT, shown
from posetrack_cli.evaluation.rows import ResultRow, ResultSet, heading
from posetrack_cli.losses import loss_line
from posetrack_cli.text import one_line

MOST_FAILED = 100
"""Failed gates that are listed: a summary of GitHub's holds a megabyte."""


def markdown_report(
    sets: Sequence[ResultSet],
    outcomes: Sequence[GateOutcome] = (),
    notes: Sequence[str] = (),
    most: int = MOST_SHOWN,
) -> str:
    """Return a summary: what failed, all results together, and each, with changes against the baseline.

    Names of results stand as code, so that nothing in them is formatted, links or mentions anybody.

    Args:
        sets: the results.
        outcomes: of gates and a baseline.
        notes: what limits the comparison with the baseline.
        most: how many results are listed, the worst; 0 for all.
    """
    failed = [one for one in outcomes if one.failed]
    lines = [f"## {_heading_of(sets, outcomes, failed)}", ""]
    if failed:
        rows = [_failure(one) for one in failed[:MOST_FAILED]]
        lines += _table(("failed gate", "result", "why"), rows, numbers=False)
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
    why = one.reason if one.figure is not None else f"cannot be judged: {one.reason}"
    return code(one.gate), code(one.result), code(why)


def _totals(results: ResultSet) -> Iterator[str]:
    """The figures of all together, a line each."""
    row = results.total
    figures = [
        figure
        for figure in dict.fromkeys((*results.figures, *results.further))
        if row.value(figure) is not None
    ]
    columns = ("figure", "now", *(("baseline", "change") if row.earlier is not None else ()))
    if figures:
        yield from _table(columns, [(code(figure), *_now_and_then(row, figure)) for figure in figures])
    yield from (f"- {code(line)}" for line in total_lines(results))
    yield ""


def _now_and_then(row: ResultRow, figure: str) -> tuple[str, ...]:
    now, change = row.value(figure), row.change(figure)
    cells = (ABSENT if now is None else shown(now),)
    if row.earlier is None:
        return cells
    then = ABSENT if now is None or change is None else shown(now - change)
    return (*cells, then, shown_change(row, figure))


def _heading(results: ResultSet, most: int) -> str:
    count = len(results.rows)
    return f"The {most} worst of {count} results" if most and count > most else "Results, worst first"


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
    told = change not in (ABSENT, "0") and (change != NEW or figure == results.worst_by)
    return f"{text} ({change})" if told else text


def _losses(evaluations: Iterable[Evaluation]) -> list[str]:
    lines = [f"- {code(one.name)}: {code(loss_line(one.losses))}" for one in evaluations if one.losses]
    more = [f"- and {len(lines) - MOST_FAILED} more"] if len(lines) > MOST_FAILED else []
    return ["### Measured over what can be read", "", *lines[:MOST_FAILED], *more] if lines else []


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]], numbers: bool = True) -> list[str]:
    """A table whose columns but the first are numbers, or none."""
    sign = " ---: |" if numbers else " --- |"
    lines = [f"| {' | '.join(columns)} |", f"| --- |{sign * (len(columns) - 1)}"]
    return [*lines, *(f"| {' | '.join(cells)} |" for cells in rows), ""]


def code(text: str) -> str:
    """Return text as code, also in a table: whatever it holds, it is shown and not obeyed."""
    shown_text = one_line(text).replace("|", "\\|")
    runs = [len(run) for run in re.findall("`+", shown_text)]
    fence = "`" * (max(runs, default=0) + 1)
    padding = " " if shown_text.startswith("`") or shown_text.endswith("`") else ""
    return f"{fence}{padding}{shown_text}{padding}{fence}" if shown_text.strip() else "` `"
