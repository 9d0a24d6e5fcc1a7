"""One job where it runs: what is there of it already is kept or gone on with, the rest is done."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

from posetrack_cli.batch.children import (
    Ending,
    Progress,
    run_child,
    was_interrupted,
    way_of,
)
from posetrack_cli.batch.jobs import Job, Kind, Limits, Outcome, Piece, State
from posetrack_cli.batch.records import (
    RUNNING,
    DamagedRecordError,
    JobRecord,
    input_digest,
    job_key,
    output_stamp,
    page_key,
    read_record,
    write_record,
)
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, PosetrackError, UsageError
from posetrack_cli.outputs import check_not_written, make_folder, part_path, state_path
from posetrack_cli.recording.identity import tell_digests
from posetrack_cli.text import one_line

_NOT_OURS = "exists already, and no record of a batch says how it was made"
_WAIT_S = 10.0
"""A process that was left alone ends within a second; until then it holds its file."""


def perform(
    job: Job,
    limits: Limits,
    progress: Progress = lambda name, done, of: None,
    stopped: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Do a job, and return what came of it: whatever goes wrong is an outcome, too.

    Args:
        job: what is done.
        limits: what its process may take.
        progress: called now and then with how far it is.
        stopped: asked several times a second whether to stop.
    """
    if stopped():
        return Outcome(job.name, State.STOPPED)
    try:
        tell_digests(job.digests)
        performance = _Performance(job, limits)
        if job.kind is Kind.SPLIT and not performance.is_kept:
            return _split(job, limits, stopped)
        return performance.run(progress, stopped)
    except PosetrackError as error:
        return Outcome(job.name, State.FAILED, str(error))
    except OSError as error:
        where = error.filename or job.output
        return Outcome(job.name, State.FAILED, one_line(f"{where}: {error.strerror or error}"))


def planned(job: Job, limits: Limits) -> str:
    """Say what ``perform`` would do, changing nothing; what cannot be told without reading says so.

    Raises:
        PosetrackError: the recording, or a file that an option names, cannot be read.
    """
    performance = _Performance(job, limits)
    if performance.is_kept:
        return "keep" if performance.has_page else "keep, and write its page"
    return f"{performance.way} ({performance.damage})" if performance.damage else performance.way


