"""``posetrack batch``: run a tracker on many recordings, on one machine or a Dask cluster."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from posetrack_cli.cli.batch_commands import BATCH_COMMANDS, BatchCommand, BatchProgress
from posetrack_cli.cli.command import Command, option, volume_options
from posetrack_cli.cli.options import (
    FILE,
    WRITTEN,
    FiniteRange,
    gate_options,
    junit_option,
    markdown_option,
    option_group,
    options_of,
)
from posetrack_cli.cli.process import LEAST_DATA_BYTES, stop_signals
from posetrack_cli.cli.terminal import STANDARD_OUTPUT, print_data, print_line, print_note
from posetrack_cli.errors import EXIT_DONE, PosetrackError, UsageError

if TYPE_CHECKING:
    from posetrack_cli.batch.jobs import Job, Limits, Outcome
    from posetrack_cli.batch.scheduling import PieceArguments
    from posetrack_cli.batch.sources import Source
    from posetrack_cli.batch.summary import Judging, Summary

_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}
_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", re.IGNORECASE)


class Size(click.ParamType[int]):
    """A number of bytes, such as ``2G`` or ``1500M``."""

    name = "size"

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> int:
        """Return the number of bytes.

        Raises:
            click.BadParameter: the value is not a size, or too small for any run.
        """
        if isinstance(value, int):
            return value
        found = _SIZE.fullmatch(str(value).strip())
        if found is None:
            self.fail(f"{value!r} is not a size such as 2G or 1500M.", parameter, context)
        size = round(float(found[1]) * _UNITS[found[2].upper()])
        if size < LEAST_DATA_BYTES:
            self.fail(f"{value} is too small; a run needs at least 512M.", parameter, context)
        return size


# Options of every batch command
BATCH_OPTIONS = options_of(
    option_group(
        option(
            "-o",
            "--output",
            "results",
            metavar="FOLDER",
            required=True,
            type=FILE,
            help="Output folder; created if missing. Finished results are reused.",
            meaning="Output file or folder",
        ),
        option("--redo", is_flag=True, help="Track all recordings again and overwrite existing results."),
        option("--dry-run", is_flag=True, help="Show the action for each recording and exit."),
        option(
            "--remote",
            is_flag=True,
            help="Read URLs in lists and manifests (s3://, gs://, https://); those on the command line are "
            "always read.",
        ),
        option(
            "--reports/--no-reports", default=True, show_default=True, help="Write an HTML page per result."
        ),
        junit_option("Write gates as JUnit XML: a test per gate and result, and whether each was tracked."),
        markdown_option(),
        option_group(
            option(
                "--jobs",
                metavar="N",
                type=click.IntRange(1, 1024),
                help="Number of recordings to track in parallel on this machine.  [default: number of cores]",
            ),
            option(
                "--scheduler",
                metavar="ADDRESS",
                help="Address of a running Dask scheduler, e.g. tcp://host:8786.",
            ),
            option(
                "--scheduler-file",
                metavar="FILE",
                type=FILE,
                help="File with the scheduler's address, from dask scheduler --scheduler-file.",
            ),
            option("--dashboard", is_flag=True, help="Serve the Dask dashboard and print its address."),
            option(
                "--timeout",
                "timeout_s",
                metavar="S",
                type=FiniteRange(min=0.0, min_open=True),
                help="Time limit per recording, or per chunk, in seconds; the next batch resumes it.",
            ),
            option(
                "--memory-limit",
                metavar="SIZE",
                type=Size(),
                help="Memory limit per recording, e.g. 2G; a recording that exceeds it fails, the others go "
                "on.",
            ),
            option(
                "--chunk-s",
                metavar="S",
                type=FiniteRange(min=1.0),
                help="Split long recordings into chunks of S seconds, track them in parallel and join the "
                "results.",
            ),
            option(
                "--overlap-s",
                metavar="S",
                type=FiniteRange(min=0.0),
                default=2.0,
                show_default=True,
                help="Seconds tracked before a chunk's own frames, and with --smooth also after them.",
            ),
            title="Batch",
        ),
        gate_options,
        volume_options,
        title=WRITTEN,
    )
)


@click.group()
def batch() -> None:
    """Track many recordings in parallel; finished results are reused."""


@batch.group("hand")
def batch_hand() -> None:
    """Track hands in many recordings."""


@batch.group("head")
def batch_head() -> None:
    """Track heads in many recordings."""


def _command(command: BatchCommand) -> click.Command:
    """Return the batch command of a tracker: batch options plus those of the tracker."""
    argument = click.Argument(["recordings"], nargs=-1, required=True, metavar="RECORDING...")
    line = " ".join(command.words)

    @click.pass_context
    def callback(context: click.Context, /, recordings: tuple[str, ...], **options: Any) -> None:
        own = {str(one.name): options[str(one.name)] for one in BATCH_OPTIONS if one.expose_value}
        run_batch_command(command, recordings, command.arguments(context), own)

    return Command(
        command.words[-1],
        params=[argument, *BATCH_OPTIONS, *command.parameters],
        callback=callback,
        examples=command.examples,
        short_help=command.command.short_help and f"Run posetrack {line} on many recordings.",
        help=f"""Run posetrack {line} on each RECORDING: files, folders, quoted patterns such as
        'in/**/*.mcap', lists of these (.txt, one per line), or manifests (.toml) with options per recording.

        The output folder receives one result per recording, summary.csv, summary.json and index.html. Each
        result is identical to that of posetrack {line}. After an interruption or failure, run the same
        command again: results of the same input, options and version are reused, partial ones resumed.

        Exit code 1: a gate failed. Exit code 3: a recording failed, or some of its data was unusable. Exit
        code 130: interrupted. Further options are those of posetrack {line}.
        """,
    )


for _one in BATCH_COMMANDS.values():
    {"hand": batch_hand, "head": batch_head}[_one.words[0]].add_command(_command(_one))


@dataclass(frozen=True)
class _Plan:
    jobs: tuple[Job, ...]
    limits: Limits
    piece_arguments: PieceArguments | None
    command: BatchCommand

    def person_arguments(self, job: Job, learned: Sequence[Job]) -> tuple[str, ...]:
        """Return the options of a job that takes the shape of its person from other results."""
        shared = self.command.share(learned)
        return self.command.of_person(job.arguments, learned[0]) if shared else job.arguments


def run_batch_command(
    command: BatchCommand, recordings: Sequence[str], arguments: tuple[str, ...], options: dict[str, Any]
) -> None:
    """Run a batch, or print its plan for --dry-run.

    Args:
        command: the tracker's command.
        recordings: files, folders, patterns, lists or manifests.
        arguments: options for the tracker.
        options: options of the batch.
    """
    from posetrack_cli.batch.sources import find_sources

    if options["scheduler"] is not None and options["scheduler_file"] is not None:
        what = "--scheduler and --scheduler-file are mutually exclusive"
        raise UsageError(what, hint="leave one of them out")
    sources = find_sources(recordings, options["results"], remote=options["remote"])
    plan = _planned(command, sources, arguments, options)
    judging = _judging(options)
    if options["dry_run"]:
        _show_plan(plan)
        return
    from posetrack_cli.batch.summary import markdown_of, summarise, write_summary

    folder = options["results"]
    _make_folder(folder)
    with _locked(folder):
        # The test for case needs the folder to exist, so names that differ only in case are checked late.
        if _folds_case(folder):
            _check_places(folder, plan.jobs, str.casefold)
        outcomes = _run(plan, options)
        summary = summarise(plan.jobs, outcomes, judging)
        write_summary(folder, summary, judging)
    if options["markdown"] == STANDARD_OUTPUT:
        print_data(markdown_of(summary, judging))
    _close(folder, summary)


def _judging(options: dict[str, Any]) -> Judging:
    """Return the gates, baseline and reports, checked before the first job starts."""
    from posetrack_cli.batch.summary import Judging
    from posetrack_cli.evaluation.judging.assessment import Request
    from posetrack_cli.evaluation.judging.baseline import read_baseline
    from posetrack_cli.evaluation.judging.gates import all_gates
    from posetrack_cli.evaluation.reports.report_files import check_reports
    from posetrack_cli.evaluation.reports.table import MOST_SHOWN
    from posetrack_cli.evaluation.reports.writing import Reports

    baseline = options["baseline"]
    request = Request(
        gates=all_gates(options["conditions"], options["gate_files"]),
        baseline=None if baseline is None else read_baseline(baseline),
        baseline_tolerance=options["baseline_tolerance"],
    )
    reports = Reports(
        junit=options["junit"],
        markdown=None if options["markdown"] == STANDARD_OUTPUT else options["markdown"],
    )
    written = [path for path in (reports.junit, reports.markdown) if path is not None]
    inputs = [*options["gate_files"], *([] if baseline is None else [baseline])]
    check_reports(written, inputs, overwrite=True)  # a repeated batch rewrites its reports
    return Judging(request, reports, MOST_SHOWN)


def _planned(
    command: BatchCommand, sources: Sequence[Source], arguments: tuple[str, ...], options: dict[str, Any]
) -> _Plan:
    """Return the jobs and limits, checked before the first job starts."""
    from posetrack_cli.batch.jobs import Job, Limits, input_path, record_path
    from posetrack_cli.evaluation.judging.gates import parse_gate
    from posetrack_cli.text import one_line

    folder, chunk_s = options["results"], options["chunk_s"]
    jobs = []
    for source in sources:
        where = source.manifest or ""
        own = (*arguments, *command.arguments_of(source.options, where))
        command.check(own, where)
        if source.url and chunk_s:
            raise UsageError("--chunk-s does not apply to remote recordings", where=source.url)
        if chunk_s and "--faces=all" in own:
            raise UsageError("--chunk-s applies to one face", hint="leave out --faces all")
        for gate in source.gates:
            parse_gate(gate)
        jobs.append(
            Job(
                one_line(source.name),
                command.words,
                input_path(folder, source.name, source.path) if source.url else source.path,
                own,
                folder / f"{source.name}.mcap",
                record_path(folder, source.name),
                folder,
                source.truth,
                source.gates,
                folder / f"{source.name}.html" if options["reports"] else None,
                chunk_s=chunk_s or 0.0,
                overlap_s=options["overlap_s"] if chunk_s else 0.0,
                url=source.url,
                person=source.person,
            )
        )
    _check_places(folder, jobs)
    limits = Limits(options["memory_limit"], options["timeout_s"], redo=options["redo"])

    def piece_arguments(job: Job, number: int, learned: Path) -> tuple[str, ...]:
        return command.of_piece(job.arguments, number, learned)

    return _Plan(tuple(jobs), limits, piece_arguments if chunk_s else None, command)


def _check_places(folder: Path, jobs: Sequence[Job], alike: Callable[[str], str] = str) -> None:
    """Check that no two outputs have the same path.

    Args:
        folder: output folder.
        jobs: jobs of the recordings.
        alike: normalises a path; equal values are the same file (``str.casefold`` where case is ignored).

    Raises:
        UsageError: an output collides with another one or with a file of the batch.
    """
    from posetrack_cli.batch.jobs import RECORDS_FOLDER
    from posetrack_cli.batch.summary import PAGE, REPORT, TABLE
    from posetrack_cli.outputs import part_path

    taken = {alike(str(folder / one)): "a file of the batch" for one in (PAGE, TABLE, REPORT, RECORDS_FOLDER)}

    def check(what: str, path: Path, job: Job) -> None:
        if (other := taken.get(alike(str(path)))) is not None:
            hint = "set another name in a manifest" + (", or use --no-reports" if what == "page" else "")
            found = path.relative_to(folder)
            raise UsageError(
                f"its {what} would overwrite {other}", where=job.recording, found=found, hint=hint
            )

    for job in jobs:
        for what, path in (("result", job.output), ("page", job.page)):
            if path is not None:
                check(what, path, job)
                taken |= {
                    alike(str(one)): f"the {what} of {job.recording}" for one in (path, part_path(path))
                }
    # A name such as a.mcap/b would need a folder at the path of a file.
    for job in jobs:
        for above in job.output.relative_to(folder).parents[:-1]:
            check("folder", folder / above, job)


def _show_plan(plan: _Plan) -> None:
    """Print the action for each recording."""
    from posetrack_cli.batch.execution import planned_action

    first: dict[str, list[Job]] = {}  # recordings that determine a person
    for job in plan.jobs:
        known = first.setdefault(job.person, [])
        if job.person and len(known) == plan.command.determining:
            job = replace(job, arguments=plan.command.of_person(job.arguments, known[0]))
        else:
            known.append(job)
        try:
            way = planned_action(job, plan.limits)
        except PosetrackError as error:
            way = f"fail: {error}"
        print_line(f"{way}: {job.shown_recording} -> {job.output}")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise UsageError("output is a file", where=folder, expected="a folder") from error


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Lock an output folder against other batches."""
    from posetrack_cli.batch.jobs import RECORDS_FOLDER
    from posetrack_cli.files import open_output
    from posetrack_cli.outputs import check_not_written, lock, make_folder

    path = folder / RECORDS_FOLDER / "lock"
    make_folder(path.parent, folder)
    try:
        check_not_written(path)
    except UsageError as error:
        raise UsageError(
            "output folder is in use by another batch", where=folder, hint="wait, or choose another folder"
        ) from error
    with open_output(path) as stream:
        lock(stream)
        yield


