"""Text tables of metrics, result rows and comparisons."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isnan
from typing import TypeAlias

import numpy as np

from posetrack_cli.evaluation.judging.comparing import Comparison, Difference
from posetrack_cli.evaluation.judging.rows import ResultRow, ResultSet, heading
from posetrack_cli.evaluation.measuring.catalogue import (
    CATALOGUE,
    Measured,
    figure_of,
    is_pooled,
    metric_of,
    place_of,
    split_address,
)
from posetrack_cli.evaluation.measuring.evaluation import STATISTIC_NAMES, Evaluation, Statistics, Value
from posetrack_cli.evaluation.measuring.head_metrics import HEAD_POSE
from posetrack_cli.evaluation.measuring.honesty import Bin, reliability
from posetrack_cli.evaluation.measuring.measures import GROUP_TITLES, Group
from posetrack_cli.evaluation.measuring.pooling import Pool
from posetrack_cli.evaluation.reading.alignment import JointOffsets
from posetrack_cli.losses import loss_line

# Tables of evaluations, for the terminal and the HTML report


ABSENT = "-"
SHOWN = ("mean", "sd", "median", "p95", "max", "p5")
"""Statistics of a single result; p5 only for metrics where higher is better."""
SPREAD, LOW_SPREAD = ("median", "p95", "max"), ("median", "p5")
"""Statistics below the mean for several results, where lower is better and where higher is better."""

OFFSETS_TITLE = "Removed joint offsets, mm"
OFFSET_COLUMNS: tuple[str, ...] = ("x", "y", "z", "norm")
"""Ground truth minus estimate, in the axes that a note states."""

RELIABILITY_COLUMNS: tuple[str, ...] = ("frames", "mean confidence", "share correct")

MOST_NAMES = 4
"""Maximum number of result names in a line."""


@dataclass(frozen=True)
class Row:
    """A table row.

    Attributes:
        label: label of the row.
        cells: one text per column.
        address: address of the metric without statistic; empty for none.
        indent: 0 for a metric, 1 for a detail of the metric above.
    """

    label: str
    cells: tuple[str, ...]
    address: str = ""
    indent: int = 0


@dataclass(frozen=True)
class Section:
    """Rows with a common title, which may be empty."""

    title: str
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class Table:
    """A table: title, column headings (without that of the labels), and sections."""

    title: str
    columns: tuple[str, ...]
    sections: tuple[Section, ...]


RowsOf: TypeAlias = Callable[[str], list[Row]]
"""Returns the rows of an address."""


def tables(evaluations: Sequence[Evaluation], *, parts: bool = False) -> list[Table]:
    """Return the tables of one result, or of several side by side, in catalogue order.

    A single result has a column per statistic. Several results have a column each with mean and sd, and below
    median, p95 and max, or median and p5 if higher is better. Metrics without a value are left out; see
    ``closing_lines``.

    Args:
        evaluations: at least one.
        parts: include rows of joints, fingers, angles and points.
    """
    more = (thesis_table(evaluations), offsets_table(evaluations))
    bases = [base for base in _bases(evaluations) if parts or "." not in base]
    title, columns, rows = (_of_one if len(evaluations) == 1 else _of_several)(evaluations)
    main = Table(title, columns, _sections((metric_of(base).group, rows(base)) for base in bases))
    return [main, *(table for table in more if table is not None)]


def catalogue_lines() -> Iterator[str]:
    """Yield address, unit, direction and meaning of all metrics, for ``--list-metrics``."""
    for metric in CATALOGUE:
        part = f"[.{metric.part.upper()}]" if metric.part else ""
        statistic = "" if metric.scalar else ".STATISTIC"
        better = "" if metric.better == "neither" else f", {metric.better} is better"
        unit = f", {metric.unit}" if metric.unit else ""
        yield f"{metric.name}{part}{statistic}{unit}{better}"
        yield f"    {metric.meaning}"
    yield f"STATISTIC: one of {', '.join(STATISTIC_NAMES)}"
    lone = ", ".join(metric.name for metric in CATALOGUE if not is_pooled(metric.name))
    yield f"pooled.NAME: value over the frames of all results, or of each group; not available for {lone}"
    yield "STATISTIC(NAME): statistic over the values of all results, e.g. p95(joint_error_mm.mean)"


def pooled_table(pools: Sequence[Pool]) -> Table | None:
    """Return the table of pooled values, or None if there are none."""
    shown_pools = [pool for pool in pools if pool.has_pooled_values]
    if not shown_pools:
        return None
    bases = [base for base in _bases(shown_pools) if "." not in base]
    rows = (
        (metric_of(base).group, [_row(base, tuple(_mean_cell(one.metrics.get(base)) for one in shown_pools))])
        for base in bases
    )
    return Table("Pooled over results", tuple(pool.name for pool in shown_pools), _sections(rows))


def reliability_table(evaluations: Sequence[Evaluation], pools: Sequence[Pool]) -> Table | None:
    """Return the reliability diagrams of results and pools as a table, or None if no frame was judged."""
    every: list[Evaluation | Pool] = [*evaluations, *(pool for pool in pools if pool.has_pooled_values)]
    found = {one.name: reliability(*one.judged.scored) for one in every if one.judged is not None}
    if not found:
        return None
    bins = list(zip(*found.values(), strict=True))
    labels = [f"{own[0].low:.1f} to {own[0].high:.1f}" for own in bins]
    if len(found) == 1:
        columns: tuple[str, ...] = RELIABILITY_COLUMNS
        cells = [_reliability_cells(own[0]) for own in bins]
    else:
        columns = tuple(found)
        cells = [tuple(" / ".join(_reliability_cells(one)) for one in own) for own in bins]
    rows = tuple(Row(label, own) for label, own in zip(labels, cells, strict=True))
    what = "" if len(found) == 1 else f": {' / '.join(RELIABILITY_COLUMNS)}"
    return Table(f"Confidence{what}", columns, (Section("", rows),))


def criterion_lines(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return the criteria for correct and far-off frames."""
    judged = [one.judged for one in evaluations if one.judged is not None]
    lines = (f"correct: {one.right_if}; far off: {one.far_if}" for one in judged)
    return list(dict.fromkeys(lines))


