"""One recording, tracked by every entrant, in a process of its own.

Usage: PYTHONPATH=scripts .venv/bin/python -m reproduction.accuracy.tasks TASK OUT

TASK is a Task as JSON. A result that the same code made with the same arguments is kept, so a study that was
stopped goes on where it was. Recordings are deleted in the end: the same arguments make the same ones again.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from posetrack_cli.build import source_digest
from reproduction.made import command
from reproduction.task import EntrantsTask

RECORDING = "{recording}"
"""In an entrant's arguments: the recording's path."""


@dataclass(frozen=True)
class Task(EntrantsTask):
    """A task about a hand; see ``EntrantsTask``.

    Attributes:
        name: what its files are called by.
        recording: arguments of ``posetrack`` that make the recording; its path follows.
        entrants: by name the arguments of ``posetrack hand run``, beside recording and output.
    """

    name: str
    recording: tuple[str, ...]
    entrants: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def result(self, out: Path, entrant: str) -> Path:
        """Where an entrant's result lies."""
        return out / f"{self.name}-{entrant}.mcap"

    def facts(self, entrant: str) -> dict[str, object]:
        """What a result depends on."""
        return {"recording": self.recording, "arguments": self.entrants[entrant], "code": source_digest()}

    @contextmanager
    def prepared(self, out: Path) -> Iterator[Callable[[str], None]]:
        """Make the recording, and delete it in the end."""
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / f"{self.name}.mcap"
            command(*self.recording, str(recording))
            yield lambda entrant: _track(self.entrants[entrant], recording, self.result(out, entrant))


def _track(arguments: tuple[str, ...], recording: Path, result: Path) -> None:
    """Track by one entrant."""
    used = [str(recording) if argument == RECORDING else argument for argument in arguments]
    command("hand", "run", str(recording), "-o", str(result), *used, "--overwrite")


if __name__ == "__main__":
    Task.command()()
