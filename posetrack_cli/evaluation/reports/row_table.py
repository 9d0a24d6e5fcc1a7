"""Many results as a table of text: a row for each, the worst first, and one for all."""

from __future__ import annotations

from collections.abc import Sequence

from posetrack_cli.evaluation.figures import figure_of
from posetrack_cli.evaluation.pooling import Pool
from posetrack_cli.evaluation.reports.table import ABSENT, Row, Section, Table, shown
from posetrack_cli.evaluation.rows import ResultRow, ResultSet, heading

MOST_SHOWN = 50
"""Rows that are shown unless more are asked for."""
MOST_LINES = 20
"""Lines below the tables: every result may have some of its own."""
NEW = "new"
"""Of a result that the baseline has not."""


def row_table(results: ResultSet, most: int = MOST_SHOWN) -> Table:
    """Make the table of a set; headings take two lines, the second as the first row.

    Args:
        results: the set.
        most: how many results are shown, the worst; 0 for all.
    """
    headings = [heading(figure) for figure in results.figures]
    if results.compared and results.worst_by in results.figures:
        unit = heading(results.worst_by)[1].rpartition(", ")[2]
        headings.insert(results.figures.index(results.worst_by) + 1, ("change", unit))
    if results.judged:
        headings.append(("gates", "failed"))
    kept = results.rows[:most] if most else results.rows
    body = [Row("", tuple(below for _, below in headings))]
    body += [Row(one.name, _cells(one, results)) for one in kept]
    total = Row(f"TOTAL of {len(results.rows)}", _cells(results.total, results))
    title = f"Worst first{f': {results.title}' if results.title else ''}"
    return Table(title, tuple(above for above, _ in headings), (Section("", (*body, total)),))


def _cells(row: ResultRow, results: ResultSet) -> tuple[str, ...]:
    cells: list[str] = []
    for figure in results.figures:
        value = row.value(figure)
        cells.append(ABSENT if value is None else shown(value))
        if results.compared and figure == results.worst_by:
            cells.append(shown_change(row, figure))
    return (*cells, *([str(row.failed)] if results.judged else []))


def shown_change(row: ResultRow, figure: str) -> str:
    """Show by how much a figure changed, with its sign; a result that the baseline has not is new."""
    change = row.change(figure)
    if change is None:
        return NEW if row.earlier is None and not isinstance(row.measured, Pool) else ABSENT
    text = shown(abs(change))
    return "0" if text == "0" else f"{'-' if change < 0 else '+'}{text}"


def row_lines(sets: Sequence[ResultSet], most: int = MOST_SHOWN) -> list[str]:
    """What belongs under the tables: names of columns, what is not shown, why there is no total."""
    lines: list[str] = []
    for one in sets:
        names = ", ".join(dict.fromkeys(figure for figure in one.figures))
        what = f"{one.title}: " if one.title else ""
        lines.append(f"{what}columns: {names}; worst by {one.worst_by}; TOTAL: every frame counts alike")
        if most and len(one.rows) > most:
            lines.append(
                f"{what}{most} of {len(one.rows)} results are shown, the worst: --worst 0 shows all, "
                "--json, --csv and --html have them"
            )
        lines += [f"{what}{line}" for line in total_lines(one)]
    return lines


def total_lines(results: ResultSet) -> list[str]:
    """Why there is no total of some columns, one line a reason."""
    reasons: dict[str, list[str]] = {}
    for figure in results.figures:
        reason = figure_of(results.pool, figure).reason
        if reason:
            reasons.setdefault(reason, []).append(figure)
    return [f"no total of {', '.join(figures)}: {reason}" for reason, figures in reasons.items()]


def fewer(lines: Sequence[str]) -> list[str]:
    """Return the first lines, and how many more there are."""
    if len(lines) <= MOST_LINES:
        return list(lines)
    return [*lines[: MOST_LINES - 1], f"{len(lines) - MOST_LINES + 1} more notes: --json has those of all"]
