"""Run jobs (sequences of posetrack commands that write files), each in its own process.

Usage: PYTHONPATH=scripts .venv/bin/python -m research.runner JOB, with JOB as written by ``run_jobs``.

Files written by the same code with the same arguments and inputs are reused, so that an interrupted study
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
from functools import cache
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from posetrack_cli.build import PACKAGE, source_digest
from posetrack_cli.cli.main import run as posetrack
from posetrack_cli.cli.terminal import bar
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, PosetrackError
from posetrack_cli.head.face.points import MEAN_SHAPE, SHAPE_SD
from posetrack_cli.recording.identity import files_digest

SHARED = PACKAGE.parent.parent / "shared"
# Prefix of arguments that are outputs of other steps or files in output folders; also of VALUE in NAME=VALUE
FILE = "@"
TOOL = "tool"  # first argument of a step that runs an external Python program; its path follows
# Sources that determine synthetic head recordings, in addition to the average face
DRAWING = (
    *("synthesis/*.py", "synthesis/head/*.py", "head/face/points.py", "rendering/port.py"),
    *(f"geometry/{name}.py" for name in ("camera", "kernels", "rigid", "rotations")),
    *("rendering/gl/device.py", "rendering/gl/shaders/textured.*"),
)
# Parallel recordings use the cores better than threads of software OpenGL
ONE_CORE = dict.fromkeys(
    ("LP_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)


def _placed(argument: str, out: Path) -> str:
    """Return an argument with the path of an output in a folder, if it names one."""
    name, equals, value = argument.rpartition("=")
    return f"{name}{equals}{out / value.removeprefix(FILE)}" if value.startswith(FILE) else argument


class Step(NamedTuple):
    """A file or folder, and the command that writes it."""

    output: str  # path below the study's folder
    # of ``posetrack`` without ``-o``; or ``TOOL``, a program and its arguments after the output
    arguments: tuple[str, ...]
    scratch: bool = False  # whether it is deleted at the end of its job

    @property
    def files(self) -> list[str]:
        """Outputs of other steps used as inputs."""
        parts = (one.rpartition("=")[2] for one in self.arguments)
        return [one.removeprefix(FILE) for one in parts if one.startswith(FILE)]

    def run(self, out: Path) -> None:
        """Write the output.

        Raises:
            PosetrackError: the command failed.
        """
        path = out / self.output
        path.parent.mkdir(parents=True, exist_ok=True)
        given = [_placed(one, out) for one in self.arguments]
        if given[0] != TOOL:
            command(*given, "-o", str(path), "--overwrite")
            return
        program = [sys.executable, given[1], str(path), *given[2:]]
        ended = subprocess.run(program, capture_output=True, text=True, check=False)
        if ended.returncode:
            said = ended.stderr.strip().splitlines() or [f"exit code {ended.returncode}"]
            raise PosetrackError(f"failed to write {self.output}: {said[-1]}", where=given[1])


class Job(NamedTuple):
    """Steps that one process runs in order; jobs of the same name are merged."""

    name: str
    steps: tuple[Step, ...]


class Order(NamedTuple):
    """A step with the digest of all its dependencies, and the digests of its inputs."""

    step: Step
    key: str
    inputs: Mapping[str, str]


class Files:
    """The files of a study in the folder ``out``, and the jobs that write them."""

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
        """Return the path of an output if it is current (same code, arguments, inputs), else None."""
        known = output in self._steps and _is_made(self.out / output, self._key(output))
        return self.out / output if known else None

    def _key(self, output: str) -> str:
        """Return a digest of all dependencies of an output."""
        if output not in self._keys:
            step = self._steps[output]
            inputs = {name: self._key(self._owner(name)) for name in step.files}
            facts = [step.arguments, inputs, _code_of(step)]
            self._keys[output] = hashlib.sha256(json.dumps(facts).encode()).hexdigest()
        return self._keys[output]

    def _owner(self, name: str) -> str:
        """Return the output that is, or contains, a file."""
        path = PurePosixPath(name)
        return next(str(one) for one in (path, *path.parents) if str(one) in self._steps)

    def missing(self, job: Job) -> list[Order]:
        """Return the steps of a job that must run: those of missing outputs, and scratch they depend on."""
        wanted: set[str] = set()
        for step in reversed(job.steps):
            if (not step.scratch or step.output in wanted) and self.made(step.output) is None:
                wanted |= {step.output, *(self._owner(name) for name in step.files)}
        steps = [one for one in job.steps if one.output in wanted and self.made(one.output) is None]
        read = [{self._owner(name) for name in step.files} for step in steps]
        return [
            Order(step, self._key(step.output), {name: self._key(name) for name in sorted(names)})
            for step, names in zip(steps, read, strict=True)
        ]

    def levels(self) -> list[list[Job]]:
        """Return the jobs in order of their dependencies; jobs of a level are independent."""
        job_of = {step.output: job.name for job in self.jobs for step in job.steps}
        needs = {
            job.name: {job_of[self._owner(name)] for step in job.steps for name in step.files} - {job.name}
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
    """Run the missing steps in up to ``jobs`` parallel processes; return one line per failed job."""
    failures = []
    for level in files.levels():
        todo = {job.name: orders for job in level if (orders := files.missing(job))}
        if not todo:
            continue
        with ThreadPoolExecutor(jobs) as pool, bar(title, "recording", len(todo)) as shown:
            running = [pool.submit(_run_process, files.out, name, orders) for name, orders in todo.items()]
            for future in as_completed(running):
                failures += [failure] if (failure := future.result()) else []
                shown.advance()
    return failures


def _run_process(out: Path, name: str, orders: Sequence[Order]) -> str:
    """Run steps in a new process; return the error as a line, or an empty string."""
    found = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    line = [sys.executable, "-m", "research.runner", json.dumps([str(out.resolve()), orders])]
    ended = subprocess.run(line, env=os.environ | ONE_CORE | found, capture_output=True, text=True)
    if ended.returncode == 0:
        return ""
    said = [line for line in ended.stderr.splitlines() if line.startswith("posetrack: ")]
    said = said or ended.stderr.strip().splitlines()
    return f"{name}: {said[-1] if said else f'exit code {ended.returncode}'}"


def run_steps(out: Path, orders: Sequence[Order]) -> list[str]:
    """Run steps in order, then delete scratch; return the outputs that failed.

    A failed step only prevents the steps that depend on it.
    """
    failed = []
    for step, key, inputs in orders:
        stamp_path(out / step.output).unlink(missing_ok=True)  # an old output must not count as current
        try:
            for name in inputs:
                if not _is_made(out / name, inputs[name]):
                    raise PosetrackError(f"{name} was not made")
            step.run(out)
        except PosetrackError as error:
            print(f"posetrack: {error}", file=sys.stderr)
            failed.append(step.output)
        else:
            stamp_path(out / step.output).write_text(key, encoding="utf-8")
    for path in (out / step.output for step, _, _ in orders if step.scratch):
        shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)
        stamp_path(path).unlink(missing_ok=True)
    return failed


def command(*arguments: str) -> None:
    """Run ``posetrack`` in this process; raises PosetrackError if it fails."""
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
        return source_digest(DRAWING) + json.dumps([MEAN_SHAPE.tolist(), SHAPE_SD.tolist()])
    return source_digest()


@cache
def tool_digest(tool: Path) -> str:
    """Return SHA-256 over the tool that draws strangers and the hands that it draws from."""
    data = (tool.parent.parent / "data" / "foreign-hands").glob("*")
    return files_digest([(path.name, path) for path in (tool, *sorted(filter(Path.is_file, data)))])[1]


if __name__ == "__main__":
    folder, given = json.loads(sys.argv[1])
    todo = [
        Order(Step(output, tuple(arguments), scratch), *rest) for (output, arguments, scratch), *rest in given
    ]
    if broken := run_steps(Path(folder), todo):
        raise SystemExit(f"failed: {', '.join(broken)}")
