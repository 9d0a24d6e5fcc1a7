"""Summary of a batch: evaluation of all results, written as CSV, JSON and HTML with a row per recording."""

from __future__ import annotations

import base64
import json
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from html import unescape
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.parse import quote

from posetrack_cli import limits
from posetrack_cli.batch.jobs import Job, Outcome, State
from posetrack_cli.batch.scheduling import states_line
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED
from posetrack_cli.evaluation.html.components import DATA_URL, data_url
from posetrack_cli.evaluation.html.rows_page import RowsPage, Thumbnail, write_rows_html
from posetrack_cli.evaluation.judging.assessment import (
    MEASURED,
    Assessment,
    PerResultOptions,
    Request,
    assess,
    stated_options,
)
from posetrack_cli.evaluation.judging.gates import GateOutcome, parse_gate
from posetrack_cli.evaluation.judging.rows import ResultRow, worst_first
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.reports.report_files import json_report, write_report
from posetrack_cli.evaluation.reports.writing import Reports, report_texts
from posetrack_cli.files import read_text
from posetrack_cli.tables import csv_of
from posetrack_cli.text import printable_json

PAGE, TABLE, REPORT = "index.html", "summary.csv", "summary.json"
DATA_LOST = "part of the recording was unusable"
MOST_THUMBNAILS, THUMBNAIL_PX = 12, 240
PAGE_BYTES = 32 * limits.MIB
"""Limit of the size of a page that pictures are taken from; pages have at most 10 MB."""
_PICTURE = re.compile(
    rf'<figure><img src="{re.escape(DATA_URL)}([A-Za-z0-9+/=]+)" alt="[^"]*" width="\d+" height="\d+">'
    r"<figcaption>([^<]*)<"
)
TRACKED = "tracked"
"""Title of the gate that a recording has a result: the first of its test cases in JUnit."""


@dataclass(frozen=True)
class Judging:
    """How the results of a batch are evaluated.

    Attributes:
        request: common gates and baseline; ``summarise`` adds results and per-result options.
        reports: further reports, such as JUnit and Markdown.
        most: maximum number of results in the Markdown report.
    """

    request: Request
    reports: Reports
    most: int


@dataclass(frozen=True, eq=False)
class Summary:
    """Outcomes and evaluation of a batch.

    Attributes:
        jobs, outcomes: one per recording, in the same order.
        found: assessment of the results. Its first gates state whether each recording was tracked, so that
            all reports and the exit code agree.
    """

    jobs: tuple[Job, ...]
    outcomes: tuple[Outcome, ...]
    found: Assessment

    @property
    def unmeasured(self) -> Mapping[str, str]:
        """Reasons why results could not be evaluated, by name."""
        return {one.result: one.reason for one in self.found.outcomes if one.title == MEASURED}

    @property
    def processors(self) -> set[str]:
        """The CPU models that the results were computed on."""
        stated = (one.run.get("processor", "") for one in self.found.evaluations)
        return {kind for kinds in stated for kind in kinds.split("; ") if kind}

    @property
    def missing(self) -> tuple[Outcome, ...]:
        """Outcomes of the recordings without a result."""
        return tuple(one for one in self.outcomes if not one.has_result)

    @property
    def failed_gates(self) -> tuple[GateOutcome, ...]:
        """The failed gates, except those for recordings that were not tracked."""
        return tuple(one for one in self.found.failed if one.title != TRACKED)

    @property
    def exit_code(self) -> int:
        """Exit code of the batch; 0 if no test failed in any report."""
        if any(one.state is State.STOPPED for one in self.outcomes):
            return EXIT_INTERRUPTED
        if self.failed_gates:
            return EXIT_FAILED
        return EXIT_DATA_LOST if self.found.failed else EXIT_DONE


