"""Job execution with Dask, on this machine or on a running cluster. The only module that imports Dask.

Each job runs in its own child process (``execution``), so local workers are threads of this process. On a
cluster, each worker thread runs one job at a time; recordings, results and records must be on a shared file
system that is mounted at the same path everywhere.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any
from uuid import uuid4

from posetrack_cli.batch.execution import Progress
from posetrack_cli.batch.jobs import Job, Limits, Outcome, State
from posetrack_cli.build import source_digest
from posetrack_cli.errors import PosetrackError, UsageError

try:
    import dask
    import distributed
    from dask.system import CPU_COUNT
    from distributed import Client, Event, LocalCluster
except ModuleNotFoundError as missing:
    raise UsageError(
        f"posetrack batch needs the optional dependencies of posetrack[batch]; {missing.name} is missing",
        hint="pip install 'posetrack[batch]'",
    ) from missing

CONNECT_S = 15.0
# A worker polls the stop event at this interval; every poll is a round trip to the scheduler.
_STOP_POLL_S = 1.0
_DASHBOARD = "127.0.0.1:8787"
# Dask always serves its state over HTTP, by default on one fixed port of all interfaces. Port 0 picks a free
# one, so that concurrent batches do not collide, and 127.0.0.1 keeps it private.
_FREE_LOCAL_PORT = "127.0.0.1:0"
_PROGRESS_EVERY_S = 1.0
_TOPIC = "posetrack-batch"
_SETTINGS = {
    "distributed.scheduler.allowed-failures": 1,
    "distributed.admin.log-length": 0,
    # Memory is used by the child processes, which --memory-limit bounds; Dask must not kill the worker.
    "distributed.worker.memory.terminate": False,
    "distributed.worker.use-file-locking": False,  # each batch has its own scratch folder
}

RunJob = Callable[[Job, Limits, Progress, Callable[[], bool]], Outcome]


class EngineError(PosetrackError):
    """The cluster is unreachable or runs another build of posetrack."""


@dataclass(frozen=True)
class EngineOptions:
    """Where the jobs of a batch run.

    Attributes:
        jobs: number of concurrent jobs on this machine.
        scheduler: address of a running Dask scheduler; None to use this machine.
        scheduler_file: scheduler file of a running Dask scheduler; None to use this machine.
        scratch: folder for Dask's temporary files; None for Dask's default, which is not cleaned up.
        dashboard: serve the Dask dashboard.
    """

    jobs: int = 1
    scheduler: str | None = None
    scheduler_file: Path | None = None
    scratch: Path | None = None
    dashboard: bool = False

    @property
    def is_cluster(self) -> bool:
        """Whether the jobs run on a Dask cluster."""
        return self.scheduler is not None or self.scheduler_file is not None


@dataclass(frozen=True)
class JobProgress:
    """Progress of a job.

    Attributes:
        job: name of the job.
        pass_name: name of the current pass over the frames.
        frames: number of finished frames.
        of: total number of frames; None if unknown.
    """

    job: str
    pass_name: str
    frames: int
    of: int | None


class Engine:
    """Runs jobs on all worker threads of a scheduler.

    Args:
        client: Dask client.
        run_job: function that runs a job; called on the worker.
        on_progress: progress callback; called from another thread.
    """

    def __init__(self, client: Client, run_job: RunJob, on_progress: Callable[[JobProgress], None]) -> None:
        self._client, self._perform = client, run_job
        self._run = uuid4().hex
        self._topic = f"{_TOPIC}-{self._run}"
        self._stop = Event(f"{_TOPIC}-stop-{self._run}", client=client)
        self._done: SimpleQueue[tuple[str, Any]] = SimpleQueue()
        self._futures: dict[str, Any] = {}  # Dask cancels a job when its last future is garbage-collected
        client.subscribe_topic(self._topic, lambda event: on_progress(JobProgress(*event[1])))

    def submit(self, job: Job, limits: Limits, *, is_continuation: bool = False) -> None:
        """Submit a job. Jobs start in order of submission, continuations before all others."""
        future = self._client.submit(
            _perform_on_worker,
            self._perform,
            job,
            limits,
            self._topic,
            self._stop.name,
            key=f"{job.name}-{job.kind}-{self._run}",
            pure=False,
            priority=int(is_continuation),
        )
        self._futures[job.name] = future
        future.add_done_callback(lambda done, name=job.name: self._done.put((name, done)))

    def next_outcome(self, timeout_s: float) -> Outcome | None:
        """Return the outcome of the next job to end, or None if none ends within ``timeout_s``."""
        try:
            name, future = self._done.get(timeout=timeout_s)
        except Empty:
            return None
        self._futures.pop(name, None)
        try:
            outcome: Outcome = future.result(timeout=CONNECT_S)
        except BaseException as error:  # Dask reports dead workers and lost connections as exceptions
            outcome = Outcome(name, State.FAILED, _failure_reason(error))
        future.release()
        return outcome

    def stop(self) -> None:
        """Stop running jobs after their current frame; start no further ones."""
        with suppress(OSError, TimeoutError):
            self._stop.set()

    def capacity(self) -> int:
        """Return the current number of worker threads; 0 if the scheduler cannot be reached."""
        with suppress(OSError, TimeoutError):
            return sum(self._client.nthreads().values())
        return 0


@contextmanager
def open_engine(
    where: EngineOptions,
    run_job: RunJob,
    on_progress: Callable[[JobProgress], None] = lambda progress: None,
    note: Callable[[str], None] = lambda line: None,
) -> Iterator[Engine]:
    """Start local workers or connect to a cluster; shut down on exit.

    Args:
        where: machines to use.
        run_job: function that runs a job; called on the worker.
        on_progress: progress callback.
        note: called with a line of text for the user.

    Raises:
        EngineError: no scheduler responds, or a worker runs another build of posetrack.
    """
    for name in ("distributed", "distributed.worker", "distributed.scheduler", "distributed.nanny"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # job failures are reported by the batch itself
    with ExitStack() as stack:
        scratch = {} if where.scratch is None else {"temporary-directory": str(where.scratch)}
        stack.enter_context(dask.config.set(_SETTINGS | scratch))
        client = stack.enter_context(_cluster_client(where) if where.is_cluster else _local_client(where))
        if where.is_cluster:
            _check_cluster(client, note)
        if where.dashboard:
            note(f"dashboard: {_dashboard_url(client, where)}")
        yield Engine(client, run_job, on_progress)


@contextmanager
def _local_client(where: EngineOptions) -> Iterator[Client]:
    """Start one worker in this process; each of its threads waits for the child process of a job."""
    if where.dashboard and find_spec("bokeh") is None:
        raise UsageError("--dashboard needs Bokeh, which is not installed", hint="pip install bokeh")
    with (
        LocalCluster(
            n_workers=1,
            threads_per_worker=where.jobs,
            processes=False,
            dashboard_address=_DASHBOARD if where.dashboard else None,
            scheduler_kwargs={} if where.dashboard else {"dashboard_address": _FREE_LOCAL_PORT},
            worker_dashboard_address=_FREE_LOCAL_PORT,
            memory_limit=0,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def _dashboard_url(client: Client, where: EngineOptions) -> str:
    """Return the URL of the Dask dashboard."""
    link: str = client.dashboard_link
    if where.is_cluster:
        return link
    # For an in-process scheduler, dashboard_link names an interface that Dask does not listen on.
    port = client.scheduler_info()["services"]["dashboard"]
    return f"http://{_DASHBOARD.partition(':')[0]}:{port}/status"


@contextmanager
def _cluster_client(where: EngineOptions) -> Iterator[Client]:
    """Connect to a running scheduler."""
    place = where.scheduler_file if where.scheduler is None else where.scheduler
    hint = "start one with: dask scheduler"
    message = "no Dask scheduler responds"
    try:
        client = _connect(where)
    except FileNotFoundError as error:
        found = f"no such file after {CONNECT_S:g} s"
        raise EngineError(message, where=place, found=found, hint=hint) from error
    except OSError as error:
        found = f"no connection after {CONNECT_S:g} s"
        raise EngineError(message, where=place, found=found, hint=hint) from error
    except (ValueError, KeyError, TypeError) as error:  # Dask parses addresses and files without checks
        raise EngineError(
            "not a Dask scheduler address or file", where=place, found=error, hint=hint
        ) from error
    with client:
        yield client


def _connect(where: EngineOptions) -> Client:
    if where.scheduler is not None:
        return Client(where.scheduler, timeout=CONNECT_S)
    assert where.scheduler_file is not None
    end_s = time.monotonic() + CONNECT_S
    while not where.scheduler_file.is_file():  # written once the scheduler is up
        if time.monotonic() > end_s:
            raise FileNotFoundError(where.scheduler_file)
        time.sleep(0.2)
    return Client(scheduler_file=str(where.scheduler_file), timeout=CONNECT_S)


def _check_cluster(client: Client, note: Callable[[str], None]) -> None:
    """Raise an error if any worker runs another build, as results would depend on the worker.

    Workers that join later are checked by each job's child process (``cli.batch_child``).
    """
    if not client.nthreads():
        note("waiting for workers: the cluster has none (start one with: dask worker ADDRESS)")
        client.wait_for_workers(1)
    try:
        found = client.run(_worker_sources)
    except Exception as error:  # Dask re-raises worker exceptions, including import errors, as any type
        hint = "install the same posetrack build on the worker"
        raise EngineError(
            "posetrack is missing on a worker, or is another build", found=error, hint=hint
        ) from error
    for address, sources in found.items():
        if sources != source_digest():
            raise EngineError(
                "worker runs another build of posetrack",
                where=address,
                found=f"sources {sources}",
                expected=f"sources {source_digest()}",
                hint="install the same build on client and workers (check with posetrack --version)",
            )


def _worker_sources() -> str:
    return source_digest()


def _perform_on_worker(run_job: RunJob, job: Job, limits: Limits, topic: str, stop_name: str) -> Outcome:
    """Run a job in a worker thread."""
    worker = distributed.get_worker()
    stop = Event(stop_name, client=distributed.get_client())
    threads = limits.threads or max(1, CPU_COUNT // worker.state.nthreads)
    polled_s = sent_s = float("-inf")
    is_stopped = False

    def stopped() -> bool:
        nonlocal polled_s, is_stopped
        if not is_stopped and (now := time.monotonic()) - polled_s >= _STOP_POLL_S:
            polled_s = now
            with suppress(OSError, TimeoutError):
                is_stopped = stop.is_set()
        return is_stopped

    def progress(pass_name: str, frames: int, of: int | None) -> None:
        nonlocal sent_s
        if (now := time.monotonic()) - sent_s >= _PROGRESS_EVERY_S:
            sent_s = now
            worker.log_event(topic, (job.name, pass_name, frames, of))

    return run_job(job, replace(limits, threads=threads), progress, stopped)


def _failure_reason(error: BaseException) -> str:
    if isinstance(error, distributed.KilledWorker):
        return "worker died on every attempt"
    if isinstance(error, distributed.CancelledError):
        return "lost connection to the scheduler"
    return f"{type(error).__name__}: {error}"
