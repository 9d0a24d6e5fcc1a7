"""One recording of a head, tracked by every entrant, in a process of its own.

Usage: PYTHONPATH=scripts .venv/bin/python -m reproduction.heads.tasks TASK OUT

TASK is a Task as JSON. Drawing heads takes most of the time, so a synthetic recording is kept beside the
results, and made anew only when the code that draws it or its options are others. A result that the same code
made with the same arguments is kept, too: a study that was stopped goes on where it was.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from posetrack_cli.build import source_digest
from reproduction.heads_data import TRUTH, reading_arguments
from reproduction.made import command, drawing_digest, is_made, mark_made
from reproduction.task import EntrantsTask

ENTRANTS: dict[str, tuple[str, ...]] = {
    "deformable": (),
    "deformable-2": ("--passes", "2"),
    "rigid": ("--model", "rigid"),
    "rigid-2": ("--model", "rigid", "--passes", "2"),
    "paper": ("--config", "head-stereo-paper"),
    "paper-rigid": ("--config", "head-stereo-paper", "--model", "rigid"),
}
"""By name the arguments of ``posetrack head stereo``, beside recording and output."""


@dataclass(frozen=True)
class Task(EntrantsTask):
    """A task about a head; see ``EntrantsTask``.

    Attributes:
        name: what its files are called by.
        synthetic: arguments of ``posetrack head synth`` but the output; empty for a folder.
        folder: a recording with ``left``, ``right``, calibration.json and truth.csv; empty for a synthetic
            one.
        entrants: names of ``ENTRANTS``.
    """

    name: str
    synthetic: tuple[str, ...] = ()
    folder: str = ""
    entrants: tuple[str, ...] = tuple(ENTRANTS)

    def recording(self, out: Path) -> Path:
        """Where the recording lies."""
        return Path(self.folder) if self.folder else out / "recordings" / f"{self.name}.mcap"

    def result(self, out: Path, entrant: str) -> Path:
        """Where an entrant's result lies."""
        return out / "runs" / f"{self.name}-{entrant}.mcap"

    @property
    def truth(self) -> Path | None:
        """A file with the truth; None if the results carry it."""
        return Path(self.folder) / TRUTH if self.folder else None

    def facts(self, entrant: str) -> dict[str, object]:
        """What a result depends on."""
        source = {"folder": self.folder} if self.folder else {"recording": self.synthetic}
        return {**source, "arguments": ENTRANTS[entrant], "code": source_digest()}

    @contextmanager
    def prepared(self, out: Path) -> Iterator[Callable[[str], None]]:
        """Make the recording if it is not there; it is kept."""
        for folder in ("recordings", "runs"):
            (out / folder).mkdir(parents=True, exist_ok=True)
        reading = self._reading(out)

        def track(entrant: str) -> None:
            result = str(self.result(out, entrant))
            arguments = ENTRANTS[entrant]
            command("head", "stereo", *reading, "-o", result, *arguments, "--timings", "--overwrite")

        yield track

    def _reading(self, out: Path) -> tuple[str, ...]:
        """Make what is missing; return the arguments that read the recording."""
        path = self.recording(out)
        if self.folder:
            return reading_arguments(path, out / "recordings")
        facts = {"recording": self.synthetic, "code": drawing_digest()}
        if not is_made(path, facts):
            command("head", "synth", *self.synthetic, "-o", str(path), "--overwrite")
            mark_made(path, facts)
        return (str(path),)


if __name__ == "__main__":
    Task.command()()
