"""Compile every kernel, unless that was done: short runs of all trackers, before processes that need them.

Without, each process of a parallel test run would compile what it comes to first, some of it twice. Each run
is done once more with the kernels that were kept: it must compile nothing and give the same bytes. Freshly
compiled and loaded code once added up in different orders.
"""

from __future__ import annotations

import filecmp
import hashlib
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from posetrack_cli.compiled import kernel_folder

_ALL = """
import gc, sys
gc.disable()  # a compiler's objects stay; an eighth of its time went into looking for those that do not
from posetrack_cli.cli.main import run
sys.exit(next((code for code in map(run, map(str.split, sys.argv[1:])) if code), 0))
"""
POSETRACK = (sys.executable, "-c", _ALL)
"""Runs command lines, each an argument, one after the other in one process, up to one that fails."""
RUNS = (
    (
        "hand synth --frames 3 -o hand.mcap",
        "hand run hand.mcap --particles 8 --hand-side right -o hand-result.mcap",
        "export hand-result.mcap --estimate-topic /truth/hand/estimate -o told.csv",
        "hand run hand.mcap --particles 8 --hand-side right --keypoints told.csv -o told-result.mcap",
    ),
    (
        "head synth --frames 10 --fps 4 --motion slight --image-size 320x240 -o head.mcap",
        "head stereo head.mcap --particles 20 -o stereo.mcap",
        "head mono head.mcap --cameras left --particles 20 -o mono.mcap",
    ),
)
"""Command lines that come to every kernel; each tuple's one after the other, the tuples side by side. The
head is seen for long enough to make a map of its skin."""
TRACKERS = ("run", "stereo", "mono")  # commands of which a second run must give the same bytes


def main() -> None:
    """Do the runs if this checkout's kernels are not in the cache."""
    folder = kernel_folder()
    if folder is None:
        return
    checkout = hashlib.sha256(str(Path(__file__).parent).encode()).hexdigest()[:16]
    done = Path(folder) / f"warm-{checkout}"
    if done.exists():
        return
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(len(RUNS)) as threads:
        for _ in threads.map(lambda lines: warm(lines, Path(scratch)), RUNS):
            pass
    done.touch()


def warm(lines: Sequence[str], folder: Path) -> None:
    """Do runs, then those of trackers once more, with what was compiled."""
    _posetrack(lines, folder)
    tracked = [line.rsplit(maxsplit=1) for line in lines if line.split()[1] in TRACKERS]
    said = _posetrack([f"{command} again-{output}" for command, output in tracked], folder)
    if "compiling" in said:
        raise SystemExit(f"the kernels are not kept: {said.strip()}")
    for command, output in tracked:
        if not filecmp.cmp(folder / output, folder / f"again-{output}", shallow=False):
            raise SystemExit(f"posetrack {command}: compiled and loaded kernels give different bytes")


def _posetrack(lines: Sequence[str], folder: Path) -> str:
    """Run commands in a process of their own, and return what they say on standard error."""
    done = subprocess.run([*POSETRACK, *lines], cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"posetrack, one of {'; '.join(lines)}: {done.stderr.strip()}")
    return done.stderr


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # and not at once: what is temporary goes
    main()
