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

from posetrack_cli.build import source_digest
from reproduction.accuracy.tasks import Task as AccuracyTask
from reproduction.made import command
from reproduction.strangers.tool import draw, tool_digest
from reproduction.task import EntrantsTask

MESH, TRUTH = "{mesh}", "{truth}"
"""In an entrant's arguments: the paths of the person's own hand, a GLB file, and of the true joints, CSV."""
VIEW, CALIBRATE = "view", "calibrate"
"""Begin of the arguments of an entrant that does not track: it draws another one's result on one sheet, or
estimates the hand's shape alone."""
HAND_OF = "{hand}:"
"""Begin of an argument that goes on with an entrant's name: the path of its result, with the side and
the shape that it found. That one comes before."""
_SUFFIXES = {VIEW: "png", CALIBRATE: "toml"}


@dataclass(frozen=True)
class Task(EntrantsTask):
    """A task about a stranger; see ``EntrantsTask``.

    Attributes:
        name: what its files are called by.
        tool: path of the tool that makes the recording.
        recording: its arguments, without the folder.
        entrants: by name the arguments of ``posetrack hand run``, beside recording and output; or ``VIEW``,
            the entrant whose result is drawn, which comes before, and further arguments of ``view``; or
            ``CALIBRATE`` and further arguments of ``hand calibrate``.
    """

    name: str
    tool: str
    recording: tuple[str, ...]
    entrants: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def result(self, out: Path, entrant: str) -> Path:
        """Where an entrant's result, picture or hand file lies."""
        return out / f"{self.name}-{entrant}.{_SUFFIXES.get(_kind(self.entrants[entrant]), 'mcap')}"

    def facts(self, entrant: str) -> dict[str, object]:
        """What a result depends on; what another one's is used for on what that does, too."""
        arguments = self.entrants[entrant]
        of = _source(arguments)
        facts: dict[str, object] = {"recording": self.recording, "tool": tool_digest(Path(self.tool))}
        facts |= {"arguments": arguments, "code": source_digest()}
        return facts | ({"of": self.entrants[of]} if of else {})

    @contextmanager
    def prepared(self, out: Path) -> Iterator[Callable[[str], None]]:
        """Make the recording, and delete it in the end."""
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            draw(Path(self.tool), folder, self.recording)
            recording = folder / f"{self.name}.mcap"
            command(
                "convert", str(folder / "depth"), "-o", str(recording), "--truth", str(folder / "truth.csv")
            )
            yield lambda entrant: self._done(entrant, recording, out.resolve())

    def _done(self, entrant: str, recording: Path, out: Path) -> None:
        """Track, or draw, in the recording's folder: there ``view`` looks for the mesh of a result."""
        with chdir(recording.parent):
            command(*self._command(entrant, recording, out), "--overwrite")

    def _command(self, entrant: str, recording: Path, out: Path) -> tuple[str, ...]:
        """What tracks, draws or calibrates; the results' folder is absolute."""
        arguments, result = self.entrants[entrant], self.result(out, entrant)
        kind, of = _kind(arguments), _source(arguments)
        if kind == VIEW:
            drawn, given = str(self.result(out, of)), ("--recording", str(recording))
            return (VIEW, drawn, "-o", str(result), *given, *arguments[2:])
        if kind == CALIBRATE:
            return ("hand", CALIBRATE, str(recording), "-o", str(result), *arguments[1:])
        paths = {MESH: recording.with_name("hand.glb"), TRUTH: recording.with_name("truth.csv")}
        if of:
            paths[HAND_OF + of] = self.result(out, of)
        used = [str(paths.get(argument, argument)) for argument in arguments]
        return ("hand", "run", str(recording), "-o", str(result), *used)


def _kind(arguments: tuple[str, ...]) -> str:
    """``VIEW``, ``CALIBRATE`` or nothing: what an entrant's arguments begin with."""
    return arguments[0] if arguments and arguments[0] in _SUFFIXES else ""


def _source(arguments: tuple[str, ...]) -> str:
    """The entrant whose result another one's arguments use; nothing where there is none."""
    if _kind(arguments) == VIEW:
        return arguments[1]
    told = (argument.removeprefix(HAND_OF) for argument in arguments if argument.startswith(HAND_OF))
    return next(told, "")


Kind = TypeVar("Kind", Task, AccuracyTask)


def merged(tasks: Iterable[Kind]) -> list[Kind]:
    """Tasks with the entrants of all of the same name, so that each recording is made once.

    What uses another one's result comes last.
    """
    found: dict[str, Kind] = {}
    for task in tasks:
        known = found.get(task.name, task)
        found[task.name] = replace(known, entrants={**known.entrants, **task.entrants})
    return [replace(task, entrants=dict(sorted(task.entrants.items(), key=_last))) for task in found.values()]


def _last(entrant: tuple[str, tuple[str, ...]]) -> bool:
    return bool(_source(entrant[1]))


if __name__ == "__main__":
    Task.command()()
