"""Run steps in a folder and compute digests of their output."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import click

from digesting.contents import digests_of, printed_digest
from digesting.steps import Step

POSETRACK = (sys.executable, "-m", "posetrack_cli.cli.main")
INTERRUPTED_S = 600.0  # a run must write the checkpoint that it is interrupted after within this time
_EXIT_CODES = (0, 1, 3)

Digests = Mapping[str, Mapping[str, str]]


class Workplace:
    """A folder for running steps with the ``posetrack_cli`` of a checkout."""

    def __init__(self, folder: Path, package: Path) -> None:
        self._folder = folder
        self._outputs: dict[str, tuple[str, ...]] = {}
        self._environment = {**os.environ, "PYTHONPATH": str(package), "COLUMNS": "100"}

    def digest(self, step: Step) -> dict[str, str]:
        """Run a step and return the digests of its output by name."""
        digests = {} if step.make is not None else self._run(step)
        if step.make is not None:
            step.make(self._folder)
        self._outputs[step.name] = step.outputs
        for name in step.outputs:
            for path in _files_of(self._folder / name):
                shown = str(path.relative_to(self._folder))
                digests |= {f"{shown} {part}".rstrip(): value for part, value in digests_of(path).items()}
        return digests

    def _run(self, step: Step) -> dict[str, str]:
        arguments = step.filled(self._outputs)
        if step.interrupted:
            self._interrupt(arguments, step)
            arguments.append("--resume")
        line = [*POSETRACK, *arguments]
        ended = subprocess.run(line, cwd=self._folder, env=self._environment, capture_output=True)
        written = all((self._folder / name).exists() for name in step.outputs)
        if ended.returncode not in _EXIT_CODES or not written:
            said = ended.stderr.decode(errors="replace").strip().splitlines()[-3:]
            raise click.ClickException(f"{step.name}: exit code {ended.returncode}: {' / '.join(said)}")
        digests = {"exit code": str(ended.returncode)}
        if step.printed:
            digests["standard output"] = printed_digest(ended.stdout)
        return digests

    def _interrupt(self, arguments: Sequence[str], step: Step) -> None:
        """Start a run and interrupt it (SIGINT) as soon as it can be resumed."""
        output = self._folder / step.outputs[0]
        state = output.with_name(f"{output.name}.part.state")
        null = subprocess.DEVNULL
        with subprocess.Popen(
            [*POSETRACK, *arguments], cwd=self._folder, env=self._environment, stdout=null, stderr=null
        ) as run:
            until = time.monotonic() + INTERRUPTED_S
            while not state.exists():
                if run.poll() is not None or time.monotonic() > until:
                    raise click.ClickException(f"{step.name}: ended before it could be interrupted")
                time.sleep(0.005)
            run.send_signal(signal.SIGINT)
        if not state.exists():
            raise click.ClickException(f"{step.name}: finished before it was interrupted")


def _files_of(path: Path) -> list[Path]:
    """Return a file, or the files of a folder without hidden ones, such as the records of a batch."""
    if not path.is_dir():
        return [path]
    below = ((p, p.relative_to(path).parts) for p in path.rglob("*") if p.is_file())
    return sorted(p for p, parts in below if not any(part.startswith(".") for part in parts))


def chosen(groups: Mapping[str, Sequence[Step]], names: Iterable[str]) -> list[Step]:
    """Return the steps of the named groups and steps (all if none) with dependencies, in order."""
    steps = {step.name: step for group in groups.values() for step in group}
    wanted = [step for name in names for step in groups.get(name, (name,))]
    pending = [step.name if isinstance(step, Step) else step for step in wanted] or list(steps)
    kept = set[str]()
    while pending:
        name = pending.pop()
        if name not in steps:
            raise click.UsageError(f"no step or group is named {name}")
        if name not in kept:
            kept.add(name)
            pending.extend(steps[name].needs)
    return [step for step in steps.values() if step.name in kept]


def differences(before: Digests, now: Digests) -> Iterator[str]:
    """Yield one line per output of the current steps that differs from the earlier digests."""
    for step, digests in now.items():
        known = before.get(step, {})
        for name in sorted(digests.keys() | known.keys()):
            if digests.get(name) != known.get(name):
                was, is_now = (d.get(name, "nothing")[:16] for d in (known, digests))
                yield f"{step}: {name}: {was} before, {is_now} now"
