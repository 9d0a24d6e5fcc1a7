"""Report of a study: Markdown tables, paired tests, targets, and all figures as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarking.rows import source
from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.judging.comparing import Paired, paired
from posetrack_cli.evaluation.reports.report_files import finite

NOTHING = "-"
Figures = Mapping[str, float]
PAIR_COLUMNS = ("n", "first", "second", "difference [95 %]", "p", "p adjusted", "second lower on")


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    name: str  # of the figure
    title: str  # heading with unit
    digits: int = 2  # decimals
    percent: bool = False  # whether to show a share in percent
    whole: str = "mean"  # NumPy function that summarises recordings or people; empty for none
    spread: bool = False  # whether to show the standard deviation

    def cell(self, figures: Figures) -> str:
        """Return the cell of a figure."""
        sd = figures.get(f"{self.name} sd") if self.spread else None
        shown = number(figures.get(self.name), self.digits, self.percent)
        return shown if sd is None else f"{shown} ± {number(sd, self.digits, self.percent)}"


def number(value: float | None, digits: int = 2, percent: bool = False) -> str:
    """Format a number for a table; ``NOTHING`` for None and NaN."""
    if value is None or value != value:
        return NOTHING
    return f"{100.0 * value:.{digits}f} %" if percent else f"{value:.{digits}f}"


def values_of(rows: Iterable[Figures], name: str) -> FloatArray:
    """Return the existing values (n,) of a figure."""
    return np.array([row[name] for row in rows if row.get(name, np.nan) == row.get(name, np.nan)])


def over(rows: Iterable[Figures], name: str, how: str = "mean") -> float | None:
    """Summarise a figure over recordings or people by a NumPy function; None without values."""
    values = values_of(rows, name)
    return float(getattr(np, how)(values)) if len(values) else None


def whole(columns: Iterable[Column], rows: Sequence[Figures]) -> dict[str, float]:
    """Return the summaries of columns over recordings or people."""
    found: dict[str, float] = {}
    for column in columns:
        if column.whole and (summary := over(rows, column.name, column.whole)) is not None:
            found[column.name] = summary
        if column.spread and len(values := values_of(rows, column.name)) > 1:
            found[f"{column.name} sd"] = float(values.std(ddof=1))
    return found


def pairs_of(first: Mapping[str, Figures], second: Mapping[str, Figures], name: str) -> FloatArray:
    """Return a figure of two entrants, (n, 2), for the recordings with both values."""
    both = ((first[key], second[key]) for key in first if key in second)
    return np.array(
        [[row[name] for row in pair] for pair in both if all(name in row for row in pair)]
    ).reshape(-1, 2)


def adjusted(p_values: Sequence[float]) -> FloatArray:
    """Return p-values (n,) adjusted for multiple tests (Benjamini and Hochberg 1995); NaN is ignored."""
    from scipy.stats import false_discovery_control

    found = np.array(p_values, dtype=np.float64)
    known = np.isfinite(found)
    if known.any():
        found[known] = false_discovery_control(found[known])
    return found


@dataclass
class Report:
    """Report of a study, filled part by part."""

    lines: list[str] = field(default_factory=list)  # Markdown
    # figure, target, measurement, whether the target was reached
    targets: list[tuple[str, str, str, str]] = field(default_factory=list)
    # figures for the JSON file by part and row
    notes: dict[str, dict[str, Any]] = field(default_factory=dict)

    def text(self, *paragraphs: str) -> None:
        """Add paragraphs."""
        for one in paragraphs:
            self.lines += [one, ""]

    def picture(self, path: Path, caption: str) -> None:
        """Add a picture in the output folder."""
        self.text(f"![{caption}]({path.name})")

    def table(self, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        """Add a table."""
        self.lines += [f"| {' | '.join(header)} |", "|---" * len(header) + "|"]
        self.lines += [f"| {' | '.join(row)} |" for row in rows]
        self.lines.append("")

    def figures(
        self,
        part: str,
        columns: Sequence[Column],
        rows: Mapping[str, Figures],
        groups: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        """Add a table of recordings or people, followed by summaries of all or of groups.

        Args:
            part: key of the figures in the JSON file.
            columns: columns of the table.
            rows: figures by name.
            groups: names by title of a group; None for one summary of all.
        """
        titles = {"**all**": tuple(rows)} if groups is None else groups
        summaries = {title: whole(columns, [rows[name] for name in of]) for title, of in titles.items() if of}
        cells = {**rows, **(summaries if rows else {})}
        self.table(
            ("", *(c.title for c in columns)),
            ([name, *(c.cell(found) for c in columns)] for name, found in cells.items()),
        )
        for name, found in cells.items():
            self.note(part, name.strip("*"), found)

    def entrants(self, part: str, columns: Sequence[Column], rows: Mapping[str, Sequence[Figures]]) -> None:
        """Add a table with one row per entrant, summarised over its recordings."""
        found = {title: whole(columns, of) for title, of in rows.items() if any(of)}
        self.figures(part, columns, found, {})

    def pairs(self, part: str, titles: Sequence[str], rows: Mapping[Any, FloatArray]) -> list[Paired]:
        """Add a table of paired comparisons with bootstrap intervals and Wilcoxon signed-rank tests.

        Args:
            part: key of the figures in the JSON file.
            titles: headings of the first columns.
            rows: figures (n, 2) of two entrants by the cells of the first columns.
        """
        found = [paired(*values.T) for values in rows.values()]
        cells = []
        for (first, values), said, p in zip(
            rows.items(), found, adjusted([one.p_value for one in found]), strict=True
        ):
            self.note(part, ", ".join(first), asdict(said))
            sds = [f" ± {one.std(ddof=1):.2f}" if len(one) > 1 else "" for one in values.T]
            means = [
                f"{one.mean():.2f}{sd}" if len(one) else NOTHING
                for one, sd in zip(values.T, sds, strict=True)
            ]
            interval = f" [{said.low:+.2f}, {said.high:+.2f}]" if said.count > 1 else ""
            tests = [f"{said.difference:+.2f}{interval}", f"{said.p_value:.2g}", f"{p:.2g}"]
            lower = f"{int((values[:, 1] < values[:, 0]).sum())} of {said.count}"
            cells.append([*first, str(said.count), *means, *(tests if said.count else [NOTHING] * 3), lower])
        self.table((*titles, *PAIR_COLUMNS), cells)
        return found

    def judge(
        self,
        what: str,
        value: float | None,
        *,
        most: float | None = None,
        least: float | None = None,
        digits: int = 2,
        percent: bool = False,
    ) -> None:
        """Compare a figure with its target; None and NaN count as not measured."""
        limits = ((">=", least), ("<=", most))
        shown = [f"{sign} {(100.0 if percent else 1.0) * one:g}" for sign, one in limits if one is not None]
        target, verdict = ", ".join(shown) + (" %" if percent else ""), "not measured"
        if value is not None and value == value:
            reached = (most is None or value <= most) and (least is None or value >= least)
            verdict = "reached" if reached else "**missed**"
        self.targets.append((what, target, number(value, digits, percent), verdict))

    def note(self, part: str, row: str, figures: Mapping[str, Any]) -> None:
        """Record figures for the JSON file."""
        self.notes.setdefault(part, {})[row] = dict(figures)

    def write(self, folder: Path, name: str, head: Iterable[str], failures: Sequence[str]) -> Path:
        """Write ``NAME.md`` and ``NAME.json``; return the former's path."""
        whole_report = Report()
        whole_report.text(*head)
        if self.targets:
            whole_report.text("## Targets")
            whole_report.table(("", "target", "measured", ""), self.targets)
        whole_report.lines += self.lines
        if failures:
            whole_report.text(f"{len(failures)} recordings failed and are left out:")
            whole_report.lines += [f"- {failure}" for failure in failures]
        path = folder / f"{name}.md"
        path.write_text("\n".join(whole_report.lines) + "\n", encoding="utf-8")
        found = {
            "source": source("scripts/reproduce"),
            "targets": self.targets,
            "figures": self.notes,
            "failures": list(failures),
        }
        text = json.dumps(finite(found), indent=1, ensure_ascii=False) + "\n"
        (folder / f"{name}.json").write_text(text, encoding="utf-8")
        return path
