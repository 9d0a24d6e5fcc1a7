"""What posetrack's commands cost as processes of their own: time of --help, peak memory of long runs."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarking.rows import Row

POSETRACK = (sys.executable, "-m", "posetrack_cli.cli.main")
HELPS = ((), ("head", "stereo"), ("head", "mono"))

# A child's ru_maxrss begins at the size of whoever forked it, so a small process has to do that.
_LAUNCHER = """
import json, os, sys
quiet = os.open(os.devnull, os.O_WRONLY)
actions = [(os.POSIX_SPAWN_DUP2, quiet, 1), (os.POSIX_SPAWN_DUP2, quiet, 2)]
pid = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ, file_actions=actions)
_, status, usage = os.wait4(pid, 0)
print(json.dumps([os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, usage.ru_maxrss]))
"""


def usage_of(command: Sequence[str]) -> tuple[float, float]:
    """Run a command; return its CPU seconds and its peak memory, MiB.

    Raises:
        subprocess.CalledProcessError: it fails.
    """
    launched = subprocess.run(
        [sys.executable, "-S", "-c", _LAUNCHER, *command], check=True, capture_output=True, text=True
    )
    code, seconds, kibibytes = json.loads(launched.stdout)
    if code:
        raise subprocess.CalledProcessError(code, list(command))
    return seconds, kibibytes / 1024


def start_up() -> Iterator[Row]:
    """CPU time of --help."""
    for names in HELPS:
        command = [*POSETRACK, *names, "--help"]
        times = [usage_of(command)[0] for _ in range(6)]
        yield Row(" ".join(["posetrack", *names, "--help, CPU time"]), float(np.median(times[1:])), "s", 0.3)


def peak_memory(
    subject: str, command: Sequence[str], frames: int, folder: Path, target: float | None = None
) -> Iterator[Row]:
    """Peak memory of a run over a tenth of a recording and over all of it.

    Args:
        subject: of the rows' names.
        command: arguments of posetrack, without output and frames.
        frames: of all of it.
        folder: for the results.
        target: of the peaks, MiB.
    """
    peaks = []
    for end in (frames // 10, frames):
        output = ["-o", str(folder / f"{end}.mcap"), "--end", str(end)]
        peaks.append(usage_of([*POSETRACK, *command, *output])[1])
        yield Row(f"{subject}, peak memory, {end} frames", peaks[-1], "MiB", target)
    yield Row(f"{subject}, ten times the frames over one time", peaks[1] / peaks[0], "", 1.05)
