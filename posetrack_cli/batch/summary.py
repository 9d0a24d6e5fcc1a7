"""What came of a batch: every result measured, and one row for each recording as CSV, JSON and a page."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from posetrack_cli.batch.jobs import Job, Outcome, State
from posetrack_cli.batch.running import states_line
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, EXIT_FAILED, EXIT_INTERRUPTED
from posetrack_cli.evaluation.html.rows_page import RowsPage, write_rows_html
from posetrack_cli.evaluation.judging.assessment import (
    MEASURED,
    Assessment,
    Own,
    Request,
    assess,
    stated_options,
)
from posetrack_cli.evaluation.judging.gates import Gate, GateOutcome, parse_gate
from posetrack_cli.evaluation.judging.rows import ResultRow, worst_first
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions
from posetrack_cli.evaluation.reports.report_files import json_report, write_report
from posetrack_cli.evaluation.reports.writing import Reports, report_texts
from posetrack_cli.tables import csv_of
from posetrack_cli.text import printable_json

PAGE, TABLE, REPORT = "index.html", "summary.csv", "summary.json"
DATA_LOST = "some of the recording could not be used"
TRACKED = "tracked"
"""What a recording is that has a result: the first of its tests in JUnit."""


@dataclass(frozen=True)
class Judging:
    """How the results of a batch are judged.

    Attributes:
        request: gates for all and a baseline; results and what is asked of single ones are filled in.
        reports: further reports, such as JUnit and Markdown.
        most: how many results Markdown lists.
    """

    request: Request
    reports: Reports
    most: int


@dataclass(frozen=True, eq=False)
class Summary:
    """What came of a batch.

    Attributes:
        jobs, outcomes: of every recording, in one order.
        found: what was measured of the results; its first gates are whether each recording was tracked, so
            that all reports and the exit code judge alike.
    """

    jobs: tuple[Job, ...]
    outcomes: tuple[Outcome, ...]
    found: Assessment

    @property
    def unmeasured(self) -> Mapping[str, str]:
        """Results that cannot be measured, by name, and why."""
        return {one.result: one.reason for one in self.found.outcomes if one.title == MEASURED}

    @property
    def processors(self) -> set[str]:
        """The kinds of processor that the results were made on."""
        stated = (one.run.get("processor", "") for one in self.found.evaluations)
        return {kind for kinds in stated for kind in kinds.split("; ") if kind}

    @property
    def missing(self) -> tuple[Outcome, ...]:
        """The recordings without a result."""
        return tuple(one for one in self.outcomes if not one.is_there)

    @property
    def failed_gates(self) -> tuple[GateOutcome, ...]:
        """The gates that failed, without recordings that were not tracked."""
        return tuple(one for one in self.found.failed if one.title != TRACKED)

    @property
    def exit_code(self) -> int:
        """Of the batch: 0 where no test failed in any report."""
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
    """Measure what there is.

    Args:
        jobs, outcomes: of every recording, in one order.
        judging: how.
        report: called after each result.

    Raises:
        PosetrackError: a gate names what no result has.
    """
    there = [job for job, outcome in zip(jobs, outcomes, strict=True) if outcome.is_there]
    request = replace(
        judging.request,
        results=tuple(job.output for job in there),
        layout="rows",
        own={job.output: Own(job.name, job.truth, _gates(job)) for job in there},
        lenient=True,
    )
    found = assess(request, report)
    found = replace(found, outcomes=(*map(_tracked, outcomes), *found.outcomes))
    return Summary(tuple(jobs), tuple(outcomes), found)


def _gates(job: Job) -> tuple[Gate, ...]:
    return tuple(parse_gate(text) for text in job.gates)


def _tracked(outcome: Outcome) -> GateOutcome:
    """Whether a recording was tracked, all of it, told as gates are."""
    reason = "it was stopped" if outcome.state is State.STOPPED else outcome.reason
    if outcome.lost_data:
        reason = "; ".join(outcome.remarks) or DATA_LOST
    there, failed = outcome.is_there, outcome.lost_data or not outcome.is_there
    return GateOutcome(
        TRACKED, outcome.name, float(there), failed, reason if failed else "there is a result", TRACKED
    )


def write_summary(folder: Path, summary: Summary, judging: Judging) -> None:
    """Write the page, the table and the report into the folder of results, and what else is asked for.

    Raises:
        ResultError: a file cannot be written.
    """
    write_report(folder / TABLE, _table(summary))
    write_report(folder / REPORT, _report(summary, judging.request.options))
    write_rows_html(folder / PAGE, _page(folder, summary))
    for path, text in report_texts(summary.found, judging.request.options, judging.reports, judging.most):
        write_report(path, text)


def markdown_of(summary: Summary, judging: Judging) -> str:
    """Return the summary that ``Reports.markdown`` writes."""
    options, reports = judging.request.options, Reports(markdown=Path("-"))
    ((_, text),) = report_texts(summary.found, options, reports, judging.most)
    return text


def _rows(summary: Summary) -> Iterator[tuple[Job, Outcome, ResultRow | None]]:
    """Every recording: those without a result, those that cannot be measured, then the worst first."""
    jobs = {job.name: job for job in summary.jobs}
    outcomes = {one.name: one for one in summary.outcomes}
    measured = {row.name: row for one in summary.found.sets for row in one.rows}
    last = [name for name in measured if name in jobs]
    first = [one.name for one in summary.missing]
    between = [name for name in jobs if name not in measured and name not in first]
    for name in (*first, *between, *last):
        yield jobs[name], outcomes[name], measured.get(name)


def _table(summary: Summary) -> str:
    """A line for each recording, the worst first."""
    figures = list(dict.fromkeys(name for one in summary.found.sets for name in (*one.figures, *one.further)))
    facts = ("name", "recording", "state", "reason")
    lines = [[*facts, *figures, "gates_failed", "seconds", "cpu_s", "frames_per_s", "peak_mb", "remarks"]]
    failed = Counter(one.result for one in summary.found.failed)
    for job, outcome, row in _rows(summary):
        values = ["" if row is None or (value := row.value(one)) is None else repr(value) for one in figures]
        lines.append(
            [
                *(outcome.name, str(job.recording), outcome.state.value, _reason(summary, outcome)),
                *values,
                str(failed[outcome.name]),
                *(f"{outcome.seconds:.2f}", f"{outcome.cpu_s:.2f}", _rate(outcome)),
                f"{outcome.peak_bytes / 1e6:.0f}",
                "; ".join(outcome.remarks),
            ]
        )
    return csv_of(lines)


def _reason(summary: Summary, outcome: Outcome) -> str:
    return outcome.reason or summary.unmeasured.get(outcome.name, "")


def _rate(outcome: Outcome) -> str:
    return f"{outcome.frames / outcome.seconds:.2f}" if outcome.seconds and outcome.frames else ""


def _report(summary: Summary, options: EvalOptions) -> str:
    """The report of ``eval``, which serves as a baseline, with what came of each recording."""
    found = summary.found
    report = json.loads(
        json_report(
            worst_first(found.sets), stated_options(options), None, found.outcomes, found.pools, rows=True
        )
    )
    report["recordings"] = [_facts(summary, job, outcome) for job, outcome, _ in _rows(summary)]
    return printable_json(json.dumps(report, indent=1, ensure_ascii=False, allow_nan=False)) + "\n"


def _facts(summary: Summary, job: Job, outcome: Outcome) -> dict[str, Any]:
    return {
        "name": outcome.name,
        "recording": str(job.recording),
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
            job.name: "./" + quote(os.fsencode(job.page.relative_to(folder)))
            for job in summary.jobs
            if job.page is not None and job.page.is_file()
        },
    )


def _failure(outcome: Outcome) -> str:
    """Why there is no result, with the process's last lines where they say more."""
    more = [line for line in outcome.last_lines if outcome.reason not in line]
    lines = f" (last lines: {' / '.join(more)})" if more else ""
    return f"{outcome.reason or outcome.state.value}{lines}"
