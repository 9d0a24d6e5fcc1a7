"""``posetrack batch``: any of the trackers over many recordings, on one machine or on a cluster."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
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
            click.BadParameter: it is none, or less than any run needs.
        """
        if isinstance(value, int):
            return value
        found = _SIZE.fullmatch(str(value).strip())
        if found is None:
            self.fail(f"{value!r} is no size such as 2G or 1500M.", parameter, context)
        size = round(float(found[1]) * _UNITS[found[2].upper()])
        if size < LEAST_DATA_BYTES:
            self.fail(f"{value} is less than any run needs; 512M or more.", parameter, context)
        return size


BATCH_OPTIONS = options_of(
    option_group(
        option(
            "-o",
            "--output",
            "results",
            metavar="FOLDER",
            required=True,
            type=FILE,
            help="Where to write. A folder, made if it is not there; what is finished in it is kept.",
        ),
        option("--redo", is_flag=True, help="Track everything anew, and replace what is there."),
        option("--dry-run", is_flag=True, help="Say what would be done with each recording, and exit."),
        option(
            "--reports/--no-reports", default=True, show_default=True, help="Write a page about each result."
        ),
        junit_option("One test for each and each result; also whether it was tracked."),
        markdown_option(),
        option_group(
            option(
                "--jobs",
                metavar="N",
                type=click.IntRange(1, 1024),
                help="Recordings at a time on this machine.  [default: one for each core]",
            ),
            option(
                "--scheduler",
                metavar="ADDRESS",
                help="A Dask cluster that exists, such as tcp://host:8786.",
            ),
            option(
                "--scheduler-file",
                metavar="FILE",
                type=FILE,
                help="The same by the file that its dask scheduler --scheduler-file writes.",
            ),
            option(
                "--dashboard", is_flag=True, help="Serve Dask's page about the jobs, and print its address."
            ),
            option(
                "--timeout",
                "timeout_s",
                metavar="S",
                type=FiniteRange(min=0.0, min_open=True),
                help="Stop a recording, or a piece of one, after so many seconds; the next batch goes on "
                "with it.",
            ),
            option(
                "--memory-limit",
                metavar="SIZE",
                type=Size(),
                help="Memory that each recording's process may take, such as 2G; one that needs more "
                "fails alone.",
            ),
            option(
                "--chunk-s",
                metavar="S",
                type=FiniteRange(min=1.0),
                help="Track long recordings in pieces of so many seconds, side by side, and join their "
                "results.",
            ),
            option(
                "--overlap-s",
                metavar="S",
                type=FiniteRange(min=0.0),
                default=2.0,
                show_default=True,
                help="What a piece is tracked for before its own frames, with --smooth also after them.",
            ),
            title="Batch",
        ),
        gate_options,
        volume_options,
        title=WRITTEN,
    )
)
"""Those of every batch."""


@click.group()
def batch() -> None:
    """Track many recordings: in processes side by side, and what is finished is kept."""


@batch.group("hand")
def batch_hand() -> None:
    """Track the hands of many recordings."""


@batch.group("head")
def batch_head() -> None:
    """Track the heads of many recordings."""


def _command(command: BatchCommand) -> click.Command:
    """The batch of a command: its own options, and those of a batch."""
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
        short_help=command.command.short_help and f"posetrack {line} over many recordings.",
        help=f"""Run posetrack {line} over each RECORDING: files, folders, quoted patterns such as
        'in/**/*.mcap', lists of those (.txt, one a line), or manifests (.toml) with options of each.

        Results lie below -o under the recordings' names, beside summary.csv, summary.json and index.html;
        each is, byte for byte, that of posetrack {line} alone. Run it again after an interruption or a
        failure: what is finished and of the same input, options and version is kept, what was begun goes on.

        Exit code 1: a gate failed. Exit code 3: a recording failed, or some of its data could not be used.
        130: stopped by Ctrl-C. All other options are those of posetrack {line}.
        """,
    )