def summarise(
    jobs: Sequence[Job],
    outcomes: Sequence[Outcome],
    judging: Judging,
    report: Callable[[], Any] = lambda: None,
) -> Summary:
    """Evaluate the results of a batch.

    Args:
        jobs, outcomes: one per recording, in the same order.
        judging: gates, baseline and reports.
        report: called after each result.

    Raises:
        PosetrackError: a gate names a metric that no result has.
    """
    tracked = [job for job, outcome in zip(jobs, outcomes, strict=True) if outcome.has_result]
    request = replace(
        judging.request,
        results=tuple(job.output for job in tracked),
        layout="rows",
        own={
            job.output: PerResultOptions(job.name, job.truth, tuple(map(parse_gate, job.gates)))
            for job in tracked
        },
        lenient=True,  # an unreadable result is a row of the report, not an error of the batch
    )
    found = assess(request, report)
    found = replace(found, outcomes=(*map(_tracked_gate, outcomes), *found.outcomes))
    return Summary(tuple(jobs), tuple(outcomes), found)


def _tracked_gate(outcome: Outcome) -> GateOutcome:
    """Return the outcome of the gate that a recording was tracked completely."""
    reason = "stopped" if outcome.state is State.STOPPED else outcome.reason
    if outcome.lost_data:
        reason = "; ".join(outcome.remarks) or DATA_LOST
    value, failed = float(outcome.has_result), outcome.lost_data or not outcome.has_result
    return GateOutcome(TRACKED, outcome.name, value, failed, reason if failed else "result exists", TRACKED)


def write_summary(folder: Path, summary: Summary, judging: Judging) -> None:
    """Write the HTML page, the CSV table and the JSON report to the results folder, and requested reports.

    Raises:
        ResultError: a file cannot be written.
    """
    write_report(folder / TABLE, _table(summary))
    write_report(folder / REPORT, _report(summary, judging.request.options))
    write_rows_html(folder / PAGE, _page(folder, summary))
    for path, text in report_texts(summary.found, judging.request.options, judging.reports, judging.most):
        write_report(path, text)


def markdown_of(summary: Summary, judging: Judging) -> str:
    """Return the Markdown report."""
    options, reports = judging.request.options, Reports(markdown=Path("-"))
    ((_, text),) = report_texts(summary.found, options, reports, judging.most)
    return text


def _rows(summary: Summary) -> Iterator[tuple[Job, Outcome, ResultRow | None]]:
    """Yield all recordings: first those without a result or evaluation, then the others, worst first."""
    # Failures come first, as they need attention before any error.
    jobs = {job.name: job for job in summary.jobs}
    outcomes = {one.name: one for one in summary.outcomes}
    measured = _measured(summary)
    evaluated = {job.name for job, _ in measured}
    first = [one.name for one in summary.missing]
    between = [name for name in jobs if name not in evaluated and name not in first]
    for name in (*first, *between):
        yield jobs[name], outcomes[name], None
    for job, row in measured:
        yield job, outcomes[job.name], row


def _measured(summary: Summary) -> list[tuple[Job, ResultRow]]:
    """Return the rows with their recordings, worst first; there is one per subject."""
    jobs = {job.output: job for job in summary.jobs}
    rows = [(row, row.measured) for one in summary.found.sets for row in one.rows]
    return [(jobs[of.path], row) for row, of in rows if isinstance(of, Evaluation) and of.path in jobs]


def _table(summary: Summary) -> str:
    """Return the CSV table, one line per recording, or per subject of one with several."""
    figures = list(dict.fromkeys(name for one in summary.found.sets for name in (*one.figures, *one.further)))
    facts = ("name", "recording", "state", "reason")
    lines = [[*facts, *figures, "gates_failed", "seconds", "cpu_s", "frames_per_s", "peak_mb", "remarks"]]
    failed = Counter(one.result for one in summary.found.failed)
    for job, outcome, row in _rows(summary):
        values = ["" if row is None or (value := row.value(one)) is None else repr(value) for one in figures]
        lines.append(
            [
                *(_name(outcome, row), job.shown_recording, outcome.state.value, _reason(summary, outcome)),
                *values,
                str(failed[_name(outcome, row)]),
                *(f"{outcome.seconds:.2f}", f"{outcome.cpu_s:.2f}", _rate(outcome)),
                f"{outcome.peak_bytes / 1e6:.0f}",
                "; ".join(outcome.remarks),
            ]
        )
    return csv_of(lines)


