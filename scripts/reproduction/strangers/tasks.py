"""One recording of a stranger, tracked by every entrant, in a process of its own.

Usage: PYTHONPATH=scripts .venv/bin/python -m reproduction.strangers.tasks TASK OUT

TASK is a Task as JSON. A result that the same code, with the same tool, made with the same arguments is kept.
Recordings and meshes are deleted in the end: the same arguments make the same ones again.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import chdir, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from reproduction.accuracy.tasks import Task as AccuracyTask
from reproduction.made import code_digest, command
from reproduction.strangers.tool import draw, tool_digest
from reproduction.task import EntrantsTask

MESH, TRUTH = "{mesh}", "{truth}"
"""In an entrant's arguments: the paths of the person's own hand, a GLB file, and of the true joints, CSV."""
VIEW = "view"
"""Begin of the arguments of an entrant that does not track, but draws another one's result on one sheet."""


@dataclass(frozen=True)
class Task(EntrantsTask):
    """A task about a stranger; see ``EntrantsTask``.

    Attributes:
        name: what its files are called by.
        tool: path of the tool that makes the recording.
        recording: its arguments, without the folder.
        entrants: by name the arguments of ``posetrack hand run``, beside recording and output; or ``VIEW``,
            the entrant whose result is drawn, which comes before, and further arguments of ``view``.
    """

    name: str
    tool: str
    recording: tuple[str, ...]
    entrants: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def result(self, out: Path, entrant: str) -> Path:
        """Where an entrant's result, or picture, lies."""
        return out / f"{self.name}-{entrant}.{'png' if self._is_picture(entrant) else 'mcap'}"

    def facts(self, entrant: str) -> dict[str, object]:
        """What a result depends on; a picture on what its result does, too."""
        arguments = self.entrants[entrant]
        facts: dict[str, object] = {"recording": self.recording, "tool": tool_digest(Path(self.tool))}
        facts |= {"arguments": arguments, "code": code_digest()}
        drawn = {"of": self.entrants[arguments[1]]} if self._is_picture(entrant) else {}
        return facts | drawn

    @contextmanager
    def prepared(self, out: Path) -> Iterator[Callable[[str], None]]:
        """Make the recording, and delete it in the end."""
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            draw(Path(self.tool), folder, self.recording)
            recording = folder / f"{self.name}.mcap"
            command("convert", str(folder / "depth"), str(recording), "--truth", str(folder / "truth.csv"))
            yield lambda entrant: self._done(entrant, recording, out.resolve())

    def _done(self, entrant: str, recording: Path, out: Path) -> None:
        """Track, or draw, in the recording's folder: there ``view`` looks for the mesh of a result."""
        with chdir(recording.parent):
            command(*self._command(entrant, recording, out), "--overwrite")

    def _command(self, entrant: str, recording: Path, out: Path) -> tuple[str, ...]:
        """What tracks or draws; the results' folder is absolute."""
        arguments, result = self.entrants[entrant], str(self.result(out, entrant))
        if self._is_picture(entrant):
            of, given = str(self.result(out, arguments[1])), ("--recording", str(recording))
            return ("view", of, "-o", result, *given, *arguments[2:])
        drawn = {MESH: "hand.glb", TRUTH: "truth.csv"}
        paths = {word: str(recording.with_name(name)) for word, name in drawn.items()}
        used = [paths.get(argument, argument) for argument in arguments]
        return ("hand", "run", str(recording), "-o", result, *used)

    def _is_picture(self, entrant: str) -> bool:
        return self.entrants[entrant][:1] == (VIEW,)


Kind = TypeVar("Kind", Task, AccuracyTask)


def merged(tasks: Iterable[Kind]) -> list[Kind]:
    """Tasks with the entrants of all of the same name, so that each recording is made once; pictures last."""
    found: dict[str, Kind] = {}
    for task in tasks:
        known = found.get(task.name, task)
        found[task.name] = replace(known, entrants={**known.entrants, **task.entrants})
    return [replace(task, entrants=dict(sorted(task.entrants.items(), key=_last))) for task in found.values()]


def _last(entrant: tuple[str, tuple[str, ...]]) -> bool:
    return entrant[1][:1] == (VIEW,)


if __name__ == "__main__":
    Task.command()()
