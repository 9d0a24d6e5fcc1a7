"""Runs cases and tells what became of them."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any, TypeVar

from hostile.case import Case

CPU_S = 5.0
"""Of a command whose valid input takes next to none; ``WORK_S`` is added."""
BLOCKED_S, TRIED_BLOCKED_S = 30.0, 3.0
"""A child that computes nothing for so long waits for what never comes; where that is tried, sooner."""
WORK_S = {
    ("hand", "run"): 5.0,
    ("hand", "synth"): 5.0,
    ("hand", "calibrate"): 40.0,
    ("head", "stereo"): 3.0,
    ("head", "mono"): 3.0,
    ("head", "synth"): 10.0,
    ("head", "build-model"): 3.0,
    ("calibrate", "stereo"): 3.0,
    ("view",): 5.0,
}
"""Seconds that a command takes for small valid input, on a busy machine: it opens a GL context, loads
compiled code from its cache, and tracks frames."""
ROOT = Path(__file__).parents[2]
FRESH_LIMIT_S = 300.0
SEED, COMPILING_S = "seed", 900
FRESH = (sys.executable, "-m", "posetrack_cli.cli.main")
MEASURING = """
import json, resource, subprocess, sys
code = subprocess.call(sys.argv[2:])
used = resource.getrusage(resource.RUSAGE_CHILDREN)
with open(sys.argv[1], "w") as report:
    json.dump([code, used.ru_utime + used.ru_stime, used.ru_maxrss], report)
