"""The question the paper left open: PF against RBPF, over many recordings, each with its own process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from reproduction.processes import run_modules
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
    """Track all units, so many at a time, and return what went wrong, a line per unit."""
    out.mkdir(parents=True, exist_ok=True)
    return run_modules({unit.name: _command(unit, entrants, out) for unit in units}, jobs, "study")


def _command(unit: Unit, entrants: Sequence[str], out: Path) -> list[str]:
    arguments = {
        "motion": unit.motion,
        "speed": unit.speed,
        "seed": unit.seed,
        "frames": unit.frames,
        "entrants": ",".join(entrants),
        "out": out,
    }
    return [
        "reproduction.unit",
        *(part for name, value in arguments.items() for part in (f"--{name}", str(value))),
    ]
