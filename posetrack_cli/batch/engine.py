"""Jobs given to Dask: on this machine, or on a cluster that exists. The only module that knows Dask.

A job's work is done by a process of its own (``performing``), so on one machine the workers are threads of
this process: nothing has to start. On a cluster each thread of each worker does one job at a time; results,
records and recordings lie in folders that all of them see under the same names.
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

from posetrack_cli.batch.jobs import Job, Limits, Outcome, State
from posetrack_cli.batch.performing import Progress
from posetrack_cli.build import source_digest
from posetrack_cli.errors import PosetrackError, UsageError

try:
    import dask
    import distributed
    from dask.system import CPU_COUNT
    from distributed import Client, Event, LocalCluster
except ModuleNotFoundError as missing:  # the extra is not installed
    raise UsageError(
        f"posetrack batch needs the extra packages of posetrack[batch], and {missing.name} is missing",
        hint="pip install 'posetrack[batch]'",
    ) from missing

CONNECT_S = 15.0
_CHECKED_EVERY_S = 1.0
"""So often a job on a worker asks whether it shall stop."""
_DASHBOARD = "127.0.0.1:8787"
_NOBODYS_PORT = "127.0.0.1:0"
"""Dask serves its state over HTTP, wanted or not: on any free port, for this machine alone. Left to itself it
takes the same port for every batch, and any network's."""
_TOLD_EVERY_S = 1.0
_TOPIC = "posetrack-batch"
_SETTINGS = {
    "distributed.scheduler.allowed-failures": 1,
    "distributed.admin.log-length": 0,
    "distributed.worker.memory.terminate": False,
    "distributed.worker.use-file-locking": False,  # a batch's scratch folder is its own
}

Perform = Callable[[Job, Limits, Progress, Callable[[], bool]], Outcome]


class EngineError(PosetrackError):
    """A cluster that cannot be used."""


@dataclass(frozen=True)
class Where:
    """Which machines do the jobs.

    Attributes:
        jobs: how many at a time on this machine.
        scheduler: address of a cluster's scheduler; None for this machine.
        scheduler_file: of a cluster's scheduler; None for this machine.
        scratch: folder that Dask may write to on this machine; None leaves that to Dask, which leaves files.
        dashboard: whether Dask's page about its state is served.
    """

    jobs: int = 1
    scheduler: str | None = None
    scheduler_file: Path | None = None
    scratch: Path | None = None
    dashboard: bool = False

    @property
    def is_cluster(self) -> bool:
        """Whether they are of a cluster that exists."""
        return self.scheduler is not None or self.scheduler_file is not None


@dataclass(frozen=True)
class Told:
    """How far a job is.

    Attributes:
        job: its name.
        pass_name: of what is done.
        frames: that are done.
        of: how many there are; None where that is not known.
    """

    job: str
    pass_name: str
    frames: int
    of: int | None


class Engine:
    """Does jobs, as many at a time as its machines have places.

    Args:
        client: of the scheduler.
        perform: does a job, where it runs.
        told: called, in another thread, with how far a job is.
    """

    def __init__(self, client: Client, perform: Perform, told: Callable[[Told], None]) -> None:
        self._client, self._perform = client, perform
        self._run = uuid4().hex
        self._topic = f"{_TOPIC}-{self._run}"
        self._stop = Event(f"{_TOPIC}-stop-{self._run}", client=client)
        self._done: SimpleQueue[tuple[str, Any]] = SimpleQueue()
        self._futures: dict[str, Any] = {}  # of jobs that are not over: Dask drops what nobody holds
        client.subscribe_topic(self._topic, lambda event: told(Told(*event[1])))

    def submit(self, job: Job, limits: Limits, *, goes_on: bool = False) -> None:
        """Give a job; those that were given first begin first, and what goes on with one before all."""
        future = self._client.submit(
            _perform_there,
            self._perform,
            job,
            limits,
            self._topic,
            self._stop.name,
            key=f"{job.name}-{job.kind}-{self._run}",
            pure=False,
            priority=int(goes_on),
        )
        self._futures[job.name] = future
        future.add_done_callback(lambda done, name=job.name: self._done.put((name, done)))

    def next_outcome(self, timeout_s: float) -> Outcome | None:
        """Wait for the next job that is over; None if none is so soon. Nothing of it is kept here."""
        try:
            name, future = self._done.get(timeout=timeout_s)
        except Empty:
            return None
        self._futures.pop(name, None)
        try:
            outcome: Outcome = future.result(timeout=CONNECT_S)
        except BaseException as error:  # of workers that died, and of Dask
            outcome = Outcome(name, State.FAILED, _line_of(error))
        future.release()
        return outcome

    def stop(self) -> None:
        """Have jobs stop after the frame at hand, and begin no others."""
        with suppress(OSError, TimeoutError):
            self._stop.set()

    def places(self) -> int:
        """How many jobs can be done at a time just now."""
        with suppress(OSError, TimeoutError):
            return sum(self._client.nthreads().values())
        return 0


