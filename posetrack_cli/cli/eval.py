"""``posetrack eval``: measure results, compare them and check gates."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.options import (
    BOTH,
    FILE,
    FILE_OR_STANDARD_OUTPUT,
    TRACKS,
    chosen_tracks,
    gate_options,
    json_option,
    junit_option,
    markdown_option,
    of_option,
    option_group,
    overwrite_option,
    recording_option,
    track_option,
    truth_option,
)
from posetrack_cli.cli.terminal import (
    STANDARD_OUTPUT,
    bar,
    ignore_closed_pipe,
    is_quiet,
    print_data,
    print_line,
    print_note,
)
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_FAILED, UsageError

if TYPE_CHECKING:
    from posetrack_cli.evaluation.judging.assessment import Assessment, Layout, Request
    from posetrack_cli.evaluation.measuring.evaluation import Evaluation
    from posetrack_cli.evaluation.reports.table import Table
    from posetrack_cli.evaluation.viewing.pictures import Picture
    from posetrack_cli.losses import Loss

# Option names of the reports that are text
TEXT_REPORTS = ("json", "csv", "curve", "junit", "markdown")
WORST_FRAMES = 6


def _list_metrics(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value:
        from posetrack_cli.evaluation.reports.table import catalogue_lines

        for line in catalogue_lines():
            print_line(line)
        context.exit()


@click.command(
    "eval",
    cls=Command,
    examples=(
        "posetrack eval result.mcap --html report.html",
        "posetrack eval result.mcap --mcap evaluated.mcap",
        "posetrack eval result.mcap --truth joints.csv --joint-offsets palm",
        "posetrack eval result.mcap --fail-if 'coverage < 0.9'",
        "posetrack eval results/*.mcap --baseline baseline.json --junit junit.xml",
    ),
    former={"--layout": "--rows or --columns", "--tolerance-ms": "--truth-tolerance-ms"},
    short_help="Measure results against ground truth, compare them, check gates.",
)
@click.argument("results", metavar="RESULT...", nargs=-1, type=FILE)
@option_group(
    truth_option(
        "Ground truth: a recording, result, CSV file, or annotations of a public dataset.  "
        "[default: from the result]"
    ),
    option(
        "--face-truth",
        metavar="CSV",
        type=FILE,
        help="Landmarks of the face in its own frame: stamp_ns or t_s, and p0_x_mm to p67_z_mm (68 points).",
        rare=True,
    ),
    option(
        "--truth-tolerance-ms",
        metavar="MS",
        type=float,
        default=5.0,
        show_default=True,
        help="Maximum timestamp difference between an estimate and its ground truth.",
        rare=True,
    ),
    option(
        "--time-offset-s",
        metavar="S",
        type=float,
        default=0.0,
        help="Seconds to add to the ground truth timestamps.  [default: 0]",
        rare=True,
    ),
    option(
        "--align",
        type=click.Choice(["none", "rigid", "rigid+points", "similarity"]),
        default="none",
        show_default=True,
        help="Align before measuring: one constant rigid offset (rigid), plus a constant offset per point "
        "(rigid+points), or plus one scale, for a single camera (similarity).",
    ),
    option(
        "--joint-offsets",
        type=click.Choice(["bone", "palm", "camera"]),
        help="Remove each hand joint's median offset, for ground truth with other joint definitions: in the "
        "axes of the bone that ends at the joint, of the palm or of the camera.",
        rare=True,
    ),
    title="Ground truth",
)
@option_group(
    track_option(
        *TRACKS,
        BOTH,
        default=None,
        text="Track to measure; both measures and compares the two.  [default: filtered; both with --html]",
    ),
    of_option("measure"),
    option(
        "--group",
        "groups",
        metavar="NAME=PATTERN",
        multiple=True,
        help="Compare groups of results, e.g. pf='out/pf-*.mcap', paired by recording. Repeatable.",
    ),
    recording_option("Recording of the result; adds residuals against its images."),
    option(
        "--list-metrics",
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=_list_metrics,
        help="List all metrics with unit and meaning, and exit.",
    ),
    title="Measurement",
)
@option_group(
    option(
        "--rows/--columns",
        default=None,
        help="One row per result, worst first, and a pooled row; or one column per result, compared if of "
        "the same recording.  [default: rows for five or more recordings]",
    ),
    option(
        "--worst",
        metavar="N",
        type=click.IntRange(min=0),
        default=50,
        show_default=True,
        help="Maximum number of rows in the terminal and in Markdown, worst first; 0 for all.",
        rare=True,
    ),
    option(
        "--parts",
        is_flag=True,
        help="Also list every joint, finger, angle or point; with --rows only in JSON and CSV.",
        rare=True,
    ),
    option(
        "--honesty",
        is_flag=True,
        help="Also show a reliability table (share of correct frames by confidence), and pooled metrics for "
        "several results.",
        rare=True,
    ),
    title="Tables",
)
@option_group(
    option(
        "--html",
        type=FILE,
        metavar="FILE",
        help="Write an HTML page with tables and plots; with --rows a sortable table.",
    ),
    option(
        "--mcap",
        type=FILE,
        metavar="OUT",
        help="Write a copy of the result with metrics per frame as /eval/... topics, and totals, gates and "
        "ground truth source as metadata. OUT is a *.mcap file, or a folder for several results.",
    ),
    json_option("Write the full report as JSON, usable as --baseline."),
    option(
        "--csv",
        type=FILE_OR_STANDARD_OUTPUT,
        metavar="FILE|-",
        help="Write CSV: one metric per line; with --rows one result per line.",
    ),
    option(
        "--curve",
        type=FILE_OR_STANDARD_OUTPUT,
        metavar="FILE|-",
        help="Write CSV with the share of frames whose joint errors are below D = 0..100 mm.",
        rare=True,
    ),
    junit_option("Write gates as JUnit XML: one test per gate and result."),
    markdown_option(),
    overwrite_option("existing reports", "Reports"),
    title="Reports",
)
@gate_options
@volume_options
def evaluate(results: tuple[Path, ...], **options: Any) -> None:
    """Measure RESULTs against ground truth, or without it. Unfinished results can be measured as well.

    Results of the same recording are compared with the first one, second by second; groups are compared
    recording by recording (Wilcoxon signed-rank test, bootstrap interval). Results of many recordings get one
    row each, worst first, and a pooled row. With five or more results, an unreadable one fails and the others
    are still measured.

    Exit code 1: a gate failed or could not be evaluated; each is printed with its value on stderr. Exit code
    3: a result is unfinished or damaged, and its readable part was measured. If both apply, the exit code
    is 1.
    """
    from posetrack_cli.evaluation.judging.assessment import assess

    request = _request(results, options)
    outputs = _check_reports(request, options)
    with _progress(len(results) + sum(map(len, request.groups.values()))) as report:
        found = assess(request, report)
    _write_reports(found, request, options)
    lost = _write_mcaps(found, request, outputs, options["track"])
    with ignore_closed_pipe():
        _show(found, len(results), options)
        _show_files(outputs, options)
    _close(found, lost)


def _request(results: tuple[Path, ...], options: dict[str, Any]) -> Request:
    """Return what to measure, checked before the first result is read."""
    from posetrack_cli.evaluation.judging.assessment import Request
    from posetrack_cli.evaluation.judging.baseline import read_baseline
    from posetrack_cli.evaluation.judging.comparing import expand_groups
    from posetrack_cli.evaluation.judging.gates import all_gates
    from posetrack_cli.evaluation.measuring.evaluate import EvalOptions

    groups = expand_groups(options["groups"])
    if not (results or groups):
        raise UsageError("no result to evaluate", hint="see: posetrack eval --help")
    names = ("truth", "time_offset_s", "align", "recording", "joint_offsets", "face_truth")
    track = options["track"]
    return Request(
        results=results,
        groups=groups,
        options=EvalOptions(
            **{name: options[name] for name in names}, tolerance_ms=options["truth_tolerance_ms"]
        ),
        tracks=chosen_tracks(track),
        page=options["html"] is not None and track is None,
        layout=_layout(options["rows"]),
        parts=options["parts"],
        gates=all_gates(options["conditions"], options["gate_files"]),
        baseline=None if options["baseline"] is None else read_baseline(options["baseline"]),
        baseline_tolerance=options["baseline_tolerance"],
        keep_tracks=options["html"] is not None or options["mcap"] is not None,
        label=options["of"],
    )


def _layout(rows: bool | None) -> Layout | None:
    return None if rows is None else "rows" if rows else "columns"


def _check_reports(request: Request, options: dict[str, Any]) -> dict[Path, Path]:
    """Check that the reports can be written; return the --mcap output of each result."""
    from posetrack_cli.evaluation.reports.mcap_report import mcap_outputs
    from posetrack_cli.evaluation.reports.report_files import check_reports

    if options["junit"] is not None and not (request.gates or request.baseline):
        raise UsageError("--junit requires gates", expected="--fail-if, --gates or --baseline")
    names = (*TEXT_REPORTS, "html")
    reports = [options[name] for name in names if options[name] is not None]
    if reports.count(STANDARD_OUTPUT) > 1:
        raise UsageError("more than one report goes to standard output", hint="write the others to files")
    if STANDARD_OUTPUT in reports and sys.stdout is None:
        raise UsageError("standard output is closed", hint="write the report to a file")
    # Checks come before the measurement, which may take minutes.
    if options["html"] is not None:
        from posetrack_cli.evaluation.html import check_page

        check_page(options["html"])
    given = [options[name] for name in ("truth", "face_truth", "recording", "baseline")]
    inputs = [*request.results, *options["gate_files"], *(path for path in given if path is not None)]
    inputs += [path for paths in request.groups.values() for path in paths]
    out, overwrite = options["mcap"], options["overwrite"]
    outputs = {} if out is None else mcap_outputs(out, request.paths, overwrite=overwrite)
    reports += [path for path in outputs.values() if path.parent.is_dir()]  # other folders are created later
    check_reports((path for path in reports if path != STANDARD_OUTPUT), inputs, overwrite=overwrite)
    return outputs


@contextmanager
def _progress(total: int) -> Iterator[Callable[[], Any]]:
    """Yield a function that advances a progress bar; no bar for a single result."""
    if total < 2:
        yield lambda: None
        return
    with bar("eval", "result", total, stays=False) as shown:
        yield shown.advance


def _write_reports(found: Assessment, request: Request, options: dict[str, Any]) -> None:
    """Write the text reports and the page, also if a gate failed."""
    from posetrack_cli.evaluation.reports.writing import Reports, report_texts

    reports = Reports(**{name: options[name] for name in TEXT_REPORTS})
    for path, text in report_texts(found, request.options, reports, options["worst"]):
        _write(path, text)
    if options["html"] is not None:
        write_page(found, options["html"], options["recording"])


def _write_mcaps(
    found: Assessment, request: Request, outputs: dict[Path, Path], track: str | None
) -> dict[str, tuple[Loss, ...]]:
    """Write copies of the results with metrics; return the losses of each by name."""
    from posetrack_cli.evaluation.reports.mcap_report import write_mcaps

    lost = {}
    with _progress(len(outputs)) as report:
        for name, losses in write_mcaps(found, request, outputs, None if track is None else request.tracks):
            lost[name] = losses
            report()
    return lost


def _write(path: Path, text: str) -> None:
    from posetrack_cli.evaluation.reports.report_files import write_report

    if path == STANDARD_OUTPUT:
        print_data(text)
    else:
        write_report(path, text)


def write_page(found: Assessment, path: Path, recording: Path | None) -> None:
    """Write the HTML page of results, with pictures of the worst frames if they can be rendered.

    Args:
        found: the assessment, with tracks.
        path: output file.
        recording: recording to draw on; None searches for that of each result.
    """
    from posetrack_cli.evaluation.html import write_html, write_rows_html
    from posetrack_cli.evaluation.html.writer import ReportPage
    from posetrack_cli.evaluation.reports.writing import rows_page_of

    if found.rows:
        return write_rows_html(path, rows_page_of(found))
    pictures = {one.name: _pictures(one, recording) for one in found.on_page}
    title = ", ".join(one.name for one in found.evaluations)
    write_html(path, ReportPage(found.on_page, found.page_comparison, pictures, title, found.pools))


def _pictures(evaluation: Evaluation, given: Path | None) -> list[Picture] | str:
    """Return pictures of the worst frames, or the reason why there are none, which is also printed."""
    from posetrack_cli.errors import RenderingError

    try:
        pictures, reason = _worst_frames(evaluation, given)
    except RenderingError as error:
        pictures, reason = None, str(error)
    except ModuleNotFoundError as error:
        pictures, reason = None, f"{error.name} is not installed"
    if pictures is not None:
        return pictures
    print_note(f"{evaluation.name}: no pictures of the worst frames: {reason}")
    return reason


def _worst_frames(evaluation: Evaluation, given: Path | None) -> tuple[list[Picture] | None, str]:
    """Return pictures of the worst frames, or None and the reason why there are none."""
    from posetrack_cli.evaluation.reading.recording_of import search_recording
    from posetrack_cli.evaluation.viewing.pictures import worst_frame_pictures
    from posetrack_cli.results.reader import read_result

    result = read_result(evaluation.path).of(evaluation.label)
    search = search_recording(result, given, in_colour=True)
    if search.recording is None:
        return None, search.reason
    return worst_frame_pictures(evaluation, search.recording, WORST_FRAMES), ""


def _show(found: Assessment, given: int, options: dict[str, Any]) -> None:
    """Print the tables, unless standard output is closed or used by a report."""
    from posetrack_cli.evaluation.reports.table import (
        NOT_COMPARED,
        comparison_lines,
        comparison_tables,
        criterion_lines,
        pool_lines,
        pooled_table,
        reliability_table,
    )
    from posetrack_cli.evaluation.reports.writing import print_tables

    if is_quiet() or sys.stdout is None or STANDARD_OUTPUT in [options[name] for name in TEXT_REPORTS]:
        return
    made, lines = _rows(found, options) if found.rows else _columns(found, given, options)
    if not found.rows and any(one.label for one in found.evaluations) and not options["honesty"]:
        made += [table for table in (pooled_table(found.pools),) if table is not None]
    if options["honesty"]:
        columns = () if found.rows else found.evaluations
        more = (reliability_table(columns, found.pools), pooled_table(found.pools))
        made += [table for table in more if table is not None]
        lines += criterion_lines(found.evaluations) + ([] if found.rows else pool_lines(found.pools))
    if found.comparison is not None:
        made += comparison_tables(found.comparison, parts=options["parts"])
        lines += comparison_lines(found.comparison, parts=options["parts"])
    elif len({one.path for one in found.evaluations}) > 1 and not found.rows:
        lines.append(NOT_COMPARED)
    if found.outcomes:
        passed = len(found.outcomes) - len(found.failed)
        lines.append(f"gates: {passed} passed, {len(found.failed)} failed")
    print_tables(made, lines, sys.stdout)


def _show_files(outputs: dict[Path, Path], options: dict[str, Any]) -> None:
    """Print the written files, unless standard output is used by a report."""
    if STANDARD_OUTPUT in [options[name] for name in TEXT_REPORTS]:
        return
    written = [(name, options[name]) for name in (*TEXT_REPORTS, "html") if options[name] is not None]
    for name, path in (*written, *(("mcap", path) for path in outputs.values())):
        print_line(f"{path}: {name}, {path.stat().st_size} bytes")


def _columns(found: Assessment, given: int, options: dict[str, Any]) -> tuple[list[Table], list[str]]:
    """Return tables with one column per result, and the lines below them."""
    from posetrack_cli.evaluation.reports.table import closing_lines, tables

    shown = found.evaluations[:given] if found.grouped else found.evaluations
    return tables(shown, parts=options["parts"]) if shown else [], closing_lines(found.evaluations)


def _rows(found: Assessment, options: dict[str, Any]) -> tuple[list[Table], list[str]]:
    """Return tables with one row per result, and the lines below them."""
    from posetrack_cli.evaluation.reports.table import closing_lines, fewer, row_lines, row_table

    most = options["worst"]
    sets = [one for one in found.sets if not one.pool.grouped]  # groups have their own comparison table
    lines = fewer(closing_lines(found.evaluations))
    return [row_table(one, most) for one in sets], [*row_lines(sets, most), *lines]


def _close(found: Assessment, lost: dict[str, tuple[Loss, ...]]) -> None:
    """Print failed gates and losses on standard error, and set the exit code.

    Args:
        found: the assessment.
        lost: losses while copying results for --mcap, by name.
    """
    from posetrack_cli.losses import loss_line

    for note in found.notes:
        print_note(f"baseline: {note}")
    for outcome in found.failed:
        print_note(outcome.line)
    damaged = [one for one in found.evaluations if one.losses]
    for one in damaged:
        print_note(f"{one.name}: only the readable part was measured: {loss_line(one.losses)}")
    known = {one.name for one in damaged}
    cut = {name: losses for name, losses in lost.items() if losses and name not in known}
    for name, losses in cut.items():
        print_note(f"{name}: only the readable part was written: {loss_line(losses)}")
    # A failed gate takes precedence: CI should see it whatever else happened.
    context = click.get_current_context()
    if found.failed:
        context.exit(EXIT_FAILED)
    if damaged or cut:
        context.exit(EXIT_DATA_LOST)
