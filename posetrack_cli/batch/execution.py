"""Execution of one job in a child process on the machine that runs it."""

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
    remote_digest,
    write_record,
)
from posetrack_cli.batch.remote import CopyStoppedError, local_copy
from posetrack_cli.compiled import THREADS_VARIABLE
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, EXIT_INTERRUPTED, PosetrackError, UsageError
from posetrack_cli.files import open_output
from posetrack_cli.interpreter import module_command, module_environment
from posetrack_cli.outputs import check_not_written, make_folder, part_path, state_path
from posetrack_cli.recording.identity import tell_digests
from posetrack_cli.text import one_line

# The child process of a job: starting, watching and stopping it


# By name, as the command line is the layer above and must not be imported here.
_PROGRAM = "posetrack_cli.cli.batch_child"
_THREADS = (
    THREADS_VARIABLE,
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
    "LP_NUM_THREADS",
)
_POLL_S = 0.25
# Time between SIGINT and SIGKILL: the child finishes its current frame and writes a checkpoint.
_GRACE_S = 30.0
_LAST_LINES, _LAST_BYTES = 5, 4000

Progress = Callable[[str, int, int | None], None]
"""Progress callback: name of the pass, finished frames, total frames (None if unknown)."""


@dataclass
class ProcessResult:
    """Exit status and messages of a child process.

    Attributes:
        code: exit code, or the negative number of the signal that killed the process.
        seconds: wall-clock time, s.
        timed_out, stopped: whether it was ended by the time limit or on request.
        messages: last value of each message, by name.
        remarks: notes for the user.
        last_lines: last lines of the log.
    """

    code: int = 0
    seconds: float = 0.0
    timed_out: bool = False
    stopped: bool = False
    messages: dict[str, Any] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    last_lines: tuple[str, ...] = ()


def run_child(
    job: Job,
    arguments: tuple[str, ...],
    limits: Limits,
    progress: Progress = lambda name, done, of: None,
    stopped: Callable[[], bool] = lambda: False,
) -> ProcessResult:
    """Run a job in a child process and wait for it to end.

    The child runs in its own session, so Ctrl-C in a terminal signals only the parent. It exits when its
    standard input closes, that is when this process ends for any reason.

    Args:
        job: job to run.
        arguments: command line of the tracking command; empty if nothing is tracked.
        limits: resource limits.
        progress: progress callback.
        stopped: polled every ``_POLL_S``; returns True to stop the child.

    Raises:
        OSError: the process cannot be started, or its log cannot be written.
    """
    began = time.monotonic()
    reading, writing = os.pipe()
    with open_output(job.log) as log, os.fdopen(reading, "rb", buffering=0) as pipe:
        try:
            child = subprocess.Popen(
                module_command(_PROGRAM, str(writing)),
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                pass_fds=(writing,),  # messages have their own pipe, as libraries print to stdout
                env=_environment(limits.threads),
                start_new_session=True,
            )
        finally:
            os.close(writing)
        with _killed_on_exit(child):
            assert child.stdin is not None
            with suppress(BrokenPipeError):  # the child has already exited; its log has the reason
                child.stdin.write(json.dumps(_task(job, arguments, limits)).encode() + b"\n")
                child.stdin.flush()
            process = _watch(child, pipe, limits.timeout_s, progress, stopped)
    process.seconds = time.monotonic() - began
    process.last_lines = last_lines(job.log)
    return process


def last_lines(log: Path) -> tuple[str, ...]:
    """Return the last non-empty lines of a log, made printable; empty if it cannot be read."""
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
    """Return the environment with all thread pools limited, as other jobs share the cores."""
    return module_environment() | dict.fromkeys(_THREADS, str(max(1, threads)))


