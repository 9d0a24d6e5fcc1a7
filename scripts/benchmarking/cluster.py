"""A Dask cluster of processes on this machine, which may be killed."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

from benchmarking.commands import POSETRACK

_DASK = (POSETRACK[0], "-m", "dask")


class Cluster:
    """A scheduler and workers of one thread each; as a context they end with it.

    Args:
        folder: for the scheduler's file and what workers write.
        workers: how many.
        environment: variables beside this process's own.
    """

    def __init__(self, folder: Path, workers: int, environment: Mapping[str, str] | None = None) -> None:
        self.file = folder / "scheduler.json"
        self._folder, self._count = folder, workers
        self._environment = {**os.environ, **(environment or {})}
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Cluster:
        self.file.unlink(missing_ok=True)  # of a scheduler that was killed
        self.scheduler = self._started("scheduler", "--port", "0")
        for _ in range(self._count):
            self.add_worker()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        every = [*self.workers, *([self.scheduler] if self.scheduler is not None else [])]
        for one in every:  # without asking: a worker whose scheduler is gone waits for it
            one.kill()
        for one in every:
            one.wait()
        self.workers = []

    def add_worker(self) -> None:
        """Start one more."""
        scratch = ("--local-directory", str(self._folder))
        self.workers.append(self._started("worker", "--nthreads", "1", "--no-nanny", *scratch))

    def kill_worker(self, worker: subprocess.Popen[bytes]) -> None:
        """Kill one."""
        self.workers.remove(worker)
        worker.kill()
        worker.wait()

    def _started(self, *arguments: str) -> subprocess.Popen[bytes]:
        common = ("--scheduler-file", str(self.file), "--no-dashboard", "--host", "127.0.0.1")
        nowhere = subprocess.DEVNULL
        return subprocess.Popen(
            [*_DASK, *arguments, *common], stdout=nowhere, stderr=nowhere, env=self._environment
        )
