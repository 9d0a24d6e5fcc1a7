"""posetrack commands as processes: CPU time, peak memory, and a Dask cluster."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType

import numpy as np

from benchmarking.rows import Row

POSETRACK = (sys.executable, "-P", "-m", "posetrack_cli.cli.main")  # -P: not what lies in the current folder

# ru_maxrss of a child starts at the size of the process that forked it, so a small one has to fork.
_LAUNCHER = """
import json, os, sys
quiet = os.open(os.devnull, os.O_WRONLY)
actions = [(os.POSIX_SPAWN_DUP2, quiet, 1), (os.POSIX_SPAWN_DUP2, quiet, 2)]
pid = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ, file_actions=actions)
_, status, usage = os.wait4(pid, 0)
print(json.dumps([os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, usage.ru_maxrss]))
"""


def usage_of(command: Sequence[str], allowed: Sequence[int] = (0,)) -> tuple[float, float]:
    """Run a command; return its CPU seconds and its peak memory, MiB. Other exit codes are errors."""
    line = [sys.executable, "-S", "-c", _LAUNCHER, *command]
    launched = subprocess.run(line, check=True, capture_output=True, text=True)
    code, seconds, kibibytes = json.loads(launched.stdout)
    if code not in allowed:
        raise subprocess.CalledProcessError(code, list(command))
    return seconds, kibibytes / 1024


def start_up() -> Iterator[Row]:
    """Yield the CPU time of --help."""
    for names in ((), ("head", "stereo"), ("head", "mono")):
        times = [usage_of([*POSETRACK, *names, "--help"])[0] for _ in range(6)]
        yield Row(" ".join(["posetrack", *names, "--help, CPU time"]), float(np.median(times[1:])), "s", 0.3)


def peak_memory(
    subject: str, command: Sequence[str], frames: int, folder: Path, target: float | None = None
) -> Iterator[Row]:
    """Yield the peak memory (MiB) of a run over a tenth of a recording and over all of it.

    ``command`` has no output or frame options; results go to ``folder``.
    """
    peaks = []
    for end in (frames // 10, frames):
        output = ["-o", str(folder / f"{end}.mcap"), "--end", str(end)]
        peaks.append(usage_of([*POSETRACK, *command, *output])[1])
        yield Row(f"{subject}, peak memory, {end} frames", peaks[-1], "MiB", target)
    yield Row(f"{subject}, ten times the frames over one time", peaks[1] / peaks[0], "", 1.05)


class Cluster:
    """A Dask scheduler and single-threaded workers, which may be killed; a context that ends them."""

    def __init__(self, folder: Path, workers: int, environment: Mapping[str, str] | None = None) -> None:
        self.file = folder / "scheduler.json"
        self._folder, self._count = folder, workers
        self._environment = {**os.environ, **(environment or {})}
        self._scheduler: list[subprocess.Popen[bytes]] = []
        self.workers: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Cluster:
        self.file.unlink(missing_ok=True)  # left by a killed scheduler
        self._scheduler = [self._started("scheduler", "--port", "0")]
        for _ in range(self._count):
            self.add_worker()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        every = [*self.workers, *self._scheduler]
        for one in every:  # SIGKILL: a worker without scheduler would wait for it
            one.kill()
        for one in every:
            one.wait()
        self.workers = []

    def add_worker(self) -> None:
        """Start another worker."""
        scratch = ("--local-directory", str(self._folder))
        self.workers.append(self._started("worker", "--nthreads", "1", "--no-nanny", *scratch))

    def kill_worker(self, worker: subprocess.Popen[bytes]) -> None:
        """Kill a worker."""
        self.workers.remove(worker)
        worker.kill()
        worker.wait()

    def _started(self, *arguments: str) -> subprocess.Popen[bytes]:
        common = ("--scheduler-file", str(self.file), "--no-dashboard", "--host", "127.0.0.1")
        line, nowhere = [POSETRACK[0], "-m", "dask", *arguments, *common], subprocess.DEVNULL
        return subprocess.Popen(line, stdout=nowhere, stderr=nowhere, env=self._environment)