@contextmanager
def _killed_on_exit(child: subprocess.Popen[bytes]) -> Iterator[None]:
    """Kill the child on leaving the block if it is still running."""
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
    pipe: IO[bytes],
    timeout_s: float | None,
    progress: Progress,
    stopped: Callable[[], bool],
) -> ProcessResult:
    """Read messages from the child until it exits; interrupt it on timeout or request."""
    process, rest = ProcessResult(), b""
    end_s = float("inf") if timeout_s is None else time.monotonic() + timeout_s
    kill_s = float("inf")
    with selectors.DefaultSelector() as selector:
        selector.register(pipe, selectors.EVENT_READ)
        while True:
            if selector.select(_POLL_S):
                piece = os.read(pipe.fileno(), 1 << 16)
                *lines, rest = (rest + piece).split(b"\n")
                for line in lines:
                    _take(process, line, progress)
                if not piece:
                    break  # end of file: the child has exited
            now = time.monotonic()
            if kill_s == float("inf") and (now >= end_s or stopped()):
                process.timed_out, process.stopped = now >= end_s, now < end_s
                kill_s = now + _GRACE_S
                child.send_signal(signal.SIGINT)
            elif now >= kill_s:
                child.kill()
                break
    process.code = _exit_code(child, kill_s)
    return process


def _exit_code(child: subprocess.Popen[bytes], kill_s: float) -> int:
    """Return the exit code of a child that has closed its pipe; kill it if it does not exit in time."""
    try:
        return child.wait(max(0.0, min(kill_s - time.monotonic(), _GRACE_S)))
    except subprocess.TimeoutExpired:
        child.kill()
        return child.wait()


def _take(process: ProcessResult, line: bytes, progress: Progress) -> None:
    try:
        message = json.loads(line)
    except ValueError:  # truncated: the child died while writing
        return
    if "progress" in message:
        progress(*message["progress"])
    elif "remark" in message:
        process.remarks.append(message["remark"])
    else:
        process.messages |= message


def failure_reason(process: ProcessResult, limits: Limits) -> str:
    """Return why the child failed, in one line: its error message if it exited, else the signal."""
    if process.timed_out:
        return f"exceeded --timeout {limits.timeout_s:g} s"
    if process.code >= 0 and process.last_lines:
        return process.last_lines[-1].removeprefix("posetrack: ")
    memory = limits.memory_bytes
    likely = "" if memory is None else f", possibly because of --memory-limit {memory >> 20}M"
    return f"process {_exit_text(process.code)}{likely}"


def _exit_text(code: int) -> str:
    with suppress(ValueError):
        return f"was killed by {signal.Signals(-code).name}"
    return f"was killed by signal {-code}" if code < 0 else f"exited with code {code}"


def was_interrupted(process: ProcessResult) -> bool:
    """Whether the child stopped on request, so that the run can be resumed."""
    return process.stopped or (process.code == EXIT_INTERRUPTED and not process.timed_out)


# One job on a worker: skip, resume or run it


_NOT_OURS = "already exists and was not created by posetrack batch"
_REDO_HINT = "use --redo to replace it, or choose another results folder"
# A child whose parent was killed exits within 1 s and holds the lock on its output until then.
_WAIT_S = 10.0


