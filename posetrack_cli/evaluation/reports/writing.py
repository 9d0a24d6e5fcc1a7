"""All reports of an assessment, by what they are called; commands say where they go."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from posetrack_cli.evaluation.assessment import Assessment, stated_options
from posetrack_cli.evaluation.evaluate import EvalOptions
from posetrack_cli.evaluation.html.rows_page import RowsPage
from posetrack_cli.evaluation.reports.junit import junit_report
from posetrack_cli.evaluation.reports.markdown import markdown_report
from posetrack_cli.evaluation.reports.report_files import (
    csv_report,
    csv_rows,
    curve_report,
    json_report,
)
from posetrack_cli.evaluation.reports.row_table import MOST_SHOWN
from posetrack_cli.evaluation.rows import worst_first


@dataclass(frozen=True)
class Reports:
    """Where the reports that are texts go; None writes none.

    Attributes:
        json, csv, curve: see ``report_files``.
        junit: see ``junit``.
        markdown: see ``markdown``.
    """

    json: Path | None = None
    csv: Path | None = None
    curve: Path | None = None
    junit: Path | None = None
    markdown: Path | None = None


def report_texts(
    found: Assessment, options: EvalOptions, reports: Reports, most: int = MOST_SHOWN
) -> Iterator[tuple[Path, str]]:
    """Yield the text of each report that is asked for, with its place.

    Args:
        found: what was found out.
        options: how results were measured.
        reports: where the reports go.
        most: how many results Markdown lists, the worst; 0 for all.

    Raises:
        UsageError: a curve is asked for, and no result has one.
    """
    if reports.json is not None:
        shown = worst_first(found.sets) if found.rows else found.evaluations
        stated = stated_options(options)
        text = json_report(shown, stated, found.comparison, found.outcomes, found.pools, rows=found.rows)
        yield reports.json, text
    if reports.csv is not None:
        in_columns = csv_report(found.evaluations, found.comparison, found.pools) if not found.rows else ""
        yield reports.csv, csv_rows(found.sets) if found.rows else in_columns
    if reports.curve is not None:
        yield reports.curve, curve_report(found.evaluations)
    if reports.junit is not None:
        yield reports.junit, junit_report(found.outcomes)
    if reports.markdown is not None:
        yield reports.markdown, markdown_report(found.sets, found.outcomes, found.notes, most)


def rows_page_of(found: Assessment) -> RowsPage:
    """Return the page that shows results as rows."""
    return RowsPage(found.sets, found.outcomes, found.notes, found.comparison)
