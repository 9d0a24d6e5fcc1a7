"""Batches with pieces whose processes are killed: the same command comes to the bytes of a whole batch."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path

from benchmarking.cluster import Cluster
from soaking.cases import Case
from soaking.findings import Findings
from soaking.kills import Attempt, kill_until_enough
from soaking.processes import DATA_LOST, DONE, FAILED, Ended, Started, started

HERE, ON_CLUSTER = ("batch", "process of a job"), ("client of a cluster", "worker", "scheduler")
VICTIMS = (*HERE, *ON_CLUSTER)
WORKERS = 2
KILLS_A_BATCH = 6
ENDS_WITHIN_S = 900.0
_LEFT = (".part", ".state", ".frames", ".pieces", "scratch")
_JOB = b"posetrack_cli.cli.batch_child"


@dataclass(frozen=True)
class WholeBatch:
    """A batch that nothing happened to.

    Attributes:
        results: bytes of each, by name.
        seconds: that it took.
    """

    results: dict[str, bytes]
    seconds: float


class BatchKilling:
    """One batch, killed again and again until it is done.

    Args:
        case: the batch.
        whole: what it must come to.
        folder: for everything it writes; not there yet.
        rng: chooses the moments.
    """

    def __init__(self, case: Case, whole: WholeBatch, folder: Path, rng: random.Random) -> None:
        self._case, self._whole, self._folder, self._rng = case, whole, folder, rng
        self.killed: Counter[str] = Counter()
        self._attempts = 0
        self.output = folder / "out"
        folder.mkdir(parents=True)

    def run(self, victims: Sequence[str]) -> Iterator[str]:
        """Kill these in turn, all here or all of a cluster; yield what is not as it must be."""
        allowed = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "3"}
        on_cluster = victims[0] in ON_CLUSTER
        with Cluster(self._folder, WORKERS, allowed) if on_cluster else nullcontext() as cluster:
            for victim in victims:
                ended = self._attempt(victim, cluster)
                is_batch = victim in ("batch", "client of a cluster")
                codes = (DONE, -signal.SIGKILL) if is_batch else (DONE, FAILED, DATA_LOST)
                yield from (f"{victim} killed: {line}" for line in _odd(ended, codes))
                if ended.code == DONE:
                    break
            else:
                ended = self._attempt(None, cluster)
        yield from _odd(ended, (DONE,))
        yield from self._judge()

    def _attempt(self, victim: str | None, cluster: Cluster | None) -> Ended:
        self._attempts += 1
        more = () if cluster is None else ("--scheduler-file", str(cluster.file))
        command = self._case.command(self.output, *more)
        with started(command, self._folder / f"attempt-{self._attempts}.txt") as run:
            if victim is not None and _wait(run, self._rng.uniform(0.05, 0.9) * self._whole.seconds):
                self.killed[victim] += self._kill(victim, run, cluster)
            try:
                run.process.wait(ENDS_WITHIN_S)
            except subprocess.TimeoutExpired:
                return Ended(DONE, f"Traceback: did not end within {ENDS_WITHIN_S:g} s")
            return run.end()

    def _kill(self, victim: str, run: Started, cluster: Cluster | None) -> bool:
        """Kill it, and put another one into the place of what a cluster lost; return whether it was there."""
        if victim == "process of a job":
            return _killed_job(run)
        if cluster is None or victim == "client of a cluster":
            run.process.kill()
        elif victim == "worker":
            busy = [one for one in cluster.workers if _jobs_of(one.pid)]
            cluster.kill_worker(self._rng.choice(busy or cluster.workers))
            cluster.add_worker()
        else:
            cluster.__exit__(None, None, None)
            time.sleep(self._rng.uniform(0.0, 2.0))
            run.process.wait(ENDS_WITHIN_S)
            cluster.__enter__()
        return True

    def _judge(self) -> Iterator[str]:
        """Yield what is wrong with the results, and what was left beside them."""
        if read_results(self.output) != self._whole.results:
            yield f"results differ from an uninterrupted batch's after {self.killed.total()} kills"
        left = [
            str(path.relative_to(self.output)) for path in self.output.rglob("*") if path.name.endswith(_LEFT)
        ]
        if left:
            yield f"left behind: {', '.join(sorted(left))}"


def _odd(ended: Ended, codes: Sequence[int]) -> Iterator[str]:
    """Yield what is not as it must be of a batch, which also tells in lines of its own what failed."""
    last = ended.said.splitlines()[-1:] or [""]
    if ended.code not in codes:
        yield f"exit code {ended.code}, expected {' or '.join(map(str, codes))}; said: {last[0][:300]}"
    if "Traceback" in ended.said or "internal error" in ended.said:
        yield f"a traceback; said: {last[0][:300]}"


def _wait(run: Started, seconds: float) -> bool:
    """Wait; return False if the process ended before."""
    try:
        run.process.wait(seconds)
    except subprocess.TimeoutExpired:
        return True
    return False


def _killed_job(run: Started) -> bool:
    while run.running:
        if jobs := _jobs_of(run.process.pid):
            with suppress(ProcessLookupError):  # ended meanwhile
                os.kill(jobs[0], signal.SIGKILL)
                return True
        time.sleep(0.02)
    return False


def _jobs_of(process: int) -> list[int]:
    """The processes of jobs that a process has started."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == process and _JOB in (path / "cmdline").read_bytes():
                found.append(int(path.name))
        except (OSError, ValueError):  # ended meanwhile
            continue
    return found


def read_results(folder: Path) -> dict[str, bytes]:
    """Return the bytes of a batch's results by name."""
    return {path.name: path.read_bytes() for path in folder.glob("*.mcap")}


def whole_batch(case: Case, folder: Path, findings: Findings) -> WholeBatch | None:
    """Run a batch twice, the first time for its kernels to be compiled; None if that fails."""
    folder.mkdir(parents=True)
    found = []
    for number in range(2):
        output, began = folder / f"whole-{number}", time.perf_counter()
        with started(case.command(output), folder / f"whole-{number}.txt") as run:
            ended = run.end()
        if not findings.troubles_of(f"{case.name}, uninterrupted", _odd(ended, (DONE,))):
            return None
        found.append(WholeBatch(read_results(output), time.perf_counter() - began))
    if found[0].results != found[1].results:
        findings.trouble(f"{case.name}: two batches that nothing happened to differ")
    return found[1]


def soak_batches(case: Case, kills: int, seed: int, folder: Path, findings: Findings) -> None:
    """Kill parts of batches, so many times in all, and note how many batches came to other bytes."""
    whole = whole_batch(case, folder / "whole", findings)
    if whole is None:
        return
    rng = random.Random(seed)

    def attempt(number: int, most: int) -> Attempt:
        kind = ON_CLUSTER if number % 3 else HERE  # of five victims three are of a cluster
        victims = rng.choices(kind, k=min(KILLS_A_BATCH, most))
        killing = BatchKilling(case, whole, folder / f"batch-{number}", rng)
        name = f"{case.name}, killed batch {number}"
        return Attempt(name, len(victims), killing.killed, killing.run(victims))

    names = {victim: f"batches, {victim} killed" for victim in VICTIMS}
    kill_until_enough("batches", "batches, kills", names, kills, attempt, findings)
