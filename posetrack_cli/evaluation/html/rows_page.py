"""HTML page of many results: failed gates, pooled values, and a table with a row per result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from posetrack_cli.evaluation.html.packing import rendered, write_page
from posetrack_cli.evaluation.html.summary import Notice, described, differences
from posetrack_cli.evaluation.judging.comparing import Comparison
from posetrack_cli.evaluation.judging.gates import GateOutcome, gates_line
from posetrack_cli.evaluation.judging.rows import ResultRow, ResultSet, worst_first
from posetrack_cli.evaluation.measuring.catalogue import metric_of
from posetrack_cli.evaluation.reports.table import ABSENT, closing_lines, shown, shown_change, total_lines

SCRIPTS = ("rows",)
MOST_UNFOLDED = 20
"""Maximum length of lists that are not collapsed."""
GATES_FAILED = "gates failed"
NOTHING = "\u2013"
LEAST_RESULTS, BINS = 5, 20
"""Smallest number of results with a histogram, and its bins."""


@dataclass(frozen=True)
class Thumbnail:
    """Picture of a result's worst frame.

    Attributes:
        name: name of the result.
        link: link to its page.
        source: data URL of the picture.
        caption: frame, time, status and error.
    """

    name: str
    link: str
    source: str
    caption: str


@dataclass(frozen=True)
class RowsPage:
    """Content of a page of many results.

    Attributes:
        sets: the results.
        outcomes: outcomes of gates and baseline.
        notes: limitations of the comparison with the baseline.
        comparison: comparison of groups; None for none.
        title: heading; defaults to the number of results.
        missing: names of recordings without a result, with the reason.
        remarks: names of results, with a remark.
        links: links to pages about single results, by name.
        worst: pictures of the worst results.
    """

    sets: Sequence[ResultSet]
    outcomes: Sequence[GateOutcome] = ()
    notes: Sequence[str] = ()
    comparison: Comparison | None = None
    title: str = ""
    missing: Sequence[tuple[str, str]] = ()
    remarks: Sequence[tuple[str, str]] = ()
    links: Mapping[str, str] = field(default_factory=dict)
    worst: Sequence[Thumbnail] = ()


def write_rows_html(path: Path, page: RowsPage) -> None:
    """Write the page to ``*.html``; an existing one is overwritten.

    The page is self-contained and deterministic, like that of ``write_html``.

    Raises:
        UsageError: the name does not end with ``.html``, or is a folder.
        ResultError: the file cannot be written.
    """
    write_page(path, rows_page(page))


def rows_page(page: RowsPage) -> str:
    """Return the text of the page; see ``write_rows_html``."""
    evaluations = worst_first(page.sets)
    failed = [one for one in page.outcomes if one.failed]
    return rendered(
        "rows.html",
        page.title or f"{len(evaluations)} results",
        SCRIPTS,
        most_unfolded=MOST_UNFOLDED,
        lead=f"{line[:1].upper()}{line[1:]}." if (line := gates_line(page.outcomes)) else "",
        notices=[Notice(f"Baseline: {note}") for note in page.notes],
        missing=page.missing,
        failed=[("", one.line) for one in failed],
        sets=[_shown_set(one, page.links) for one in page.sets],
        worst=page.worst,
        comparison=differences(page.comparison),
        remarks=page.remarks,
        notes=closing_lines(evaluations),
    )


@dataclass(frozen=True)
class Head:
    """A column heading.

    Attributes:
        label: text, unless it is a metric.
        meaning: tooltip.
        kind: type of the values, ``text`` or ``number``.
        figure: address of the metric; empty for none.
        ordered: whether the rows are sorted by it.
    """

    label: str
    meaning: str
    kind: str
    figure: str = ""
    ordered: bool = False


@dataclass(frozen=True)
class Cell:
    """A table cell.

    Attributes:
        column: name of the column.
        shown: text.
        number: sort key; None for none.
        worse: whether it is a change for the worse.
    """

    column: str
    shown: str
    number: str | None = None
    worse: bool = False


@dataclass(frozen=True)
class Line:
    """A table row of a result or a pool."""

    name: str
    link: str
    failed: bool
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Total:
    """A pooled value."""

    figure: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Distribution:
    """Histogram of a metric over results.

    Attributes:
        figure: address of the metric.
        bars: relative heights, 0 to 1, of bins of equal width from the smallest to the largest value.
        least, median, most: texts.
    """

    figure: str
    bars: tuple[float, ...]
    least: str
    median: str
    most: str


@dataclass(frozen=True)
class ShownSet:
    """Section of a result set.

    Attributes:
        title: title of the set; empty if there is only one.
        count: number of results.
        total_columns, totals: table of pooled values.
        total_lines: reasons for missing pooled values.
        judged: whether there are gates.
        distributions: histograms over the results.
        heads, rows, total: table with a row per result.
    """

    title: str
    count: int
    total_columns: tuple[str, ...]
    totals: tuple[Total, ...]
    total_lines: tuple[str, ...]
    judged: bool
    distributions: tuple[Distribution, ...]
    heads: tuple[Head, ...]
    rows: tuple[Line, ...]
    total: Line


def _shown_set(results: ResultSet, links: Mapping[str, str]) -> ShownSet:
    """Return the section of a result set."""
    figures = list(dict.fromkeys((*results.figures, *results.further)))
    compared = results.total.baseline is not None
    known = [figure for figure in figures if results.total.value(figure) is not None]
    return ShownSet(
        title=results.title[:1].upper() + results.title[1:],
        count=len(results.rows),
        total_columns=("value", *(("baseline", "change") if compared else ())),
        totals=tuple(Total(figure, _total_cells(results.total, figure, compared)) for figure in known),
        total_lines=tuple(total_lines(results)),
        judged=results.judged,
        distributions=tuple(_distributions(results)),
        heads=tuple(_heads(results, figures)),
        rows=tuple(_line(one, figures, results, one.name, links.get(one.name, "")) for one in results.rows),
        total=_line(results.total, figures, results, f"Total of {len(results.rows)}"),
    )


def _distributions(results: ResultSet) -> Iterator[Distribution]:
    """Yield the histograms of the columns with enough different values."""
    for figure in results.figures:
        if figure == "frames":
            continue
        values = np.array([value for one in results.rows if (value := one.value(figure)) is not None])
        values = values[np.isfinite(values)]
        if len(values) < LEAST_RESULTS or values.min() == values.max():
            continue
        counts, _ = np.histogram(values, BINS)
        least, median, most = (shown(float(of(values))) for of in (np.min, np.median, np.max))
        yield Distribution(figure, tuple((counts / counts.max()).round(3).tolist()), least, median, most)


def _total_cells(total: ResultRow, figure: str, compared: bool) -> tuple[Cell, ...]:
    now, change = total.value(figure), total.change(figure)
    cells = (Cell("value", _number(now)),)
    if not compared:
        return cells
    then = None if now is None or change is None else now - change
    return (*cells, Cell("baseline", _number(then)), _change(total, figure))


def _heads(results: ResultSet, figures: Sequence[str]) -> Iterator[Head]:
    """Yield the column headings; a script sorts by them."""
    yield Head("result", "result", "text")
    for figure in figures:
        yield Head("", figure, "number", figure, figure == results.worst_by)
        if results.compared and figure != "frames":  # a note reports a changed number of frames
            yield Head("change", f"{figure}: value minus baseline", "number")
    if results.judged:
        yield Head(GATES_FAILED, GATES_FAILED, "number")


def _line(one: ResultRow, figures: Sequence[str], results: ResultSet, name: str, link: str = "") -> Line:
    cells = []
    for figure in figures:
        value = one.value(figure)
        # The script sorts by the exact value, not by the rounded text.
        cells.append(Cell(_words(figure), _number(value), None if value is None else repr(value)))
        if results.compared and figure != "frames":
            cells.append(_change(one, figure))
    if results.judged:
        cells.append(Cell(GATES_FAILED, str(one.failed), str(one.failed)))
    return Line(name, link, bool(one.failed), tuple(cells))


@cache
def _words(figure: str) -> str:
    """Return the display name of a metric with its unit."""
    named = described(figure)
    return f"{named.label} {named.unit}".strip()


def _change(one: ResultRow, figure: str) -> Cell:
    """Return the cell with the change of a metric, which is highlighted if it is for the worse."""
    change, better = one.change(figure), metric_of(figure).better
    text = shown_change(one, figure)
    if change is None:
        return Cell("change", NOTHING if text == ABSENT else text)
    worse = (change > 0.0 and better == "lower") or (change < 0.0 and better == "higher")
    return Cell("change", text, repr(change), worse and text != "0")


def _number(value: float | None) -> str:
    return NOTHING if value is None else shown(value)