for _one in BATCH_COMMANDS.values():
    {"hand": batch_hand, "head": batch_head}[_one.words[0]].add_command(_command(_one))


@dataclass(frozen=True)
class _Plan:
    """What a command line asks for."""

    jobs: tuple[Job, ...]
    limits: Limits
    piece_arguments: PieceArguments | None


def run_batch_command(
    command: BatchCommand, recordings: Sequence[str], arguments: tuple[str, ...], options: dict[str, Any]
) -> None:
    """Do a batch, or say what it would do.

    Args:
        command: that tracks.
        recordings: as they were given.
        arguments: options of the command.
        options: of the batch.
    """
    from posetrack_cli.batch.sources import find_sources

    if options["scheduler"] is not None and options["scheduler_file"] is not None:
        raise UsageError("--scheduler and --scheduler-file both say where", hint="leave one of them out")
    plan = _planned(command, find_sources(recordings, options["results"]), arguments, options)
    judging = _judging(options)
    if options["dry_run"]:
        _show_plan(plan)
        return
    from posetrack_cli.batch.summary import markdown_of, summarise, write_summary

    folder = options["results"]
    _make_folder(folder)
    with _locked(folder):
        if _folds_case(folder):
            _check_places(folder, plan.jobs, str.casefold)
        outcomes = _run(plan, options)
        summary = summarise(plan.jobs, outcomes, judging)
        write_summary(folder, summary, judging)
    if options["markdown"] == STANDARD_OUTPUT:
        print_data(markdown_of(summary, judging))
    _close(folder, summary)


def _judging(options: dict[str, Any]) -> Judging:
    """How results are judged; what cannot be meant is refused before the first is made."""
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
    check_reports(written, inputs, overwrite=True)
    return Judging(request, reports, MOST_SHOWN)


def _planned(
    command: BatchCommand, sources: Sequence[Source], arguments: tuple[str, ...], options: dict[str, Any]
) -> _Plan:
    """The jobs; everything that can be refused is refused here."""
    from posetrack_cli.batch.jobs import Job, Limits, record_path
    from posetrack_cli.evaluation.judging.gates import parse_gate
    from posetrack_cli.text import one_line

    folder, chunk_s = options["results"], options["chunk_s"]
    jobs = []
    for source in sources:
        where = source.manifest or ""
        own = (*arguments, *command.arguments_of(source.options, where))
        command.check(own, where)
        for gate in source.gates:
            parse_gate(gate)
        jobs.append(
            Job(
                one_line(source.name),
                command.words,
                source.path,
                own,
                folder / f"{source.name}.mcap",
                record_path(folder, source.name),
                folder,
                source.truth,
                source.gates,
                folder / f"{source.name}.html" if options["reports"] else None,
                chunk_s=chunk_s or 0.0,
                overlap_s=options["overlap_s"] if chunk_s else 0.0,
            )
        )
    _check_places(folder, jobs)
    limits = Limits(options["memory_limit"], options["timeout_s"], redo=options["redo"])

    def piece_arguments(job: Job, number: int, learned: Path) -> tuple[str, ...]:
        return command.of_piece(job.arguments, number, learned)

    return _Plan(tuple(jobs), limits, piece_arguments if chunk_s else None)


def _check_places(folder: Path, jobs: Sequence[Job], alike: Callable[[str], str] = str) -> None:
    """Refuse a recording whose result or page has the place of something else.

    Args:
        folder: of results.
        jobs: of recordings.
        alike: returns what names have in common that are one on the file system.
    """
    from posetrack_cli.batch.jobs import RECORDS_FOLDER
    from posetrack_cli.batch.summary import PAGE, REPORT, TABLE
    from posetrack_cli.outputs import part_path

    taken = {alike(str(folder / one)): "the batch's own" for one in (PAGE, TABLE, REPORT, RECORDS_FOLDER)}

    def check(what: str, path: Path, job: Job) -> None:
        if (other := taken.get(alike(str(path)))) is not None:
            hint = "give it another name in a manifest" + (", or --no-reports" if what == "page" else "")
            found = path.relative_to(folder)
            raise UsageError(f"its {what} would be {other}", where=job.recording, found=found, hint=hint)

    for job in jobs:
        for what, path in (("result", job.output), ("page", job.page)):
            if path is not None:
                check(what, path, job)
                taken |= {alike(str(one)): f"that of {job.recording}" for one in (path, part_path(path))}
    for job in jobs:
        for above in job.output.relative_to(folder).parents[:-1]:
            check("folder", folder / above, job)


