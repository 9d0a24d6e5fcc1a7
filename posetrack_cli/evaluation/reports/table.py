"""The tables of reports: metrics, rows of results, comparisons."""

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

# Evaluations as tables of text, for the terminal and the HTML report alike


ABSENT = "-"
SHOWN = ("mean", "sd", "median", "p95", "max", "p5")
"""Columns of one result; the last is filled where small is bad."""
SPREAD, LOW_SPREAD = ("median", "p95", "max"), ("median", "p5")
"""What several results show below the mean, where large is bad and where small is."""

OFFSETS_TITLE = "Joint offsets removed, mm"
OFFSET_COLUMNS: tuple[str, ...] = ("x", "y", "z", "length")
"""Truth minus estimate, in the axes that a note names."""

RELIABILITY_COLUMNS: tuple[str, ...] = ("frames", "mean confidence", "share right")

MOST_NAMES = 4
"""How many results a line below the tables names."""


@dataclass(frozen=True)
class Row:
    """One line of a table.

    Attributes:
        label: what it is about.
        cells: one text per column.
        address: the metric's address without statistic, or empty.
        indent: 0 for a metric, 1 for what belongs to the metric above.
    """

    label: str
    cells: tuple[str, ...]
    address: str = ""
    indent: int = 0


@dataclass(frozen=True)
class Section:
    """Rows under a title of their own, which may be empty."""

    title: str
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class Table:
    """A title, headings of the columns (without that of the labels), and sections."""

    title: str
    columns: tuple[str, ...]
    sections: tuple[Section, ...]


RowsOf: TypeAlias = Callable[[str], list[Row]]
"""Makes the rows of a metric or a part, by its address."""


def tables(evaluations: Sequence[Evaluation], *, parts: bool = False) -> list[Table]:
    """Make the tables of results beside each other, in the catalogue's order, coverage always first.

    One result has a column for each statistic; of several each has a column with mean and sd, and below it
    median, 95th percentile and largest, or where small is bad median and 5th percentile. Metrics without a
    value are left out: see ``closing_lines``.

    Args:
        evaluations: at least one.
        parts: also a row for every joint, finger, angle or point.
    """
    more = (thesis_table(evaluations), offsets_table(evaluations))
    bases = [base for base in _bases(evaluations) if parts or "." not in base]
    title, columns, rows = (_of_one if len(evaluations) == 1 else _of_several)(evaluations)
    main = Table(title, columns, _sections((metric_of(base).group, rows(base)) for base in bases))
    return [main, *(table for table in more if table is not None)]


def catalogue_lines() -> Iterator[str]:
    """Yield every metric's address, unit and direction, and below it its meaning, for people to read."""
    for metric in CATALOGUE:
        part = f"[.{metric.part.upper()}]" if metric.part else ""
        statistic = "" if metric.scalar else ".STATISTIC"
        better = "" if metric.better == "neither" else f", {metric.better} is better"
        unit = f", {metric.unit}" if metric.unit else ""
        yield f"{metric.name}{part}{statistic}{unit}{better}"
        yield f"    {metric.meaning}"
    yield f"STATISTIC is one of {', '.join(STATISTIC_NAMES)}"
    lone = ", ".join(metric.name for metric in CATALOGUE if not is_pooled(metric.name))
    yield "pooled.NAME is the figure of the frames of all results together, or of each group; not of " + lone
    yield "p95(NAME), and so every STATISTIC, is that of the figures that the results have: p5(coverage)"


def pooled_table(pools: Sequence[Pool]) -> Table | None:
    """The figures of results together, or None where no two were pooled."""
    shown_pools = [pool for pool in pools if pool.says_more]
    if not shown_pools:
        return None
    bases = [base for base in _bases(shown_pools) if "." not in base]
    rows = (
        (metric_of(base).group, [_row(base, tuple(_mean_cell(one.metrics.get(base)) for one in shown_pools))])
        for base in bases
    )
    return Table("Pooled over results", tuple(pool.name for pool in shown_pools), _sections(rows))


