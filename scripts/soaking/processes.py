"""Commands as processes of their own: started, watched, and judged by how they ended."""

from __future__ import annotations

import json
import os
import resource
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarking.commands import POSETRACK
from posetrack_cli.recording.base import TRUTH_PREFIX
from posetrack_cli.results.channels import SMOOTHED_PREFIX
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME

DONE, FAILED, DATA_LOST = 0, 1, 3
LINE = "posetrack: "


@dataclass(frozen=True)
class Ended:
    """How a process ended: its exit code and what it wrote on standard error."""

    code: int
    said: str

    def troubles(self, codes: Sequence[int]) -> Iterator[str]:
        """Yield what is not as it must be: another exit code, a traceback, not one line for a failure."""
        lines = self.said.splitlines()
        told = [line for line in lines if line.startswith(LINE)]
        wanted = 1 if self.code == FAILED else 0
        last = f"; said: {lines[-1][:300]}" if lines else ""
        if self.code not in codes:
            yield f"exit code {self.code}, expected {' or '.join(map(str, codes))}{last}"
        if any("Traceback" in line or "Warning:" in line for line in lines):
            yield f"a traceback or a Python warning{last}"
        if self.code in codes and len(told) != wanted:
            yield f"{len(told)} lines '{LINE}...', expected {wanted}{last}"


class Started:
    """A process that was started, with its standard error in a file.

    Args:
        process: the process.
        said: the file.
    """

    def __init__(self, process: subprocess.Popen[bytes], said: Path) -> None:
        self.process, self._said = process, said

    @property
    def said(self) -> str:
        """What it has written on standard error."""
        return self._said.read_text(errors="replace")

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self.process.poll() is None

    def end(self) -> Ended:
        """Wait for its end."""
        return Ended(self.process.wait(), self.said)


@contextmanager
def started(
    command: Sequence[str],
    said: Path,
    environment: Mapping[str, str] | None = None,
    *,
    file_bytes: int | None = None,
) -> Iterator[Started]:
    """Start a command, and kill it if it still runs at the end of the context.

    Args:
        command: the command.
        said: file for its standard error.
        environment: variables in place of, or beside, this process's own.
        file_bytes: no file may grow larger than this; None for no limit.
    """
    with said.open("wb") as stream:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=stream,
            env={**os.environ, **(environment or {})},
        )
    try:
        if file_bytes is not None:  # long before it has loaded what it writes with
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
        yield Started(process, said)
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def run_to_end(command: Sequence[str], said: Path, *, file_bytes: int | None = None) -> Ended:
    """Run a command and wait for it."""
    with started(command, said, file_bytes=file_bytes) as run:
        return run.end()


def frames_readable(path: Path) -> tuple[int, Ended]:
    """Ask ``posetrack info`` how many frames an unfinished result holds; 0 where it cannot be read."""
    asked = subprocess.run([*POSETRACK, "info", str(path), "--json", "-"], capture_output=True, text=True)
    ended = Ended(asked.returncode, asked.stderr)
    if ended.code not in (DONE, DATA_LOST):
        return 0, ended
    topics = json.loads(asked.stdout)["topics"]
    estimates = [topic for topic in topics if topic["type"] == ESTIMATE_SCHEMA_NAME]
    others = (SMOOTHED_PREFIX, TRUTH_PREFIX)
    return sum(t["messages"] for t in estimates if not t["topic"].startswith(others)), ended
