"""Whole commands, file to file with start-up: CPU time per frame, and cost per recorded hour."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarking.processes import POSETRACK, usage_of
from benchmarking.rows import Row
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE
from posetrack_cli.results.reader import read_result
from research.hand_accuracy import KINECT_CAMERA
from research.runner import SHARED

CENTS_PER_CORE_HOUR = 2.0
FACEMESH_MS = 3.6
"""CPU time per frame of clip-a with decoding, MediaPipe 0.10.21; measured once on this kind of machine."""
FPS = 30.0
WARM_UP_FRAMES = 40
STRANGER = 800  # person and motion of foreign_hand.py, for measuring only


class Case(NamedTuple):
    """A command line without its output."""

    name: str
    line: tuple[str, ...]


class Usage(NamedTuple):
    """Time of one run."""

    cpu_s: float
    wall_s: float
    frames: int
    recorded_s: float


def files(frames: int | None, repeats: int, previous: Path | None) -> Iterator[Row]:
    """Yield CPU time and cost of each case, and of the previous version, alternately.

    Args:
        frames: number of frames of each recording; None for all.
        repeats: runs of each version, of which the median counts.
        previous: checkout of the previous version; None measures only this one.
    """
    versions: dict[str, tuple[str, ...]] = {"": POSETRACK}
    if previous is not None:  # its sources with this environment's libraries
        versions["previous version"] = ("/usr/bin/env", f"PYTHONPATH={previous.resolve()}", *POSETRACK)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for case in _cases(folder):
            runs: dict[str, list[Usage]] = {version: [] for version in versions}
            for command in versions.values():
                _run(command, case, folder, WARM_UP_FRAMES)  # compiles the kernels
            for repeat in range(repeats):
                for version in list(versions)[:: 1 if repeat % 2 else -1]:
                    runs[version].append(_run(versions[version], case, folder, frames))
            yield from _rows(case.name, runs)
    yield from _costs("FaceMesh on clip-a (peer)", FACEMESH_MS, FACEMESH_MS * 1e-3 * FPS)


def _rows(name: str, runs: dict[str, list[Usage]]) -> Iterator[Row]:
    own = runs[""]
    cpu_s = float(np.median([one.cpu_s for one in own]))
    yield Row(f"{name}, CPU time", cpu_s, "s")
    yield Row("  frames a second", own[0].frames / float(np.median([one.wall_s for one in own])), "")
    yield from _costs(name, 1e3 * cpu_s / own[0].frames, cpu_s / own[0].recorded_s)
    if before := runs.get("previous version"):
        earlier_s = float(np.median([one.cpu_s for one in before]))
        yield Row(f"{name}, previous version, CPU time a frame", 1e3 * earlier_s / before[0].frames, "ms")
        yield Row("  this version over it", cpu_s / earlier_s, "")


def _costs(name: str, frame_ms: float, share: float) -> Iterator[Row]:
    """Yield the cost of ``share`` seconds of CPU time per recorded second."""
    yield Row(f"{name}, CPU time a frame", frame_ms, "ms")
    yield Row(f"{name}, core-hours a recorded hour", share, "h")
    yield Row(f"{name}, cents a recorded hour", CENTS_PER_CORE_HOUR * share, "")


def _run(command: Sequence[str], case: Case, folder: Path, frames: int | None) -> Usage:
    output = folder / "result.mcap"
    end = () if frames is None else ("--end", str(frames))
    began = time.perf_counter()
    cpu_s, _ = usage_of(
        [*command, *case.line, "-o", str(output), "--overwrite", "-q", *end], (EXIT_DONE, EXIT_DATA_LOST)
    )
    wall_s = time.perf_counter() - began
    stamps = read_result(output).columns(fields=("stamp_ns",))["stamp_ns"]
    spacing_s = 1e-9 * float(stamps[-1] - stamps[0]) / (len(stamps) - 1)
    return Usage(cpu_s, wall_s, len(stamps), spacing_s * len(stamps))


def _cases(folder: Path) -> Iterator[Case]:
    """Yield the cases, real data first; those whose data is missing are left out."""
    data = SHARED / "data"
    rate = ("--fps", f"{FPS:g}")
    if (kinect := data / "kinect2-hand").is_dir():
        camera = folder / "kinect.toml"
        camera.write_text(KINECT_CAMERA, encoding="utf-8")
        yield Case("Kinect folder", ("hand", "run", str(kinect), "--camera", str(camera), *rate))
    if (tool := SHARED / "tools" / "foreign_hand.py").is_file():
        drawn = ["--person", str(STRANGER), "--motion", str(STRANGER), "--frames", "150"]
        subprocess.run([sys.executable, str(tool), str(folder / "stranger"), *drawn], check=True)
        yield Case("stranger", ("hand", "run", str(folder / "stranger" / "depth")))
    if (clip := data / "faces" / "clip-a.mp4").is_file():
        yield Case("clip-a", ("head", "mono", str(clip)))
        yield Case("clip-a, one pass", ("head", "mono", str(clip), "--passes", "1"))
    for name, made, line in (
        ("own hand model", ("hand", "synth", "--motion", "C", "--frames", "300"), ("hand", "run")),
        ("rendered head, two cameras", ("head", "synth", "--frames", "150"), ("head", "stereo")),
    ):
        path = folder / f"{made[0]}.mcap"
        usage_of([*POSETRACK, *made, "--seed", "201", "-o", str(path)])
        yield Case(name, (*line, str(path)))