def _folds_case(folder: Path) -> bool:
    """Return whether the folder's file system ignores case."""
    from posetrack_cli.batch.jobs import RECORDS_FOLDER

    return (folder / RECORDS_FOLDER.upper()).exists()  # the records folder exists, in lower case


def _run(plan: _Plan, options: dict[str, Any]) -> list[Outcome]:
    """Run the jobs with a progress bar."""
    from posetrack_cli.batch.engine import EngineOptions, open_engine
    from posetrack_cli.batch.execution import run_job
    from posetrack_cli.batch.jobs import RECORDS_FOLDER
    from posetrack_cli.batch.scheduling import run_batch

    scratch = options["results"] / RECORDS_FOLDER / "scratch"
    # The affinity respects taskset and container limits, unlike os.cpu_count.
    jobs = options["jobs"] or len(os.sched_getaffinity(0))
    if plan.piece_arguments is None:
        jobs = min(jobs, len(plan.jobs))  # cores are divided among jobs: a single one gets all of them
    where = EngineOptions(
        jobs, options["scheduler"], options["scheduler_file"], scratch, options["dashboard"]
    )
    with (
        _new_folder(scratch),
        BatchProgress(len(plan.jobs)) as shown,
        stop_signals() as stopped,
        open_engine(where, run_job, shown.on_progress, shown.note) as engine,
    ):
        return run_batch(
            engine,
            plan.jobs,
            plan.limits,
            plan.piece_arguments,
            plan.person_arguments,
            plan.command.determining,
            shown.on_outcome,
            stopped,
        )