def pool_lines(pools: Sequence[Pool]) -> list[str]:
    """Return the reasons for missing pooled values."""
    several = [pool for pool in pools if len(pool.results) > 1]
    return [f"{one.name}: {line}" for one in several for line in _absent_lines(one.absent)]


def _reliability_cells(one: Bin) -> tuple[str, ...]:
    if not one.count:
        return ("0", ABSENT, ABSENT)
    return (str(one.count), shown(one.confidence), shown(one.right))


def thesis_table(evaluations: Sequence[Evaluation]) -> Table | None:
    """Return mean and sd of the six absolute pose errors of heads, or None if no result has them."""
    heads = [one for one in evaluations if all(name in one.metrics for name in HEAD_POSE)]
    if not heads:
        return None
    rows = tuple(_thesis_row(one, name, len(heads)) for one in heads for name in ("mean", "sd"))
    columns = tuple(name.replace("_", " ") for name in HEAD_POSE)
    return Table("Absolute pose errors", columns, (Section("", rows),))


def offsets_table(evaluations: Sequence[Evaluation]) -> Table | None:
    """Return the removed constant offsets of the joints, or None if none were removed."""
    removed = {one.name: one.joint_offsets for one in evaluations if one.joint_offsets is not None}
    if not removed:
        return None
    names = dict.fromkeys(name for one in removed.values() for name in one.names)
    cells = {name: [_offset_cells(one, name) for one in removed.values()] for name in names}
    if len(removed) == 1:
        columns, rows = OFFSET_COLUMNS, [Row(name, own[0]) for name, own in cells.items()]
    else:
        columns = tuple(removed)
        rows = [Row(name, tuple(" ".join(cell) for cell in own)) for name, own in cells.items()]
    return Table(OFFSETS_TITLE, columns, (Section("", tuple(rows)),))


def _offset_cells(removed: JointOffsets, name: str) -> tuple[str, ...]:

    if name not in removed.names:
        return (ABSENT,) * len(OFFSET_COLUMNS)
    row = removed.names.index(name)
    values = np.round([*removed.offsets[row], removed.lengths[row]], 1) + 0.0  # + 0.0 turns -0.0 into 0.0
    return tuple(f"{value:.1f}" for value in values)