def run_job(
    job: Job,
    limits: Limits,
    progress: Progress = lambda name, done, of: None,
    stopped: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Run one batch job on a worker: skip, resume or restart it. Errors are returned as outcomes.

    Args:
        job: job to run.
        limits: resource limits of its child process.
        progress: progress callback.
        stopped: polled several times per second; returns True to stop the job.
    """
    if stopped():
        return Outcome(job.name, State.STOPPED)
    try:
        tell_digests(job.digests)
        with _provided(job, stopped) as provide:
            job_run = _JobRun(job, limits, provide)
            if job.kind is Kind.SPLIT and not job_run.is_kept:
                return _split(job, limits, stopped)
            return job_run.run(progress, stopped)
    except CopyStoppedError:
        return Outcome(job.name, State.STOPPED)
    except PosetrackError as error:
        return Outcome(job.name, State.FAILED, str(error))
    except OSError as error:
        where = error.filename or job.output
        return Outcome(job.name, State.FAILED, one_line(f"{where}: {error.strerror or error}"))


@contextmanager
def _provided(job: Job, stopped: Callable[[], bool]) -> Iterator[Callable[[], None]]:
    """Yield a function that provides the files: a local copy of a remote recording, deleted at the end."""
    if not job.url:
        yield lambda: None
        return
    make_folder(job.recording.parent, job.results)
    with local_copy(job.url, job.recording, stopped) as copy:
        yield copy


def _refuse_copy() -> None:
    raise CopyStoppedError


def planned_action(job: Job, limits: Limits) -> str:
    """Return the action that ``run_job`` would take, such as "keep" or "resume", without changing files.

    Raises:
        PosetrackError: the recording, or a file named by an option, cannot be read.
    """
    try:
        job_run = _JobRun(job, limits, _refuse_copy)
    except CopyStoppedError:  # its content decides, and a plan copies nothing
        return "copy and track"
    if job_run.is_kept:
        return "keep" if job_run.has_page else "keep, write page"
    return f"{job_run.action} ({job_run.damage})" if job_run.damage else job_run.action


class _JobRun:
    """A job with its stored record and the action that follows from it.

    Args:
        job: the job.
        limits: resource limits of its child process.
        provide: provides the files of a remote recording; called if they are needed.
    """

    def __init__(self, job: Job, limits: Limits, provide: Callable[[], None]) -> None:
        self._job, self._limits, self._provide = job, limits, provide
        self._known, self.damage = None, ""
        try:
            self._known = read_record(job.record)
        except DamagedRecordError as error:
            self.damage = str(error)
        known = {} if self._known is None else self._known.input
        if job.url:
            self._input = remote_digest(job.url, job.recording, known, provide)
        else:
            self._input = input_digest(job.recording, known)
        self._key = job_key(job, self._input["sha256"])
        self._page, self._stamp = page_key(job), output_stamp(job.output)

    @property
    def is_finished(self) -> bool:
        """Whether this exact job has a finished result."""
        known = self._known
        if known is None or known.key != self._key or not self._stamp:
            return False
        is_recorded = known.state == State.DONE and known.output == self._stamp
        # A record still in RUNNING with a new output: the batch was killed after the result was finished.
        return is_recorded or (known.state == RUNNING and known.output != self._stamp)

    @property
    def is_kept(self) -> bool:
        """Whether the existing result is kept."""
        return self.is_finished and not self._limits.redo

    @property
    def has_page(self) -> bool:
        """Whether the requested page is up to date; True if none is requested."""
        page, known = self._job.page, self._known
        return page is None or (page.is_file() and known is not None and known.page == self._page)

    @property
    def action(self) -> str:
        """Action that produces the result: ``track``, ``resume`` or ``replace``.

        Raises:
            UsageError: a result or an interrupted run exists that was not created by a batch.
        """
        job, known = self._job, self._known
        if self._limits.redo or self.damage:
            return "replace"
        is_ours = known is not None and (known.output == self._stamp or known.state == RUNNING)
        if self._stamp and not is_ours:
            raise UsageError(_NOT_OURS, where=job.output, hint=_REDO_HINT)
        if known is None and state_path(job.output).exists():
            raise UsageError(
                "interrupted run that was not started by posetrack batch",
                where=part_path(job.output),
                hint=_REDO_HINT,
            )
        if known is not None and known.key == self._key and state_path(job.output).is_file():
            return "resume"
        return "replace" if self._stamp or state_path(job.output).exists() else "track"

    def run(self, progress: Progress, stopped: Callable[[], bool]) -> Outcome:
        """Run the job unless its result is kept."""
        make_folder(self._job.record.parent, self._job.results)
        if self.is_kept:
            return self._keep(progress, stopped)
        action = self.action
        make_folder(self._job.output.parent, self._job.results)
        _wait_for_writer(self._job)
        self._provide()
        self._write_record(RUNNING)
        process = self._child(action, progress, stopped)
        if action == "resume" and _was_refused(process):
            process = self._child("replace", progress, stopped)
        return self._finish(process)

    def _child(self, action: str, progress: Progress, stopped: Callable[[], bool]) -> ProcessResult:
        return run_child(self._job, self._arguments(action), self._limits, progress, stopped)

    def _arguments(self, action: str) -> tuple[str, ...]:
        """Return the command line of the tracking command; empty for a join."""
        job = self._job
        if job.kind is Kind.JOIN:
            return ()
        how = {"resume": ("--resume",), "replace": ("--overwrite",)}.get(action, ())
        return (*job.command, *job.arguments, *how, "-o", str(job.output), "--", str(job.recording))

    def _keep(self, progress: Progress, stopped: Callable[[], bool]) -> Outcome:
        """Return the recorded outcome; write the page if it is missing or outdated."""
        assert self._known is not None
        self._delete_pieces()  # left over if a batch was killed right after joining
        known = self._known.outcome or Outcome(self._job.name, State.KEPT)
        outcome = replace(known, name=self._job.name, state=State.KEPT, reason="")
        if not self.has_page:
            self._provide()
            process = run_child(self._job, (), self._limits, progress, stopped)
            if process.code != EXIT_DONE:
                return _failure(self._job, process, self._limits)
            self._write_record(State.DONE, outcome)
        return outcome

    def _finish(self, process: ProcessResult) -> Outcome:
        if process.code not in (EXIT_DONE, EXIT_DATA_LOST) or not self._job.output.exists():
            outcome = _failure(self._job, process, self._limits)
            # If the output has changed, the child died after renaming it into place: the record must stay in
            # RUNNING so that the next batch keeps the result.
            if output_stamp(self._job.output) == self._stamp:
                self._write_record(outcome.state, outcome)
            return outcome
        reason = f"repeated: {self.damage}" if self.damage else ""
        lost = process.code == EXIT_DATA_LOST
        outcome = replace(_outcome_of(self._job, process), state=State.DONE, reason=reason, lost_data=lost)
        self._write_record(State.DONE, outcome)
        if self._job.kind is Kind.JOIN:
            self._delete_pieces()
        return outcome

    def _delete_pieces(self) -> None:
        shutil.rmtree(self._job.pieces_folder, ignore_errors=True)

    def _write_record(self, state: str, outcome: Outcome | None = None) -> None:
        is_made = state == State.DONE
        stamp = output_stamp(self._job.output) if is_made else self._stamp
        record = JobRecord(self._key, self._page if is_made else "", self._input, stamp, state, outcome)
        write_record(self._job.record, record)


def _split(job: Job, limits: Limits, stopped: Callable[[], bool]) -> Outcome:
    """Split a recording into pieces; no record is written."""
    make_folder(job.record.parent, job.results)
    process = run_child(job, (), limits, stopped=stopped)
    if process.code != EXIT_DONE:
        return _failure(job, process, limits)
    return replace(
        _outcome_of(job, process),
        state=State.DONE,
        pieces=tuple(Piece(*piece) for piece in process.messages["pieces"]),
        digests=process.messages["digests"],
    )


def _wait_for_writer(job: Job) -> None:
    """Wait for the child of a killed worker to exit and release the output.

    Raises:
        UsageError: the output is still locked after ``_WAIT_S``.
    """
    end_s = time.monotonic() + _WAIT_S
    while time.monotonic() < end_s:
        with suppress(UsageError):
            check_not_written(part_path(job.output))
            return
        time.sleep(0.1)
    check_not_written(part_path(job.output))


def _was_refused(process: ProcessResult) -> bool:
    """Whether the child failed before its first frame, so that the run cannot be resumed."""
    return process.code > 0 and "tracked" not in process.messages and not was_interrupted(process)


def _failure(job: Job, process: ProcessResult, limits: Limits) -> Outcome:
    if was_interrupted(process):
        return replace(_outcome_of(job, process), state=State.STOPPED)
    return replace(
        _outcome_of(job, process),
        reason=failure_reason(process, limits),
        last_lines=process.last_lines,
    )


def _outcome_of(job: Job, process: ProcessResult) -> Outcome:
    """Return a failed outcome with the resources and remarks of a child process."""
    messages = process.messages
    return Outcome(
        job.name,
        State.FAILED,
        exit_code=process.code,
        seconds=process.seconds,
        cpu_s=messages.get("cpu_s", 0.0),
        peak_bytes=messages.get("peak_bytes", 0),
        frames=messages.get("tracked", 0),
        remarks=tuple(map(one_line, process.remarks)),
    )