@contextmanager
def open_engine(
    where: Where,
    perform: Perform,
    told: Callable[[Told], None] = lambda progress: None,
    note: Callable[[str], None] = lambda line: None,
) -> Iterator[Engine]:
    """Start workers here, or connect to a cluster.

    Raises:
        EngineError: there is no cluster where one should be, or it has another build of posetrack.
    """
    for name in ("distributed", "distributed.worker", "distributed.scheduler", "distributed.nanny"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        scratch = {} if where.scratch is None else {"temporary-directory": str(where.scratch)}
        stack.enter_context(dask.config.set(_SETTINGS | scratch))
        client = stack.enter_context(_connected(where) if where.is_cluster else _started(where))
        if where.is_cluster:
            _check_cluster(client, note)
        if where.dashboard:
            note(f"dashboard: {_dashboard_of(client, where)}")
        yield Engine(client, perform, told)


@contextmanager
def _started(where: Where) -> Iterator[Client]:
    """A client of one worker in this process, whose threads each wait for the process of a job."""
    if where.dashboard and find_spec("bokeh") is None:
        raise UsageError("--dashboard needs Bokeh, which is missing", hint="pip install bokeh")
    with (
        LocalCluster(
            n_workers=1,
            threads_per_worker=where.jobs,
            processes=False,
            dashboard_address=_DASHBOARD if where.dashboard else None,
            scheduler_kwargs={} if where.dashboard else {"dashboard_address": _NOBODYS_PORT},
            worker_dashboard_address=_NOBODYS_PORT,
            memory_limit=0,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def _dashboard_of(client: Client, where: Where) -> str:
    """The address of Dask's page; of a scheduler here Dask names an address that it does not listen on."""
    link: str = client.dashboard_link
    if where.is_cluster:
        return link
    port = client.scheduler_info()["services"]["dashboard"]
    return f"http://{_DASHBOARD.partition(':')[0]}:{port}/status"


@contextmanager
def _connected(where: Where) -> Iterator[Client]:
    """A client of a scheduler that exists."""
    place = where.scheduler_file if where.scheduler is None else where.scheduler
    hint = "start one with: dask scheduler"
    try:
        client = _client_of(where)
    except FileNotFoundError as error:
        found = f"no such file within {CONNECT_S:g} s"
        raise EngineError("no Dask scheduler answers", where=place, found=found, hint=hint) from error
    except OSError as error:
        found = f"nothing within {CONNECT_S:g} s"
        raise EngineError("no Dask scheduler answers", where=place, found=found, hint=hint) from error
    except (ValueError, KeyError, TypeError) as error:  # no address, or no file of a scheduler
        raise EngineError("tells of no Dask scheduler", where=place, found=error, hint=hint) from error
    with client:
        yield client


def _client_of(where: Where) -> Client:
    if where.scheduler is not None:
        return Client(where.scheduler, timeout=CONNECT_S)
    assert where.scheduler_file is not None
    end_s = time.monotonic() + CONNECT_S
    while not where.scheduler_file.is_file():  # a scheduler writes it when it is up
        if time.monotonic() > end_s:
            raise FileNotFoundError(where.scheduler_file)
        time.sleep(0.2)
    return Client(scheduler_file=str(where.scheduler_file), timeout=CONNECT_S)


def _check_cluster(client: Client, note: Callable[[str], None]) -> None:
    """Refuse workers with another posetrack; results would depend on which of them a recording meets.

    The processes of workers that come later look for themselves (``cli.batch_child``).
    """
    if not client.nthreads():
        note("the cluster has no workers yet; waiting for some (dask worker ADDRESS)")
        client.wait_for_workers(1)
    try:
        found = client.run(_sources_there)
    except Exception as error:  # Dask passes on what a worker raises as it likes
        hint = "install posetrack there as it is here"
        raise EngineError("worker has no posetrack, or another build", found=error, hint=hint) from error
    for address, sources in found.items():
        if sources != source_digest():
            raise EngineError(
                "worker has another build of posetrack",
                where=address,
                found=f"sources {sources}",
                expected=f"sources {source_digest()}",
                hint="install the same on client and workers; posetrack --version says which it is",
            )


def _sources_there() -> str:
    return source_digest()


def _perform_there(perform: Perform, job: Job, limits: Limits, topic: str, stop_name: str) -> Outcome:
    """Do a job in a thread of a worker."""
    worker = distributed.get_worker()
    stop = Event(stop_name, client=distributed.get_client())
    threads = limits.threads or max(1, CPU_COUNT // worker.state.nthreads)
    asked_s = told_s = float("-inf")
    is_stopped = False

    def stopped() -> bool:
        nonlocal asked_s, is_stopped
        if not is_stopped and (now := time.monotonic()) - asked_s >= _CHECKED_EVERY_S:
            asked_s = now
            with suppress(OSError, TimeoutError):
                is_stopped = stop.is_set()
        return is_stopped

    def progress(pass_name: str, frames: int, of: int | None) -> None:
        nonlocal told_s
        if (now := time.monotonic()) - told_s >= _TOLD_EVERY_S:
            told_s = now
            worker.log_event(topic, (job.name, pass_name, frames, of))

    return perform(job, replace(limits, threads=threads), progress, stopped)


def _line_of(error: BaseException) -> str:
    """Why there is no outcome, in words of ours where it is known."""
    if isinstance(error, distributed.KilledWorker):
        return "the worker died each time that it was tried"
    if isinstance(error, distributed.CancelledError):
        return "the connection to the scheduler was lost"
    return f"{type(error).__name__}: {error}"