def closing_lines(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return the lines below the tables: renderer, notes, lost data, and reasons for missing values.

    Lines that apply to all results are not repeated; others are prefixed with the names of the results.
    """
    of: dict[str, list[str]] = {}
    for one in evaluations:
        for line in dict.fromkeys(_lines(one)):  # without duplicates, in order
            of.setdefault(line, []).append(one.name)
    return [
        line if len(names) == len(evaluations) else f"{some_names(names)}: {line}"
        for line, names in of.items()
    ]


def some_names(names: Sequence[str]) -> str:
    """Return the names as text, abbreviated if there are many."""
    if len(names) <= MOST_NAMES:
        return ", ".join(names)
    return f"{', '.join(names[: MOST_NAMES - 1])} and {len(names) - MOST_NAMES + 1} more"


def shown(value: float) -> str:
    """Format a value with four digits. Only integers are shown without decimals: 0.99999 is 1.0000."""
    if not math.isfinite(value):
        return str(value)
    size = abs(value)
    if value == int(value) and size < 1e15:
        return str(int(value))
    if size < 1e-3 or size >= 1e15:
        return f"{value:.3g}"
    return f"{value:.{max(0, min(4, 3 - math.floor(math.log10(size))))}f}"


def mean_and_sd(mean: float, sd: float) -> str:
    """Format mean and standard deviation for one cell."""
    return f"{shown(mean)} \u00b1 {shown(sd)}"


def _of_one(evaluations: Sequence[Evaluation]) -> tuple[str, tuple[str, ...], RowsOf]:
    """Return title, columns and row function of the table of a single result."""
    (evaluation,) = evaluations

    def rows(base: str) -> list[Row]:
        return [_row(base, _statistics_cells(base, evaluation.metrics[base]))]

    return evaluation.name, ("mean/value", *SHOWN[1:]), rows


def _of_several(evaluations: Sequence[Evaluation]) -> tuple[str, tuple[str, ...], RowsOf]:
    """Return title, columns and row function of the table of several results."""

    def rows(base: str) -> list[Row]:
        values = [one.metrics.get(base) for one in evaluations]
        main = _row(base, tuple(_mean_cell(value) for value in values))
        if main.indent or not any(isinstance(value, Statistics) for value in values):
            return [main]
        names = LOW_SPREAD if _small_is_bad(base) else SPREAD
        return [main, Row(" / ".join(names), tuple(_spread_cell(value, names) for value in values), base, 1)]

    return "Results", tuple(one.name for one in evaluations), rows


def _sections(grouped: Iterable[tuple[Group, list[Row]]]) -> tuple[Section, ...]:
    """Return a section per group of metrics, in table order."""
    found: dict[Group, list[Row]] = {group: [] for group in GROUP_TITLES}
    for group, rows in grouped:
        found[group] += rows
    return tuple(Section(GROUP_TITLES[group], tuple(rows)) for group, rows in found.items() if rows)


def _bases(evaluations: Iterable[Measured]) -> list[str]:
    """Return all addresses with a value, in catalogue order."""
    found = dict.fromkeys(base for one in evaluations for base in one.metrics)
    return sorted(found, key=place_of)


def _row(base: str, cells: tuple[str, ...]) -> Row:
    name, _, part = base.partition(".")
    return Row(part or name, cells, base, 1 if part else 0)


def _small_is_bad(base: str) -> bool:
    return metric_of(base).better == "higher"


def _statistics_cells(base: str, value: Value) -> tuple[str, ...]:
    if not isinstance(value, Statistics):
        return (shown(value), *[""] * (len(SHOWN) - 1))
    cells = [shown(getattr(value, name)) for name in SHOWN]
    return (*cells[:-1], cells[-1] if _small_is_bad(base) else "")


def _mean_cell(value: Value | None) -> str:
    if value is None:
        return ABSENT
    return mean_and_sd(value.mean, value.sd) if isinstance(value, Statistics) else shown(value)


def _spread_cell(value: Value | None, names: Sequence[str]) -> str:
    if not isinstance(value, Statistics):
        return ABSENT
    return " / ".join(shown(getattr(value, name)) for name in names)


def _thesis_row(evaluation: Evaluation, statistic: str, heads: int) -> Row:
    values = [evaluation.metrics[name] for name in HEAD_POSE]
    label = statistic if heads == 1 else f"{evaluation.name} {statistic}"
    return Row(label, tuple(shown(getattr(value, statistic, float("nan"))) for value in values))


def _lines(evaluation: Evaluation) -> list[str]:
    renderer = evaluation.run.get("renderer")
    lines = [f"renderer: {renderer}"] if renderer else []
    lines += [f"note: {note}" for note in evaluation.notes]
    lines += [f"lost data: {loss_line((loss,))}" for loss in evaluation.losses]
    return [*lines, *_absent_lines(evaluation.absent)]


def _absent_lines(absent: Mapping[str, str]) -> Iterator[str]:
    """Yield one line per reason; parts are left out if the whole is also missing."""
    # With 21 joints per metric, listing the parts of missing metrics would hide everything else.
    wholes = [base for base in absent if base.partition(".")[0] == base or base.split(".")[0] not in absent]
    for reason in dict.fromkeys(absent[base] for base in wholes):
        names = ", ".join(base for base in wholes if absent[base] == reason)
        yield f"not available ({reason}): {names}"


# Tables with a row per result, worst first


MOST_SHOWN = 50
"""Default number of result rows."""
MOST_LINES = 20
"""Maximum number of lines below the tables."""
NEW = "new"
"""Change of a result that is not in the baseline."""


def row_table(results: ResultSet, most: int = MOST_SHOWN) -> Table:
    """Return the table of a set. Headings have two lines; the second is the first row.

    Args:
        results: the set.
        most: maximum number of results, worst first; 0 for all.
    """
    headings = [heading(figure) for figure in results.figures]
    if results.compared and results.worst_by in results.figures:
        unit = heading(results.worst_by)[1].rpartition(", ")[2]
        headings.insert(results.figures.index(results.worst_by) + 1, ("change", unit))
    if results.judged:
        headings.append(("gates", "failed"))
    kept = results.rows[:most] if most else results.rows
    body = [Row("", tuple(below for _, below in headings))]
    body += [Row(one.name, _row_cells(one, results)) for one in kept]
    total = Row(f"TOTAL of {len(results.rows)}", _row_cells(results.total, results))
    title = f"Worst first{f': {results.title}' if results.title else ''}"
    return Table(title, tuple(above for above, _ in headings), (Section("", (*body, total)),))


def _row_cells(row: ResultRow, results: ResultSet) -> tuple[str, ...]:
    cells: list[str] = []
    for figure in results.figures:
        value = row.value(figure)
        cells.append(ABSENT if value is None else shown(value))
        if results.compared and figure == results.worst_by:
            cells.append(shown_change(row, figure))
    return (*cells, *([str(row.failed)] if results.judged else []))


def shown_change(row: ResultRow, figure: str) -> str:
    """Format the change of a value with its sign, or "new" for results that are not in the baseline."""
    change = row.change(figure)
    if change is None:
        return NEW if row.baseline is None and not isinstance(row.measured, Pool) else ABSENT
    text = shown(abs(change))
    return "0" if text == "0" else f"{'-' if change < 0 else '+'}{text}"


def row_lines(sets: Sequence[ResultSet], most: int = MOST_SHOWN) -> list[str]:
    """Return the lines below the tables: columns, hidden rows, and reasons for missing totals."""
    lines: list[str] = []
    for one in sets:
        names = ", ".join(dict.fromkeys(figure for figure in one.figures))
        what = f"{one.title}: " if one.title else ""
        lines.append(f"{what}columns: {names}; sorted by {one.worst_by}; TOTAL: over all frames")
        if most and len(one.rows) > most:
            lines.append(
                f"{what}showing the worst {most} of {len(one.rows)} results; use --worst 0 for all "
                "(--json, --csv and --html include all)"
            )
        lines += [f"{what}{line}" for line in total_lines(one)]
    return lines


def total_lines(results: ResultSet) -> list[str]:
    """Return the reasons for missing totals, one line per reason."""
    reasons: dict[str, list[str]] = {}
    for figure in results.figures:
        reason = figure_of(results.pool, figure).reason
        if reason:
            reasons.setdefault(reason, []).append(figure)
    return [f"no total for {', '.join(figures)}: {reason}" for reason, figures in reasons.items()]


def fewer(lines: Sequence[str]) -> list[str]:
    """Return at most ``MOST_LINES`` lines, the last one with the number of omitted lines."""
    if len(lines) <= MOST_LINES:
        return list(lines)
    return [*lines[: MOST_LINES - 1], f"{len(lines) - MOST_LINES + 1} more notes; --json includes all"]


# Tables of comparisons


NOT_COMPARED = (
    "not compared: no two results have the same recording and common metrics; "
    "use --group to compare groups of results"
)
COLUMNS = ("difference", "95 % CI low", "high", "p", "pairs")


def comparison_tables(comparison: Comparison, *, parts: bool = False) -> list[Table]:
    """Return a table of the groups, if any, and a table of differences for each pair.

    Args:
        comparison: the comparison.
        parts: include metrics of single fingers, joints, angles and points.
    """
    pairs = dict.fromkeys((one.first, one.second) for one in comparison.differences)
    differences = [_differences(_shown(comparison, *pair, parts=parts), *pair) for pair in pairs]
    return [_groups(comparison), *differences] if comparison.groups else differences


def comparison_lines(comparison: Comparison, *, parts: bool = False) -> list[str]:
    """Return the lines below the tables: statistical methods and notes."""
    lines = [f"pairs: {comparison.unit}; p: two-sided Wilcoxon signed-rank test; CI: BCa bootstrap"]
    for first, second in dict.fromkeys((one.first, one.second) for one in comparison.differences):
        shown = _shown(comparison, first, second, parts=parts)
        for note in dict.fromkeys(one.note for one in shown if one.note):
            figures = [one.figure for one in shown if one.note == note]
            about = "" if len(figures) == len(shown) else f": {', '.join(figures)}"
            lines.append(f"{_name(first, second)}: {note}{about}")
    return [*lines, *comparison.notes]


def _shown(comparison: Comparison, first: str, second: str, *, parts: bool) -> list[Difference]:
    """Return the differences of a pair of results or groups."""
    return [
        one
        for one in comparison.differences
        if (one.first, one.second) == (first, second) and (parts or split_address(one.figure).part is None)
    ]


def _groups(comparison: Comparison) -> Table:
    """Return the table with mean and sd over the results of each group."""
    groups = comparison.groups
    figures = list(dict.fromkeys(figure for summary in groups.values() for figure in summary))
    counts = Row("results", tuple(_largest_count(summary.values()) for summary in groups.values()))
    rows = [
        Row(figure, tuple(_cell(summary.get(figure)) for summary in groups.values()), figure)
        for figure in figures
    ]
    return Table("Groups, mean \u00b1 sd over results", tuple(groups), (Section("", (counts, *rows)),))


def _largest_count(summaries: Iterable[Statistics]) -> str:
    return str(max((one.count for one in summaries), default=0))


def _cell(summary: Statistics | None) -> str:
    return mean_and_sd(summary.mean, summary.sd) if summary is not None and summary.count else ABSENT


def _differences(found: list[Difference], first: str, second: str) -> Table:
    rows = tuple(Row(one.figure, _difference_cells(one), one.figure) for one in found)
    return Table(_name(first, second), COLUMNS, (Section("", rows),))


def _difference_cells(one: Difference) -> tuple[str, ...]:
    if not one.paired.count:
        return (*[ABSENT] * 4, "0")
    numbers = (one.paired.difference, one.paired.low, one.paired.high)
    return (
        *(ABSENT if isnan(number) else shown(number) for number in numbers),
        shown_p(one.paired.p_value),
        str(one.paired.count),
    )


def shown_p(p_value: float) -> str:
    """Format a p-value with two digits, or as below 0.0001."""
    return "<0.0001" if p_value < 1e-4 else f"{p_value:.2g}"


def _name(first: str, second: str) -> str:
    return f"{second} - {first}"
