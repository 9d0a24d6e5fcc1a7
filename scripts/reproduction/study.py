"""The question the paper left open: PF against RBPF, over many recordings, each with its own process."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from reproduction.unit import Unit

STUDIED = ("pf-printed", "rbpf-printed", "pf-paper", "rbpf-paper", "pf-union", "rbpf-union")
MOTIONS, SPEEDS = ("A", "B", "C"), (1.0, 2.0)
FIRST_SEED = 201
"""Seeds from here on were not used for tuning or elsewhere."""


@dataclass(frozen=True)
class Condition:
    """A kind of recording."""

    motion: str
    speed: float

    def units(self, seeds: int, frames: int) -> list[Unit]:
        """Its recordings."""
        return [Unit(self.motion, self.speed, FIRST_SEED + k, frames) for k in range(seeds)]


CONDITIONS = tuple(Condition(motion, speed) for motion in MOTIONS for speed in SPEEDS)


def run_units(units: Sequence[Unit], entrants: Sequence[str], out: Path, jobs: int) -> list[str]:
    """Track all units, so many at a time, and return what went wrong, a line per unit.

    A process per unit: one that fails loses only its own recording. Each draws on one core: software GL
    gains less from a second core than a second unit does.
    """
    out.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(jobs) as pool:
        running = {pool.submit(_track, unit, entrants, out): unit for unit in units}
        done = tqdm(as_completed(running), total=len(running), desc="study", unit="recording", disable=None)
        return [failure for future in done if (failure := future.result())]


def _track(unit: Unit, entrants: Sequence[str], out: Path) -> str:
    arguments = {
        "motion": unit.motion,
        "speed": unit.speed,
        "seed": unit.seed,
        "frames": unit.frames,
        "entrants": ",".join(entrants),
        "out": out,
    }
    command = [sys.executable, "-m", "reproduction.unit"]
    command += [part for name, value in arguments.items() for part in (f"--{name}", str(value))]
    one_core = dict.fromkeys(("LP_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    found = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    ended = subprocess.run(command, env=os.environ | one_core | found, capture_output=True, text=True)
    if ended.returncode == 0:
        return ""
    said = ended.stderr.strip().splitlines()
    return f"{unit.name}: {said[-1] if said else f'exit code {ended.returncode}'}"
