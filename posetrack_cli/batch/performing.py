"""One job, done in a process of its own where it runs."""

from __future__ import annotations

import json
import os
import selectors
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any

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
from posetrack_cli.compiled import THREADS_VARIABLE
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, EXIT_INTERRUPTED, PosetrackError, UsageError
from posetrack_cli.files import open_output
from posetrack_cli.interpreter import module_command, module_environment
from posetrack_cli.outputs import check_not_written, make_folder, part_path, state_path
from posetrack_cli.recording.identity import tell_digests
from posetrack_cli.text import one_line

# The process of a job, as whoever started it sees it: what it tells, what it takes, and how it is ended


_PROGRAM = "posetrack_cli.cli.batch_child"
"""By name: it is the command line's, which lies above."""
_THREADS = (
    THREADS_VARIABLE,
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
    "LP_NUM_THREADS",
)
_LOOKED_EVERY_S = 0.25
_GRACE_S = 30.0
"""A process that is asked to stop ends after the frame at hand, and then writes what it has."""
_LAST_LINES, _LAST_BYTES = 5, 4000

Progress = Callable[[str, int, int | None], None]
"""Gets the name of a pass, the frames of it that are done, and how many there are, where that is known."""


@dataclass
class Ending:
    """How a process ended, and what it told.

    Attributes:
        code: its exit code, negative for the signal that killed it.
        seconds: wall-clock time.
        timed_out, stopped: whether it was ended because of its time, or as it was asked to.
        told: the last of each thing that it told, by name.
        remarks: that it told.
        last_lines: what it printed last.
    """

    code: int = 0
    seconds: float = 0.0
    timed_out: bool = False
    stopped: bool = False
    told: dict[str, Any] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    last_lines: tuple[str, ...] = ()


def run_child(
    job: Job,
    arguments: tuple[str, ...],
    limits: Limits,
    progress: Progress = lambda name, done, of: None,
    stopped: Callable[[], bool] = lambda: False,
) -> Ending:
    """Do a job in a process of its own, and wait for its end.

    It has a session of its own, so that Ctrl-C in a terminal reaches only whoever started it. It ends when
    this process ends, however that happens.

    Args:
        job: what is done.
        arguments: of the command line; none where nothing is tracked.
        limits: what it may take.
        progress: called now and then.
        stopped: asked every quarter of a second whether it shall stop.

    Raises:
        OSError: it cannot be started, or its log not be written.
    """
    began = time.monotonic()
    reading, writing = os.pipe()
    with open_output(job.log) as log, os.fdopen(reading, "rb", buffering=0) as told:
        try:
            child = subprocess.Popen(
                module_command(_PROGRAM, str(writing)),
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                pass_fds=(writing,),
                env=_environment(limits.threads),
                start_new_session=True,
            )
        finally:
            os.close(writing)
        with _ended_at_last(child):
            assert child.stdin is not None
            with suppress(BrokenPipeError):  # it has ended already, and its log tells why
                child.stdin.write(json.dumps(_task(job, arguments, limits)).encode() + b"\n")
                child.stdin.flush()
            ending = _watch(child, told, limits.timeout_s, progress, stopped)
    ending.seconds = time.monotonic() - began
    ending.last_lines = last_lines(job.log)
    return ending


def last_lines(log: Path) -> tuple[str, ...]:
    """Return the end of a log as printable lines; none where it cannot be read."""
    try:
        with log.open("rb") as stream:
            stream.seek(max(0, log.stat().st_size - _LAST_BYTES))
            text = stream.read(_LAST_BYTES).decode("utf-8", "backslashreplace")
    except OSError:
        return ()
    lines = [one_line(line).strip() for line in text.splitlines()]
    return tuple([line for line in lines if line][-_LAST_LINES:])


