"""Runs and batches that are killed at random times and resumed; their bytes must not change."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import NamedTuple

from benchmarking.processes import Cluster
from benchmarking.rows import Row
from posetrack_cli.cli.terminal import bar
from posetrack_cli.outputs import part_path, state_path
from soaking import runs

PHASES = ("start-up", "compiling", "first pass", "second pass", "finishing")
COMPILING_S = 20.0  # longest delay of a kill after a compilation is announced
COLD_EVERY = 4  # every fourth run starts with an empty kernel cache
MISSES = 3  # allowed ratio of kills that come too late to all wanted kills
HERE, ON_CLUSTER = ("batch", "process of a job"), ("client of a cluster", "worker", "scheduler")
WORKERS = 2
KILLS_A_BATCH = 6
ENDS_WITHIN_S = 900.0
_LEFT = (".part", ".state", ".frames", ".pieces", "scratch")


class Attempt(NamedTuple):
    """A run or batch that is killed and resumed until it finishes."""

    name: str  # for messages
    planned: int  # kills
    killed: Counter[str]  # kills that were in time, by victim or phase; final after ``troubles``
    troubles: Iterator[str]  # performs the attempt and yields failed checks


def kill_until_enough(
    what: str,
    total: str,
    names: Mapping[str, str],
    kills: int,
    attempt: Callable[[int, int], Attempt],
    findings: runs.Findings,
) -> None:
    """Make attempts until the wanted number of kills is reached, and record the outcome.

    Args:
        what: victims in the plural, for row names.
        total: row name of the number of kills.
        names: row name of the number of kills by kind.
        kills: number of kills wanted.
        attempt: starts an attempt, given its number and the maximum number of kills.
        findings: receives the figures.
    """
    killed, missed, attempts, wrong = Counter[str](), 0, 0, 0
    with bar(total, "kill", kills) as shown:
        while (done := killed.total()) < kills and missed <= MISSES * kills:
            one = attempt(attempts, kills - done)
            fine = findings.troubles_of(one.name, one.troubles)
            wrong, attempts = wrong + (not fine), attempts + 1
            missed += one.planned - one.killed.total()
            killed += one.killed
            shown.advance(one.killed.total())
    for kind, name in names.items():
        findings.add(Row(name, killed[kind], ""))
    findings.add(Row(total, killed.total(), ""))
    findings.add(Row(f"killed {what}, all resumed to their end", attempts, ""))
    findings.add(Row(f"killed {what} that came to other bytes or were not as they must be", wrong, "", 0.0))
    if killed.total() < kills:
        findings.trouble(f"{total}: {killed.total()} of {kills}, as {missed} came too late")


# Runs


class Moment(NamedTuple):
    """Time of a kill, as a share of a phase's duration; above 1 it may fall after the end."""

    phase: str
    share: float


def plan(rng: random.Random, most: int, *, cold: bool) -> list[Moment]:
    """Return the moments of at most ``most`` kills of one run, in the order of the phases.

    With an empty kernel cache (``cold``), the first kill is during compilation.
    """
    count = min(most, rng.randint(1, 4))
    phases = ["compiling"] if cold else []
    phases += rng.choices([phase for phase in PHASES if phase != "compiling"], k=count - len(phases))
    resumed = [phase for phase in phases if phase != "start-up"]
    ordered = sorted(resumed, key=PHASES.index)
    for _ in range(len(phases) - len(resumed)):  # every resumed run has a start-up phase
        ordered.insert(rng.randint(1 if cold else 0, len(ordered)), "start-up")
    return [Moment(phase, rng.uniform(0.0, 1.2 if phase == "finishing" else 1.0)) for phase in ordered]


