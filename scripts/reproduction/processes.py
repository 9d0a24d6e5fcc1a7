"""Many commands, some at a time, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from posetrack_cli.cli.progress import bar

ONE_CORE = dict.fromkeys(
    ("LP_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)


def run_modules(
    commands: Mapping[str, Sequence[str]], jobs: int, title: str, *, one_core: bool = True
) -> list[str]:
    """Run Python modules with their arguments, so many at a time; return what went wrong, a line for each.

    A process per command: one that fails loses only its own recording.

    Args:
        commands: by name the module and its arguments.
        jobs: processes at a time.
        title: of the progress bar.
        one_core: whether each keeps to one core: software GL gains less from a second core than a second
            recording does.
    """
    cores = ONE_CORE if one_core else {}
    with ThreadPoolExecutor(jobs) as pool:
        running = {pool.submit(_run, name, command, cores) for name, command in commands.items()}
        failures = []
        with bar(title, "recording", len(running)) as shown:
            for future in as_completed(running):
                failures += [failure] if (failure := future.result()) else []
                shown.advance()
        return failures


def _run(name: str, command: Sequence[str], cores: Mapping[str, str]) -> str:
    found = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    ended = subprocess.run(
        [sys.executable, "-m", *command], env=os.environ | cores | found, capture_output=True, text=True
    )
    if ended.returncode == 0:
        return ""
    said = [line for line in ended.stderr.splitlines() if line.startswith("posetrack: ")]
    said = said or ended.stderr.strip().splitlines()
    return f"{name}: {said[-1] if said else f'exit code {ended.returncode}'}"
