"""Compile every kernel, unless that was done: short runs of all trackers, before processes that need them.

Without, each process of a parallel test run would compile what it comes to first, some of it twice.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from posetrack_cli.compiled import cache_folder

POSETRACK = (sys.executable, "-m", "posetrack_cli.cli.main")
RUNS = (
    ("hand synth --frames 3 -o hand.mcap", "hand run hand.mcap --particles 8 -o hand-result.mcap"),
    (
        "head synth --frames 3 --image-size 320x240 -o head.mcap",
        "head stereo head.mcap --particles 20 -o stereo.mcap",
        "head mono head.mcap --cameras left --particles 20 -o mono.mcap",
    ),
)
"""Command lines that come to every kernel; each tuple's one after the other, the tuples side by side."""


def main() -> None:
    """Do the runs if this checkout's kernels are not in the cache."""
    folder = cache_folder()
    if folder is None:
        return
    checkout = hashlib.sha256(str(Path(__file__).parent).encode()).hexdigest()[:16]
    done = Path(folder) / f"warm-{checkout}"
    if done.exists():
        return
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(len(RUNS)) as threads:
        for _ in threads.map(lambda lines: _run(lines, scratch), RUNS):
            pass
    done.touch()


def _run(lines: Sequence[str], folder: str) -> None:
    for line in lines:
        subprocess.run([*POSETRACK, *line.split()], cwd=folder, capture_output=True, check=True)


if __name__ == "__main__":
    main()
