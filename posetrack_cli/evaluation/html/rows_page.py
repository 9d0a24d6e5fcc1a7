"""The page of many results: what failed, all together, and one table with a row for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from posetrack_cli.evaluation.comparing.comparison import Comparison
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.gates import GateOutcome
from posetrack_cli.evaluation.html.assets import filled, write_page
from posetrack_cli.evaluation.html.components import details, element, listed, row, scrolling, text
from posetrack_cli.evaluation.html.summary import comparison_section
from posetrack_cli.evaluation.metrics.catalogue import label_and_unit, metric_of, split_address
from posetrack_cli.evaluation.reports.row_table import shown_change, total_lines
from posetrack_cli.evaluation.reports.table import ABSENT, closing_lines, shown
from posetrack_cli.evaluation.rows import ResultRow, ResultSet, worst_first

SCRIPTS = ("rows",)
MOST_UNFOLDED = 20
"""Failed gates that are shown at once."""
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
    title = page.title or f"{len(evaluations)} results"
    comparison = comparison_section(page.comparison)
    return filled(
        "rows.html",
        title,
        SCRIPTS,
        lead=_lead(page, failed),
        notices=_against(page.notes),
        failed=_named("Recordings without a result", page.missing) + _failed(failed),
        sets="".join(_set(one, page.links) for one in page.sets),
        comparison=element("section", comparison, id="comparison") if comparison else "",
        remarks=_named("Remarks of single results", page.remarks) + _remarks(evaluations),
    )


def _lead(page: RowsPage, failed: Sequence[GateOutcome]) -> str:
    if not page.outcomes:
        return ""
    words = f"{len(failed)} of {len(page.outcomes)} gates failed." if failed else "All gates passed."
    return element("p", words, class_="lead")


def _failed(failed: Sequence[GateOutcome]) -> str:
    lines = [text(one.line) for one in failed]
    if not lines:
        return ""
    few = {"open": ""} if len(lines) <= MOST_UNFOLDED else {}
    return details(f"Failed gates ({len(lines)})", listed(lines), **few)


def _named(heading: str, lines: Sequence[tuple[str, str]]) -> str:
    """What there is to say of single results, folded where it is much."""
    if not lines:
        return ""
    few = {"open": ""} if len(lines) <= MOST_UNFOLDED else {}
    items = (f"<bdi>{text(name)}</bdi>: {text(said)}" for name, said in lines)
    return details(f"{heading} ({len(lines)})", listed(items), **few)


def _against(notes: Sequence[str]) -> str:
    """What limits the comparison with the baseline, before any figure."""
    lines = listed(text(f"Baseline: {note}") for note in notes)
    return element("div", lines, class_="notices", role="note") if lines else ""


def _remarks(evaluations: Sequence[Evaluation]) -> str:
    lines = closing_lines(evaluations)
    shown_lines = listed(text(line) for line in lines)
    return details(f"Notes, and what has no value ({len(lines)})", shown_lines) if lines else ""


def _set(results: ResultSet, links: Mapping[str, str]) -> str:
    """All together, and the table of rows."""
    title = text(results.title[:1].upper() + results.title[1:])
    content = element("h2", f"All {len(results.rows)} results{': ' + title if title else ''}")
    content += _totals(results)
    content += element("h2", f"Result by result{': ' + title if title else ''}")
    return element("section", content + _table(results, links))


def _totals(results: ResultSet) -> str:
    """The pooled figures, one a line, or why there are none."""
    total = results.total
    figures = dict.fromkeys((*results.figures, *results.further))
    known = [figure for figure in figures if total.value(figure) is not None]
    reasons = listed(text(line) for line in total_lines(results))
    remark = element("div", reasons, class_="remark") if reasons else ""
    if not known:
        return remark
    compared = total.earlier is not None
    columns = ["now", *(("baseline", "change") if compared else ())]
    head = element(
        "thead", row([element("th", "", scope="col"), *(element("th", c, scope="col") for c in columns)])
    )
    lines = (
        row([element("th", _label(figure), scope="row"), *_total_cells(total, figure, compared)])
        for figure in known
    )
    table = element("table", head + element("tbody", "".join(lines)), class_="figures")
    return scrolling(table, "All results together") + remark


def _total_cells(total: ResultRow, figure: str, compared: bool) -> list[str]:
    now, change = total.value(figure), total.change(figure)
    cells = [element("td", _number(now))]
    if not compared:
        return cells
    then = None if now is None or change is None else now - change
    return [*cells, element("td", _number(then)), _change(total, figure)]


def _table(results: ResultSet, links: Mapping[str, str]) -> str:
    """A row for each result: script sorts and filters it, and without script it is in order."""
    figures = list(dict.fromkeys((*results.figures, *results.further)))
    heads = [_head("result", "result", "text")]
    for figure in figures:
        heads.append(_head(_label(figure), figure, "number", figure == results.worst_by))
        if results.compared and figure != "frames":
            heads.append(_head("change", f"{figure}: now minus baseline", "number"))
    if results.judged:
        heads.append(_head("gates failed", "gates failed", "number"))
    body = "".join(_row(one, figures, results, links=links) for one in results.rows)
    foot = _row(results.total, figures, results, f"Total of {len(results.rows)}")
    table = element(
        "table",
        element("thead", row(heads)) + element("tbody", body) + element("tfoot", foot),
        class_="figures rows",
    )
    failed = (
        '<label><input type="checkbox" class="only-failed"> failed only</label>' if results.judged else ""
    )
    bar = (
        '<div class="heading filter" hidden>'
        '<label>Filter by name <input type="search" class="name-filter"></label>'
        f'{failed}<span class="shown-count remark" role="status"></span></div>'
    )
    return bar + scrolling(table, "Results, worst first")


def _head(label: str, meaning: str, kind: str, ordered: bool = False) -> str:
    more = {"aria_sort": "descending"} if ordered else {}
    return element("th", label, scope="col", title=meaning, data_kind=kind, **more)


def _label(figure: str) -> str:
    """What a figure is called, with its address and meaning as a tooltip."""
    label, unit = label_and_unit(split_address(figure).base)
    statistic = split_address(figure).statistic
    words = f"{label}{f', {statistic}' if statistic else ''}"
    unit_text = f' <span class="unit">{text(unit)}</span>' if unit else ""
    return element("abbr", text(words), title=f"{figure}: {metric_of(figure).meaning}") + unit_text


def _row(
    one: ResultRow,
    figures: Sequence[str],
    results: ResultSet,
    label: str = "",
    links: Mapping[str, str] = MappingProxyType({}),
) -> str:
    shown_name = f"<bdi>{text(label or one.name)}</bdi>"
    if one.name in links:
        shown_name = element("a", shown_name, href=links[one.name])
    name = element("th", shown_name, scope="row")
    cells = [name]
    for figure in figures:
        value = one.value(figure)
        cells.append(element("td", _number(value), **({} if value is None else {"data_value": repr(value)})))
        if results.compared and figure != "frames":
            cells.append(_change(one, figure))
    if results.judged:
        cells.append(element("td", str(one.failed), data_value=one.failed))
    return row(cells, **({"class_": "failed"} if one.failed else {}))


def _change(one: ResultRow, figure: str) -> str:
    """By how much a figure changed; where that is for the worse it stands out."""
    change, better = one.change(figure), metric_of(figure).better
    shown_text = shown_change(one, figure)
    if change is None:
        return element("td", NOTHING if shown_text == ABSENT else shown_text)
    worse = (change > 0.0 and better == "lower") or (change < 0.0 and better == "higher")
    marked = {"class_": "worse"} if worse and shown_text != "0" else {}
    return element("td", text(shown_text).replace("-", "\u2212"), data_value=repr(change), **marked)


def _number(value: float | None) -> str:
    return NOTHING if value is None else text(shown(value)).replace("-", "\u2212")
