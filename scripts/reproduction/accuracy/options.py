"""What the study is asked for, and what every part of it has in common."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from reproduction import running
from reproduction.accuracy.measuring import Measured
from reproduction.accuracy.tasks import Task
from reproduction.running import FIRST_SEED

NO_MESH = ("--set", "output.mesh=none")
"""Nobody looks at the hands of the study."""
AVERAGE = ("--shape", "average")
"""The hand that is drawn is known to be the average one: no time goes into finding that out."""


@dataclass(frozen=True)
class Options:
    """How much is done.

    Attributes:
        output: folder of everything.
        seeds: recordings per condition.
        frames: per synthetic recording.
        hand_seeds: recordings of each other hand.
        kinect: folder of the real Kinect v2 recording; None leaves it out.
        cvar: folder of the annotated, head-mounted recordings; None leaves them out.
        mesh: GLB file of a hand; None leaves it out.
        first_seed: of the recordings; others than the default's are for trying things out.
        entrants: those that are run now; none for all. Results that are there already count in any case.
    """

    output: Path
    seeds: int = 20
    frames: int = 300
    hand_seeds: int = 3
    kinect: Path | None = None
    cvar: Path | None = None
    mesh: Path | None = None
    first_seed: int = FIRST_SEED
    entrants: tuple[str, ...] = ()

    @property
    def runs(self) -> Path:
        """Where results lie."""
        return self.output / "runs"


class Part(running.Part[Options, Measured], Protocol):
    """One part of the study: the recordings it needs, and what it says about their results."""

    def tasks(self, options: Options) -> list[Task]:
        """What has to be tracked."""


def synthetic(
    options: Options, motion: str, speed: float, seed: int, *more: str, frames: int | None = None
) -> tuple[str, ...]:
    """Arguments that make a synthetic recording, with all that the motion usually has around it."""
    made = {"--motion": motion, "--speed": f"{speed:g}", "--seed": str(seed)}
    made["--frames"] = str(frames or options.frames)
    return ("hand", "synth", *(part for pair in made.items() for part in pair), *more, "-o")


def seeds(options: Options) -> range:
    """The seeds of the reported figures."""
    return range(options.first_seed, options.first_seed + options.seeds)
