"""The parts of the page above the plots: what to know first, the tables of figures, what they mean."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from posetrack_cli.evaluation.comparing.comparison import Comparison
from posetrack_cli.evaluation.evaluation import Evaluation, Statistics
from posetrack_cli.evaluation.html.components import details, element, listed, readable, row, scrolling, text
from posetrack_cli.evaluation.metrics.catalogue import label_and_unit, metric_of
from posetrack_cli.evaluation.pooling import Pool
from posetrack_cli.evaluation.reports.comparison_table import comparison_lines, comparison_tables
from posetrack_cli.evaluation.reports.table import (
    ABSENT,
    Row,
    Section,
    Table,
    criterion_lines,
    pool_lines,
    pooled_table,
    reliability_table,
    shown,
    tables,
)
from posetrack_cli.evaluation.subjects import KINDS
from posetrack_cli.losses import loss_line


def notices(evaluations: Sequence[Evaluation]) -> str:
    """Return what a reader must know before any figure: notes and data that could not be read."""
    found: dict[str, list[str]] = {}
    for one in evaluations:
        for line in _notices_of(one):
            found.setdefault(line, []).append(one.name)
    lines = [_notice(line, names, len(evaluations)) for line, names in found.items()]
    return element("div", listed(lines), class_="notices", role="note") if lines else ""


def _notices_of(evaluation: Evaluation) -> Iterator[str]:
    if evaluation.losses:
        yield f"Data lost: {loss_line(evaluation.losses)}"
    yield from evaluation.notes
    if not evaluation.coverage.frames:
        yield "The result holds no estimate."
    elif not evaluation.coverage.has_truth:
        yield "No truth: errors cannot be told, only what the run says of itself."


def _notice(line: str, names: Sequence[str], results: int) -> str:
    if len(names) == results:
        return text(line)
    return ", ".join(element("b", text(name)) for name in names) + f": {text(line)}"


def lead(evaluations: Sequence[Evaluation]) -> str:
    """Return one sentence per result: coverage and the main error."""
    if len(evaluations) > 1:
        return ""
    return "".join(element("p", _lead_of(one), class_="lead") for one in evaluations)


def _lead_of(evaluation: Evaluation) -> str:
    coverage = evaluation.coverage
    due = coverage.frames + coverage.missed
    parts = [f"Coverage <strong>{shown(coverage.share)}</strong> ({due} frames due, {coverage.lost} lost)"]
    for name in KINDS[evaluation.subject].lead:
        value = evaluation.metrics.get(name)
        if isinstance(value, Statistics) and value.count:
            label, unit = label_and_unit(name)
            parts.append(
                f"{text(label)} <strong>{shown(value.mean)} {unit}</strong> on average, "
                f"95 % below {shown(value.p95)} {unit}"
            )
    return "; ".join(parts) + "."


def summary_tables(evaluations: Sequence[Evaluation], pools: Sequence[Pool] = ()) -> str:
    """Return the tables of figures, those of parts and confidence on demand, absent ones and meanings."""
    if not evaluations:
        return element("p", "No result was given.", class_="missing")
    made = tables(evaluations)
    found = [_table(table, "" if place == 0 else table.title) for place, table in enumerate(made)]
    parts = _parts_only(tables(evaluations, parts=True)[0])
    if parts.sections:
        found.append(details("Per joint, finger, angle or point", _table(parts, "Parts")))
    pooled = pooled_table(pools)
    if pooled is not None:
        notes = listed(text(line) for line in pool_lines(pools))
        found.append(_table(pooled, pooled.title) + element("div", notes, class_="remark"))
    confidence = reliability_table(evaluations, pools)
    if confidence is not None:
        found.append(details("Reliability of confidence", _table(confidence, confidence.title)))
    found += [_absent(evaluations), _meanings(evaluations)]
    return "".join(found)


def honesty_remark(evaluations: Sequence[Evaluation]) -> str:
    """Say what makes a frame right; nothing where none was judged."""
    return text(" ".join(f"{line[0].upper()}{line[1:]}." for line in criterion_lines(evaluations)))


def comparison_section(comparison: Comparison | None) -> str:
    """Return the tables of paired differences, and what belongs under them."""
    if comparison is None:
        return ""
    found = [_table(table, table.title) for table in comparison_tables(comparison)]
    notes = listed(text(line) for line in comparison_lines(comparison))
    return element("h3", "Paired differences") + "".join(found) + element("div", notes, class_="remark")


def _parts_only(table: Table) -> Table:
    """Rows about parts, under the metric they belong to."""
    rows = [one for section in table.sections for one in section.rows if "." in one.address]
    names = dict.fromkeys(one.address.split(".")[0] for one in rows)
    sections = tuple(
        Section(name, tuple(one for one in rows if one.address.split(".")[0] == name)) for name in names
    )
    return Table(table.title, table.columns, sections)


def _table(table: Table, caption: str) -> str:
    heading = row(
        [
            element("th", "", scope="col"),
            *(element("th", f"<bdi>{text(name)}</bdi>", scope="col", title=name) for name in table.columns),
        ]
    )
    bodies = "".join(_section(section, len(table.columns)) for section in table.sections)
    title = element("caption", text(caption)) if caption else ""
    content = title + element("thead", heading) + bodies
    return scrolling(element("table", content, class_="figures"), caption or "Summary")


def _section(section: Section, columns: int) -> str:
    rows = [_row(one) for one in section.rows]
    if section.title:
        title = _spoken(section.title) if section.title.islower() else text(section.title)
        rows.insert(0, row([element("th", title, scope="rowgroup", colspan=columns + 1)], class_="group"))
    return element("tbody", "".join(rows))


def _row(one: Row) -> str:
    label = _metric_label(one) if one.address.split(".")[-1] == one.label else text(one.label)
    cells = [element("td", "–" if cell == ABSENT else text(cell).replace("-", "−")) for cell in one.cells]
    return row([element("th", label, scope="row"), *cells], class_="inner" if one.indent else "")


def _metric_label(one: Row) -> str:
    if "." in one.address:
        return text(readable(one.label))
    return _spoken(one.address)


def _spoken(address: str) -> str:
    """What a metric is called, its unit, and its meaning as a tooltip."""
    label, unit = label_and_unit(address)
    meaning = f"{address}: {metric_of(address).meaning}"
    unit_text = f' <span class="unit">{text(unit)}</span>' if unit else ""
    return element("abbr", text(label), title=meaning) + unit_text


def _absent(evaluations: Sequence[Evaluation]) -> str:
    """What has no value, and why: one line for each reason and result."""
    lines: dict[str, list[str]] = {}
    for one in evaluations:
        for reason in dict.fromkeys(one.absent.values()):
            lines.setdefault(_absent_line(one, reason), []).append(one.name)
    made = [_notice_line(line, names, len(evaluations)) for line, names in lines.items()]
    return details(f"Without a value here ({len(made)})", listed(made)) if made else ""


def _absent_line(evaluation: Evaluation, reason: str) -> str:
    names = [name for name, why in evaluation.absent.items() if why == reason and "." not in name]
    names = names or [name for name, why in evaluation.absent.items() if why == reason]
    codes = ", ".join(element("code", text(name)) for name in names)
    return f"{text(reason)}: {codes}"


def _notice_line(line: str, names: Sequence[str], results: int) -> str:
    who = "" if len(names) == results else ", ".join(text(name) for name in names) + " – "
    return who + line


def _meanings(evaluations: Sequence[Evaluation]) -> str:
    """Name, address and meaning of every figure on the page."""
    names = dict.fromkeys(base.split(".")[0] for one in evaluations for base in (*one.metrics, *one.absent))
    items = []
    for name in names:
        metric = metric_of(name)
        label, unit = label_and_unit(name)
        better = {"lower": " Lower is better.", "higher": " Higher is better."}.get(metric.better, "")
        items.append(
            element("dt", f"{text(label)}{f', {text(unit)}' if unit else ''} {element('code', text(name))}")
            + element("dd", text(metric.meaning + better))
        )
    content = element("dl", "".join(items)) + element(
        "p",
        "sd is the standard deviation of the values themselves; p95 their 95th percentile, and p5, "
        "told where small is bad, their 5th. Lost frames count "
        "in every figure that does not say otherwise. The names in code are those of <code>--fail-if</code>.",
    )
    return details("What the figures mean", content)