def _show_plan(plan: _Plan) -> None:
    """Say what would be done with each recording."""
    from posetrack_cli.batch.execution import planned_action

    for job in plan.jobs:
        try:
            way = planned_action(job, plan.limits)
        except PosetrackError as error:
            way = f"fail: {error}"
        print_line(f"{way}: {job.recording} -> {job.output}")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise UsageError("output is a file", where=folder, expected="a folder for the results") from error


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Keep other batches out of a folder of results."""
    from posetrack_cli.batch.jobs import RECORDS_FOLDER
    from posetrack_cli.files import open_output
    from posetrack_cli.outputs import check_not_written, lock, make_folder

    path = folder / RECORDS_FOLDER / "lock"
    make_folder(path.parent, folder)
    try:
        check_not_written(path)
    except UsageError as error:
        raise UsageError(
            "another batch writes there", where=folder, hint="wait for it, or choose another"
        ) from error
    with open_output(path) as stream:
        lock(stream)
        yield


def _folds_case(folder: Path) -> bool:
    """Whether the file system of a folder of results takes names for one that differ in capitals alone."""
    from posetrack_cli.batch.jobs import RECORDS_FOLDER

    return (folder / RECORDS_FOLDER.upper()).exists()


def _run(plan: _Plan, options: dict[str, Any]) -> list[Outcome]:
    """Do the jobs, and show how far they are."""
    from posetrack_cli.batch.engine import EngineOptions, open_engine
    from posetrack_cli.batch.execution import run_job
    from posetrack_cli.batch.jobs import RECORDS_FOLDER
    from posetrack_cli.batch.scheduling import run_batch

    scratch = options["results"] / RECORDS_FOLDER / "scratch"
    jobs = options["jobs"] or len(os.sched_getaffinity(0))
    if plan.piece_arguments is None:
        jobs = min(jobs, len(plan.jobs))  # so that one alone has all cores
    where = EngineOptions(
        jobs, options["scheduler"], options["scheduler_file"], scratch, options["dashboard"]
    )
    with (
        _new_folder(scratch),
        BatchProgress(len(plan.jobs)) as shown,
        stop_signals() as stopped,
        open_engine(where, run_job, shown.on_progress, shown.note) as engine,
    ):
        return run_batch(engine, plan.jobs, plan.limits, plan.piece_arguments, shown.on_outcome, stopped)


@contextmanager
def _new_folder(path: Path) -> Iterator[None]:
    """Make a folder anew, also where a batch that was killed has left one, and delete it at the end."""
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir()
    try:
        yield
    finally:
        shutil.rmtree(path, ignore_errors=True)


def _close(folder: Path, summary: Summary) -> None:
    """Say what came of the batch, and set the exit code."""
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
        print_note("interrupted; the same command goes on")
    if summary.exit_code != EXIT_DONE:
        click.get_current_context().exit(summary.exit_code)


def _note_processors(summary: Summary) -> None:
    """Say where results cannot have the bytes that this machine would give them, as kept ones may not."""
    from posetrack_cli.batch.jobs import State
    from posetrack_cli.build import only_in, processor_features

    kinds = set(summary.processors)
    if any(one.state is State.KEPT for one in summary.outcomes):
        kinds.add(processor_features())
    if len(kinds) > 1:
        first, *others = sorted(kinds)
        found = "; ".join([only_in(first, others[0]), *(only_in(other, first) for other in others)])
        print_note(f"results of several kinds of processor differ in their last digits: {found}")