def reliability_table(evaluations: Sequence[Evaluation], pools: Sequence[Pool]) -> Table | None:
    """How many frames of each confidence are right, of results and pools; None where no frame was judged.

    One result has columns of counts, mean confidences and shares right; of several each has a column.
    """
    every: list[Evaluation | Pool] = [*evaluations, *(pool for pool in pools if pool.says_more)]
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
    """What makes frames right, or far off, in the results that were judged."""
    judged = [one.judged for one in evaluations if one.judged is not None]
    lines = (f"right: {one.right_if}; far off: {one.far_if}" for one in judged)
    return list(dict.fromkeys(lines))


def pool_lines(pools: Sequence[Pool]) -> list[str]:
    """Why results have no figures together, or not all of them."""
    several = [pool for pool in pools if len(pool.results) > 1]
    return [f"{one.name}: {line}" for one in several for line in _absent_lines(one.absent)]


def _reliability_cells(one: Bin) -> tuple[str, ...]:
    if not one.count:
        return ("0", ABSENT, ABSENT)
    return (str(one.count), shown(one.confidence), shown(one.right))


def thesis_table(evaluations: Sequence[Evaluation]) -> Table | None:
    """Mean and sd of a head's six absolute errors side by side, or None where no result has them."""
    heads = [one for one in evaluations if all(name in one.metrics for name in HEAD_POSE)]
    if not heads:
        return None
    rows = tuple(_thesis_row(one, name, len(heads)) for one in heads for name in ("mean", "sd"))
    columns = tuple(name.replace("_", " ") for name in HEAD_POSE)
    return Table("Absolute errors of the pose", columns, (Section("", rows),))


def offsets_table(evaluations: Sequence[Evaluation]) -> Table | None:
    """The constant offset that each joint was rid of, or None where no result has any."""
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
    """x, y, z and length."""
    if name not in removed.names:
        return (ABSENT,) * len(OFFSET_COLUMNS)
    row = removed.names.index(name)
    values = np.round([*removed.offsets[row], removed.lengths[row]], 1) + 0.0  # no -0.0
    return tuple(f"{value:.1f}" for value in values)


def closing_lines(evaluations: Sequence[Evaluation]) -> list[str]:
    """What belongs under the tables: renderer, notes, metrics without a value and why, data lost.

    What holds for all results is said once, else with the names of those that it holds for.
    """
    of: dict[str, list[str]] = {}
    for one in evaluations:
        for line in dict.fromkeys(_lines(one)):
            of.setdefault(line, []).append(one.name)
    return [
        line if len(names) == len(evaluations) else f"{some_names(names)}: {line}"
        for line, names in of.items()
    ]


def some_names(names: Sequence[str]) -> str:
    """The names, of many the first ones and how many more there are."""
    if len(names) <= MOST_NAMES:
        return ", ".join(names)
    return f"{', '.join(names[: MOST_NAMES - 1])} and {len(names) - MOST_NAMES + 1} more"


def shown(value: float) -> str:
    """Show four digits without exponent; what looks exact is: 1 is 1, and 0.99999 is 1.0000."""
    if not math.isfinite(value):
        return str(value)
    size = abs(value)
    if value == int(value) and size < 1e15:
        return str(int(value))
    if size < 1e-3 or size >= 1e15:
        return f"{value:.3g}"
    return f"{value:.{max(0, min(4, 3 - math.floor(math.log10(size))))}f}"


def mean_and_sd(mean: float, sd: float) -> str:
    """Show both in one cell."""
    return f"{shown(mean)} \u00b1 {shown(sd)}"


def _of_one(evaluations: Sequence[Evaluation]) -> tuple[str, tuple[str, ...], RowsOf]:
    """Title, columns and the rows of an address of a table of the only result."""
    (evaluation,) = evaluations

    def rows(base: str) -> list[Row]:
        return [_row(base, _statistics_cells(base, evaluation.metrics[base]))]

    return evaluation.name, ("mean/value", *SHOWN[1:]), rows


