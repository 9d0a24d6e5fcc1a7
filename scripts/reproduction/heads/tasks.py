"""One recording of a head, tracked by every entrant, in a process of its own.

Usage: PYTHONPATH=scripts .venv/bin/python -m reproduction.heads.tasks TASK OUT

TASK is a Task as JSON. Drawing heads takes most of the time, so a synthetic recording is kept beside the
results, and made anew only when the code that draws it or its options are others. A result that the same code
made with the same arguments is kept, too: a study that was stopped goes on where it was.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from posetrack_cli.errors import PosetrackError
from posetrack_cli.recording.base import CAMERA_FILE_NAME
from reproduction.heads_data import camera_file_text, frame_rate
from reproduction.made import code_digest, command, drawing_digest, is_made, mark_made

CALIBRATION, TRUTH = "calibration.json", "truth.csv"
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
class Task:
    """What one process does.

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

    @property
    def text(self) -> str:
        """As JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def of_text(cls, text: str) -> Task:
        """The task of a JSON text."""
        values = json.loads(text)
        return cls(values["name"], tuple(values["synthetic"]), values["folder"], tuple(values["entrants"]))


@click.command()
@click.argument("task", type=Task.of_text)
@click.argument("out", type=click.Path(path_type=Path))
def main(task: Task, out: Path) -> None:
    """Make the recording if it is not there, track it by every entrant whose result is not there."""
    run_task(task, out)


def run_task(task: Task, out: Path) -> None:
    """Track a task's recording by the entrants that are missing.

    Raises:
        PosetrackError: a command failed; what it said is on standard error.
    """
    missing = [entrant for entrant in task.entrants if not is_current(task, entrant, out)]
    if not missing:
        return
    for folder in ("recordings", "runs"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    reading = _prepared(task, out)
    failed = [entrant for entrant in missing if not _track(task, entrant, reading, out)]
    if failed:
        raise PosetrackError(f"{task.name}: failed: {', '.join(failed)}")


def _prepared(task: Task, out: Path) -> tuple[str, ...]:
    """Make what is missing; return the arguments that read the recording."""
    path = task.recording(out)
    if task.folder:
        camera = out / "recordings" / f"{task.name}.{CAMERA_FILE_NAME}"
        camera.write_text(camera_file_text(path / CALIBRATION), encoding="utf-8")
        return (str(path), "--camera", str(camera), "--fps", f"{frame_rate(path / CALIBRATION):g}")
    if not is_made(path, _recording_facts(task)):
        command("head", "synth", *task.synthetic, "-o", str(path), "--overwrite")
        mark_made(path, _recording_facts(task))
    return (str(path),)


def _track(task: Task, entrant: str, reading: tuple[str, ...], out: Path) -> bool:
    """Track by one entrant; one that fails does not keep the others from it."""
    result = task.result(out, entrant)
    try:
        command("head", "stereo", *reading, "-o", str(result), *ENTRANTS[entrant], "--timings", "--overwrite")
    except PosetrackError as error:
        click.echo(str(error), err=True)
        return False
    mark_made(result, _facts(task, entrant))
    return True


def is_current(task: Task, entrant: str, out: Path) -> bool:
    """Whether the result that the same code and arguments give is there."""
    return is_made(task.result(out, entrant), _facts(task, entrant))


def _facts(task: Task, entrant: str) -> dict[str, object]:
    """What a result depends on."""
    source = {"folder": task.folder} if task.folder else {"recording": task.synthetic}
    return {**source, "arguments": ENTRANTS[entrant], "code": code_digest()}


def _recording_facts(task: Task) -> dict[str, object]:
    """What a recording depends on."""
    return {"recording": task.synthetic, "code": drawing_digest()}


if __name__ == "__main__":
    main()
