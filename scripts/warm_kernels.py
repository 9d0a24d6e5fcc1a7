"""Compile and cache all kernels by short runs of all trackers, unless the cache is current.

Otherwise the processes of a parallel test run would compile kernels several times. Each tracking run is
repeated with cached kernels; it must compile nothing and give an identical file, since freshly compiled and
cached code could sum in different orders.
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
        "export hand-result.mcap --estimate-topic /truth/hand/estimate -o told.csv",
        "hand run hand.mcap --particles 8 --hand-side right --keypoints told.csv -o told-result.mcap",
    ),
    (
        "head synth --frames 10 --fps 4 --motion slight --image-size 320x240 -o head.mcap",
        "head stereo head.mcap --particles 20 -o stereo.mcap",
        "head mono head.mcap --cameras left --particles 20 -o mono.mcap",
    ),
)
TRACKERS = ("run", "stereo", "mono")  # commands whose second run must give an identical file


def main() -> None:
    """Run the commands unless the kernels of this checkout are cached."""
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
    """Run the commands, then repeat those of trackers with cached kernels."""
    _posetrack(lines, folder)
    tracked = [line.rsplit(maxsplit=1) for line in lines if line.split()[1] in TRACKERS]
    said = _posetrack([f"{command} again-{output}" for command, output in tracked], folder)
    if "compiling" in said:
        raise SystemExit(f"kernels were not cached: {said.strip()}")
    for command, output in tracked:
        if not filecmp.cmp(folder / output, folder / f"again-{output}", shallow=False):
            raise SystemExit(f"posetrack {command}: compiled and cached kernels give different results")


def _posetrack(lines: Sequence[str], folder: Path) -> str:
    """Run commands in one process, and return its standard error."""
    done = subprocess.run([*POSETRACK, *lines], cwd=folder, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"posetrack, one of {'; '.join(lines)}: {done.stderr.strip()}")
    return done.stderr


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # exit normally: deletes temporary files
    main()
