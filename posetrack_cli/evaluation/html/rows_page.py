"""The page of many results: what failed, all together, and one table with a row for each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from posetrack_cli.evaluation.html.packing import rendered, write_page
from posetrack_cli.evaluation.html.summary import Notice, described, differences
from posetrack_cli.evaluation.judging.comparing import Comparison
from posetrack_cli.evaluation.judging.gates import GateOutcome, gates_line
from posetrack_cli.evaluation.judging.rows import ResultRow, ResultSet, worst_first
from posetrack_cli.evaluation.measuring.catalogue import metric_of
from posetrack_cli.evaluation.reports.table import ABSENT, closing_lines, shown, shown_change, total_lines

SCRIPTS = ("rows",)
MOST_UNFOLDED = 20
"""Failed gates that are shown at once."""
GATES_FAILED = "gates failed"
NOTHING = "\u2013"


@dataclass(frozen=True)
class RowsPage:
    """What a page of many results shows.

    Attributes:
        sets: the results.
        outcomes: of gates and a baseline.
        notes: what limits the comparison with the baseline.
        comparison: of groups; None shows none.
        title: heading; by default how many results there are.
        missing: recordings without a result, by name, and why.
        remarks: what a user should know of results, by name, one line each.
        links: pages about single results, by name.
    """

    sets: Sequence[ResultSet]
    outcomes: Sequence[GateOutcome] = ()
    notes: Sequence[str] = ()
    comparison: Comparison | None = None
    title: str = ""
    missing: Sequence[tuple[str, str]] = ()
    remarks: Sequence[tuple[str, str]] = ()
    links: Mapping[str, str] = field(default_factory=dict)


def write_rows_html(path: Path, page: RowsPage) -> None:
    """Write a page to ``*.html``; equal pages give equal bytes.

    The page loads nothing, as that of ``write_html``. An existing page is replaced.

    Raises:
        UsageError: the path is not named as a page, or is a folder.
        ResultError: it cannot be written.
    """
    write_page(path, rows_page(page))


def rows_page(page: RowsPage) -> str:
    """Return the page's text, see ``write_rows_html``."""
    evaluations = worst_first(page.sets)
    failed = [one for one in page.outcomes if one.failed]
    return rendered(
        "rows.html",
        page.title or f"{len(evaluations)} results",
        SCRIPTS,
        most_unfolded=MOST_UNFOLDED,
        lead=f"{said[:1].upper()}{said[1:]}." if (said := gates_line(page.outcomes)) else "",
        notices=[Notice(f"Baseline: {note}") for note in page.notes],
        missing=page.missing,
        failed=[("", one.line) for one in failed],
        sets=[_shown_set(one, page.links) for one in page.sets],
        comparison=differences(page.comparison),
        remarks=page.remarks,
        notes=closing_lines(evaluations),
    )


@dataclass(frozen=True)
class Head:
    """The heading of a column.

    Attributes:
        label: what it says, unless it is a figure.
        meaning: as a tooltip.
        kind: of what it is sorted by, ``text`` or ``number``.
        figure: address of the figure below it; empty for none.
        ordered: whether rows are in its order.
    """

    label: str
    meaning: str
    kind: str
    figure: str = ""
    ordered: bool = False


@dataclass(frozen=True)
class Cell:
    """A value of a row.

    Attributes:
        column: what it is of.
        shown: as text.
        number: that it is sorted by; None for none.
        worse: whether it is a change for the worse.
    """

    column: str
    shown: str
    number: str | None = None
    worse: bool = False


@dataclass(frozen=True)
class Line:
    """A row of the table: a result, or all of them."""

    name: str
    link: str
    failed: bool
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Total:
    """A figure of all results together."""

    figure: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class ShownSet:
    """What the page shows of results of one kind.

    Attributes:
        title: what they are; empty if there is but one set.
        count: how many they are.
        total_columns, totals: the pooled figures.
        total_lines: why there are none, or not all.
        judged: whether there are gates.
        heads, rows, total: the table with a row for each result.
    """

    title: str
    count: int
    total_columns: tuple[str, ...]
    totals: tuple[Total, ...]
    total_lines: tuple[str, ...]
    judged: bool
    heads: tuple[Head, ...]
    rows: tuple[Line, ...]
    total: Line


def _shown_set(results: ResultSet, links: Mapping[str, str]) -> ShownSet:
    """All together, and the table of rows."""
    figures = list(dict.fromkeys((*results.figures, *results.further)))
    compared = results.total.earlier is not None
    known = [figure for figure in figures if results.total.value(figure) is not None]
    return ShownSet(
        title=results.title[:1].upper() + results.title[1:],
        count=len(results.rows),
        total_columns=("now", *(("baseline", "change") if compared else ())),
        totals=tuple(Total(figure, _total_cells(results.total, figure, compared)) for figure in known),
        total_lines=tuple(total_lines(results)),
        judged=results.judged,
        heads=tuple(_heads(results, figures)),
        rows=tuple(_line(one, figures, results, one.name, links.get(one.name, "")) for one in results.rows),
        total=_line(results.total, figures, results, f"Total of {len(results.rows)}"),
    )


def _total_cells(total: ResultRow, figure: str, compared: bool) -> tuple[Cell, ...]:
    now, change = total.value(figure), total.change(figure)
    cells = (Cell("now", _number(now)),)
    if not compared:
        return cells
    then = None if now is None or change is None else now - change
    return (*cells, Cell("baseline", _number(then)), _change(total, figure))


def _heads(results: ResultSet, figures: Sequence[str]) -> Iterator[Head]:
    """The headings: script sorts and filters by them, and without script rows are in order."""
    yield Head("result", "result", "text")
    for figure in figures:
        yield Head("", figure, "number", figure, figure == results.worst_by)
        if results.compared and figure != "frames":
            yield Head("change", f"{figure}: now minus baseline", "number")
    if results.judged:
        yield Head(GATES_FAILED, GATES_FAILED, "number")


def _line(one: ResultRow, figures: Sequence[str], results: ResultSet, name: str, link: str = "") -> Line:
    cells = []
    for figure in figures:
        value = one.value(figure)
        cells.append(Cell(_words(figure), _number(value), None if value is None else repr(value)))
        if results.compared and figure != "frames":
            cells.append(_change(one, figure))
    if results.judged:
        cells.append(Cell(GATES_FAILED, str(one.failed), str(one.failed)))
    return Line(name, link, bool(one.failed), tuple(cells))


@cache
def _words(figure: str) -> str:
    """What a figure is called, with its unit."""
    named = described(figure)
    return f"{named.label} {named.unit}".strip()


def _change(one: ResultRow, figure: str) -> Cell:
    """By how much a figure changed; where that is for the worse it stands out."""
    change, better = one.change(figure), metric_of(figure).better
    text = shown_change(one, figure)
    if change is None:
        return Cell("change", NOTHING if text == ABSENT else text)
    worse = (change > 0.0 and better == "lower") or (change < 0.0 and better == "higher")
    return Cell("change", text, repr(change), worse and text != "0")


def _number(value: float | None) -> str:
    return NOTHING if value is None else shown(value)
