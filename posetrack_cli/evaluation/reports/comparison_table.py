"""Comparisons as tables of text."""

from __future__ import annotations

from collections.abc import Iterable
from math import isnan

from posetrack_cli.evaluation.comparing.comparison import Comparison, Difference
from posetrack_cli.evaluation.evaluation import Statistics
from posetrack_cli.evaluation.metrics.catalogue import split_address
from posetrack_cli.evaluation.reports.table import ABSENT, Row, Section, Table, mean_and_sd, shown

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
    rows = tuple(Row(one.figure, _cells(one), one.figure) for one in found)
    return Table(_name(first, second), COLUMNS, (Section("", rows),))


def _cells(one: Difference) -> tuple[str, ...]:
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
