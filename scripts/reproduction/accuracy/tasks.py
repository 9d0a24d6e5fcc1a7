"""One recording, tracked by every entrant, in a process of its own.

Usage: PYTHONPATH=scripts .venv/bin/python -m reproduction.accuracy.tasks TASK OUT

TASK is a Task as JSON. A result that the same code made with the same arguments is kept, so a study that was
stopped goes on where it was. Recordings are deleted in the end: the same arguments make the same ones again.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import click

from posetrack_cli.errors import PosetrackError
from reproduction.made import code_digest, command, is_made, mark_made

RECORDING, CALIBRATED = "{recording}", "{calibrated}"
"""In an entrant's arguments: the recording's path, and that of the hand calibrated on it."""


@dataclass(frozen=True)
class Task:
    """What one process does.

    Attributes:
        name: what its files are called by.
        recording: arguments of ``posetrack`` that make the recording; its path follows.
        entrants: by name the arguments of ``posetrack hand run``, beside recording and output.
    """

    name: str
    recording: tuple[str, ...]
    entrants: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def result(self, folder: Path, entrant: str) -> Path:
        """Where an entrant's result lies."""
        return folder / f"{self.name}-{entrant}.mcap"

    @property
    def text(self) -> str:
        """As JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def of_text(cls, text: str) -> Task:
        """The task of a JSON text."""
        values = json.loads(text)
        entrants = {name: tuple(arguments) for name, arguments in values["entrants"].items()}
        return cls(values["name"], tuple(values["recording"]), entrants)


@click.command()
@click.argument("task", type=Task.of_text)
@click.argument("out", type=click.Path(path_type=Path))
def main(task: Task, out: Path) -> None:
    """Make the recording, track it by every entrant whose result is not there yet, delete it."""
    run_task(task, out)


def run_task(task: Task, out: Path) -> None:
    """Track a task's recording by the entrants that are missing.

    Raises:
        PosetrackError: a command failed; what it said is on standard error.
    """
    missing = [entrant for entrant in task.entrants if not is_current(task, entrant, out)]
    if not missing:
        return
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / f"{task.name}.mcap"
        command(*task.recording, str(recording))
        failed = [entrant for entrant in missing if not _track(task, entrant, recording, out)]
    if failed:
        raise PosetrackError(f"{task.name}: failed: {', '.join(failed)}")


def _track(task: Task, entrant: str, recording: Path, out: Path) -> bool:
    """Track by one entrant; one that fails does not keep the others from it."""
    result = task.result(out, entrant)
    given = {RECORDING: str(recording), CALIBRATED: str(result.with_suffix(".toml"))}
    arguments = task.entrants[entrant]
    used = [given.get(argument, argument) for argument in arguments]
    try:
        if CALIBRATED in arguments:
            side = _side(arguments)
            command("hand", "calibrate", str(recording), "-o", given[CALIBRATED], *side, "--overwrite")
        command("hand", "run", str(recording), "-o", str(result), *used, "--overwrite")
    except PosetrackError as error:
        click.echo(str(error), err=True)
        return False
    mark_made(result, _facts(task, entrant))
    return True


def _side(arguments: tuple[str, ...]) -> tuple[str, ...]:
    """The hand's side, where a run is told it."""
    if "--hand-side" not in arguments:
        return ()
    at = arguments.index("--hand-side")
    return arguments[at : at + 2]


def is_current(task: Task, entrant: str, out: Path) -> bool:
    """Whether the result that the same code and arguments give is there."""
    return is_made(task.result(out, entrant), _facts(task, entrant))


def _facts(task: Task, entrant: str) -> dict[str, object]:
    """What a result depends on."""
    return {"recording": task.recording, "arguments": task.entrants[entrant], "code": code_digest()}


if __name__ == "__main__":
    main()