class _Performance:
    """One job, with what is known of it."""

    def __init__(self, job: Job, limits: Limits) -> None:
        self._job, self._limits = job, limits
        self._known, self.damage = None, ""
        try:
            self._known = read_record(job.record)
        except DamagedRecordError as error:
            self.damage = str(error)
        self._input = input_digest(job.recording, {} if self._known is None else self._known.input)
        self._key = job_key(job, self._input["sha256"])
        self._page, self._stamp = page_key(job), output_stamp(job.output)

    @property
    def is_finished(self) -> bool:
        """Whether this very job has a finished result, also where its batch died before noting it."""
        known = self._known
        if known is None or known.key != self._key or not self._stamp:
            return False
        is_noted = known.state == State.DONE and known.output == self._stamp
        return is_noted or (known.state == RUNNING and known.output != self._stamp)

    @property
    def is_kept(self) -> bool:
        """Whether there is nothing to track."""
        return self.is_finished and not self._limits.redo

    @property
    def has_page(self) -> bool:
        """Whether the page that is asked for is there."""
        page, known = self._job.page, self._known
        return page is None or (page.is_file() and known is not None and known.page == self._page)

    @property
    def way(self) -> str:
        """What is done to get the result: ``track``, ``go on`` or ``replace``.

        Raises:
            UsageError: there is a result that no batch made.
        """
        job, known = self._job, self._known
        if self._limits.redo or self.damage:
            return "replace"
        is_ours = known is not None and (known.output == self._stamp or known.state == RUNNING)
        if self._stamp and not is_ours:
            raise UsageError(_NOT_OURS, where=job.output, hint="--redo replaces it, or choose another folder")
        if known is None and state_path(job.output).exists():
            raise UsageError(
                "is of an interrupted run that no batch began",
                where=part_path(job.output),
                hint="--redo replaces it, or choose another folder",
            )
        if known is not None and known.key == self._key and state_path(job.output).is_file():
            return "go on"
        return "replace" if self._stamp or state_path(job.output).exists() else "track"

    def run(self, progress: Progress, stopped: Callable[[], bool]) -> Outcome:
        """Keep the result, or make it."""
        make_folder(self._job.record.parent, self._job.results)
        if self.is_kept:
            return self._kept(progress, stopped)
        way = self.way
        make_folder(self._job.output.parent, self._job.results)
        _wait_for_writer(self._job)
        self._remember(RUNNING)
        ending = self._child(way, progress, stopped)
        if way == "go on" and _was_refused(ending):
            ending = self._child("replace", progress, stopped)
        return self._finish(ending)

    def _child(self, way: str, progress: Progress, stopped: Callable[[], bool]) -> Ending:
        return run_child(self._job, self._arguments(way), self._limits, progress, stopped)

    def _arguments(self, way: str) -> tuple[str, ...]:
        """The command line; nothing where pieces are joined."""
        job = self._job
        if job.kind is Kind.JOIN:
            return ()
        how = {"go on": ("--resume",), "replace": ("--overwrite",)}.get(way, ())
        return (*job.command, *job.arguments, *how, "-o", str(job.output), "--", str(job.recording))

    def _kept(self, progress: Progress, stopped: Callable[[], bool]) -> Outcome:
        """The outcome of before; the page is written where it is missing."""
        assert self._known is not None
        self._delete_pieces()  # of a batch that was killed once they were joined
        known = self._known.outcome or Outcome(self._job.name, State.KEPT)
        outcome = replace(known, name=self._job.name, state=State.KEPT, reason="")
        if not self.has_page:
            ending = run_child(self._job, (), self._limits, progress, stopped)
            if ending.code != EXIT_DONE:
                return _failure(self._job, ending, self._limits)
            self._remember(State.DONE, outcome)
        return outcome

    def _finish(self, ending: Ending) -> Outcome:
        if ending.code not in (EXIT_DONE, EXIT_DATA_LOST) or not self._job.output.exists():
            outcome = _failure(self._job, ending, self._limits)
            if output_stamp(self._job.output) == self._stamp:
                self._remember(outcome.state, outcome)
            # else the process ended once the result had its name, and the next batch keeps that
            return outcome
        reason = f"done again: {self.damage}" if self.damage else ""
        lost = ending.code == EXIT_DATA_LOST
        outcome = replace(_told(self._job, ending), state=State.DONE, reason=reason, lost_data=lost)
        self._remember(State.DONE, outcome)
        if self._job.kind is Kind.JOIN:
            self._delete_pieces()
        return outcome

    def _delete_pieces(self) -> None:
        shutil.rmtree(self._job.pieces_folder, ignore_errors=True)

    def _remember(self, state: str, outcome: Outcome | None = None) -> None:
        is_made = state == State.DONE
        stamp = output_stamp(self._job.output) if is_made else self._stamp
        record = JobRecord(self._key, self._page if is_made else "", self._input, stamp, state, outcome)
        write_record(self._job.record, record)


def _split(job: Job, limits: Limits, stopped: Callable[[], bool]) -> Outcome:
    """Find out the pieces of a recording, which nothing is remembered of."""
    make_folder(job.record.parent, job.results)
    ending = run_child(job, (), limits, stopped=stopped)
    if ending.code != EXIT_DONE:
        return _failure(job, ending, limits)
    return replace(
        _told(job, ending),
        state=State.DONE,
        pieces=tuple(Piece(*piece) for piece in ending.told["pieces"]),
        digests=ending.told["digests"],
    )


def _wait_for_writer(job: Job) -> None:
    """Wait for the process of a worker that was killed: it is about to end, and still holds its file."""
    end_s = time.monotonic() + _WAIT_S
    while time.monotonic() < end_s:
        with suppress(UsageError):
            check_not_written(part_path(job.output))
            return
        time.sleep(0.1)
    check_not_written(part_path(job.output))


def _was_refused(ending: Ending) -> bool:
    """Whether a run could not be gone on with, which shows before its first frame."""
    return ending.code > 0 and "tracked" not in ending.told and not was_interrupted(ending)


def _failure(job: Job, ending: Ending, limits: Limits) -> Outcome:
    if was_interrupted(ending):
        return replace(_told(job, ending), state=State.STOPPED)
    return replace(
        _told(job, ending),
        reason=way_of(ending, limits),
        last_lines=ending.last_lines,
    )


def _told(job: Job, ending: Ending) -> Outcome:
    """What a process told and took."""
    told = ending.told
    return Outcome(
        job.name,
        State.FAILED,
        exit_code=ending.code,
        seconds=ending.seconds,
        cpu_s=told.get("cpu_s", 0.0),
        peak_bytes=told.get("peak_bytes", 0),
        frames=told.get("tracked", 0),
        remarks=tuple(map(one_line, ending.remarks)),
    )
