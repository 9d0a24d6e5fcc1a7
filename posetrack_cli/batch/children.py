"""The process of a job, as whoever started it sees it: what it tells, what it takes, and how it is ended."""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from posetrack_cli.batch.jobs import Job, Limits
from posetrack_cli.compiled import THREADS_VARIABLE
from posetrack_cli.errors import EXIT_INTERRUPTED
from posetrack_cli.files import open_output
from posetrack_cli.interpreter import module_command, module_environment
from posetrack_cli.text import one_line

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