class Killing:
    """One run in a new folder, killed at planned moments and resumed until it finishes.

    Args:
        case: the run.
        reference: uninterrupted run with the expected result.
        folder: new folder for all files.
        cold: whether to start with an empty kernel cache.
    """

    def __init__(
        self, case: runs.Case, reference: runs.Reference, folder: Path, *, cold: bool = False
    ) -> None:
        self._case, self._reference, self._folder = case, reference, folder
        self.killed: Counter[str] = Counter()
        self.attempts = 0
        self.output = folder / "out" / "result.mcap"
        self.output.parent.mkdir(parents=True)
        self._environment: Mapping[str, str] = {"NUMBA_CACHE_DIR": str(folder / "cache")} if cold else {}

    def run(self, moments: Sequence[Moment]) -> Iterator[str]:
        """Kill and resume; yield failed checks, one line each."""
        for moment in moments:
            if self.output.exists():
                break
            ended = self._attempt(moment)
            if ended.code != -signal.SIGKILL:
                yield from self._judge_end(ended)
                return
            self.killed[moment.phase] += 1
            left = (*ended.troubles((-signal.SIGKILL,)), *unreadable(self._case, self.output))
            yield from (f"killed in {moment.phase}: {line}" for line in left)
        if self.output.exists():  # killed after the result was renamed to its final name
            yield from self._judge_bytes()
            return
        yield from self._judge_end(self._attempt(None))

    def _attempt(self, moment: Moment | None) -> runs.Ended:
        """Start or resume the run, and kill it at the moment, if given and reached."""
        self.attempts += 1
        more = ["--resume"] if state_path(self.output).exists() else []
        command = self._case.command(self.output, *more)
        with runs.started(command, self._folder / f"attempt-{self.attempts}.txt", self._environment) as run:
            if moment is not None and self._wait(run, moment, resumed=bool(more)):
                run.process.kill()
            return run.end()

    def _wait(self, run: runs.Started, moment: Moment, *, resumed: bool) -> bool:
        """Wait for a moment; return False if the process ended before."""
        threshold, seconds = self._window(moment)
        looker = runs.Looker(self._case, self.output)
        if moment.phase == "compiling":
            reached = run.wait_until(lambda: "compiling" in run.said)
        elif moment.phase == "start-up":
            reached = True
        elif resumed and looker.steps >= threshold:
            seconds, reached = seconds + self._reference.first, True
        else:
            reached = run.wait_until(lambda: looker.steps >= threshold)
        until = time.perf_counter() + seconds
        return reached and run.wait_until(lambda: time.perf_counter() >= until)

    def _window(self, moment: Moment) -> tuple[int, float]:
        """Return the frame count at which a moment's phase begins, and the delay after that, s."""
        times, case = self._reference, self._case
        if moment.phase == "finishing" and case.smoothed:  # the end of the backward pass
            return case.steps, (0.8 + 0.2 * moment.share) * (times.end - times.last)
        begins, lasts = {
            "start-up": (0, times.first),
            "compiling": (0, COMPILING_S),
            "first pass": (0, times.second - times.first),
            "second pass": (case.frames, (times.end if case.smoothed else times.last) - times.second),
            "finishing": (case.steps, times.end - times.last),
        }[moment.phase]
        return begins, moment.share * lasts

    def _judge_end(self, ended: runs.Ended) -> Iterator[str]:
        """Yield failed checks of a run that ended by itself."""
        troubles = list(ended.troubles((runs.DONE,)))
        yield from troubles
        if not troubles:
            yield from self._judge_bytes()
            others = sorted(path.name for path in self.output.parent.iterdir() if path != self.output)
            if others:
                yield f"left next to the result: {', '.join(others)}"

    def _judge_bytes(self) -> Iterator[str]:
        if self.output.read_bytes() != self._reference.data:
            yield f"the result differs from an uninterrupted run's after {self.attempts - 1} kills"


def unreadable(case: runs.Case, output: Path) -> Iterator[str]:
    """Check that every frame of an unfinished result up to its checkpoint is readable; yield failures."""
    part = part_path(output)
    if output.exists() or not part.exists():
        return
    standing = runs.standing_of(case, output)
    found, ended = runs.frames_readable(part)
    if standing is None:  # nothing was flushed yet
        yield from ended.troubles((runs.DONE, runs.DATA_LOST, runs.FAILED))
        return
    yield from ended.troubles((runs.DONE, runs.DATA_LOST))
    if found < standing.written:
        yield f"info finds {found} frames in the unfinished result, the checkpoint is of {standing.written}"


def soak_kills(
    references: Mapping[str, tuple[runs.Case, runs.Reference]],
    kills: int,
    seed: int,
    folder: Path,
    findings: runs.Findings,
) -> None:
    """Kill runs of all cases in turn, and record how many gave a different result."""
    folder.mkdir()
    rng, cases = random.Random(seed), list(references.values())

    def attempt(number: int, most: int) -> Attempt:
        case, reference = cases[number % len(cases)]
        moments = plan(rng, most, cold=number % COLD_EVERY == 1)
        cold = any(moment.phase == "compiling" for moment in moments)
        killing = Killing(case, reference, folder / f"run-{number}", cold=cold)
        name = f"{case.name}, killed run {number}"
        return Attempt(name, len(moments), killing.killed, killing.run(moments))

    names = {phase: f"kills in {phase}" for phase in PHASES}
    kill_until_enough("runs", "kills", names, kills, attempt, findings)


# Batches with pieces


class WholeBatch(NamedTuple):
    """An uninterrupted batch: bytes of the results by name, and its duration in seconds."""

    results: dict[str, bytes]
    seconds: float


