"""Compile and cache all kernels by short runs of all trackers, for ``posetrack doctor --warm``.

Container images and CI caches store the compiled code, and parallel processes need not compile it each. Every
tracking run is repeated with cached kernels; it must compile nothing and give an identical file, since
compiled and cached code could sum in different orders.
"""

from __future__ import annotations

import filecmp
import hashlib
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from posetrack_cli.compiled import kernel_folder
from posetrack_cli.errors import PosetrackError

_ALL = """
import gc, sys
gc.disable()  # a compiler's objects stay alive; collection would take an eighth of the time
from posetrack_cli.cli.main import run
sys.exit(next((code for code in map(run, map(str.split, sys.argv[1:])) if code), 0))
"""
# Program that runs command lines (one per argument) in one process until one fails
POSETRACK = (sys.executable, "-c", _ALL)
# Command lines that use every kernel; tuples run in parallel, the lines of a tuple in sequence. The head
# recording is long enough for a skin map.
RUNS = (
    (
        "hand synth --frames 3 -o hand.mcap",
        "hand run hand.mcap --particles 8 --hand-side right -o hand-result.mcap",
        "export hand-result.mcap --estimate-topic /truth/hand/estimate -o keypoints.csv",
        "hand run hand.mcap --particles 8 --hand-side right --keypoints keypoints.csv -o given-result.mcap",
    ),
    (
        "head synth --frames 10 --fps 4 --motion slight --image-size 320x240 -o head.mcap",
        "head stereo head.mcap --particles 20 -o stereo.mcap",
        "head mono head.mcap --cameras left --particles 20 -o mono.mcap",
    ),
)
TRACKERS = ("run", "stereo", "mono")  # commands whose second run must give an identical file


def warm_kernels(report: Callable[[int], object]) -> Path:
    """Compile all kernels unless they are cached, and return the cache folder.

    Args:
        report: called with the number of finished groups of ``RUNS``.

    Raises:
        PosetrackError: no cache folder, a run fails, or compiled and cached kernels differ.
    """
    cache = kernel_folder()
    if cache is None:
        raise PosetrackError(
            "kernels cannot be cached", expected="a writable folder", hint="set NUMBA_CACHE_DIR"
        )
    # numba's cache is specific to the path of the installation
    installation = hashlib.sha256(str(Path(__file__).parent).encode()).hexdigest()[:16]
    done = Path(cache) / f"warm-{installation}"
    if not done.exists():
        with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(len(RUNS)) as threads:
            for _ in threads.map(lambda lines: warm(lines, Path(scratch)), RUNS):
                report(1)
        done.touch()
    return Path(cache)


def warm(lines: Sequence[str], folder: Path) -> None:
    """Run the commands, then repeat those of trackers with cached kernels."""
    _posetrack(lines, folder)
    tracked = [line.rsplit(maxsplit=1) for line in lines if line.split()[1] in TRACKERS]
    messages = _posetrack([f"{command} again-{output}" for command, output in tracked], folder)
    if "compiling" in messages:
        raise PosetrackError("kernels were not cached", found=messages.strip(), expected="no compilation")
    for command, output in tracked:
        if not filecmp.cmp(folder / output, folder / f"again-{output}", shallow=False):
            raise PosetrackError("compiled and cached kernels give different results", where=command)


def _posetrack(lines: Sequence[str], folder: Path) -> str:
    """Run commands in one process, and return its standard error."""
    done = subprocess.run([*POSETRACK, *lines], cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        raise PosetrackError(
            "a command to compile kernels failed", where="; ".join(lines), found=done.stderr.strip()
        )
    return done.stderr
