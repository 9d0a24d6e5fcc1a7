"""Runs that are killed at random moments and resumed until they are done: their bytes must not differ."""

from __future__ import annotations

import random
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from benchmarking.rows import Row
from posetrack_cli.cli.terminal import bar
from posetrack_cli.outputs import part_path, state_path
from soaking.cases import Case
from soaking.findings import Findings
from soaking.processes import DATA_LOST, DONE, FAILED, Ended, Started, frames_readable, started
from soaking.reference import Looker, Reference, wait_until
from soaking.standing import standing_of

PHASES = ("start-up", "compiling", "first pass", "second pass", "finishing")
COMPILING_S = 20.0
"""Within so many seconds of its announcement a compilation is killed."""
COLD_EVERY = 4
"""Of so many runs one begins with an empty kernel cache."""
MISSES = 3
"""So many times as many kills may come too late before the rest is given up."""


@dataclass(frozen=True)
class Moment:
    """When a process is killed.

    Attributes:
        phase: one of ``PHASES``.
        share: of the phase's duration, from its beginning; more than 1 may be after its end.
    """

    phase: str
    share: float


def plan(rng: random.Random, most: int, *, cold: bool) -> list[Moment]:
    """Return the moments of the kills of one run, in the order that it comes to them.

    Args:
        rng: random generator.
        most: kills.
        cold: whether it begins with an empty kernel cache; then the first kill is while it compiles.
    """
    count = min(most, rng.randint(1, 4))
    phases = ["compiling"] if cold else []
    phases += rng.choices([phase for phase in PHASES if phase != "compiling"], k=count - len(phases))
    resumed = [phase for phase in phases if phase != "start-up"]
    ordered = sorted(resumed, key=PHASES.index)
    for _ in range(len(phases) - len(resumed)):  # start-up comes again with every resumption
        ordered.insert(rng.randint(1 if cold else 0, len(ordered)), "start-up")
    return [Moment(phase, rng.uniform(0.0, 1.2 if phase == "finishing" else 1.0)) for phase in ordered]


class Killing:
    """One run, killed at planned moments and resumed until it is done.

    Args:
        case: the run.
        reference: what it must come to.
        folder: for everything it writes; not there yet.
        cold: whether it begins with an empty kernel cache.
    """

    def __init__(self, case: Case, reference: Reference, folder: Path, *, cold: bool = False) -> None:
        self._case, self._reference, self._folder = case, reference, folder
        self.killed: Counter[str] = Counter()
        self.attempts = 0
        self.output = folder / "out" / "result.mcap"
        self.output.parent.mkdir(parents=True)
        self._environment: Mapping[str, str] = {"NUMBA_CACHE_DIR": str(folder / "cache")} if cold else {}

    def run(self, moments: Sequence[Moment]) -> Iterator[str]:
        """Kill and resume; yield what is not as it must be, one line each."""
        for moment in moments:
            if self.output.exists():
                break
            ended = self._attempt(moment)
            if ended.code != -signal.SIGKILL:
                yield from self._judge_end(ended)
                return
            self.killed[moment.phase] += 1
            yield from (f"killed in {moment.phase}: {line}" for line in self._judge_rest(ended))
        if self.output.exists():  # killed after the result had its name
            yield from self._judge_bytes()
            return
        yield from self._judge_end(self._attempt(None))

    def _attempt(self, moment: Moment | None) -> Ended:
        """Start the run, or go on with it, and kill it at a moment if it comes to it."""
        self.attempts += 1
        more = ["--resume"] if state_path(self.output).exists() else []
        command = self._case.command(self.output, *more)
        said = self._folder / f"attempt-{self.attempts}.txt"
        looker = Looker(self._case, self.output)
        with started(command, said, self._environment) as run:
            if moment is not None and self._wait(run, moment, looker, resumed=bool(more)):
                run.process.kill()
            return run.end()

    def _wait(self, run: Started, moment: Moment, looker: Looker, *, resumed: bool) -> bool:
        """Wait for a moment; return False if the process ended before."""
        threshold, seconds = self._window(moment)
        if moment.phase == "compiling":
            reached = wait_until(run, lambda: "compiling" in run.said)
        elif moment.phase == "start-up":
            reached = True
        elif resumed and (standing := looker.look()) is not None and standing.steps >= threshold:
            seconds, reached = seconds + self._reference.first, True
        else:
            reached = wait_until(run, lambda: (at := looker.look()) is not None and at.steps >= threshold)
        until = time.perf_counter() + seconds
        return reached and wait_until(run, lambda: time.perf_counter() >= until)

    def _window(self, moment: Moment) -> tuple[int, float]:
        """Return the frames tracked when a moment's phase begins, and how long after that it comes, s."""
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

    def _judge_rest(self, ended: Ended) -> Iterator[str]:
        """Yield what is wrong with what a kill left behind."""
        yield from ended.troubles((-signal.SIGKILL,))
        yield from unreadable(self._case, self.output)

    def _judge_end(self, ended: Ended) -> Iterator[str]:
        """Yield what is wrong with a run that ended by itself."""
        troubles = list(ended.troubles((DONE,)))
        yield from troubles
        if not troubles:
            yield from self._judge_bytes()
            others = sorted(path.name for path in self.output.parent.iterdir() if path != self.output)
            if others:
                yield f"left beside the result: {', '.join(others)}"

    def _judge_bytes(self) -> Iterator[str]:
        if self.output.read_bytes() != self._reference.data:
            yield f"the result differs from an uninterrupted run's after {self.attempts - 1} kills"


def unreadable(case: Case, output: Path) -> Iterator[str]:
    """Yield what is wrong with an unfinished result: every frame up to its checkpoint must be readable."""
    part = part_path(output)
    if output.exists() or not part.exists():
        return
    standing = standing_of(case, output)
    found, ended = frames_readable(part)
    if standing is None:  # nothing was flushed yet, and so nothing promised
        yield from ended.troubles((DONE, DATA_LOST, FAILED))
        return
    yield from ended.troubles((DONE, DATA_LOST))
    if found < standing.written:
        yield f"info finds {found} frames in the unfinished result, the checkpoint is of {standing.written}"


def soak_kills(
    references: Mapping[str, tuple[Case, Reference]], kills: int, seed: int, folder: Path, findings: Findings
) -> None:
    """Kill runs of all cases in turn, so many times in all, and note how many came to other bytes."""
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


class Attempt(NamedTuple):
    """Something that is killed and resumed until it is done.

    Attributes:
        name: for people.
        planned: kills.
        killed: those that did not come too late, by what or when, once it is done.
        troubles: does it, and yields what is not as it must be.
    """

    name: str
    planned: int
    killed: Counter[str]
    troubles: Iterator[str]


def kill_until_enough(
    what: str,
    total: str,
    names: Mapping[str, str],
    kills: int,
    attempt: Callable[[int, int], Attempt],
    findings: Findings,
) -> None:
    """Make one attempt after another until there were so many kills, and note what came of them.

    Args:
        what: is killed, in the plural.
        total: what the number of all kills is called.
        names: what the numbers of kills of each kind are called.
        kills: wanted.
        attempt: begins the attempt of a number, with so many kills at most.
        findings: to add to.
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