class BatchKilling:
    """One batch in a new folder, killed and resumed until it finishes."""

    def __init__(self, case: runs.Case, whole: WholeBatch, folder: Path, rng: random.Random) -> None:
        self._case, self._whole, self._folder, self._rng = case, whole, folder, rng
        self.killed: Counter[str] = Counter()
        self._attempts = 0
        self.output = folder / "out"
        folder.mkdir(parents=True)

    def run(self, victims: Sequence[str]) -> Iterator[str]:
        """Kill the victims in turn (all local or all of a cluster); yield failed checks."""
        allowed = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "3"}
        on_cluster = victims[0] in ON_CLUSTER
        with Cluster(self._folder, WORKERS, allowed) if on_cluster else nullcontext() as cluster:
            for victim in victims:
                ended = self._attempt(victim, cluster)
                is_batch = victim in ("batch", "client of a cluster")
                codes = (runs.DONE, -signal.SIGKILL) if is_batch else (runs.DONE, runs.FAILED, runs.DATA_LOST)
                yield from (f"{victim} killed: {line}" for line in _odd(ended, codes))
                if ended.code == runs.DONE:
                    break
            else:
                ended = self._attempt(None, cluster)
        yield from _odd(ended, (runs.DONE,))
        if read_results(self.output) != self._whole.results:
            yield f"results differ from an uninterrupted batch's after {self.killed.total()} kills"
        left = [path for path in self.output.rglob("*") if path.name.endswith(_LEFT)]
        if left:
            yield f"left behind: {', '.join(sorted(str(path.relative_to(self.output)) for path in left))}"

    def _attempt(self, victim: str | None, cluster: Cluster | None) -> runs.Ended:
        self._attempts += 1
        more = () if cluster is None else ("--scheduler-file", str(cluster.file))
        command = self._case.command(self.output, *more)
        with runs.started(command, self._folder / f"attempt-{self._attempts}.txt") as run:
            if victim is not None:
                until = time.monotonic() + self._rng.uniform(0.05, 0.9) * self._whole.seconds
                if run.wait_until(lambda: time.monotonic() >= until):
                    self.killed[victim] += self._kill(victim, run, cluster)
            try:
                run.process.wait(ENDS_WITHIN_S)
            except subprocess.TimeoutExpired:
                return runs.Ended(runs.DONE, f"Traceback: did not end within {ENDS_WITHIN_S:g} s")
            return run.end()

    def _kill(self, victim: str, run: runs.Started, cluster: Cluster | None) -> bool:
        """Kill a victim, and replace a lost part of a cluster; return whether it was running."""
        if victim == "process of a job":
            while run.running:
                with suppress(IndexError, ProcessLookupError):  # none yet, or ended meanwhile
                    os.kill(jobs_of(run.process.pid)[0], signal.SIGKILL)
                    return True
                time.sleep(0.02)
            return False
        if cluster is None or victim == "client of a cluster":
            run.process.kill()
        elif victim == "worker":
            busy = [one for one in cluster.workers if jobs_of(one.pid)]
            cluster.kill_worker(self._rng.choice(busy or cluster.workers))
            cluster.add_worker()
        else:
            cluster.__exit__(None, None, None)
            time.sleep(self._rng.uniform(0.0, 2.0))
            run.process.wait(ENDS_WITHIN_S)
            cluster.__enter__()
        return True


def _odd(ended: runs.Ended, codes: Sequence[int]) -> Iterator[str]:
    """Yield failed checks of a batch; unlike a run, it may print several lines about failures."""
    last = ended.said.splitlines()[-1:] or [""]
    if ended.code not in codes:
        yield f"exit code {ended.code}, expected {' or '.join(map(str, codes))}; said: {last[0][:300]}"
    if "Traceback" in ended.said or "internal error" in ended.said:
        yield f"a traceback; said: {last[0][:300]}"


def jobs_of(process: int) -> list[int]:
    """Return the job processes that are children of a process."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, ValueError):  # the process has ended
            parent = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == process and b"posetrack_cli.cli.batch_child" in (path / "cmdline").read_bytes():
                found.append(int(path.name))
    return found


def read_results(folder: Path) -> dict[str, bytes]:
    """Return the bytes of a batch's results by name."""
    return {path.name: path.read_bytes() for path in folder.glob("*.mcap")}


def soak_batches(case: runs.Case, kills: int, seed: int, folder: Path, findings: runs.Findings) -> None:
    """Kill parts of batches, and record how many batches gave different results.

    Two uninterrupted batches come first; the first of them compiles the kernels.
    """
    (folder / "whole").mkdir(parents=True)
    found = []
    for number in range(2):
        output, began = folder / "whole" / f"whole-{number}", time.perf_counter()
        with runs.started(case.command(output), output.with_suffix(".txt")) as run:
            ended = run.end()
        if not findings.troubles_of(f"{case.name}, uninterrupted", _odd(ended, (runs.DONE,))):
            return
        found.append(WholeBatch(read_results(output), time.perf_counter() - began))
    if found[0].results != found[1].results:
        findings.trouble(f"{case.name}: two batches that nothing happened to differ")
    rng = random.Random(seed)

    def attempt(number: int, most: int) -> Attempt:
        kind = ON_CLUSTER if number % 3 else HERE  # three of the five victims belong to a cluster
        victims = rng.choices(kind, k=min(KILLS_A_BATCH, most))
        killing = BatchKilling(case, found[1], folder / f"batch-{number}", rng)
        name = f"{case.name}, killed batch {number}"
        return Attempt(name, len(victims), killing.killed, killing.run(victims))

    names = {victim: f"batches, {victim} killed" for victim in (*HERE, *ON_CLUSTER)}
    kill_until_enough("batches", "batches, kills", names, kills, attempt, findings)