def _task(job: Job, arguments: tuple[str, ...], limits: Limits) -> dict[str, Any]:
    return {
        "kind": job.kind,
        "sources": job.sources,
        "command": job.command,
        "recording": os.fspath(job.recording),
        "output": os.fspath(job.output),
        "options": job.arguments,
        "arguments": arguments,
        "truth": None if job.truth is None else os.fspath(job.truth),
        "page": None if job.page is None else os.fspath(job.page),
        "digests": dict(job.digests),
        "memory_bytes": limits.memory_bytes,
        "chunk_s": job.chunk_s,
        "overlap_s": job.overlap_s,
        "pieces": [(os.fspath(path), vars(piece)) for path, piece in job.pieces],
    }


def _environment(threads: int) -> Mapping[str, str]:
    """Ours, with so many threads for everything that has some: cores are shared with other jobs."""
    return module_environment() | dict.fromkeys(_THREADS, str(max(1, threads)))


@contextmanager
def _ended_at_last(child: subprocess.Popen[bytes]) -> Iterator[None]:
    """Leave no process behind, whatever is raised."""
    try:
        yield
    finally:
        if child.poll() is None:
            child.kill()
        if child.stdin is not None:
            with suppress(BrokenPipeError):
                child.stdin.close()
        child.wait()


def _watch(
    child: subprocess.Popen[bytes],
    told: IO[bytes],
    timeout_s: float | None,
    progress: Progress,
    stopped: Callable[[], bool],
) -> Ending:
    """Wait for the end of a process, and take what it tells."""
    ending, rest = Ending(), b""
    end_s = float("inf") if timeout_s is None else time.monotonic() + timeout_s
    kill_s = float("inf")
    with selectors.DefaultSelector() as selector:
        selector.register(told, selectors.EVENT_READ)
        while True:
            if selector.select(_LOOKED_EVERY_S):
                piece = os.read(told.fileno(), 1 << 16)
                *lines, rest = (rest + piece).split(b"\n")
                for line in lines:
                    _take(ending, line, progress)
                if not piece:
                    break  # the process has closed its end: it is over
            now = time.monotonic()
            if kill_s == float("inf") and (now >= end_s or stopped()):
                ending.timed_out, ending.stopped = now >= end_s, now < end_s
                kill_s = now + _GRACE_S
                child.send_signal(signal.SIGINT)
            elif now >= kill_s:
                child.kill()
                break
    ending.code = _code(child, kill_s)
    return ending


def _code(child: subprocess.Popen[bytes], kill_s: float) -> int:
    """The exit code of a process that has nothing more to tell; one that does not end is killed."""
    try:
        return child.wait(max(0.0, min(kill_s - time.monotonic(), _GRACE_S)))
    except subprocess.TimeoutExpired:
        child.kill()
        return child.wait()


def _take(ending: Ending, line: bytes, progress: Progress) -> None:
    try:
        told = json.loads(line)
    except ValueError:  # cut off by its death
        return
    if "progress" in told:
        progress(*told["progress"])
    elif "remark" in told:
        ending.remarks.append(told["remark"])
    else:
        ending.told |= told


def way_of(ending: Ending, limits: Limits) -> str:
    """Say in one line why a process did not do its job; its last line tells it best, where it exited."""
    if ending.timed_out:
        return f"took longer than --timeout {limits.timeout_s:g} s"
    if ending.code >= 0 and ending.last_lines:
        return ending.last_lines[-1].removeprefix("posetrack: ")
    memory = limits.memory_bytes
    likely = "" if memory is None else f", likely as it needs more than --memory-limit {memory >> 20}M"
    return f"its process {_end_of(ending.code)}{likely}"


def _end_of(code: int) -> str:
    with suppress(ValueError):
        return f"was killed by {signal.Signals(-code).name}"
    return f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"


def was_interrupted(ending: Ending) -> bool:
    """Whether a process stopped as it was asked to, with what it has kept to go on with."""
    return ending.stopped or (ending.code == EXIT_INTERRUPTED and not ending.timed_out)


# One job where it runs: what is there of it already is kept or gone on with, the rest is done


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