"""
"""Runs a command and says what it took. A process of its own, as Linux counts to a command's peak of memory
what the process had that it was forked from, and tests may have gigabytes."""


T, R = TypeVar("T"), TypeVar("R")


@dataclass(frozen=True)
class Outcome:
    """What a command did.

    Attributes:
        code: exit code; below 0 the signal that ended it.
        ended: why the harness ended it: "blocked", "too long" or "".
        out: what it wrote on standard output.
        error: what it wrote on standard error.
        cpu_s: seconds of CPU, start-up excluded.
        peak_bytes: of memory, above the idle process.
        before: every path below the case's folder before the run, and what it was.
        after: the same after the run.
        modules: imported ones that are neither Python's nor installed nor the package's.
        events: processes started, connections, files written outside the folder.
        stacks: of a process that hung or crashed.
    """

    code: int
    ended: str
    out: bytes
    error: bytes
    cpu_s: float
    peak_bytes: int
    before: dict[str, str]
    after: dict[str, str]
    modules: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
    stacks: str = ""


class Harness:
    """Runs cases in children of one warm process; to be closed, as by ``with``."""

    def __init__(self) -> None:
        self.scratch = Path(tempfile.mkdtemp(prefix="hostile-"))
        self._count = 0
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Harness:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._end()
        shutil.rmtree(self.scratch, ignore_errors=True)

    def warm(self, commands: list[list[str]]) -> list[int]:
        """Run commands in the process that children are forked from; they open no GL context."""
        codes: list[int] = self._ask({"warm": commands})["code"]
        return codes

    def run(
        self, case: Case, *, stop_after: int | None = None, keep: Path | None = None, instead: str = ""
    ) -> Outcome:
        """Run a case in a folder of its own.

        Args:
            case: the files and the command line.
            stop_after: frames after which the run believes that it was interrupted.
            keep: a folder that is not there yet; the case's folder becomes it.
            instead: Python that runs in the place of the command, to show what the harness sees.
        """
        with self._laid_out(case, keep) as laid:
            request: dict[str, Any] = {
                "folder": str(laid.folder),
                "command": case.command,
                "stop_after": stop_after,
            }
            request |= {"instead": instead, "blocked_s": TRIED_BLOCKED_S if instead else BLOCKED_S}
            answer = self._ask(request | laid.streams() | {"cpu_s": cpu_limit_s(case)})
            return laid.outcome(answer)

    def run_and_read(self, case: Case, *, stop_after: int | None = None) -> tuple[dict[str, bytes], Outcome]:
        """Run a case and return what it made, too."""
        keep = self.scratch / "made"
        shutil.rmtree(keep, ignore_errors=True)
        outcome = self.run(case, stop_after=stop_after, keep=keep)
        made = {name: (keep / name).read_bytes() for name in outcome.after if (keep / name).is_file()}
        return made, outcome

    def run_fresh(self, case: Case) -> Outcome:
        """Run a case as a user does it, in an interpreter of its own; start-up counts as CPU time here."""
        with self._laid_out(case, None) as laid:
            streams = laid.streams()
            environment = os.environ | {"TMPDIR": streams["temporary"], "PYTHONPATH": str(ROOT)}
            report = laid.folder.with_suffix(".report")
            with Path(streams["out"]).open("wb") as out, Path(streams["error"]).open("wb") as error:
                child = subprocess.Popen(
                    [sys.executable, "-c", MEASURING, report, *FRESH, *case.command],
                    cwd=laid.folder,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=error,
                    start_new_session=True,
                )
                try:
                    child.wait(FRESH_LIMIT_S)
                except subprocess.TimeoutExpired:
                    os.killpg(child.pid, signal.SIGKILL)
                    child.wait()
                    return laid.outcome({"code": -9, "ended": "too long", "cpu_s": 0.0, "peak_bytes": 0})
            code, cpu_s, kilobytes = json.loads(report.read_text())
            return laid.outcome({"code": code, "ended": "", "cpu_s": cpu_s, "peak_bytes": kilobytes * 1024})

    def _laid_out(self, case: Case, keep: Path | None) -> _LaidOut:
        self._count += 1
        return _LaidOut(case, self.scratch / str(self._count), keep)

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        process = self._started()
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(json.dumps(request) + "\n")
        process.stdin.flush()
        line = process.stdout.readline()
        if not line:
            self._end()
            raise RuntimeError("the harness's server has ended")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _started(self) -> subprocess.Popen[str]:
        if self._process is None:
            environment = os.environ | {
                "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
                "OPENBLAS_NUM_THREADS": "1",
                "LP_NUM_THREADS": "2",
            }
            self._process = subprocess.Popen(
                [sys.executable, "-m", "hostile.server"],
                cwd=self.scratch,
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                start_new_session=True,  # Ctrl-C is for the harness
            )
            assert self._process.stdout is not None
            if not self._process.stdout.readline():
                raise RuntimeError("the harness's server cannot start")
        return self._process

    def _end(self) -> None:
        if self._process is not None:
            for stream in (self._process.stdin, self._process.stdout):
                if stream is not None:
                    stream.close()
            self._process.wait()
            self._process = None


def work_s(case: Case) -> float:
    """Return the seconds of CPU that the command of a case takes by itself."""
    return max((s for command, s in WORK_S.items() if case.command[: len(command)] == command), default=0.0)


def cpu_limit_s(case: Case) -> int:
    """Seconds of CPU after which a case is ended: beyond all doubt more than it may take.

    A seed may have to compile what all others only load.
    """
    return COMPILING_S if case.target == SEED else int(2 * CPU_S + work_s(case)) + 5


class Pool:
    """Some harnesses that run cases at the same time; to be closed, as by ``with``."""

    def __init__(self, count: int = 2) -> None:
        self.harnesses = [Harness() for _ in range(count)]
        self._free: SimpleQueue[Harness] = SimpleQueue()
        for harness in self.harnesses:
            self._free.put(harness)

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        for harness in self.harnesses:
            harness.close()

    def map(self, work: Callable[[Harness, T], R], items: Iterable[T]) -> list[R]:
        """Do some work for every item, each with a harness of its own; return what came of it, in order."""

        def one(item: T) -> R:
            harness = self._free.get()
            try:
                return work(harness, item)
            finally:
                self._free.put(harness)

        with ThreadPoolExecutor(len(self.harnesses)) as threads:
            return list(threads.map(one, items))

    def run(self, cases: Iterable[Case]) -> list[Outcome]:
        return self.map(Harness.run, cases)


class _LaidOut:
    """A case's files on the disk, and what is beside them; gone on leaving the ``with`` block."""

    def __init__(self, case: Case, place: Path, keep: Path | None) -> None:
        self._case, self._place, self._keep = case, place, keep
        self.folder = place / "case"

    def __enter__(self) -> _LaidOut:
        for folder in (self.folder, self._place / "temporary"):
            folder.mkdir(parents=True)
        self._case.write(self.folder)
        self._before = listing(self.folder)
        return self

    def __exit__(self, *_: object) -> None:
        if self._keep is not None:
            shutil.move(self.folder, self._keep)
        shutil.rmtree(self._place, ignore_errors=True)

    def streams(self) -> dict[str, str]:
        return {name: str(self._place / name) for name in ("out", "error", "stacks", "temporary")}

    def outcome(self, answer: dict[str, Any]) -> Outcome:
        after = listing(self.folder)
        after |= {f"$TMPDIR/{name}": what for name, what in listing(self._place / "temporary").items()}
        stacks = self._place / "stacks"
        return Outcome(
            code=answer["code"],
            ended=answer["ended"],
            out=(self._place / "out").read_bytes(),
            error=(self._place / "error").read_bytes(),
            cpu_s=answer["cpu_s"],
            peak_bytes=answer["peak_bytes"],
            before=self._before,
            after=after,
            modules=tuple(answer.get("modules", ())),
            events=tuple(answer.get("events", ())),
            stacks=stacks.read_text() if stacks.exists() else "",
        )


def listing(folder: Path) -> dict[str, str]:
    """Return every path below a folder, and what it is; equal for equal files."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = f"link to {path.readlink()}"
        elif path.is_dir():
            found[name] = "folder"
        elif path.is_file():
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        else:
            found[name] = "special"
    return found