def _of_several(evaluations: Sequence[Evaluation]) -> tuple[str, tuple[str, ...], RowsOf]:
    """The same of a table of results beside each other."""

    def rows(base: str) -> list[Row]:
        values = [one.metrics.get(base) for one in evaluations]
        main = _row(base, tuple(_mean_cell(value) for value in values))
        if main.indent or not any(isinstance(value, Statistics) for value in values):
            return [main]
        names = LOW_SPREAD if _small_is_bad(base) else SPREAD
        return [main, Row(" / ".join(names), tuple(_spread_cell(value, names) for value in values), base, 1)]

    return "Results", tuple(one.name for one in evaluations), rows


def _sections(grouped: Iterable[tuple[Group, list[Row]]]) -> tuple[Section, ...]:
    """The rows of each group of metrics together, in the order of the groups."""
    found: dict[Group, list[Row]] = {group: [] for group in GROUP_TITLES}
    for group, rows in grouped:
        found[group] += rows
    return tuple(Section(GROUP_TITLES[group], tuple(rows)) for group, rows in found.items() if rows)


def _bases(evaluations: Iterable[Measured]) -> list[str]:
    """Every address that a result has, in the catalogue's order; parts as they come."""
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
    lines += [f"data lost: {loss_line((loss,))}" for loss in evaluation.losses]
    return [*lines, *_absent_lines(evaluation.absent)]


def _absent_lines(absent: Mapping[str, str]) -> Iterator[str]:
    """One line for each reason; a part is left out where its whole is absent too."""
    wholes = [base for base in absent if base.partition(".")[0] == base or base.split(".")[0] not in absent]
    for reason in dict.fromkeys(absent[base] for base in wholes):
        names = ", ".join(base for base in wholes if absent[base] == reason)
        yield f"not measured ({reason}): {names}"


# Many results as a table of text: a row for each, the worst first, and one for all


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


# Comparisons as tables of text


NOT_COMPARED = (
    "not compared: no two results are of the same recording with figures in common; "
    "--group compares groups, recording by recording"
)
COLUMNS = ("difference", "95 % from", "to", "p", "pairs")


def comparison_tables(comparison: Comparison, *, parts: bool = False) -> list[Table]:
    """Make a table of the groups' figures, where there are groups, and one of each pair's differences.

    Args:
        comparison: what to show.
        parts: also figures of single fingers, joints, angles or points.
    """
    pairs = dict.fromkeys((one.first, one.second) for one in comparison.differences)
    differences = [_differences(_shown(comparison, *pair, parts=parts), *pair) for pair in pairs]
    return [_groups(comparison), *differences] if comparison.groups else differences


def comparison_lines(comparison: Comparison, *, parts: bool = False) -> list[str]:
    """What belongs under the tables: the unit of the test, and its notes; arguments as of the tables."""
    lines = [
        f"a pair is {comparison.unit}; p: Wilcoxon's signed-rank test, two-sided; interval: bootstrap, BCa"
    ]
    for first, second in dict.fromkeys((one.first, one.second) for one in comparison.differences):
        shown = _shown(comparison, first, second, parts=parts)
        for note in dict.fromkeys(one.note for one in shown if one.note):
            figures = [one.figure for one in shown if one.note == note]
            about = "" if len(figures) == len(shown) else f": {', '.join(figures)}"
            lines.append(f"{_name(first, second)}: {note}{about}")
    return [*lines, *comparison.notes]


def _shown(comparison: Comparison, first: str, second: str, *, parts: bool) -> list[Difference]:
    """The differences of a pair, with or without those of parts."""
    return [
        one
        for one in comparison.differences
        if (one.first, one.second) == (first, second) and (parts or split_address(one.figure).part is None)
    ]


def _groups(comparison: Comparison) -> Table:
    """Mean and sd of each figure over the results of a group."""
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
    """Show a p-value in two digits, and those below 0.0001 as such."""
    return "<0.0001" if p_value < 1e-4 else f"{p_value:.2g}"


def _name(first: str, second: str) -> str:
    return f"{second} - {first}"
