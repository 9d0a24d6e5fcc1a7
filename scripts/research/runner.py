"""Make files with posetrack's commands, each once: jobs of steps, every job in a process of its own.

Usage: PYTHONPATH=scripts .venv/bin/python -m research.runner JOB, with JOB as ``run_jobs`` writes it.

A file that the same code made with the same arguments from the same files is kept, so an interrupted study
continues where it stopped.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path, PurePosixPath

import click

from posetrack_cli.build import PACKAGE, source_digest
from posetrack_cli.cli.main import run as posetrack
from posetrack_cli.cli.terminal import bar
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, PosetrackError
from posetrack_cli.head.face.points import MEAN_SHAPE, SHAPE_SD
from posetrack_cli.recording.identity import files_digest

SHARED = PACKAGE.parent.parent / "shared"
FILE = "@"
"""Arguments that begin with this are outputs of other steps, or files in output folders."""
TOOL = "tool"
"""First argument of a step that runs a Python program outside the project; its path follows."""
DRAWING = (
    "synthesis/*.py",
    "synthesis/head/*.py",
    "head/face/points.py",
    "geometry/camera.py",
    "geometry/kernels.py",
    "geometry/rigid.py",
    "geometry/rotations.py",
    "rendering/port.py",
    "rendering/gl/device.py",
    "rendering/gl/shaders/textured.*",
)
"""Sources of a synthetic head's images and truth, in addition to the average face."""
ONE_CORE = dict.fromkeys(
    ("LP_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""Software OpenGL gains less from a second core than a second recording does."""


@dataclass(frozen=True)
class Step:
    """A file or folder, and the command that makes it.

    Attributes:
        output: path below the study's folder.
        arguments: of ``posetrack``, without ``-o``; or ``TOOL``, a program, its arguments after the output.
        scratch: whether it is deleted at the end of its job.
    """

    output: str
    arguments: tuple[str, ...]
    scratch: bool = False

    @property
    def files(self) -> list[str]:
        """Files of other steps that it reads."""
        return [one.removeprefix(FILE) for one in self.arguments if one.startswith(FILE)]

    def run(self, out: Path) -> None:
        """Make the output.

        Raises:
            PosetrackError: the command failed.
        """
        path = out / self.output
        path.parent.mkdir(parents=True, exist_ok=True)
        given = [str(out / one.removeprefix(FILE)) if one.startswith(FILE) else one for one in self.arguments]
        if given[0] != TOOL:
            command(*given, "-o", str(path), "--overwrite")
            return
        program = [sys.executable, given[1], str(path), *given[2:]]
        ended = subprocess.run(program, capture_output=True, text=True, check=False)
        if ended.returncode:
            said = ended.stderr.strip().splitlines() or [f"exit code {ended.returncode}"]
            raise PosetrackError(f"cannot make {self.output}: {said[-1]}", where=given[1])


@dataclass(frozen=True)
class Job:
    """Steps that one process does, in order; jobs of the same name are merged."""

    name: str
    steps: tuple[Step, ...]


class Files:
    """The files of a study.

    Args:
        out: folder of the study.
        jobs: that make them.
    """

    def __init__(self, out: Path, jobs: Iterable[Job]) -> None:
        self.out = out
        merged: dict[str, dict[str, Step]] = {}
        for job in jobs:
            for step in job.steps:
                known = merged.setdefault(job.name, {}).setdefault(step.output, step)
                if known.arguments != step.arguments:
                    raise ValueError(f"two ways to make {step.output}")
        self.jobs = [Job(name, tuple(steps.values())) for name, steps in merged.items()]
        self._steps = {step.output: step for job in self.jobs for step in job.steps}
        self._keys: dict[str, str] = {}

    def made(self, output: str) -> Path | None:
        """Return the path of an output; None unless the current code and arguments made it."""
        known = output in self._steps and _is_made(self.out / output, self.key(output))
        return self.out / output if known else None

    def key(self, output: str) -> str:
        """Return a digest of everything that an output depends on."""
        if output not in self._keys:
            step = self._steps[output]
            inputs = {name: self.key(self.owner(name)) for name in step.files}
            facts = [step.arguments, inputs, _code_of(step)]
            self._keys[output] = hashlib.sha256(json.dumps(facts).encode()).hexdigest()
        return self._keys[output]

    def owner(self, name: str) -> str:
        """Return the output that is, or contains, a file."""
        path = PurePosixPath(name)
        return next(str(one) for one in (path, *path.parents) if str(one) in self._steps)

    def missing(self, job: Job) -> list[Step]:
        """Return the steps of a job that have to be run: for what is not made, with the scratch they need."""
        wanted: set[str] = set()
        for step in reversed(job.steps):
            if (not step.scratch or step.output in wanted) and self.made(step.output) is None:
                wanted |= {step.output, *(self.owner(name) for name in step.files)}
        return [step for step in job.steps if step.output in wanted and self.made(step.output) is None]

    def levels(self) -> list[list[Job]]:
        """Return the jobs in the order in which they can be run; those of a level are independent."""
        job_of = {step.output: job.name for job in self.jobs for step in job.steps}
        needs = {
            job.name: {job_of[self.owner(name)] for step in job.steps for name in step.files} - {job.name}
            for job in self.jobs
        }

        @cache
        def level(name: str) -> int:
            return 1 + max(map(level, needs[name]), default=-1)

        found: dict[int, list[Job]] = {}
        for job in self.jobs:
            found.setdefault(level(job.name), []).append(job)
        return [found[one] for one in sorted(found)]


def run_jobs(files: Files, jobs: int, title: str) -> list[str]:
    """Make what is missing; return what went wrong, a line for each job.

    Args:
        files: of the study.
        jobs: processes at a time.
        title: of the progress bar.
    """
    failures = []
    for level in files.levels():
        todo = {job.name: steps for job in level if (steps := files.missing(job))}
        if not todo:
            continue
        with ThreadPoolExecutor(jobs) as pool, bar(title, "recording", len(todo)) as shown:
            running = [pool.submit(_run_process, files, name, steps) for name, steps in todo.items()]
            for future in as_completed(running):
                failures += [failure] if (failure := future.result()) else []
                shown.advance()
    return failures


def _run_process(files: Files, name: str, steps: Sequence[Step]) -> str:
    """Run some steps in a process of its own; return what went wrong."""
    outputs = {step.output for step in steps} | {files.owner(one) for step in steps for one in step.files}
    keys = {output: files.key(output) for output in outputs}
    owners = {one: files.owner(one) for step in steps for one in step.files}
    job = {"out": str(files.out.resolve()), "steps": [asdict(step) for step in steps]}
    text = json.dumps(job | {"keys": keys, "owners": owners})
    found = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    ended = subprocess.run(
        [sys.executable, "-m", "research.runner", text],
        env=os.environ | ONE_CORE | found,
        capture_output=True,
        text=True,
    )
    if ended.returncode == 0:
        return ""
    said = [line for line in ended.stderr.splitlines() if line.startswith("posetrack: ")]
    said = said or ended.stderr.strip().splitlines()
    return f"{name}: {said[-1] if said else f'exit code {ended.returncode}'}"


@click.command()
@click.argument("job")
def main(job: str) -> None:
    """Make what is missing of a job; a step that fails prevents only those that need its output."""
    told = json.loads(job)
    steps = [replace(Step(**one), arguments=tuple(one["arguments"])) for one in told["steps"]]
    failed = run_steps(Path(told["out"]), steps, told["keys"], told["owners"])
    if failed:
        raise SystemExit(f"failed: {', '.join(failed)}")


def run_steps(
    out: Path, steps: Sequence[Step], keys: Mapping[str, str], owners: Mapping[str, str]
) -> list[str]:
    """Run steps in order, then delete scratch; return the outputs that could not be made.

    Args:
        out: folder of the study.
        steps: in order.
        keys: by output the digest of what it depends on, also of outputs of earlier jobs.
        owners: by file that a step reads the output that it is part of.
    """
    failed = []
    for step in steps:
        stamp_path(out / step.output).unlink(missing_ok=True)  # an old output must not count as the new one
        inputs = [owners[name] for name in step.files]
        try:
            for name in inputs:
                if not _is_made(out / name, keys[name]):
                    raise PosetrackError(f"{name} was not made")
            step.run(out)
        except PosetrackError as error:
            click.echo(f"posetrack: {error}", err=True)
            failed.append(step.output)
        else:
            stamp_path(out / step.output).write_text(keys[step.output], encoding="utf-8")
    for step in steps:
        if step.scratch:
            path = out / step.output
            shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)
            stamp_path(path).unlink(missing_ok=True)
    return failed


def command(*arguments: str) -> None:
    """Run ``posetrack`` in this process.

    Raises:
        PosetrackError: it failed.
    """
    code = posetrack(list(arguments))
    if code not in (EXIT_DONE, EXIT_DATA_LOST):
        raise PosetrackError(f"posetrack {' '.join(arguments[:3])} ended with exit code {code}")


def stamp_path(path: Path) -> Path:
    """Return the name of the file that holds the key of an output."""
    return path.with_name(f"{path.name}.made")


def _is_made(path: Path, key: str) -> bool:
    stamp = stamp_path(path)
    return path.exists() and stamp.exists() and stamp.read_text("utf-8") == key


def _code_of(step: Step) -> str:
    """Return a digest of the sources that an output depends on."""
    if step.arguments[0] == TOOL:
        return tool_digest(Path(step.arguments[1]))
    if step.arguments[:2] == ("head", "synth"):
        face = json.dumps([MEAN_SHAPE.tolist(), SHAPE_SD.tolist()])
        return source_digest(DRAWING) + face
    return source_digest()


@cache
def tool_digest(tool: Path) -> str:
    """Return SHA-256 over the tool that draws strangers and the hands that it draws from."""
    data = (tool.parent.parent / "data" / "foreign-hands").glob("*")
    return files_digest([(path.name, path) for path in (tool, *sorted(filter(Path.is_file, data)))])[1]


if __name__ == "__main__":
    main()