def _name(outcome: Outcome, row: ResultRow | None) -> str:
    return outcome.name if row is None else row.name


def _reason(summary: Summary, outcome: Outcome) -> str:
    return outcome.reason or summary.unmeasured.get(outcome.name, "")


def _rate(outcome: Outcome) -> str:
    return f"{outcome.frames / outcome.seconds:.2f}" if outcome.seconds and outcome.frames else ""


def _report(summary: Summary, options: EvalOptions) -> str:
    """Return the JSON report: that of ``eval``, valid as a baseline, plus the outcome of each recording."""
    found = summary.found
    report = json.loads(
        json_report(
            worst_first(found.sets), stated_options(options), None, found.outcomes, found.pools, rows=True
        )
    )
    recordings = {job.name: _facts(summary, job, outcome) for job, outcome, _ in _rows(summary)}
    report["recordings"] = list(recordings.values())
    return printable_json(json.dumps(report, indent=1, ensure_ascii=False, allow_nan=False)) + "\n"


def _facts(summary: Summary, job: Job, outcome: Outcome) -> dict[str, Any]:
    return {
        "name": outcome.name,
        "recording": job.shown_recording,
        "result": str(job.output),
        "page": None if job.page is None or not job.page.is_file() else str(job.page),
        "state": outcome.state.value,
        "reason": _reason(summary, outcome),
        "last_lines": list(outcome.last_lines),
        "exit_code": outcome.exit_code,
        "frames_tracked": outcome.frames,
        "seconds": round(outcome.seconds, 3),
        "cpu_s": round(outcome.cpu_s, 3),
        "peak_bytes": outcome.peak_bytes,
        "data_lost": outcome.lost_data,
        "remarks": list(outcome.remarks),
    }


def _page(folder: Path, summary: Summary) -> RowsPage:
    found = summary.found
    missing = [(one.name, _failure(one)) for one in summary.missing]
    return RowsPage(
        found.sets,
        found.outcomes,
        found.notes,
        title=states_line(summary.outcomes),
        missing=missing,
        remarks=[(one.name, remark) for one in summary.outcomes for remark in one.remarks],
        links={
            row.name: _link(folder, job.page)
            for job, row in _measured(summary)
            if job.page is not None and job.page.is_file()
        },
        worst=tuple(_thumbnails(folder, summary)),
    )


def _thumbnails(folder: Path, summary: Summary) -> Iterator[Thumbnail]:
    """Yield reduced pictures of the worst frames of the worst results, from their pages."""
    with_pages = (
        (job.page, row) for job, row in _measured(summary) if job.page is not None and job.page.is_file()
    )
    for page, row in islice(with_pages, MOST_THUMBNAILS):
        with suppress(OSError, ValueError):  # a damaged page has no picture
            found = _PICTURE.search(read_text(page, PAGE_BYTES))
            if found is not None:
                yield Thumbnail(row.name, _link(folder, page), _reduced(found[1]), unescape(found[2]))


def _reduced(encoded: str) -> str:
    """Return a picture, PNG in base64, as a data URL of at most ``THUMBNAIL_PX``.

    Raises:
        ValueError: not a picture.
    """
    import cv2
    import numpy as np

    from posetrack_cli.evaluation.viewing.outputs import png_of

    stored = np.frombuffer(base64.b64decode(encoded, validate=True), np.uint8)
    picture = cv2.imdecode(stored, cv2.IMREAD_COLOR) if len(stored) else None
    if picture is None:
        raise ValueError("not a picture")
    scale = min(THUMBNAIL_PX / max(picture.shape[:2]), 1.0)
    return data_url(png_of(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)))


def _link(folder: Path, page: Path) -> str:
    # "./", as a name with a colon would be parsed as a URL scheme.
    return "./" + quote(os.fsencode(page.relative_to(folder)))


def _failure(outcome: Outcome) -> str:
    """Return why there is no result, with the last log lines that the reason does not already contain."""
    more = [line for line in outcome.last_lines if outcome.reason not in line]
    lines = f" (last lines: {' / '.join(more)})" if more else ""
    return f"{outcome.reason or outcome.state.value}{lines}"