@contextmanager
def _new_folder(path: Path) -> Iterator[None]:
    """Create an empty folder, and delete it at the end."""
    shutil.rmtree(path, ignore_errors=True)  # left by a batch that was killed
    path.mkdir()
    try:
        yield
    finally:
        shutil.rmtree(path, ignore_errors=True)


def _close(folder: Path, summary: Summary) -> None:
    """Print the closing lines and set the exit code."""
    from posetrack_cli.batch.jobs import State
    from posetrack_cli.batch.scheduling import states_line
    from posetrack_cli.batch.summary import DATA_LOST, PAGE

    outcomes = summary.outcomes
    print_note(f"{states_line(outcomes)}: {folder / PAGE}")
    for one in outcomes:
        if one.state is State.FAILED:
            print_note(f"failed: {one.name}: {one.reason}")
        elif one.lost_data:
            for remark in one.remarks or (DATA_LOST,):
                print_note(f"{one.name}: {remark}")
    for gate in summary.failed_gates:
        print_note(gate.line)
    _note_processors(summary)
    if any(one.state is State.STOPPED for one in outcomes):
        print_note("interrupted; run the same command again to continue")
    if summary.exit_code != EXIT_DONE:
        click.get_current_context().exit(summary.exit_code)


def _note_processors(summary: Summary) -> None:
    """Warn if the results come from different processors, which round differently."""
    from posetrack_cli.batch.jobs import State
    from posetrack_cli.build import only_in, processor_features

    kinds = set(summary.processors)
    # Reused results are compared with those that this machine would give.
    if any(one.state is State.KEPT for one in summary.outcomes):
        kinds.add(processor_features())
    if len(kinds) > 1:
        first, *others = sorted(kinds)
        found = "; ".join([only_in(first, others[0]), *(only_in(other, first) for other in others)])
        print_note(f"results come from different processor types and may differ in the last digits: {found}")
