"""What an interrupted run must come to: the result of one that nothing happened to."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from posetrack_cli.outputs import state_path
from soaking.cases import Case
from soaking.findings import Findings
from soaking.processes import DONE, Started, started
from soaking.standing import Standing, standing_of

POLL_S = 0.01


@dataclass(frozen=True)
class Reference:
    """A run that nothing happened to.

    Attributes:
        data: bytes of the result.
        first, second, last, end: seconds from its start to its first checkpoint, to the end of the first
            pass, to its last checkpoint, to its end.
        room: bytes that its output took at most, with a checkpoint that is written beside the last.
    """

    data: bytes
    first: float
    second: float
    last: float
    end: float
    room: int


class Looker:
    """Looks at a run's checkpoint and reads it again only when it has changed.

    Args:
        case: the run.
        output: of it.
    """

    def __init__(self, case: Case, output: Path) -> None:
        self._case, self._output = case, output
        self._seen: tuple[int, int] | None = None
        self._standing: Standing | None = None

    def look(self) -> Standing | None:
        """Return where the run stands."""
        try:
            status = state_path(self._output).stat()
        except FileNotFoundError:
            return self._standing
        if (seen := (status.st_mtime_ns, status.st_ino)) != self._seen:
            self._seen, self._standing = seen, standing_of(self._case, self._output)
        return self._standing


def wait_until(run: Started, reached: Callable[[], bool]) -> bool:
    """Wait until a process has come somewhere; return False if it ended before."""
    while not reached():
        if not run.running:
            return False
        time.sleep(POLL_S)
    return True


def reference_of(case: Case, folder: Path, findings: Findings) -> Reference | None:
    """Run a case twice, the first time for its kernels to be compiled; None if that fails."""
    folder.mkdir()
    results = []
    for number in range(2):
        output = folder / f"reference-{number}.mcap"
        found = _observed(case, output, folder / f"reference-{number}.txt", findings)
        if found is None:
            return None
        results.append(found)
    if results[0].data != results[1].data:
        findings.trouble(f"{case.name}: two runs that nothing happened to differ")
    return results[1]


def _observed(case: Case, output: Path, said: Path, findings: Findings) -> Reference | None:
    looker, marks, room = Looker(case, output), dict[int, float](), 0
    began = time.perf_counter()
    with started(case.command(output), said) as run:
        while run.running:
            standing = looker.look()
            now = time.perf_counter() - began
            for threshold in (0, case.frames, case.steps):
                if standing is not None and standing.steps >= threshold:
                    marks.setdefault(threshold, now)
            room = max(room, _room_of(output))
            time.sleep(POLL_S)
        ended, end = run.end(), time.perf_counter() - began
    if not findings.troubles_of(f"{case.name}, uninterrupted", ended.troubles((DONE,))):
        return None
    first, second, last = (marks.get(threshold, end) for threshold in (0, case.frames, case.steps))
    data = output.read_bytes()
    return Reference(data, first, second, last, end, max(room, len(data)))


def _room_of(output: Path) -> int:
    """What lies in the output's folder by its name, with its checkpoint once more."""
    sizes = {}
    for path in output.parent.glob(f"{output.name}*"):
        try:
            sizes[path] = path.stat().st_size
        except FileNotFoundError:
            continue  # renamed meanwhile
    twice = sizes.get(state_path(output), 0)
    temporary = sum(size for path, size in sizes.items() if path.name.endswith(".tmp"))
    return sum(sizes.values()) - temporary + twice
